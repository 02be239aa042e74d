"""This module finds the foreground of a depth image and removes its noise (thesis, Section 8.3.1).

A pixel is foreground if its depth z is above `near`, below `far`, in front of the background and above the floor. The
last three conditions hold up to a certain depth and fail beyond it. They are therefore combined into a table with one
limit for each pixel, which is exact to the last bit. The foreground pixels are then filtered in windows of 3 × 3:
contours and flying pixels are removed, and the other pixels get the median of their window.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F32, F64, I32, I64, Bool

NEAR_M, FAR_M = 0.4, 8.0
"""Minimum and maximum depth of the foreground, in metres."""

BEFORE_BACKGROUND, BEFORE_BACKGROUND_SHARE = 0.06, 0.015
"""A pixel of depth z is foreground only if it is nearer than the background by more than the first plus z · the second.
"""

ABOVE_FLOOR_M = 0.01
"""Height in metres above a known floor up to which points belong to the floor."""

MIN_NEIGHBOURS, MAX_FROM_MEDIAN_M = 5, 0.10
"""A pixel is kept if at least this many of 8 neighbours are foreground, and it is nearer than this to the median."""

# Sensors report whole millimetres; in float32 a difference of exactly 0.10 m may not be below 0.10.
_ROUNDING_M = 1e-6


class PointArrays(NamedTuple):
    """Preallocated arrays for the points of frames of h rows and w columns.

    Parameters
    ----------
    directions : float64 array (h, w, 3)
        The point (x, y, 1) on the ray of each pixel.
    points : float64 array (h · w, 3)
        The position of each point in metres.
    pixels : int32 array (h · w, 2)
        The column and row of each point.
    numbers : int32 array (h, w)
        The index of the point of each pixel; −1 for a pixel without a point.
    depth : float32 array (h, w)
        The filtered depths.
    box : int64 array (4,)
        The bounding box of all points: first column, first row, and the column and the row after the last.
    """

    directions: F64
    points: F64
    pixels: I32
    numbers: I32
    depth: F32
    box: I64


def depth_limits(background: F32 | None, rises: F64, floor_height: float | None, far: float) -> F32:
    """Return for each pixel the smallest depth that no longer belongs to the foreground.

    Parameters
    ----------
    background : float32 array (h, w), optional
        Depths of the empty scene in metres; 0 where nothing was measured.
    rises : float64 array (h, w)
        The Y coordinate of each pixel's ray at z = 1.
    floor_height : float, optional
        The Y coordinate of the floor in metres.
    far : float
        The largest depth in metres.

    Returns
    -------
    float32 array (h, w)
        The limits: exactly the depths below them meet the conditions, evaluated in float64.
    """
    limits = np.full(rises.shape, far)
    if floor_height is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            limits = np.where(rises < 0, np.minimum(limits, (floor_height + ABOVE_FLOOR_M) / rises), limits)
    if background is not None:
        wall = (background.astype(np.float64) - BEFORE_BACKGROUND) / (1.0 + BEFORE_BACKGROUND_SHARE)
        limits = np.where(background > 0, np.minimum(limits, wall), limits)

    def passes(z: F32) -> Bool:
        return is_foreground(z, background, rises, floor_height, far)

    bound = np.maximum(limits, 0.0).astype(np.float32)
    for _ in range(64):  # rounding has moved the limit by a few steps of float32 at most
        above = np.nextafter(bound, np.float32(np.inf))
        below = np.nextafter(bound, np.float32(0.0))
        moved = np.where(passes(bound), above, np.where((bound > 0) & ~passes(below), below, bound))
        if np.array_equal(moved, bound):
            break
        bound = moved
    return np.where(np.isnan(rises), np.float32(0.0), bound)


def is_foreground(z: F32, background: F32 | None, rises: F64, floor_height: float | None, far: float) -> Bool:
    """Return a mask of depths in front of the background, above the floor and nearer than `far`; see `depth_limits`."""
    depth = z.astype(np.float64)
    found = depth < far
    if background is not None:
        wall = background.astype(np.float64)
        found &= ~(wall > 0) | (wall - depth > BEFORE_BACKGROUND + BEFORE_BACKGROUND_SHARE * depth)
    if floor_height is not None:
        found &= depth * rises > floor_height + ABOVE_FLOOR_M
    return found


def float32_below(value: float) -> np.float32:
    """Return the largest float32 that is not above a number."""
    rounded = np.float32(value)
    return rounded if float(rounded) <= value else np.nextafter(rounded, np.float32(-np.inf))


@njit(cache=True, nogil=True)
def find_foreground(image: F32, limits: F32, near: np.float32, foreground: F32, runs: I64) -> int:
    """Copy foreground depths into a padded image, find the range of columns in each row, and return their count.

    Parameters
    ----------
    image : float32 array (h, w)
        Depths in metres; 0 where nothing was measured.
    limits : float32 array (h, w)
        See `depth_limits`.
    near : float32
        Depth in metres above which a pixel can be foreground.
    foreground : float32 array (h + 2, w + 2)
        Output: the depths of the foreground, 0 elsewhere, with a border of zeros.
    runs : int64 array (h, 2)
        Output: the first foreground column of each row, and the column after the last.

    Returns
    -------
    int
        The number of foreground pixels.
    """
    height, width = image.shape
    total = 0
    for v in range(height):
        given, limit, kept = image[v], limits[v], foreground[v + 1, 1 : width + 1]
        count = np.int32(0)
        for u in range(width):
            z = given[u]
            passes = (z > near) & (z < limit[u])
            kept[u] = z if passes else np.float32(0.0)
            count += np.int32(passes)
        left, right = 0, 0
        if count > 0:
            total += int(count)
            right = width
            while kept[left] == 0:
                left += 1
            while kept[right - 1] == 0:
                right -= 1
        runs[v, 0], runs[v, 1] = left, right
    return total


@njit(cache=True, nogil=True)
def remove_noise(foreground: F32, runs: I64, rows: F32, found: PointArrays) -> int:
    """Filter the foreground of a frame and write its points; return their number.

    Parameters
    ----------
    foreground : float32 array (h + 2, w + 2)
        The foreground, see `find_foreground`.
    runs : int64 array (h, 2)
        The foreground's columns in each row.
    rows : float32 array (5, w + 2)
        Work memory for the sorted columns and the medians of a row.
    found : PointArrays
        The arrays to write; the pixels of the previous frame, within its box, are cleared first.

    Returns
    -------
    int
        The number of points.
    """
    pixels, numbers, depth, box = found.pixels, found.numbers, found.depth, found.box
    for v in range(box[1], box[3]):
        numbers[v, box[0] : box[2]] = -1
        depth[v, box[0] : box[2]] = 0.0
    n, first, last = 0, numbers.shape[1], 0
    for v in range(numbers.shape[0]):
        left, right, former = runs[v, 0], runs[v, 1], n
        if left < right:
            n = _clean_run(foreground, rows, v, left, right, np.int64(n), found)
        for k in range(former, n):
            numbers[v, pixels[k, 0]] = k
        if n > former:
            first, last = min(first, pixels[former, 0]), max(last, pixels[n - 1, 0] + 1)
    box[:] = 0
    if n > 0:
        box[0], box[1], box[2], box[3] = first, pixels[0, 1], last, pixels[n - 1, 1] + 1
    return n


@njit(cache=True, nogil=True)
def _clean_run(foreground: F32, rows: F32, v: int, left: int, right: int, n: int, found: PointArrays) -> int:
    """Write the kept pixels of a range of columns in a row, after the first n points, and return the new count."""
    directions, points, pixels, depth = found.directions, found.points, found.pixels, found.depth
    size = right - left + 2
    lows, middles, highs, counts, medians = (
        rows[0, :size], rows[1, :size], rows[2, :size], rows[3, :size], rows[4, : size - 2]
    )  # fmt: skip
    above, here, below = (
        foreground[v, left : right + 2], foreground[v + 1, left : right + 2], foreground[v + 2, left : right + 2]
    )  # fmt: skip
    _sort_columns(above, here, below, lows, middles, highs, counts)
    _medians(lows, middles, highs, medians)
    for i in range(size - 2):
        z = here[i + 1]
        kept = int(counts[i] + counts[i + 1] + counts[i + 2])
        if z == 0 or kept < MIN_NEIGHBOURS + 1:
            continue
        m = medians[i] if kept >= 8 else _sixth(above, here, below, i)
        far = np.float64(m)
        if abs(np.float64(z) - far) < MAX_FROM_MEDIAN_M - _ROUNDING_M:
            u = left + i
            depth[v, u] = m
            pixels[n, 0], pixels[n, 1] = u, v
            points[n, 0] = far * directions[v, u, 0]
            points[n, 1] = far * directions[v, u, 1]
            points[n, 2] = far * directions[v, u, 2]
            n += 1
    return n


@njit(cache=True, nogil=True)
def _sort_columns(above: F32, here: F32, below: F32, lows: F32, middles: F32, highs: F32, counts: F32) -> None:
    """Sort the three values of each column, and count the values above 0."""
    for i in range(len(above)):
        a, b, c = above[i], here[i], below[i]
        one = np.float32(1.0)
        none = np.float32(0.0)
        counts[i] = (one if a > 0 else none) + (one if b > 0 else none) + (one if c > 0 else none)
        low, high = (a if a < b else b), (b if a < b else a)
        middle = c if c > low else low
        lows[i] = low if c > low else c
        middles[i] = middle if middle < high else high
        highs[i] = high if middle < high else middle


@njit(cache=True, nogil=True)
def _medians(lows: F32, middles: F32, highs: F32, medians: F32) -> None:
    """Compute the median of each window of three columns, counting pixels without a depth as 0."""
    for i in range(len(medians)):
        a, b, c = lows[i], lows[i + 1], lows[i + 2]
        low = a if a > b else b
        low = low if low > c else c
        a, b, c = highs[i], highs[i + 1], highs[i + 2]
        high = a if a < b else b
        high = high if high < c else c
        a, b, c = middles[i], middles[i + 1], middles[i + 2]
        less, more = (a if a < b else b), (b if a < b else a)
        c = c if c < more else more
        middle = c if c > less else less
        less, more = (low if low < middle else middle), (middle if low < middle else low)
        high = high if high < more else more
        medians[i] = high if high > less else less


@njit(cache=True, nogil=True)
def _sixth(above: F32, here: F32, below: F32, i: int) -> np.float32:
    """Return the sixth smallest value of a 3 × 3 window; with two or three zeros, the lower median of the others."""
    first = second = third = fourth = np.float32(-1.0)  # the four greatest, descending
    for row in (above, here, below):
        for k in range(3):
            value = row[i + k]
            if value > fourth:
                fourth = value
                if fourth > third:
                    third, fourth = fourth, third
                if third > second:
                    second, third = third, second
                if second > first:
                    first, second = second, first
    return fourth
