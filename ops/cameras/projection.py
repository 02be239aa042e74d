"""This module projects points into a camera image, and computes the rays of its pixels.

The conventions are those of OpenCV, and hold for every camera of the project. In the camera, x points right, y down and
z forward. A point X of the world has the camera coordinates R · X + t. The centre of the first pixel of an image is
(0, 0). Lens distortion follows the model of Brown and Conrady, with coefficients in the order k1 k2 p1 p2 k3 k4 k5 k6,
of which the last may be absent:

    a = x/z, b = y/z, r² = a² + b²,  s = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)
    a' = a s + 2 p1 a b + p2 (r² + 2 a²),  b' = b s + p1 (r² + 2 b²) + 2 p2 a b,  pixel = matrix · (a', b', 1)
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from kinedex.ops.arrays import F64
from kinedex.ops.errors import ParameterError

DISTORTION_COUNTS = (0, 4, 5, 8)
"""The numbers of distortion coefficients that are supported."""

_MAX_STEPS = 60
_CLOSE = 1e-13  # in units of the focal length: 1e-10 pixels at 1000


def camera_centre(rotation: npt.ArrayLike, translation: npt.ArrayLike) -> F64:
    """Return the centre C = −Rᵀ t of a camera in the world.

    Parameters
    ----------
    rotation : float64 array (3, 3)
        R, from the world to the camera.
    translation : float64 array (3,)
        t, in the unit of the world.

    Returns
    -------
    float64 array (3,)
        The centre, in the same unit.
    """
    turned, moved = _matrix("rotation", rotation), np.asarray(translation, np.float64)
    return -turned.T @ moved


def project(
    matrix: npt.ArrayLike,
    rotation: npt.ArrayLike,
    translation: npt.ArrayLike,
    distortion: npt.ArrayLike,
    points: npt.ArrayLike,
) -> tuple[F64, F64]:
    """Project points of the world into the image of a camera.

    Parameters
    ----------
    matrix : float64 array (3, 3)
        [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], in pixels.
    rotation : float64 array (3, 3)
        R, from the world to the camera.
    translation : float64 array (3,)
        t, in the unit of the world.
    distortion : float64 array (0,), (4,), (5,) or (8,)
        k1 k2 p1 p2 k3 k4 k5 k6, or the first of them.
    points : float64 array (…, 3)
        Points of the world.

    Returns
    -------
    pixels : float64 array (…, 2)
        Positions in the image, which may lie outside its borders; NaN for points that are not in front of the camera.
    depths : float64 array (…,)
        z in the camera, in the unit of the world; 0 or negative for points that are not in front of the camera.

    Raises
    ------
    ParameterError
        An array has the wrong shape.
    """
    intrinsic, turned = _matrix("matrix", matrix), _matrix("rotation", rotation)
    positions = np.asarray(points, np.float64)
    if positions.shape[-1:] != (3,):
        raise ParameterError("points", "of shape (…, 3)", positions.shape)
    seen = positions @ turned.T + np.asarray(translation, np.float64)
    depths: F64 = seen[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        plane = np.where(depths[..., None] > 0, seen[..., :2] / depths[..., None], np.nan)
    return distort(distortion, plane) @ intrinsic[:2, :2].T + intrinsic[:2, 2], depths


def pixel_directions(
    matrix: npt.ArrayLike, rotation: npt.ArrayLike, distortion: npt.ArrayLike, pixels: npt.ArrayLike
) -> F64:
    """Return the directions of the rays through pixels.

    Parameters
    ----------
    matrix : float64 array (3, 3)
        [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], in pixels.
    rotation : float64 array (3, 3)
        R, from the world to the camera; the unit matrix gives directions in the camera's own axes.
    distortion : float64 array (0,), (4,), (5,) or (8,)
        k1 k2 p1 p2 k3 k4 k5 k6, or the first of them.
    pixels : float64 array (…, 2)
        Positions in the image.

    Returns
    -------
    float64 array (…, 3)
        Unit vectors in the world, away from the camera; NaN for a pixel far outside the image that no ray maps to.

    Raises
    ------
    ParameterError
        An array has the wrong shape.
    """
    intrinsic, turned = _matrix("matrix", matrix), _matrix("rotation", rotation)
    positions = np.asarray(pixels, np.float64)
    if positions.shape[-1:] != (2,):
        raise ParameterError("pixels", "of shape (…, 2)", positions.shape)
    (fx, skew, cx), (_, fy, cy) = intrinsic[:2]
    b = (positions[..., 1] - cy) / fy
    a = (positions[..., 0] - cx - skew * b) / fx
    plane = undistort(distortion, np.stack([a, b], axis=-1))
    rays = np.concatenate([plane, np.ones((*plane.shape[:-1], 1))], axis=-1)
    rays /= np.sqrt(np.einsum("...i,...i->...", rays, rays))[..., None]
    directions: F64 = rays @ turned  # Rᵀ · ray
    return np.where(np.isnan(plane[..., :1]), np.nan, directions)


def distort(distortion: npt.ArrayLike, plane: F64) -> F64:
    """Apply lens distortion to points (…, 2) on the plane z = 1 of a camera."""
    numbers = _coefficients(distortion)
    return plane if numbers is None else _lens(numbers, plane)[0]


def undistort(distortion: npt.ArrayLike, seen: F64) -> F64:
    """Return the undistorted points on the plane z = 1 of distorted points, by Newton's method.

    Parameters
    ----------
    distortion : float64 array (0,), (4,), (5,) or (8,)
        k1 k2 p1 p2 k3 k4 k5 k6, or the first of them.
    seen : float64 array (…, 2)
        Distorted points on the plane z = 1.

    Returns
    -------
    float64 array (…, 2)
        Undistorted points; NaN where none exists, as beyond the largest radius that a barrel distortion can produce.
    """
    numbers = _coefficients(distortion)
    if numbers is None:
        return seen
    flat = seen.reshape(-1, 2)
    plane = flat.copy()
    missing = flat - _lens(numbers, plane)[0]
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        for _ in range(_MAX_STEPS):
            error = np.abs(missing).max(axis=1, initial=0.0)
            todo = np.flatnonzero(error > _CLOSE)
            if not len(todo):
                break
            plane[todo], missing[todo] = _newton_step(numbers, flat[todo], plane[todo], missing[todo])
        slope = _lens(numbers, plane)[1]
        unfolded = slope[:, 0, 0] * slope[:, 1, 1] - slope[:, 0, 1] * slope[:, 1, 0] > 0
        found = (np.abs(missing).max(axis=1) <= 1e-10) & unfolded
    return np.where(found[:, None], plane, np.nan).reshape(seen.shape)


def _newton_step(numbers: F64, seen: F64, plane: F64, missing: F64) -> tuple[F64, F64]:
    """Return the points after one Newton step and their residuals; a step that increases the residual is shortened."""
    slope = _lens(numbers, plane)[1]
    determinant = slope[:, 0, 0] * slope[:, 1, 1] - slope[:, 0, 1] * slope[:, 1, 0]
    step = np.stack(
        [
            slope[:, 1, 1] * missing[:, 0] - slope[:, 0, 1] * missing[:, 1],
            slope[:, 0, 0] * missing[:, 1] - slope[:, 1, 0] * missing[:, 0],
        ],
        axis=1,
    )
    step /= determinant[:, None]
    best, left = plane, missing
    for share in (1.0, 0.5, 0.25, 0.125, 1 / 16, 1 / 64):
        tried = plane + share * step
        rest = seen - _lens(numbers, tried)[0]
        nearer = (np.abs(rest).max(axis=1) < np.abs(left).max(axis=1))[:, None]
        best, left = np.where(nearer, tried, best), np.where(nearer, rest, left)
    return best, left


def _lens(numbers: F64, plane: F64) -> tuple[F64, F64]:
    """Return the distorted points (…, 2), and their derivatives (…, 2, 2) with respect to the undistorted points."""
    k1, k2, p1, p2, k3, k4, k5, k6 = numbers
    a, b = plane[..., 0], plane[..., 1]
    square = a * a + b * b
    above = 1 + square * (k1 + square * (k2 + square * k3))
    below = 1 + square * (k4 + square * (k5 + square * k6))
    scale = above / below
    # derivative of the scale by r²
    slope = (k1 + square * (2 * k2 + square * 3 * k3)) / below
    slope -= scale * (k4 + square * (2 * k5 + square * 3 * k6)) / below
    seen = np.stack(
        [
            a * scale + 2 * p1 * a * b + p2 * (square + 2 * a * a),
            b * scale + p1 * (square + 2 * b * b) + 2 * p2 * a * b,
        ],
        axis=-1,
    )
    mixed = 2 * a * b * slope + 2 * p1 * a + 2 * p2 * b
    first = np.stack([scale + 2 * a * a * slope + 2 * p1 * b + 6 * p2 * a, mixed], axis=-1)
    second = np.stack([mixed, scale + 2 * b * b * slope + 6 * p1 * b + 2 * p2 * a], axis=-1)
    return seen, np.stack([first, second], axis=-2)


def _coefficients(distortion: npt.ArrayLike) -> F64 | None:
    """Return the eight distortion coefficients, padded with zeros; None if all are 0."""
    numbers = np.asarray(distortion, np.float64).reshape(-1)
    if len(numbers) not in DISTORTION_COUNTS:
        raise ParameterError("distortion", "of 0, 4, 5 or 8 numbers (k1 k2 p1 p2 k3 k4 k5 k6)", len(numbers))
    return np.pad(numbers, (0, 8 - len(numbers))) if numbers.any() else None


def _matrix(name: str, values: npt.ArrayLike) -> F64:
    matrix = np.asarray(values, np.float64)
    if matrix.shape != (3, 3):
        raise ParameterError(name, "of shape (3, 3)", matrix.shape)
    return matrix
