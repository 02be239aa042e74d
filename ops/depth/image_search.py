"""The point of a depth image that corresponds to a sample of the body's surface (thesis, 8.4.1).

A sample is projected into the image; its point is the closest one in a window around the pixel with a point that is
nearest to it there. A sample is hidden where its point lies clearly before it on almost the same ray.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.errors import ParameterError

F64 = npt.NDArray[np.float64]
I32 = npt.NDArray[np.int32]

HIDDEN_M, SAME_RAY = 0.12, 0.02
"""A sample is hidden by a point nearer to the camera by the first, if x/z and y/z differ by less than the second."""


class DepthView(NamedTuple):
    """The camera that the points of a recording were made with.

    Attributes
    ----------
    matrix : float64 array (3, 3)
        [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] in pixels of the strided image.
    distortion : float64 array (8,)
        Distortion in OpenCV's order, filled up with 0.
    turn : float64 array (3, 3)
        The rotation that was applied to the camera's own axes (x, −y, −z).
    """

    matrix: F64
    distortion: F64
    turn: F64


class FrameImage(NamedTuple):
    """A frame as the search uses it.

    Attributes
    ----------
    points : float64 array (n, 3)
        Points in metres, with the camera at the origin.
    pixels : int32 array (n, 2)
        Column and row of each point in the strided image.
    numbers : int32 array (h, w)
        The point of each pixel; −1 where there is none.
    nearest : int32 array (h, w)
        The point of the pixel that is nearest to each pixel of the box.
    box : int64 array (4,)
        First column, first row, and the column and row after the last, of all points.
    """

    points: F64
    pixels: I32
    numbers: I32
    nearest: I32
    box: npt.NDArray[np.int64]


def depth_view(
    matrix: npt.ArrayLike, distortion: npt.ArrayLike = (), turn: npt.ArrayLike | None = None, stride: int = 1
) -> DepthView:
    """Return the camera of a recording.

    Parameters
    ----------
    matrix : float64 array (3, 3)
        [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] in pixels of the whole image.
    distortion : float64 array (0,), (4,), (5,) or (8,), optional
        Distortion in OpenCV's order.
    turn : float64 array (3, 3), optional
        The rotation that brings the camera's own (x, −y, −z) to axes with +Y up; None for a level camera.
    stride : int, optional
        Every how many rows and columns a pixel is used.

    Returns
    -------
    DepthView
        The camera, for kernels.

    Raises
    ------
    ParameterError
        A shape is wrong, or the stride is below 1.
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
    return DepthView(scaled, np.pad(numbers, (0, 8 - len(numbers))), around)


@njit(cache=True, nogil=True, error_model="numpy")
def camera_ray(view: DepthView, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return x/z, y/z and z of a point in the camera's axes, x right, y down, z forward; z ≤ 0 behind the camera."""
    t = view.turn
    depth = -(t[0, 2] * x + t[1, 2] * y + t[2, 2] * z)
    if depth <= 1e-6:
        return 0.0, 0.0, 0.0
    return (t[0, 0] * x + t[1, 0] * y + t[2, 0] * z) / depth, -(t[0, 1] * x + t[1, 1] * y + t[2, 1] * z) / depth, depth


@njit(cache=True, nogil=True, error_model="numpy")
def ray_pixel(view: DepthView, a: float, b: float) -> tuple[float, float]:
    """Return column and row of the place (x/z, y/z) in the strided image."""
    if view.distortion.any():
        k1, k2, p1, p2, k3, k4, k5, k6 = view.distortion
        square = a * a + b * b
        scale = 1.0 + square * (k1 + square * (k2 + square * k3))
        scale /= 1.0 + square * (k4 + square * (k5 + square * k6))
        a, b = (
            a * scale + 2.0 * p1 * a * b + p2 * (square + 2.0 * a * a),
            b * scale + p1 * (square + 2.0 * b * b) + 2.0 * p2 * a * b,
        )
    matrix = view.matrix
    return matrix[0, 0] * a + matrix[0, 1] * b + matrix[0, 2], matrix[1, 1] * b + matrix[1, 2]


@njit(cache=True, nogil=True, error_model="numpy")
def corresponding_point(
    view: DepthView, image: FrameImage, x: float, y: float, z: float, reach: int, beside: bool
) -> tuple[int, float, bool]:
    """Return the point that corresponds to a sample.

    Parameters
    ----------
    view : DepthView
        The camera.
    image : FrameImage
        The frame, with at least one point.
    x, y, z : float
        The sample in metres.
    reach : int
        Half the width of the window: 3 for one of 7 × 7 pixels.
    beside : bool
        True to search only for samples that are projected more than a pixel away from all points.

    Returns
    -------
    point : int
        Its number; −1 for a sample behind the camera, or one that is not searched for.
    distance : float
        Its distance from the sample in metres.
    hidden : bool
        True where the point hides the sample.
    """
    a, b, depth = camera_ray(view, x, y, z)
    if depth <= 0.0:
        return -1, 0.0, False
    column, row = ray_pixel(view, a, b)
    height, width = image.numbers.shape
    u = math.floor(min(max(column, 0.0), width - 1.0) + 0.5)
    v = math.floor(min(max(row, 0.0), height - 1.0) + 0.5)
    left, top, right, bottom = image.box
    near = image.nearest[min(max(v, top), bottom - 1), min(max(u, left), right - 1)]
    i, j = image.pixels[near]
    if beside and abs(i - u) <= 1 and abs(j - v) <= 1:
        return -1, 0.0, False
    found, least = -1, np.inf
    for q in range(max(j - reach, top), min(j + reach + 1, bottom)):
        for p in range(max(i - reach, left), min(i + reach + 1, right)):
            number = image.numbers[q, p]
            if number < 0:
                continue
            point = image.points[number]
            square = (point[0] - x) ** 2 + (point[1] - y) ** 2 + (point[2] - z) ** 2
            if square < least:
                found, least = number, square
    point = image.points[found]
    one, other, before = camera_ray(view, point[0], point[1], point[2])
    hidden = depth - before > HIDDEN_M and (one - a) ** 2 + (other - b) ** 2 < SAME_RAY**2
    return found, math.sqrt(least), hidden
