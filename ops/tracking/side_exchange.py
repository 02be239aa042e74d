"""This module exchanges leg keypoints whose sides a camera confuses, where this agrees with the poses of a track.

A detector that takes the left leg for the right one reports both with full confidence. Compared with poses that do not
depend on these keypoints (interpolated, or from a prior), the exchanged keypoints fit and the reported ones do not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.kinematic_chain import ChainBody, Poses, forward
from kinedex.ops.tracking.observations import BodyPoints, Places, Rays
from kinedex.ops.tracking.rays import LEAST_CONFIDENCE, LEAST_DEPTH_M, SIGMA_PX

LEG = ("hip", "knee", "ankle", "toes")
"""The joints of a leg, whose keypoints are exchanged together."""

CLEARLY = 0.8
"""Ratio of costs, exchanged to reported, below which keypoints are exchanged."""

_WIDTH = 3.0  # the width c of the robust loss


def exchanged_sides(
    body: ChainBody,
    observations: Rays | Places,
    points: BodyPoints | None,
    poses: Poses,
    sigma_px: float = SIGMA_PX,
) -> Rays | Places:
    """Return rays with the legs exchanged in each frame and camera where this fits the poses clearly better.

    Parameters
    ----------
    body : ChainBody
        A body of the shipped chain's joints.
    observations : Rays or Places
        The observations of T frames; places are returned unchanged.
    points : BodyPoints or None
        The points that rays observe; only joints of the legs are exchanged. None for places.
    poses : Poses
        T poses.
    sigma_px : float, optional
        Standard deviation of a keypoint in pixels.
    """
    if points is None or not isinstance(observations, Rays):
        return observations
    rays = observations
    column = {body.chain.joints[joint]: p for p, joint in enumerate(points.joints) if joint >= 0}
    pairs = [(column["l" + name], column["r" + name]) for name in LEG if {"l" + name, "r" + name} <= column.keys()]
    if not pairs:
        return rays
    left, right = (np.array(side, np.int64) for side in zip(*pairs, strict=True))
    mine, other = np.concatenate([left, right]), np.concatenate([right, left])
    places = _places(body, points, poses, mine)
    exchanged = _costs(rays, places, other, sigma_px) < CLEARLY * _costs(rays, places, mine, sigma_px)
    directions, confidence = rays.directions.copy(), rays.confidence.copy()
    directions[:, :, mine] = np.where(exchanged[..., None, None], rays.directions[:, :, other], directions[:, :, mine])
    confidence[:, :, mine] = np.where(exchanged[..., None], rays.confidence[:, :, other], confidence[:, :, mine])
    return replace(rays, directions=directions, confidence=confidence)


def _places(body: ChainBody, points: BodyPoints, poses: Poses, chosen: I64) -> F64:
    """Return the positions (T, L, 3) of some points of the body."""
    positions, turned = forward(body, poses)
    nodes = points.nodes[chosen]
    centres = positions[np.array(body.chain.centres)[nodes]].transpose(2, 0, 1)
    return centres + np.einsum("tlij,lj->tli", turned[:, nodes], points.offsets[chosen])


def _costs(rays: Rays, places: F64, keypoints: I64, sigma_px: float) -> F64:
    """Return the robust cost (T, V) of keypoints as observations of positions (T, L, 3)."""
    gaps = places[:, None] - rays.centres[None, :, None]
    depths = np.einsum("tvli,tvli->tvl", gaps, rays.directions[:, :, keypoints])
    squares = np.maximum((gaps**2).sum(axis=3) - depths**2, 0.0)
    units = rays.focal_px[None, :, None] / (sigma_px * np.maximum(depths, LEAST_DEPTH_M))
    squares *= units**2
    confidence = rays.confidence[:, :, keypoints]
    seen = (confidence >= LEAST_CONFIDENCE) & np.isfinite(squares)
    costs: F64 = np.where(seen, confidence**2 * squares / (1.0 + squares / _WIDTH**2), 0.0).sum(axis=2)
    return costs
