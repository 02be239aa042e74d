"""This module finds the nearest foreground pixel of every pixel in a box by an exact distance transform."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I32, I64


class NearestBuffers(NamedTuple):
    """Preallocated arrays for finding nearest points.

    Attributes
    ----------
    nearest : int32 array (h, w)
        The nearest point of each pixel of the box.
    box : int64 array (4,)
        The box in which `nearest` is filled.
    steps : int32 array (h, w)
        The number of rows from each pixel to the nearest point in its column.
    hull : float64 array (3, w)
        The lower envelope of a row: the start of each of its parts, and the part's column and squared distance.
    """

    nearest: I32
    box: I64
    steps: I32
    hull: F64


def nearest_pixels(numbers: I32, box: tuple[int, int, int, int], buffers: NearestBuffers | None = None) -> I32:
    """Return for each pixel of the box the point of the nearest pixel that has a point.

    Parameters
    ----------
    numbers : int32 array (h, w)
        The index of the point of each pixel; −1 for a pixel without a point.
    box : (int, int, int, int)
        The bounding box of all points: first column, first row, and the column and the row after the last.
    buffers : NearestBuffers, optional
        Arrays to reuse from earlier frames; None allocates them.

    Returns
    -------
    int32 array (h, w)
        The points; in a tie, that of the lowest column, then of the lowest row; −1 outside the box, or if there are no
        points. The array is overwritten by the next call with the same buffers.
    """
    buffers = nearest_buffers(numbers.shape) if buffers is None else buffers
    _nearest(numbers, *box, buffers)
    return buffers.nearest


def nearest_buffers(shape: tuple[int, ...]) -> NearestBuffers:
    """Allocate the arrays for images of h rows and w columns."""
    empty = np.zeros(4, np.int64)
    return NearestBuffers(np.full(shape, -1, np.int32), empty, np.zeros(shape, np.int32), np.zeros((3, shape[1])))


@njit(cache=True, nogil=True)
def _nearest(numbers: I32, left: int, top: int, right: int, bottom: int, buffers: NearestBuffers) -> None:
    """Fill in the nearest points: down and up each column, then along each row by the lower envelope of parabolas."""
    nearest, box, steps = buffers.nearest, buffers.box, buffers.steps
    for v in range(box[1], box[3]):
        nearest[v, box[0] : box[2]] = -1
    box[0], box[1], box[2], box[3] = left, top, right, bottom
    far = np.int32(1 << 14)  # above any distance in an image, and its square below 2³¹
    for v in range(top, bottom):  # signed number of rows to the nearest point of the column; negative for a point above
        for u in range(left, right):
            before = steps[v - 1, u] - 1 if v > top else -far
            steps[v, u] = 0 if numbers[v, u] >= 0 else max(before, -far)
    for v in range(bottom - 2, top - 1, -1):
        for u in range(left, right):
            after = steps[v + 1, u] + 1 if steps[v + 1, u] >= 0 else far
            if after < -steps[v, u]:
                steps[v, u] = after
    for v in range(top, bottom):
        _nearest_of_row(numbers, v, left, right, far, steps[v], buffers.hull, nearest[v])


@njit(cache=True, nogil=True)
def _nearest_of_row(numbers: I32, v: int, left: int, right: int, far: int, steps: I32, hull: F64, nearest: I32) -> None:
    """Fill in the nearest points of a row from those of the columns (Meijster, Roerdink and Hesselink, 2000)."""
    starts, columns, squares = hull[0], hull[1], hull[2]
    count = 0
    for u in range(left, right):
        if abs(steps[u]) >= far:
            continue
        square = np.float64(steps[u]) * np.float64(steps[u])
        start = np.float64(left)
        while count > 0:
            last = columns[count - 1]
            reach = (u * u - last * last + square - squares[count - 1]) / (2.0 * (u - last))
            start = np.floor(reach) + 1.0  # the first column that is nearer to this one
            if start > starts[count - 1]:
                break
            count -= 1
            start = np.float64(left)
        if count == 0 or start < right:
            starts[count], columns[count], squares[count] = start, u, square
            count += 1
    k = 0
    for u in range(left, right):
        while k + 1 < count and starts[k + 1] <= u:
            k += 1
        if count > 0:
            column = int(columns[k])
            nearest[u] = numbers[v + steps[column], column]
