"""This module renders the mask of a body in a camera: the pixels whose rays meet one of its capsules."""

from __future__ import annotations

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, U8, Bool
from kinedex.ops.body.capsules import Capsules
from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking.views import View, capsule_box, mask_pixel, ray_distance, seen_joints

_EDGE = 5  # points along each side of a box that are projected if the lens has distortion


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
        True where the ray of a pixel meets the body before the camera.
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
