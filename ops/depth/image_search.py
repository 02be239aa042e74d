"""This module finds the point of a depth image that corresponds to a sample of the body's surface (thesis, 8.4.1).

A sample is projected into the image, and the nearest pixel that has a point is found. The corresponding point is the
closest point in a window around that pixel. The sample is hidden if its point lies clearly in front of it on almost the
same ray.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.arrays import F64, I32, I64
from kinedex.ops.errors import ParameterError

HIDDEN_M, SAME_RAY = 0.12, 0.02
"""A point hides a sample if it is nearer by the first, in metres, and x/z and y/z differ by at most the second."""

_NEAREST_M = 1e-6  # a depth z in metres; anything nearer counts as behind the camera


class DepthView(NamedTuple):
    """The camera and the orientation of a recording's points.

    Attributes
    ----------
    matrix : float64 array (3, 3)
        [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] in pixels of the strided image.
    distortion : float64 array (8,)
        Distortion coefficients in OpenCV's order, padded with 0.
    turn : float64 array (3, 3)
        The rotation that was applied to the camera's axes (x, −y, −z).
    is_distorted : bool
        False if all distortion coefficients are 0.
    """

    matrix: F64
    distortion: F64
    turn: F64
    is_distorted: bool


class FrameImage(NamedTuple):
    """A frame with the look-up tables that the search needs.

    Attributes
    ----------
    points : float64 array (n, 3)
        Points in metres, with the camera at the origin.
    pixels : int32 array (n, 2)
        Column and row of each point in the strided image.
    numbers : int32 array (h, w)
        The index of the point of each pixel; −1 for a pixel without a point.
    nearest : int32 array (h, w)
        For each pixel of the box, the point of the nearest pixel that has a point.
    box : int64 array (4,)
        The bounding box of all points: first column, first row, and the column and the row after the last.
    """

    points: F64
    pixels: I32
    numbers: I32
    nearest: I32
    box: I64


def depth_view(
    matrix: npt.ArrayLike, distortion: npt.ArrayLike = (), turn: npt.ArrayLike | None = None, stride: int = 1
) -> DepthView:
    """Return the camera of a recording in the form that kernels expect.

    Parameters
    ----------
    matrix : float64 array (3, 3)
        [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] in pixels of the whole image.
    distortion : float64 array (0,), (4,), (5,) or (8,), optional
        Distortion coefficients in OpenCV's order.
    turn : float64 array (3, 3), optional
        The rotation from the camera's axes (x, −y, −z) to axes with +Y up; None for a level camera.
    stride : int, optional
        The step between the rows and columns that are used.

    Returns
    -------
    DepthView
        The camera, for kernels.

    Raises
    ------
    ParameterError
        An array has the wrong shape, or the stride is below 1.
    """
    if stride < 1:
        raise ParameterError("stride", "at least 1", stride)
    scaled = np.array(matrix, np.float64)
    if scaled.shape != (3, 3):
        raise ParameterError("matrix", "of shape (3, 3)", scaled.shape)
    scaled[:2] /= stride
    numbers = np.asarray(distortion, np.float64).reshape(-1)
    if len(numbers) > 8:
        raise ParameterError("distortion", "of 0, 4, 5 or 8 numbers", len(numbers))
    around = np.eye(3) if turn is None else np.ascontiguousarray(turn, np.float64)
    if around.shape != (3, 3):
        raise ParameterError("turn", "of shape (3, 3)", around.shape)
    return DepthView(scaled, np.pad(numbers, (0, 8 - len(numbers))), around, bool(numbers.any()))


@njit(cache=True, nogil=True, error_model="numpy")
def project_samples(view: DepthView, image: FrameImage, samples: F64, seen: F64, positions: I64) -> None:
    """Project samples into the image, and find the nearest pixel with a point for each.

    Parameters
    ----------
    view : DepthView
        The camera.
    image : FrameImage
        The frame, with at least one point.
    samples : float64 array (S, 3)
        Samples in metres.
    seen : float64 array (S, 3)
        Output: x/z, y/z and z of each sample in the camera's axes, x right, y down, z forward; z ≤ 0 behind the camera.
    positions : int64 array (S, 3)
        Output: column and row of the pixel with a point that is nearest to the sample's pixel, and the distance between
        both pixels, as the larger of the differences in columns and rows. A sample outside the image is moved to the
        border of the image.
    """
    matrix, turn, nearest, pixels = view.matrix, view.turn, image.nearest, image.pixels
    height, width = image.numbers.shape
    left, top, right, bottom = image.box
    for i in range(len(samples)):
        x, y, z = samples[i, 0], samples[i, 1], samples[i, 2]
        depth = -(turn[0, 2] * x + turn[1, 2] * y + turn[2, 2] * z)
        if depth <= _NEAREST_M:
            seen[i, 2] = 0.0
            continue
        a = (turn[0, 0] * x + turn[1, 0] * y + turn[2, 0] * z) / depth
        b = -(turn[0, 1] * x + turn[1, 1] * y + turn[2, 1] * z) / depth
        seen[i, 0], seen[i, 1], seen[i, 2] = a, b, depth
        if view.is_distorted:
            a, b = _distorted(view.distortion, a, b)
        column = matrix[0, 0] * a + matrix[0, 1] * b + matrix[0, 2]
        row = matrix[1, 1] * b + matrix[1, 2]
        u = math.floor(min(max(column, 0.0), width - 1.0) + 0.5)
        v = math.floor(min(max(row, 0.0), height - 1.0) + 0.5)
        near = nearest[min(max(v, top), bottom - 1), min(max(u, left), right - 1)]
        p, q = np.int64(pixels[near, 0]), np.int64(pixels[near, 1])
        positions[i, 0], positions[i, 1], positions[i, 2] = p, q, max(abs(p - u), abs(q - v))


@njit(cache=True, nogil=True, error_model="numpy")
def _distorted(distortion: F64, a: float, b: float) -> tuple[float, float]:
    """Return the distorted coordinates (x/z, y/z)."""
    k1, k2, p1, p2, k3, k4, k5, k6 = distortion
    square = a * a + b * b
    scale = 1.0 + square * (k1 + square * (k2 + square * k3))
    scale /= 1.0 + square * (k4 + square * (k5 + square * k6))
    u = a * scale + 2.0 * p1 * a * b + p2 * (square + 2.0 * a * a)
    return u, b * scale + p1 * (square + 2.0 * b * b) + 2.0 * p2 * a * b


@njit(cache=True, nogil=True, error_model="numpy")
def closest_point(points: F64, numbers: I32, left: int, top: int, x: float, y: float, z: float, reach: int) -> int:
    """Return the point closest to a sample in a window of the image.

    Parameters
    ----------
    points : float64 array (n, 3)
        Points in metres.
    numbers : int32 array (h, w)
        The index of the point of each pixel; −1 for a pixel without a point.
    left, top : int
        Column and row of the middle of the window.
    x, y, z : float
        The sample in metres.
    reach : int
        Half-width of the window in pixels: 3 for a window of 7 × 7.

    Returns
    -------
    int
        The index of the point, the first in row-major order of equally close points; −1 in an empty window.
    """
    found, least = -1, np.inf
    for q in range(max(top - reach, 0), min(top + reach + 1, numbers.shape[0])):
        for p in range(max(left - reach, 0), min(left + reach + 1, numbers.shape[1])):
            number = numbers[q, p]
            if number >= 0:
                u, v, w = points[number, 0] - x, points[number, 1] - y, points[number, 2] - z
                square = u * u + v * v + w * w
                if square < least:
                    found, least = number, square
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def is_hidden(turn: F64, point: F64, a: float, b: float, depth: float) -> bool:
    """Return True if a point hides a sample at x/z, y/z and z in the camera's axes."""
    x, y, z = point[0], point[1], point[2]
    before = -(turn[0, 2] * x + turn[1, 2] * y + turn[2, 2] * z)
    if depth - before <= HIDDEN_M or before <= _NEAREST_M:
        return False
    u = (turn[0, 0] * x + turn[1, 0] * y + turn[2, 0] * z) / before - a
    v = -(turn[0, 1] * x + turn[1, 1] * y + turn[2, 1] * z) / before - b
    return u * u + v * v < SAME_RAY * SAME_RAY
