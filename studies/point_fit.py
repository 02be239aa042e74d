"""Points fitted to rays with limb lengths and smoothness, without a body: a baseline after AniPose (Karashchuk 2021).

The energy is Σ conf² ρ(r) over the rays with Geman and McClure's loss, plus the squares of second differences of every
point, plus the squares of the differences of limb lengths from the medians of the triangulated ones.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from kinedex.ops.tracking.observations import Rays
from studies.filters import without_gaps

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

SIGMA_PX, SCHEDULE = 5.0, (12.0, 6.0, 3.0)
LENGTH_M = 0.01
"""Standard deviation of the length of a limb."""
ACCELERATION = 20.0
"""Standard deviation of the acceleration of a point, in m/s²."""
STEPS, GRADIENT_STEPS = 6, 60


def fitted_points(rays: Rays, triangulated: F64, limbs: Sequence[tuple[int, int]], rate_hz: float) -> F64:
    """Fit points to rays.

    Parameters
    ----------
    rays : Rays
        T frames of V cameras and P keypoints.
    triangulated : float64 array (T, P, 3)
        The start, NaN in gaps.
    limbs : sequence of (int, int)
        Pairs of points that keep their distance.
    rate_hz : float
        Frames a second.

    Returns
    -------
    float64 array (T, P, 3)
        The points.
    """
    pairs = np.array(limbs, np.int64)
    lengths = np.nanmedian(np.linalg.norm(triangulated[:, pairs[:, 0]] - triangulated[:, pairs[:, 1]], axis=2), axis=0)
    points = without_gaps(triangulated)
    smooth = (rate_hz**2 / ACCELERATION) ** 2
    for c in SCHEDULE:
        for _ in range(STEPS):
            points = points + _step(rays, points, pairs, lengths, smooth, c)
    return points


def _step(rays: Rays, points: F64, pairs: I64, lengths: F64, smooth: float, c: float) -> F64:
    """Return the step of Gauss and Newton, solved by conjugate gradients."""
    blocks, gradient = _ray_terms(rays, points, c)
    first, second = pairs.T
    bones = points[:, first] - points[:, second]
    now = np.linalg.norm(bones, axis=2)
    units = bones / np.maximum(now, 1e-9)[..., None]
    _add_limbs(gradient, pairs, units * ((now - lengths) / LENGTH_M**2)[..., None])
    gradient += smooth * _fourth_differences(points)

    def product(step: F64) -> F64:
        result = np.einsum("tpij,tpj->tpi", blocks, step) + smooth * _fourth_differences(step)
        along = np.einsum("tli,tli->tl", units, step[:, first] - step[:, second]) / LENGTH_M**2
        _add_limbs(result, pairs, units * along[..., None])
        return result

    return _conjugate_gradients(product, -gradient, np.linalg.inv(blocks + (6.0 * smooth + 1.0) * np.eye(3)))


def _ray_terms(rays: Rays, points: F64, c: float) -> tuple[F64, F64]:
    """Return A (T, P, 3, 3) and b (T, P, 3) of the rays."""
    off = points[:, None] - rays.centres[None, :, None]
    depth = np.maximum(0.3, np.einsum("tvpi,tvpi->tvp", off, rays.directions))
    aside = off - np.einsum("tvpi,tvpi->tvp", off, rays.directions)[..., None] * rays.directions
    scale = rays.focal_px[None, :, None] / (depth * SIGMA_PX)
    squares = np.einsum("tvpi,tvpi->tvp", aside, aside) * scale**2
    weights = np.where(rays.confidence < 0.1, 0.0, rays.confidence) ** 2 * scale**2 / (1.0 + squares / c**2) ** 2
    along = np.einsum("tvp,tvpi,tvpj->tpij", weights, rays.directions, rays.directions)
    blocks = weights.sum(axis=1)[..., None, None] * np.eye(3) - along
    return blocks, np.einsum("tvp,tvpi->tpi", weights, aside)


def _fourth_differences(points: F64) -> F64:
    """Return the gradient of half the sum of squared second differences over time."""
    result = np.zeros_like(points)
    if len(points) > 2:
        second = points[2:] - 2.0 * points[1:-1] + points[:-2]
        result[2:] += second
        result[1:-1] -= 2.0 * second
        result[:-2] += second
    return result


def _add_limbs(result: F64, pairs: I64, pulls: F64) -> None:
    for limb, (first, second) in enumerate(pairs.tolist()):
        result[:, first] += pulls[:, limb]
        result[:, second] -= pulls[:, limb]


def _conjugate_gradients(product, right: F64, inverse: F64) -> F64:  # type: ignore[no-untyped-def]
    """Solve product(x) = right, preconditioned by blocks (T, P, 3, 3)."""
    solution = np.zeros_like(right)
    rest = right
    scaled = np.einsum("tpij,tpj->tpi", inverse, rest)
    way, size = scaled, float((rest * scaled).sum())
    begin = size
    for _ in range(GRADIENT_STEPS):
        if size <= 1e-10 * begin or size == 0.0:
            break
        image = product(way)
        length = size / float((way * image).sum())
        solution = solution + length * way
        rest = rest - length * image
        scaled = np.einsum("tpij,tpj->tpi", inverse, rest)
        size, before = float((rest * scaled).sum()), size
        way = scaled + size / before * way
    return solution
