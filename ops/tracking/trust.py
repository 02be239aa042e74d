"""This module judges which keypoints and nodes are reliable, and computes poses from which unreliable tracks restart.

It also exchanges left and right leg keypoints if a camera has confused them. A detector that takes the left leg for the
right leg reports both with full confidence. To detect this, the keypoints are compared with poses that do not depend on
them, which are interpolated or come from a prior: the exchanged keypoints match such poses, but the reported ones do
not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.body.kinematic_chain import ChainArrays, ChainBody, Poses, forward, pose_nodes, rotation_of, vector_of
from kinedex.ops.tracking.blocks import frame_buffers, place_points
from kinedex.ops.tracking.observations import MIN_CONFIDENCE, BodyPoints, JointPositions, Rays
from kinedex.ops.tracking.rays import MIN_DEPTH_M, SIGMA_PX, Evidence, make_evidence

TRUST_WIDTH = 3.0
"""The width c of the robust loss whose weights measure the reliability of keypoints."""

SEEN = 1.2
"""Minimum sum of confidence times robust weight over cameras for a keypoint to count as seen in a frame."""

AGREEMENT = 0.6
"""Minimum ratio of Σ conf · ω to Σ conf of a keypoint; below it the cameras contradict each other."""

NEEDED = {
    "hip": ("hip", "knee", "ankle"),
    "knee": ("knee", "ankle"),
    "ankle": ("ankle", "toes"),
    "shoulder": ("shoulder", "elbow", "wrist"),
    "elbow": ("elbow", "wrist"),
    "wrist": ("wrist",),
}
"""The joints of a side that must be seen for a node of this side to count as seen; other nodes always count as seen."""

LEG = ("hip", "knee", "ankle", "toes")
"""The joints of a leg, whose keypoints are exchanged together."""

CLEARLY = 0.8
"""Ratio of the costs of exchanged and reported keypoints below which keypoints are exchanged."""

_WIDTH = 3.0  # the width c of the robust loss


@dataclass(frozen=True, eq=False)
class Trust:
    """The reliability of the observations of a track, by keypoint and by node.

    Attributes
    ----------
    keypoints : float64 array (T, P)
        κ = Σ conf · ω over the cameras, with the robust weights ω; 0 if the keypoint is contested. For joint positions
        it is 2 ω.
    contested : bool array (T, P)
        True if the cameras contradict each other.
    nodes_seen : bool array (T, K)
        True if the joints that a node needs (`NEEDED`) are seen.
    """

    keypoints: F64
    contested: Bool
    nodes_seen: Bool


def trust(
    body: ChainBody,
    observations: Rays | JointPositions,
    points: BodyPoints | None,
    poses: Poses,
    sigma_px: float = SIGMA_PX,
) -> Trust:
    """Compute how well the observations agree with a track.

    Parameters
    ----------
    body : ChainBody
        A body of the shipped chain's nodes.
    observations : Rays or JointPositions
        The observations of T frames.
    points : BodyPoints or None
        The points that rays observe; None for joint positions.
    poses : Poses
        The track, T poses.
    sigma_px : float, optional
        Standard deviation of a keypoint in pixels.
    """
    evidence = make_evidence(body, observations, points, sigma_px)
    agreed, given = np.empty((2, len(poses.positions), len(evidence.nodes)))
    _sums(body.arrays, evidence, poses.positions, poses.rotations, agreed, given)
    contested = (given > 0) & (agreed < AGREEMENT * given)
    keypoints = np.where(contested, 0.0, agreed)
    joints = np.arange(len(evidence.nodes)) if points is None else points.joints
    return Trust(keypoints, contested, _nodes_seen(body, joints, keypoints > SEEN))


@njit(cache=True, nogil=True)
def _sums(chain: ChainArrays, evidence: Evidence, positions: F64, rotations: F64, agreed: F64, given: F64) -> None:
    """Compute Σ conf · ω and Σ conf of every keypoint; a joint position counts like two cameras."""
    buffers = frame_buffers(chain, evidence)
    agreed[:], given[:] = 0.0, 0.0
    for t in range(len(positions)):
        pose_nodes(chain, positions[t], rotations[t], buffers.turned, buffers.centres)
        place_points(evidence.nodes, evidence.offsets, buffers.turned, buffers.centres, buffers.points)
        for p in range(len(buffers.points)):
            for v in range(len(evidence.centres)):
                confidence = evidence.confidence[t, v, p]
                if confidence > 0.0:
                    gap = buffers.points[p] - evidence.centres[v]
                    depth = (gap * evidence.directions[t, v, p]).sum()
                    gap -= depth * evidence.directions[t, v, p]
                    unit = evidence.scales[v] / max(MIN_DEPTH_M, depth)
                    given[t, p] += confidence
                    agreed[t, p] += confidence * (1.0 + (gap * gap).sum() * (unit / TRUST_WIDTH) ** 2) ** -2
            if len(evidence.positions) > 0 and not np.isnan(evidence.positions[t, p, 0]):
                gap = buffers.points[p] - evidence.positions[t, p]
                given[t, p] += 2.0
                square = (gap * gap).sum() * (evidence.precisions[t, p] / TRUST_WIDTH) ** 2
                agreed[t, p] += 2.0 * (1.0 + square) ** -2


def _nodes_seen(body: ChainBody, joints: I64, seen: Bool) -> Bool:
    """Return a mask (T, K) of the nodes that are seen, from keypoints (T, P); toes without keypoints are ignored."""
    chain = body.chain
    found = np.ones((len(seen), len(chain.nodes)), np.bool_)
    column = {chain.joints[joint]: p for p, joint in enumerate(joints) if joint >= 0}
    for k, node in enumerate(chain.nodes):
        for name in NEEDED.get(node[1:], ()):
            joint = node[0] + name
            if joint in column:
                found[:, k] &= seen[:, column[joint]]
            elif name != "toes":
                found[:, k] = False
    return found


def restart(body: ChainBody, poses: Poses, nodes_seen: Bool) -> Poses:
    """Return initial poses for tracking again, with unseen nodes interpolated, and the pelvis if neither hip is seen.

    A solver converges to a solution near its start. If cameras contradict each other, or too few cameras see a limb, a
    start that is interpolated from neighbouring frames is better than one from the observations.

    Parameters
    ----------
    body : ChainBody
        A body of the shipped chain's nodes.
    poses : Poses
        The track, T poses.
    nodes_seen : bool array (T, K)
        True if a node is seen, see `Trust`.

    Returns
    -------
    Poses
        The poses with interpolated values. The rotation of an unseen node is interpolated between the nearest frames
        before and after in which the node is seen, and constant before the first and after the last such frame. The
        position of the body is interpolated likewise if the pelvis is unseen.
    """
    nodes = body.chain.nodes
    known = nodes_seen.copy()
    known[:, 0] = nodes_seen[:, [nodes.index("lhip"), nodes.index("rhip")]].any(axis=1)
    return interpolated(poses, known)


def interpolated(poses: Poses, known: Bool) -> Poses:
    """Return poses with unknown rotations interpolated; the position is interpolated with the first node.

    Parameters
    ----------
    poses : Poses
        T poses of K nodes.
    known : bool array (T, K)
        True if a rotation is kept. A node that is known in no frame is not changed.
    """
    positions, rotations = poses.positions.copy(), poses.rotations.copy()
    for k in range(known.shape[1]):
        frames = np.flatnonzero(known[:, k])
        if len(frames) in (0, len(known)):
            continue
        after = np.searchsorted(frames, np.arange(len(known)))
        low, high = frames[np.maximum(after - 1, 0)], frames[np.minimum(after, len(frames) - 1)]
        for t in np.flatnonzero(~known[:, k]):
            one, two = low[t], high[t]
            share = (t - one) / (two - one) if two > one else 0.0
            way = vector_of(np.ascontiguousarray(poses.rotations[one, k].T) @ poses.rotations[two, k])
            rotations[t, k] = poses.rotations[one, k] @ rotation_of(share * way)
            if k == 0:
                positions[t] = (1.0 - share) * poses.positions[one] + share * poses.positions[two]
    return Poses(positions, rotations)


def exchanged_sides(
    body: ChainBody,
    observations: Rays | JointPositions,
    points: BodyPoints | None,
    poses: Poses,
    sigma_px: float = SIGMA_PX,
) -> Rays | JointPositions:
    """Return rays with the legs exchanged in each frame and camera in which this matches the poses clearly better.

    Parameters
    ----------
    body : ChainBody
        A body of the shipped chain's joints.
    observations : Rays or JointPositions
        The observations of T frames; joint positions are returned unchanged.
    points : BodyPoints or None
        The points that rays observe, of which only joints of the legs are exchanged; None for joint positions.
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
    positions = _places(body, points, poses, mine)
    exchanged = _costs(rays, positions, other, sigma_px) < CLEARLY * _costs(rays, positions, mine, sigma_px)
    directions, confidence = rays.directions.copy(), rays.confidence.copy()
    directions[:, :, mine] = np.where(exchanged[..., None, None], rays.directions[:, :, other], directions[:, :, mine])
    confidence[:, :, mine] = np.where(exchanged[..., None], rays.confidence[:, :, other], confidence[:, :, mine])
    return replace(rays, directions=directions, confidence=confidence)


