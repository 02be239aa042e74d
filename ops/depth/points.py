"""From a depth image to the points of the person: rays, foreground, cleaning (thesis, Section 8.3.1).

A pixel is foreground if its depth z is above `near`, below `far` and below a limit that background and floor set. Each
of these conditions holds up to one depth and fails beyond it, so one table of limits, exact to the last bit, stands for
all of them. What is left is judged in windows of 3 × 3 pixels: contours and flying pixels go, and the others take the
median of their window. Points have the axes x right, y up, z to the rear, with the camera at the origin, turned so that
+Y is up.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.cameras.projection import undistort
from kinedex.ops.errors import ParameterError

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
I32 = npt.NDArray[np.int32]
I64 = npt.NDArray[np.int64]

NEAR_M, FAR_M = 0.4, 8.0
"""Depths of the foreground lie between these, in metres."""

BEFORE_BACKGROUND, BEFORE_BACKGROUND_SHARE = 0.06, 0.015
"""A foreground pixel is nearer than the background by more than the first, in metres, plus the second times z."""

ABOVE_FLOOR_M = 0.01
"""Points that are not higher above a known floor belong to it."""

LEAST_NEIGHBOURS, MOST_FROM_MEDIAN_M = 5, 0.10
"""A pixel stays with as many foreground neighbours of 8, and nearer than this to the median of its window."""

_ROUNDING_M = (
    1e-6  # sensors report whole millimetres: a difference of exactly 0.10 in them is not below 0.10 in float32
)

MOST_POINTS = 6000
"""The stride is the least with which the median frame has at most as many points."""

STRIDE_FRAMES = 10
"""The stride is chosen on the first frames, as many as this."""


class NearestRoom(NamedTuple):
    """The arrays that nearest points are found in.

    Attributes
    ----------
    nearest : int32 array (h, w)
        The nearest point of each pixel of the box.
    box : int64 array (4,)
        The box that `nearest` was filled in.
    steps : int32 array (h, w)
        The rows from each pixel to the nearest point of its column.
    hull : float64 array (3, w)
        The lower envelope of a row: where each part begins, its column and its squared distance.
    """

    nearest: I32
    box: I64
    steps: I32
    hull: F64


class FrameCloud(NamedTuple):
    """The points of a frame; its arrays are overwritten when the next frame is prepared.

    Attributes
    ----------
    points : float64 array (n, 3)
        Places in metres, row by row of the image.
    pixels : int32 array (n, 2)
        Column and row of each point in the strided image.
    numbers : int32 array (h, w)
        The point of each pixel; −1 where there is none.
    depth : float32 array (h, w)
        The cleaned depths in metres; 0 where there is no point.
    box : (int, int, int, int)
        First column, first row, and the column and row after the last, of all points; zeros without any.
    foreground : int
        The number of foreground pixels before cleaning.
    room : NearestRoom, optional
        Room for `nearest_pixels`, that of the recording; None: it is made.
    """

    points: F64
    pixels: I32
    numbers: I32
    depth: F32
    box: tuple[int, int, int, int]
    foreground: int
    room: NearestRoom | None = None


def ray_table(matrix: npt.ArrayLike, distortion: npt.ArrayLike, size: tuple[int, int], stride: int = 1) -> F64:
    """Return the rays (a, b, 1) of the pixels of a strided image, distortion undone.

    Parameters
    ----------
    matrix : float64 array (3, 3)
        [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], in pixels of the whole image.
    distortion : float64 array (0,), (4,), (5,) or (8,)
        k1 k2 p1 p2 k3 k4 k5 k6, or the first of them.
    size : (int, int)
        Width and height of the whole image.
    stride : int
        Every how many rows and columns a pixel is used.

    Returns
    -------
    float64 array (h, w, 2)
        a and b; NaN for pixels that no ray falls on.
    """
    (fx, skew, cx), (_, fy, cy) = np.asarray(matrix, np.float64)[:2]
    columns, rows = np.meshgrid(np.arange(0, size[0], stride), np.arange(0, size[1], stride))
    b = (rows - cy) / fy
    return undistort(distortion, np.stack([(columns - cx - skew * b) / fx, b], axis=-1))


class Preparation:
    """The preparation of the frames of one recording, with the room that it needs.

    Parameters
    ----------
    rays : float64 array (h, w, 2)
        a and b of the pixels of the strided image, see `ray_table`.
    background : float32 array (H, W), optional
        The empty scene, in metres as the frames are; 0 where nothing was measured. None: there is none.
    turn : float64 array (3, 3), optional
        The rotation that brings the camera's own (x, −y, −z) to axes with +Y up; None for a level camera.
    floor_height : float, optional
        The floor's Y after that turn, in metres: minus the height of the camera; None where it is unknown.
    near, far : float
        Depths of the foreground lie between these, in metres.
    stride : int
        Every how many rows and columns of a frame a pixel is used.
    is_range : bool
        True where frames and background hold distances along the ray, not z.
    """

    def __init__(
        self,
        rays: F64,
        background: npt.ArrayLike | None = None,
        turn: npt.ArrayLike | None = None,
        floor_height: float | None = None,
        near: float = NEAR_M,
        far: float = FAR_M,
        *,
        stride: int = 1,
        is_range: bool = False,
    ) -> None:
        if stride < 1:
            raise ParameterError("stride", "at least 1", stride)
        if floor_height is not None and not floor_height < -ABOVE_FLOOR_M:
            way = f"below −{ABOVE_FLOOR_M:g}, since the camera is at 0 and the floor below it"
            raise ParameterError("floor_height", way, floor_height)
        self.stride, self.shape = stride, rays.shape[:2]
        height, width = self.shape
        around = np.eye(3) if turn is None else np.asarray(turn, np.float64)
        a, b = rays[..., 0], rays[..., 1]
        self._directions = np.ascontiguousarray(np.stack([a, -b, -np.ones_like(a)], axis=-1) @ around.T)
        self._scales = (1.0 / np.sqrt(1.0 + a * a + b * b)).astype(np.float32) if is_range else None
        self._image = np.zeros(self.shape, np.float32)
        wall = None if background is None else self._strided("background", background).copy()
        self._limits = depth_limits(wall, self._directions[..., 1], floor_height, far)
        self._near = _float32_below(near)
        self._foreground = np.zeros((height + 2, width + 2), np.float32)
        self._runs = np.zeros((height, 2), np.int64)
        self._rows = np.zeros((5, width + 2), np.float32)
        self._points, self._pixels = np.zeros((height * width, 3)), np.zeros((height * width, 2), np.int32)
        self._numbers, self._depth = np.full(self.shape, -1, np.int32), np.zeros(self.shape, np.float32)
        self._box, self._nearest = np.zeros(4, np.int64), nearest_room(self.shape)

    def prepare(self, image: npt.ArrayLike) -> FrameCloud:
        """Return the points of a frame.

        Parameters
        ----------
        image : float32 array (H, W)
            Depths in metres; 0 where nothing was measured.

        Returns
        -------
        FrameCloud
            The points, in arrays that the next frame overwrites.

        Raises
        ------
        ParameterError
            The image has another size than the rays.
        """
        depths = self._strided("image", image)
        count = _foreground(depths, self._limits, self._near, self._foreground, self._runs)
        n = _clean(
            self._foreground, self._directions, self._runs, self._rows,
            self._points, self._pixels, self._numbers, self._depth, self._box,
        )  # fmt: skip
        u0, v0, u1, v1 = self._box.tolist()
        return FrameCloud(
            self._points[:n], self._pixels[:n], self._numbers, self._depth, (u0, v0, u1, v1), count, self._nearest
        )

    def _strided(self, name: str, image: npt.ArrayLike) -> F32:
        """Return every k-th row and column of an image as depths z, in the room of the next one."""
        taken = np.asarray(image)[:: self.stride, :: self.stride]
        if taken.shape != self.shape:
            raise ParameterError(name, f"of shape {self.shape} at stride {self.stride}", taken.shape)
        if self._scales is not None:
            return np.multiply(taken, self._scales, out=self._image, casting="same_kind")
        if taken.dtype == np.float32 and taken.flags.c_contiguous:
            return taken
        np.copyto(self._image, taken, casting="same_kind")
        return self._image


def choose_stride(
    images: Sequence[npt.ArrayLike],
    matrix: npt.ArrayLike,
    distortion: npt.ArrayLike = (),
    background: npt.ArrayLike | None = None,
    turn: npt.ArrayLike | None = None,
    floor_height: float | None = None,
    near: float = NEAR_M,
    far: float = FAR_M,
    *,
    is_range: bool = False,
    most: int = MOST_POINTS,
) -> int:
    """Return the least stride with which the median frame of the first ten has at most so many points.

    Parameters
    ----------
    images : sequence of float32 array (H, W)
        The first frames of a recording, in metres; those after the tenth are not looked at.
    matrix, distortion
        The camera, see `ray_table`.
    background, turn, floor_height, near, far, is_range
        See `Preparation`.
    most : int
        The greatest number of points.

    Returns
    -------
    int
        The stride; 1 without images.
    """
    first = [np.asarray(image) for image in images[:STRIDE_FRAMES]]
    if not first:
        return 1
    height, width = first[0].shape
    for stride in range(1, max(height, width) + 1):
        rays = ray_table(matrix, distortion, (width, height), stride)
        work = Preparation(rays, background, turn, floor_height, near, far, stride=stride, is_range=is_range)
        if np.median([len(work.prepare(image).points) for image in first]) <= most:
            return stride
    return max(height, width)


def depth_limits(background: F32 | None, rises: F64, floor_height: float | None, far: float) -> F32:
    """Return the least depth of each pixel that is no foreground any more.

    Parameters
    ----------
    background : float32 array (h, w), optional
        Depths of the empty scene in metres; 0 where nothing was measured.
    rises : float64 array (h, w)
        The Y of each pixel's ray at z = 1.
    floor_height : float, optional
        The floor's Y in metres.
    far : float
        The greatest depth in metres.

    Returns
    -------
    float32 array (h, w)
        Depths below it pass, and all others fail, with the conditions evaluated in float64.
    """
    limits = np.full(rises.shape, far)
    if floor_height is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            limits = np.where(rises < 0, np.minimum(limits, (floor_height + ABOVE_FLOOR_M) / rises), limits)
    if background is not None:
        wall = (background.astype(np.float64) - BEFORE_BACKGROUND) / (1.0 + BEFORE_BACKGROUND_SHARE)
        limits = np.where(background > 0, np.minimum(limits, wall), limits)

    def passes(z: F32) -> npt.NDArray[np.bool_]:
        return is_foreground(z, background, rises, floor_height, far)

    bound = np.maximum(limits, 0.0).astype(np.float32)
    for _ in range(64):  # rounding has moved it by a few steps of float32 at most
        above = np.nextafter(bound, np.float32(np.inf))
        below = np.nextafter(bound, np.float32(0.0))
        moved = np.where(passes(bound), above, np.where((bound > 0) & ~passes(below), below, bound))
        if np.array_equal(moved, bound):
            break
        bound = moved
    return np.where(np.isnan(rises), np.float32(0.0), bound)


def is_foreground(
    z: F32, background: F32 | None, rises: F64, floor_height: float | None, far: float
) -> npt.NDArray[np.bool_]:
    """Return which depths lie before the background, above the floor and nearer than `far`; see `depth_limits`."""
    depth = z.astype(np.float64)
    found = depth < far
    if background is not None:
        wall = background.astype(np.float64)
        found &= ~(wall > 0) | (wall - depth > BEFORE_BACKGROUND + BEFORE_BACKGROUND_SHARE * depth)
    if floor_height is not None:
        found &= depth * rises > floor_height + ABOVE_FLOOR_M
    return found


def nearest_pixels(cloud: FrameCloud) -> I32:
    """Return the point of the pixel that is nearest to each pixel of the box.

    Parameters
    ----------
    cloud : FrameCloud
        The points of a frame.

    Returns
    -------
    int32 array (h, w)
        The point, ties to the lowest column, then the lowest row; −1 outside the box, or without points. The next
        frame of the recording overwrites it.
    """
    room = nearest_room(cloud.numbers.shape) if cloud.room is None else cloud.room
    _nearest(cloud.numbers, *cloud.box, room)
    return room.nearest


def nearest_room(shape: tuple[int, ...]) -> NearestRoom:
    """Return room for the nearest points of images of h rows and w columns."""
    empty = np.zeros(4, np.int64)
    return NearestRoom(np.full(shape, -1, np.int32), empty, np.zeros(shape, np.int32), np.zeros((3, shape[1])))


def _float32_below(value: float) -> np.float32:
    """Return the greatest float32 that is not above a number."""
    rounded = np.float32(value)
    return rounded if float(rounded) <= value else np.nextafter(rounded, np.float32(-np.inf))


@njit(cache=True, nogil=True)
def _foreground(image: F32, limits: F32, near: np.float32, foreground: F32, runs: I64) -> int:
    """Copy foreground depths into the padded image, find where they begin and end in each row, and count them."""
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
def _clean(
    foreground: F32, directions: F64, runs: I64, rows: F32,
    points: F64, pixels: I32, numbers: I32, depth: F32, box: I64,
) -> int:  # fmt: skip
    """Clear the former frame's box, number the pixels that stay, set their box, and return how many there are."""
    for v in range(box[1], box[3]):
        numbers[v, box[0] : box[2]] = -1
        depth[v, box[0] : box[2]] = 0.0
    n, first, last = 0, numbers.shape[1], 0
    for v in range(numbers.shape[0]):
        left, right, former = runs[v, 0], runs[v, 1], n
        if left < right:
            n = _clean_run(foreground, rows, v, left, right, n, directions, points, pixels, depth)
        for k in range(former, n):
            numbers[v, pixels[k, 0]] = k
        if n > former:
            first, last = min(first, pixels[former, 0]), max(last, pixels[n - 1, 0] + 1)
    box[:] = 0
    if n > 0:
        box[0], box[1], box[2], box[3] = first, pixels[0, 1], last, pixels[n - 1, 1] + 1
    return n


