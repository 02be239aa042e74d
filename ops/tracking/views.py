"""This module represents calibrated cameras as arrays, and renders the mask of a body in a camera.

The mask consists of the pixels whose rays meet a capsule of the body.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.arrays import F32, F64, U8, Bool
from kinedex.ops.body.capsules import Capsules
from kinedex.ops.cameras.projection import camera_centre, pixel_directions
from kinedex.ops.errors import ParameterError

REACH_PX = 48.0
"""Search distance for the foreground boundary from a contour point, in pixels of an image that is 1280 wide."""

_WIDTH_PX = 1280.0

_EDGE = 5  # points along each side of a box that are projected if the lens has distortion


class View(NamedTuple):
    """A camera and the pixel grid of its masks.

    Attributes
    ----------
    matrix : float64 array (3, 3)
        Focal lengths and principal point in pixels of the camera.
    distortion : float64 array (8,)
        Distortion coefficients in OpenCV's order, padded with 0.
    rotation, translation : float64 array (3, 3), (3,)
        The transformation from the world to the camera, in metres.
    centre : float64 array (3,)
        Centre of the camera in the world, in metres.
    plane : float32 array (H, W, 2)
        x/z and y/z of the ray of each pixel of the mask in the camera's axes; NaN if no ray maps to the pixel.
    extent : float64 array (4,)
        Smallest x/z and y/z, and largest x/z and y/z, of all pixels of the mask.
    scale : float
        Width of a pixel of the mask in pixels of the camera.
    reach : float
        Largest distance of a boundary from a contour point, in pixels of the mask.
    """

    matrix: F64
    distortion: F64
    rotation: F64
    translation: F64
    centre: F64
    plane: F32
    extent: F64
    scale: float
    reach: float


def camera_view(
    matrix: npt.ArrayLike,
    rotation: npt.ArrayLike,
    translation: npt.ArrayLike,
    distortion: npt.ArrayLike,
    size: tuple[int, int],
    mask_size: tuple[int, int] | None = None,
    reach_px: float = REACH_PX,
) -> View:
    """Return a camera with the pixel grid of its masks.

    Parameters
    ----------
    matrix : float64 array (3, 3)
        Focal lengths and principal point in pixels.
    rotation, translation : float64 array (3, 3), (3,)
        The transformation from the world to the camera, in metres.
    distortion : float64 array (0,), (4,), (5,) or (8,)
        Distortion coefficients in OpenCV's order.
    size : (int, int)
        Width and height of the image in pixels.
    mask_size : (int, int), optional
        Width and height of the masks, which are those of the image divided by the same integer; by default the size of
        the image.
    reach_px : float, optional
        Largest distance of a boundary from a contour point, in pixels of an image that is 1280 wide.

    Returns
    -------
    View
        The camera.

    Raises
    ------
    ParameterError
        The size of the image is not an integer multiple of the masks' size, or an array has the wrong shape.
    """
    width, height = mask_size or size
    scale = size[0] // width if width > 0 else 0
    if scale < 1 or (width * scale, height * scale) != tuple(size):
        raise ParameterError("mask_size", f"{size[0]} × {size[1]} or a whole fraction of it", f"{width} × {height}")
    # The centre of a mask pixel is the centre of the block of image pixels that it covers.
    columns, rows = ((np.arange(count) + 0.5) * scale - 0.5 for count in (width, height))
    pixels = np.stack(np.broadcast_arrays(columns[None, :], rows[:, None]), axis=-1)
    rays = pixel_directions(matrix, np.eye(3), distortion, pixels)
    plane = rays[..., :2] / rays[..., 2:]
    extent = np.concatenate([np.nanmin(plane, axis=(0, 1)), np.nanmax(plane, axis=(0, 1))])
    numbers = np.asarray(distortion, np.float64).reshape(-1)
    return View(
        np.ascontiguousarray(matrix, np.float64),
        np.pad(numbers, (0, 8 - len(numbers))),
        np.ascontiguousarray(rotation, np.float64),
        np.ascontiguousarray(translation, np.float64),
        camera_centre(rotation, translation),
        plane.astype(np.float32),
        extent,
        float(scale),
        reach_px * size[0] / _WIDTH_PX / scale,
    )


@njit(cache=True, nogil=True)
def mask_pixel(view: View, x: float, y: float) -> tuple[float, float]:
    """Return the mask pixel, column and row, at the point (x/z, y/z) of the camera."""
    k1, k2, p1, p2, k3, k4, k5, k6 = view.distortion
    square = x * x + y * y
    scale = (1.0 + square * (k1 + square * (k2 + square * k3))) / (1.0 + square * (k4 + square * (k5 + square * k6)))
    a = x * scale + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)
    b = y * scale + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y
    column = view.matrix[0, 0] * a + view.matrix[0, 1] * b + view.matrix[0, 2]
    row = view.matrix[1, 1] * b + view.matrix[1, 2]
    return (column + 0.5) / view.scale - 0.5, (row + 0.5) / view.scale - 0.5


@njit(cache=True, nogil=True)
def seen_joints(view: View, joints: F64, seen: F64) -> None:
    """Transform joints (J, 3) from the world to the axes of a camera, and write them into `seen`."""
    for j in range(len(joints)):
        for i in range(3):
            seen[j, i] = view.translation[i]
            for a in range(3):
                seen[j, i] += view.rotation[i, a] * joints[j, a]


@njit(cache=True, nogil=True)
def sphere_interval(across: float, depth: float, radius: float) -> tuple[float, float]:
    """Return the smallest and the largest x/z of a sphere with its centre at x = across, z = depth.

    The result is (−∞, ∞) if the sphere reaches the plane z = 0 of the camera or lies behind it.
    """
    if depth <= radius:
        return -np.inf, np.inf
    middle, below = across * depth, depth * depth - radius * radius
    half = radius * np.sqrt(across * across + below)
    return (middle - half) / below, (middle + half) / below


@njit(cache=True, nogil=True)
def capsule_box(one: F64, other: F64, radius: float, box: F64) -> None:
    """Write the smallest x/z and y/z and the largest x/z and y/z of a capsule in a camera's axes to the last array."""
    for i in range(2):
        low, high = sphere_interval(one[i], one[2], radius)
        low_other, high_other = sphere_interval(other[i], other[2], radius)
        box[i], box[2 + i] = min(low, low_other), max(high, high_other)


