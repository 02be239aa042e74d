"""This module measures the distances between keypoints and a track in the images of the cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.body.kinematic_chain import Poses, forward
from kinedex.ops.tracking.contours import Observed
from kinedex.ops.tracking.observations import MIN_CONFIDENCE, Rays
from kinedex.ops.tracking.rays import MIN_DEPTH_M, SIGMA_PX
from kinedex.ops.tracking.trust import TRUST_WIDTH

_MEDIAN_OF_GAUSSIAN = 1.1774  # median distance from the centre of a 2D Gaussian, in standard deviations


def keypoint_sigma(rays: Rays, points: F64) -> float:
    """Return the standard deviation of keypoints in pixels, from their distances to their triangulated points.

    Parameters
    ----------
    rays : Rays
        Rays of keypoints.
    points : float64 array (T, P, 3)
        Their triangulated points in metres; NaN if there is none.

    Returns
    -------
    float
        The median distance divided by that of a 2D Gaussian of deviation 1; at least `SIGMA_PX`.
    """
    gaps = points[:, None] - rays.centres[None, :, None]
    depths = np.einsum("tvpi,tvpi->tvp", gaps, rays.directions)
    apart = np.linalg.norm(gaps - depths[..., None] * rays.directions, axis=3)
    used = (rays.confidence >= MIN_CONFIDENCE) & (depths > MIN_DEPTH_M)
    pixels = (apart / np.where(used, depths, 1.0) * rays.focal_px[None, :, None])[used]
    return max(SIGMA_PX, float(np.median(pixels)) / _MEDIAN_OF_GAUSSIAN) if len(pixels) else SIGMA_PX


@dataclass(frozen=True, eq=False)
class RayResiduals:
    """The distances of keypoints from a track in the images.

    Attributes
    ----------
    pixels : float64 array (T, V, P)
        Distance of each point of the body from the ray of its keypoint, in pixels; NaN if the keypoint is not seen.
    weights : float64 array (T, V, P)
        The robust weight of each distance, from 0 (excluded) to 1; 0 if the keypoint is not seen.
    """

    pixels: F64
    weights: F64


def ray_residuals(observed: Observed, poses: Poses, sigma_px: float) -> RayResiduals:
    """Return the residuals of the rays of a recording.

    Parameters
    ----------
    observed : Observed
        A recording with rays.
    poses : Poses
        The track.
    sigma_px : float
        Standard deviation of a keypoint in pixels.
    """
    rays, points = observed.observations, observed.points
    assert isinstance(rays, Rays)
    assert points is not None
    positions, turned = forward(observed.body, poses)
    centres = positions[list(observed.body.chain.centres)].transpose(2, 0, 1)[:, points.nodes]
    places = centres + np.einsum("tpij,pj->tpi", turned[:, points.nodes], points.offsets)
    gaps = places[:, None] - rays.centres[None, :, None]
    depths = np.einsum("tvpi,tvpi->tvp", gaps, rays.directions)
    apart = np.linalg.norm(gaps - depths[..., None] * rays.directions, axis=3)
    pixels = apart / np.maximum(depths, MIN_DEPTH_M) * rays.focal_px[None, :, None]
    seen = rays.confidence >= MIN_CONFIDENCE
    weights = (1.0 + (pixels / (sigma_px * TRUST_WIDTH)) ** 2) ** -2
    return RayResiduals(np.where(seen, pixels, np.nan), np.where(seen, weights, 0.0))