@njit(cache=True, nogil=True)
def _clean_run(
    foreground: F32, rows: F32, v: int, left: int, right: int, n: int,
    directions: F64, points: F64, pixels: I32, depth: F32,
) -> int:  # fmt: skip
    """Write the pixels that stay of some columns of a row, after n points, and return the new number of points."""
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
        if z == 0 or kept < LEAST_NEIGHBOURS + 1:
            continue
        m = medians[i] if kept >= 8 else _sixth(above, here, below, i)
        far = np.float64(m)
        if abs(np.float64(z) - far) < MOST_FROM_MEDIAN_M - _ROUNDING_M:
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
    """Sort the three values of each column, and count those above 0."""
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
    """Compute the median of each window of three columns, in which pixels without a depth count as 0."""
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
    """Return the sixth of the nine values of a window: the lower median of six or seven, zeros before them."""
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


@njit(cache=True, nogil=True)
def _nearest(numbers: I32, left: int, top: int, right: int, bottom: int, room: NearestRoom) -> None:
    """Fill the nearest points: down and up each column, then along each row by the lower envelope of parabolas."""
    nearest, box, steps = room.nearest, room.box, room.steps
    for v in range(box[1], box[3]):
        nearest[v, box[0] : box[2]] = -1
    box[0], box[1], box[2], box[3] = left, top, right, bottom
    far = np.int32(1 << 14)  # above any distance in an image, and its square below 2³¹
    for v in range(top, bottom):  # steps to the nearest point of the column; negative for one above
        for u in range(left, right):
            before = steps[v - 1, u] - 1 if v > top else -far
            steps[v, u] = 0 if numbers[v, u] >= 0 else max(before, -far)
    for v in range(bottom - 2, top - 1, -1):
        for u in range(left, right):
            after = steps[v + 1, u] + 1 if steps[v + 1, u] >= 0 else far
            if after < -steps[v, u]:
                steps[v, u] = after
    for v in range(top, bottom):
        _nearest_of_row(numbers, v, left, right, far, steps[v], room.hull, nearest[v])


@njit(cache=True, nogil=True)
def _nearest_of_row(numbers: I32, v: int, left: int, right: int, far: int, steps: I32, hull: F64, nearest: I32) -> None:
    """Fill the nearest points of a row from those of the columns (Meijster, Roerdink and Hesselink, 2000)."""
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