@njit(cache=True, nogil=True)
def ray_distance(one: F64, other: F64, x: float, y: float) -> float:
    """Return the squared distance of the ray (x, y, 1) of a camera from a segment, both in the camera's axes.

    The distance is infinite if the point of the line that is nearest to the segment lies behind the camera.
    """
    norm = x * x + y * y + 1.0
    first = one[0] * x + one[1] * y + one[2]
    last = other[0] * x + other[1] * y + other[2]
    u, v, w = other[0] - one[0], other[1] - one[1], other[2] - one[2]
    slope = last - first
    bend = u * u + v * v + w * w - slope * slope / norm
    lean = one[0] * u + one[1] * v + one[2] * w - first * slope / norm
    s = 0.0 if bend <= 1e-18 else min(max(-lean / bend, 0.0), 1.0)
    along = first + s * slope
    if along <= 0.0:
        return np.inf
    p, q, r = one[0] + s * u, one[1] + s * v, one[2] + s * w
    square: float = p * p + q * q + r * r - along * along / norm
    return square


def render_mask(capsules: Capsules, joints: F64, view: View) -> Bool:
    """Return the mask of a body in a camera, exact at the centre of every pixel.

    Parameters
    ----------
    capsules : Capsules
        The body's capsules, see `kinedex.ops.body.capsules.body_capsules`.
    joints : float64 array (J, 3)
        The joints of one pose in metres.
    view : View
        The camera, see `kinedex.ops.tracking.views.camera_view`.

    Returns
    -------
    bool array (H, W)
        True if the ray of a pixel meets the body in front of the camera; all False if a joint is not finite.
    """
    if joints.ndim != 2 or joints.shape[1] != 3 or len(joints) <= max(capsules.starts.max(), capsules.ends.max()):
        raise ParameterError("joints", "of shape (J, 3), with all joints of the capsules", joints.shape)
    mask = np.zeros(view.plane.shape[:2], np.bool_)
    if np.isfinite(joints).all():
        _render(capsules, np.ascontiguousarray(joints, np.float64), view, mask)
    return mask


@njit(cache=True, nogil=True)
def count_overlap(capsules: Capsules, joints: F64, view: View, mask: U8) -> tuple[int, int]:
    """Return the number of pixels of a body (J, 3) in a camera, and how many of these are foreground in a mask."""
    drawn = np.zeros(mask.shape, np.bool_)
    _render(capsules, joints, view, drawn)
    own, common = 0, 0
    for row in range(mask.shape[0]):
        for column in range(mask.shape[1]):
            if drawn[row, column]:
                own += 1
                common += mask[row, column] > 127
    return own, common


@njit(cache=True, nogil=True)
def _render(capsules: Capsules, joints: F64, view: View, mask: Bool) -> None:
    seen, box = np.empty_like(joints), np.empty(4)
    seen_joints(view, joints, seen)
    for n in range(len(capsules.radii)):
        one, other = seen[capsules.starts[n]], seen[capsules.ends[n]]
        radius = capsules.radii[n]
        capsule_box(one, other, radius, box)
        left, top, right, bottom = _pixel_box(view, box)
        for row in range(top, bottom):
            for column in range(left, right):
                if not mask[row, column]:
                    x, y = view.plane[row, column]
                    mask[row, column] = ray_distance(one, other, x, y) <= radius * radius


@njit(cache=True, nogil=True)
def _pixel_box(view: View, box: F64) -> tuple[int, int, int, int]:
    """Return the half-open box left, top, right, bottom of the pixels that may show a box of x/z and y/z."""
    height, width = view.plane.shape[:2]
    x0, x1 = max(box[0], view.extent[0]), min(box[2], view.extent[2])
    y0, y1 = max(box[1], view.extent[1]), min(box[3], view.extent[3])
    if x0 > x1 or y0 > y1:
        return 0, 0, 0, 0
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    for i in range(_EDGE):
        for j in range(_EDGE):
            x, y = x0 + (x1 - x0) * i / (_EDGE - 1), y0 + (y1 - y0) * j / (_EDGE - 1)
            column, row = mask_pixel(view, x, y)
            left, top, right, bottom = min(left, column), min(top, row), max(right, column), max(bottom, row)
    # The distorted image of a line leaves the box of its sampled points by less than an eighth of their distance.
    more = 2.0 if not view.distortion.any() else 2.0 + (max(right - left, bottom - top)) / 8.0
    first_column, first_row = max(0, int(np.floor(left - more))), max(0, int(np.floor(top - more)))
    return first_column, first_row, min(width, int(right + more) + 1), min(height, int(bottom + more) + 1)
