"""This module finds the centre of a frame's points, and the direction that the chest faces (thesis, Section 8.3.4)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64
from kinedex.ops.copies import copy_row
from kinedex.ops.order_statistics import median

SAMPLE = 700
"""Approximate number of points of a frame that are sampled to save time."""

WIDTH_M, CLOSE_M, MAX_SHIFTS = 0.25, 1e-3, 8
"""Bandwidth of the mean shift in metres, the step length at which it ends, and the maximum number of steps."""

AROUND_M, MIN_POINTS, MIN_HORIZONTAL = 0.15, 20, 0.5
"""Radius around the centre for the plane fit, the least number of points, and the least horizontal part of its normal.
"""

FOLLOW = 0.7
"""The weight of a fully trusted plane when the direction is updated."""


def sample_step(count: int) -> int:
    """Return the stride in which points are sampled: ⌊n/700⌋, at least 1."""
    return max(count // SAMPLE, 1)


def point_centre(points: F64) -> F64:
    """Return the centre of a frame's points by mean shift, started from the coordinate-wise median.

    Parameters
    ----------
    points : float64 array (n, 3)
        All points of the frame, in metres.

    Returns
    -------
    float64 array (3,)
        The centre; NaN without points.
    """
    centre = np.empty(3)
    _mean_shift(points, sample_step(len(points)), centre)
    return centre


def facing_from_points(points: F64, centre: F64, facing: F64) -> F64:
    """Return the direction that the chest faces, from a plane fitted to the points around the centre.

    Parameters
    ----------
    points : float64 array (n, 3)
        All points of the frame, in metres.
    centre : float64 array (3,)
        The centre of the points, see `point_centre`.
    facing : float64 array (3,)
        The direction in the previous frame, a horizontal unit vector; in the first frame (0, 0, 1), towards the camera.

    Returns
    -------
    float64 array (3,)
        The direction, a horizontal unit vector. It equals the previous direction if the plane has too few points or is
        nearly horizontal.
    """
    result = np.empty(3)
    _face(np.ascontiguousarray(points), centre, facing, result)
    return result


@njit(cache=True, nogil=True)
def _mean_shift(points: F64, step: int, centre: F64) -> None:
    count = (len(points) + step - 1) // step
    if count == 0:
        centre[:] = np.nan
        return
    sample = np.empty(count)
    for axis in range(3):
        for k in range(count):
            sample[k] = points[k * step, axis]
        centre[axis] = median(sample)
    for _ in range(MAX_SHIFTS):
        x, y, z, total = 0.0, 0.0, 0.0, 0.0
        for k in range(count):
            px, py, pz = points[k * step, 0], points[k * step, 1], points[k * step, 2]
            dx, dy, dz = px - centre[0], py - centre[1], pz - centre[2]
            weight = math.exp(-(dx * dx + dy * dy + dz * dz) / (2.0 * WIDTH_M * WIDTH_M))
            x, y, z, total = x + weight * px, y + weight * py, z + weight * pz, total + weight
        if total == 0.0:
            return
        x, y, z = x / total, y / total, z / total
        moved = max(abs(x - centre[0]), abs(y - centre[1]), abs(z - centre[2]))
        centre[0], centre[1], centre[2] = x, y, z
        if moved < CLOSE_M:
            return


@njit(cache=True, nogil=True)
def _face(points: F64, centre: F64, facing: F64, result: F64) -> None:
    copy_row(result, facing)
    covariance, count = np.zeros((3, 3)), 0
    mean = np.zeros(3)
    for step in range(2):  # first pass: the mean of the points around the centre; second pass: their covariance
        for i in range(len(points)):
            dx, dy, dz = points[i, 0] - centre[0], points[i, 1] - centre[1], points[i, 2] - centre[2]
            if dx * dx + dy * dy + dz * dz >= AROUND_M * AROUND_M:
                continue
            if step == 0:
                count += 1
                mean[0], mean[1], mean[2] = mean[0] + dx, mean[1] + dy, mean[2] + dz
            else:
                offset = (dx - mean[0], dy - mean[1], dz - mean[2])
                for a in range(3):
                    for b in range(3):
                        covariance[a, b] += offset[a] * offset[b] / count
        if step == 0:
            if count < MIN_POINTS:
                return
            mean /= count
    values, vectors = symmetric_eigenvectors(covariance)
    nx, nz = vectors[0, 0], vectors[2, 0]
    flat = math.hypot(nx, nz)
    if flat < MIN_HORIZONTAL or values[1] <= 0.0 or values[2] <= 0.0:
        return
    if nz < 0:
        nx, nz = -nx, -nz
    elongated = min(max((values[1] / values[2] - 0.3) / 0.4, 0.0), 1.0)
    thin = min(max(1.0 - (values[0] / values[1]) / 0.4, 0.0), 1.0)
    trust = FOLLOW * elongated * thin
    x, z = facing[0] + trust * (nx / flat - facing[0]), facing[2] + trust * (nz / flat - facing[2])
    length = math.hypot(x, z)
    if length > 0:
        result[0], result[1], result[2] = x / length, 0.0, z / length


@njit(cache=True, nogil=True)
def symmetric_eigenvectors(matrix: F64) -> tuple[F64, F64]:
    """Return the eigenvalues of a symmetric matrix, ascending, and its eigenvectors, by Jacobi's method.

    Parameters
    ----------
    matrix : float64 array (3, 3)
        The matrix.

    Returns
    -------
    values : float64 array (3,)
        The eigenvalues, ascending.
    vectors : float64 array (3, 3)
        An eigenvector in each column, of length 1.
    """
    a, vectors = matrix.copy(), np.eye(3)
    for _ in range(30):
        off = abs(a[0, 1]) + abs(a[0, 2]) + abs(a[1, 2])
        if off <= 1e-18 * (abs(a[0, 0]) + abs(a[1, 1]) + abs(a[2, 2])):
            break
        for p, q in ((0, 1), (0, 2), (1, 2)):
            if a[p, q] == 0.0:
                continue
            ratio = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
            t = 1.0 / (abs(ratio) + math.sqrt(ratio * ratio + 1.0))
            t = -t if ratio < 0 else t
            c = 1.0 / math.sqrt(t * t + 1.0)
            s = t * c
            for k in range(3):
                a[k, p], a[k, q] = c * a[k, p] - s * a[k, q], s * a[k, p] + c * a[k, q]
            for k in range(3):
                a[p, k], a[q, k] = c * a[p, k] - s * a[q, k], s * a[p, k] + c * a[q, k]
            for k in range(3):
                vectors[k, p], vectors[k, q] = (
                    c * vectors[k, p] - s * vectors[k, q], s * vectors[k, p] + c * vectors[k, q]
                )  # fmt: skip
    values, sorted_vectors = np.full(3, np.nan), np.full((3, 3), np.nan)
    for k in range(3):
        place = 0
        for other in range(3):
            place += a[other, other] < a[k, k] or (a[other, other] == a[k, k] and other < k)
        values[place] = a[k, k]
        copy_row(sorted_vectors[:, place], vectors[:, k])
    return values, sorted_vectors
