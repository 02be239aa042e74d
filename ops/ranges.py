"""This module computes with half-open ranges of frames: int64 arrays (R, 2), one row [start, stop) for each range.

The numbers of a range have one of three meanings. They are frames of one take; or frames of concatenated takes, where
take i has the frames offsets[i] to offsets[i + 1] - 1; or positions on an axis for a whole archive. `TakeRanges` holds
the ranges of many takes as frames of each take.

On the axis, every frame has the position ``take_index << 32 | frame``. A list of segments is an int64 array (n, 2) of
half-open ranges of positions, ascending, neither overlapping nor touching (thesis, Eq. 3.5 and 3.6). Frames are below
2**31, and gaps are clamped to 2**31 - 1. Hence a frame plus a gap stays below 2**32, and a frame minus a gap may reach
the upper half of the previous take's block of 2**32 positions, but no frame is there. So no hit leaves its take, even
if a gap is unbounded. A stop is at most 2**31, half a block before the next take begins, so that segments of two takes
neither overlap nor touch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba as nb
import numpy as np
import numpy.typing as npt

from kinedex.ops.arrays import I64
from kinedex.ops.errors import ParameterError

TAKE_BITS = 32
"""Base-2 logarithm of the distance between takes on the axis."""

_MAX_FRAMES = 2**31


@dataclass(frozen=True)
class TakeRanges:
    """Ranges of frames of T takes, in the order of the takes.

    Parameters
    ----------
    offsets : int64 array (T + 1,)
        Take i has the ranges offsets[i] to offsets[i + 1] - 1.
    ranges : int64 array (R, 2)
        Half-open ranges in frames of their take, ascending within a take, neither overlapping nor touching.
    """

    offsets: I64
    ranges: I64

    def __len__(self) -> int:
        return len(self.offsets) - 1

    @property
    def starts(self) -> I64:
        """Return the first frame of each range, int64 (R,), without a copy."""
        return self.ranges[:, 0]

    @property
    def stops(self) -> I64:
        """Return the frame after the last one of each range, int64 (R,), without a copy."""
        return self.ranges[:, 1]

    @property
    def takes(self) -> I64:
        """Return the position of the take of each range, int64 (R,)."""
        return np.repeat(np.arange(len(self), dtype=np.int64), np.diff(self.offsets))

    @property
    def frames(self) -> int:
        """Return the total number of frames in all ranges."""
        return int((self.stops - self.starts).sum())

    def take(self, index: int) -> I64:
        """Return the ranges of the take at a position, int64 (r, 2), without a copy."""
        return self.ranges[self.offsets[index] : self.offsets[index + 1]]

    def end_to_end(self, offsets: I64) -> I64:
        """Convert the ranges to frames of concatenated takes.

        Parameters
        ----------
        offsets : int64 array (T + 1,)
            The first frame of each take, and the end (`TakeWords.offsets`).

        Returns
        -------
        int64 array (R, 2)
        """
        return self.ranges + offsets[self.takes, None]

    @classmethod
    def by_take(cls, ranges: I64, offsets: I64) -> TakeRanges:
        """Divide ranges in frames of concatenated takes by take; the inverse of `end_to_end`.

        Parameters
        ----------
        ranges : int64 array (R, 2)
            Ascending ranges, each within a take.
        offsets : int64 array (T + 1,)
            The first frame of each take, and the end.
        """
        edges = np.searchsorted(ranges[:, 0], offsets).astype(np.int64)
        takes = np.repeat(np.arange(len(offsets) - 1), np.diff(edges))
        return cls(edges, ranges - offsets[takes, None])

    @classmethod
    def placed(cls, parts: Sequence[tuple[I64, TakeRanges]], takes: int) -> TakeRanges:
        """Combine the ranges of disjoint subsets of takes into the ranges of T takes; other takes have none.

        Parameters
        ----------
        parts : sequence of (int64 array (t,), TakeRanges)
            The positions of some takes among all, ascending, and the ranges of these takes. No take is in two parts.
        takes : int
            The number T of all takes.
        """
        place = np.concatenate([np.empty(0, np.int64), *(positions[found.takes] for positions, found in parts)])
        ranges = np.concatenate([np.empty((0, 2), np.int64), *(found.ranges for _, found in parts)])
        order = np.argsort(place, kind="stable")
        return cls(np.searchsorted(place[order], np.arange(takes + 1)).astype(np.int64), ranges[order])

    @staticmethod
    def united(several: Sequence[TakeRanges]) -> TakeRanges:
        """Unite ranges of the same takes, merging those that overlap or touch.

        Parameters
        ----------
        several : sequence of TakeRanges
            One or more, each of the same T takes.

        Raises
        ------
        ParameterError
            If there are none, or their numbers of takes differ.
        """
        if not several or len({len(one) for one in several}) != 1:
            raise ParameterError("ranges", "one or more, all of the same takes", [len(one) for one in several])
        if len(several) == 1:
            return several[0]
        offsets = np.arange(len(several[0]) + 1, dtype=np.int64) << TAKE_BITS
        return TakeRanges.by_take(
            extend_and_unite(np.concatenate([one.end_to_end(offsets) for one in several]), offsets), offsets
        )


def checked_ranges(ranges: npt.ArrayLike | None, frames: int) -> I64:
    """Check that ranges ascend, and return them as an array without the empty ones.

    Parameters
    ----------
    ranges : array_like (R, 2), optional
        Half-open ranges, ascending and disjoint; they may touch. None stands for one range of all frames.
    frames : int
        The number of frames that the ranges must lie within.

    Returns
    -------
    int64 array (R, 2)

    Raises
    ------
    ParameterError
        If a range ends before it starts, begins before the previous one ends, or lies outside the frames.
    """
    if ranges is None:
        return np.array([[0, frames]] if frames else np.empty((0, 2)), np.int64)
    checked = np.ascontiguousarray(ranges, np.int64).reshape(-1, 2)
    edges = checked.ravel()
    if len(edges) and (edges[0] < 0 or edges[-1] > frames or np.any(np.diff(edges) < 0)):
        raise ParameterError("ranges", f"ascending ranges within {frames} frames", checked.tolist()[:4])
    return checked[checked[:, 0] < checked[:, 1]]


def extend_and_unite(ranges: I64, offsets: I64, left: int = 0, right: int = 0) -> I64:
    """Extend ranges by margins within their takes, and merge those that then overlap or touch.

    Parameters
    ----------
    ranges : int64 array (R, 2)
        Half-open ranges of frames of concatenated takes, in any order. No range is empty or extends over two takes.
    offsets : int64 array (T + 1,)
        The first frame of each take, and the end. Ranges of two takes are never united.
    left, right : int
        The numbers of frames to add before and after each range, 0 or more.

    Returns
    -------
    int64 array (R', 2)
        Ascending ranges; two ranges touch only at the boundary between two takes.

    Raises
    ------
    ParameterError
        If a margin is negative, or a range lies outside the takes.
    """
    if left < 0 or right < 0:
        raise ParameterError("margins", "0 or more frames", (left, right))
    if not len(ranges):
        return np.empty((0, 2), np.int64)
    if np.any(ranges[1:, 0] < ranges[:-1, 0]):
        ranges = ranges[np.argsort(ranges[:, 0], kind="stable")]
    if ranges[0, 0] < offsets[0] or ranges[-1, 0] >= offsets[-1]:
        raise ParameterError("ranges", f"within the frames {offsets[0]} to {offsets[-1]}", ranges[[0, -1]].tolist())
    result = np.empty((len(ranges), 2), np.int64)
    return result[: _extend_and_unite(ranges, offsets, left, right, result)]


@nb.njit(cache=True, nogil=True)
def _extend_and_unite(ranges: I64, offsets: I64, left: int, right: int, result: I64) -> int:
    """Write the ranges that `extend_and_unite` returns to `result`, and return their number (kernel)."""
    take, count, begun = 0, 0, 0  # ranges from `begun` on belong to the current take
    for i in range(len(ranges)):
        if ranges[i, 0] >= offsets[take + 1]:
            begun = count
            while ranges[i, 0] >= offsets[take + 1]:
                take += 1
        start = max(ranges[i, 0] - left, offsets[take])
        stop = min(ranges[i, 1] + right, offsets[take + 1])
        if count > begun and start <= result[count - 1, 1]:
            result[count - 1, 1] = max(stop, result[count - 1, 1])
        else:
            result[count, 0], result[count, 1] = start, stop
            count += 1
    return count


def to_axis(take_index: npt.ArrayLike, frame: npt.ArrayLike) -> I64:
    """Return the positions of frames of takes on the axis.

    Parameters
    ----------
    take_index : array_like (n,)
        The index of the take of each frame, from 0.
    frame : array_like (n,)
        Frames or stops of the takes, 0 to 2**31.

    Returns
    -------
    int64 array (n,)
        ``take_index << 32 | frame``.

    Raises
    ------
    ParameterError
        If a frame or a take does not fit on the axis.
    """
    takes = np.asarray(take_index, dtype=np.int64)
    frames = np.asarray(frame, dtype=np.int64)
    if frames.size and (frames.min() < 0 or frames.max() > _MAX_FRAMES):
        raise ParameterError("frame", f"0 to {_MAX_FRAMES}", (int(frames.min()), int(frames.max())))
    if takes.size and (takes.min() < 0 or takes.max() >= _MAX_FRAMES):
        raise ParameterError("take_index", f"0 to {_MAX_FRAMES - 1}", (int(takes.min()), int(takes.max())))
    return (takes << TAKE_BITS) + frames


def from_axis(segments: I64) -> tuple[I64, I64]:
    """Return the take indices, int64 (n,), and the frame ranges, int64 (n, 2), of segments of the axis."""
    takes = segments[:, 0] >> TAKE_BITS
    return takes, segments - (takes << TAKE_BITS)[:, None]