def _places(body: ChainBody, points: BodyPoints, poses: Poses, chosen: I64) -> F64:
    """Return the positions (T, L, 3) of the chosen points of the body."""
    positions, turned = forward(body, poses)
    nodes = points.nodes[chosen]
    centres = positions[np.array(body.chain.centres)[nodes]].transpose(2, 0, 1)
    return centres + np.einsum("tlij,lj->tli", turned[:, nodes], points.offsets[chosen])


def _costs(rays: Rays, positions: F64, keypoints: I64, sigma_px: float) -> F64:
    """Return the robust cost (T, V) of keypoints as observations of positions (T, L, 3)."""
    gaps = positions[:, None] - rays.centres[None, :, None]
    depths = np.einsum("tvli,tvli->tvl", gaps, rays.directions[:, :, keypoints])
    squares = np.maximum((gaps**2).sum(axis=3) - depths**2, 0.0)
    units = rays.focal_px[None, :, None] / (sigma_px * np.maximum(depths, MIN_DEPTH_M))
    squares *= units**2
    confidence = rays.confidence[:, :, keypoints]
    seen = (confidence >= MIN_CONFIDENCE) & np.isfinite(squares)
    costs: F64 = np.where(seen, confidence**2 * squares / (1.0 + squares / _WIDTH**2), 0.0).sum(axis=2)
    return costs
