"""This module finds the floor of an empty room, which is the largest nearly level plane below the camera.

Points have the axes x right, y up and z backward, with the camera at the origin and not yet rotated upright.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kinedex.ops.arrays import F64
from kinedex.ops.errors import ParameterError

TRIPLES = 300
"""Number of planes that are tried, each through three random points."""

WITHIN_M = 0.03
"""Distance in metres up to which a point belongs to a plane."""

MIN_SHARE = 0.15
"""Minimum fraction of the points that the floor must have."""

MAX_FROM_UP, MAX_FROM_IMAGE_UP = np.radians(5.0), np.radians(45.0)
"""Greatest angles between the floor's normal and `up`, or the image's upward axis if there is no `up`, in radians."""

_MAX_DRAWN = 100 * TRIPLES
_COUNTED = 10_000
_REFITS = 5
# m²; least length of the normal's cross product, so that the three points are not nearly collinear
_MIN_NORMAL = 1e-6


class Floor(NamedTuple):
    """A plane below the camera.

    Attributes
    ----------
    normal : float64 array (3,)
        The unit vector that points upwards.
    height : float
        The coordinate of the floor along the normal in metres, which is minus the height of the camera above the floor.
    share : float
        The fraction of the points that belong to the floor.
    """

    normal: F64
    height: float
    share: float


def find_floor(points: npt.ArrayLike, up: npt.ArrayLike | None = None, seed: int = 0) -> Floor | None:
    """Return the largest plane that can be the floor.

    As in RANSAC, 300 planes through random triples of points, with normals near to `up`, are compared by the number of
    points within 3 cm; the best plane is then fitted to its points by least squares.

    Parameters
    ----------
    points : float64 array (n, 3)
        Points of the empty room in metres; rows that are not finite are ignored.
    up : float64 array (3,), optional
        A vector that points upwards; the normal may deviate from it by at most 5°. Without it, the normal may deviate
        from (0, 1, 0) by at most 45°.
    seed : int, optional
        Seed of the random triples.

    Returns
    -------
    Floor, optional
        The floor; None if no plane has at least 15 % of the points.

    Raises
    ------
    ParameterError
        `points` has another shape, or `up` is 0 or not finite.
    """
    positions = np.asarray(points, np.float64)
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise ParameterError("points", "of shape (n, 3)", positions.shape)
    positions = positions[np.isfinite(positions).all(axis=1)]
    axis = np.array([0.0, 1.0, 0.0]) if up is None else _unit(up)
    least = np.cos(MAX_FROM_IMAGE_UP if up is None else MAX_FROM_UP)
    if len(positions) < 3:
        return None
    normals, heights = admissible_planes(positions, axis, float(least), seed)
    if not len(normals):
        return None
    some = positions[:: -(-len(positions) // _COUNTED)]
    counts = [int((np.abs(some @ normal - h) <= WITHIN_M).sum()) for normal, h in zip(normals, heights, strict=True)]
    best = int(np.argmax(counts))
    normal, height = normals[best], float(heights[best])
    near = np.abs(positions @ normal - height) <= WITHIN_M
    for _ in range(_REFITS):
        if near.sum() < 3:
            return None
        normal, height = fitted_plane(positions[near], axis)
        former, near = near, np.abs(positions @ normal - height) <= WITHIN_M
        if (near == former).all():
            break
    share = float(near.mean())
    if share < MIN_SHARE or normal @ axis < least or height >= 0:
        return None
    return Floor(normal, height, share)


def admissible_planes(points: F64, up: F64, least: float, seed: int) -> tuple[F64, F64]:
    """Return planes through random triples of points, only those that lie below the origin and are about level.

    Parameters
    ----------
    points : float64 array (n, 3)
        Points.
    up : float64 array (3,)
        A unit vector that points upwards.
    least : float
        The smallest cosine between a normal and `up`.
    seed : int
        Seed of the triples.

    Returns
    -------
    normals : float64 array (k, 3)
        At most 300 unit vectors; fewer if 30,000 triples do not give as many.
    heights : float64 array (k,)
        The coordinates of the planes along their normals, below 0.
    """
    triples = np.random.default_rng(seed).integers(0, len(points), (_MAX_DRAWN, 3))
    a, b, c = (points[triples[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    lengths = np.linalg.norm(across, axis=1)
    known = lengths > _MIN_NORMAL
    normals = np.where(known[:, None], across / np.maximum(lengths, _MIN_NORMAL)[:, None], 0.0)
    normals *= np.where(normals @ up < 0, -1.0, 1.0)[:, None]
    heights = np.einsum("ij,ij->i", normals, a)
    fit = np.flatnonzero(known & (normals @ up >= least) & (heights < 0))[:TRIPLES]
    return normals[fit], heights[fit]


def fitted_plane(points: F64, up: F64) -> tuple[F64, float]:
    """Return normal and height of the least-squares plane of points (n, 3); the normal points to the side of `up`."""
    middle = points.mean(axis=0)
    offsets = points - middle
    normal: F64 = np.linalg.eigh(offsets.T @ offsets)[1][:, 0]
    if normal @ up < 0:
        normal = -normal
    return normal, float(normal @ middle)


def upright_rotation(up: npt.ArrayLike) -> F64:
    """Return the smallest rotation (3, 3) that maps a direction to +Y.

    Parameters
    ----------
    up : float64 array (3,)
        The direction; if it points straight down, the rotation is about the x axis.

    Raises
    ------
    ParameterError
        The vector is 0 or not finite.
    """
    x, y, z = _unit(up)
    aside = x * x + z * z
    if y < 0 and aside < 1e-300:
        return np.diag([1.0, -1.0, -1.0])
    share = 1 / (1 + y) if y >= 0 else (1 - y) / aside  # the same number, where 1 + y would lose digits
    return np.array([[1 - x * x * share, -x, -x * z * share], [x, y, z], [-x * z * share, -z, 1 - z * z * share]])


def _unit(up: npt.ArrayLike) -> F64:
    vector = np.asarray(up, np.float64)
    length = float(np.linalg.norm(vector)) if vector.shape == (3,) else 0.0
    if not 1e-9 < length < np.inf:
        raise ParameterError("up", "a direction of shape (3,), not 0", vector.tolist())
    return vector / length
