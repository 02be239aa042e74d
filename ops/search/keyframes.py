"""Keyframe search: exact and linear, over merged segments of feature words (thesis, Chapter 3).

Every frame of an archive has one position on a single int64 axis, `take_index << 32 | frame`. A frame is
below 2**31 and a gap is clamped to 2**31 - 1, so a frame plus a gap stays below 2**32 and a frame minus a
gap ends in the upper half of the take before, where no frame is: no hit leaves its take, unbounded gaps
included. A stop is at most 2**31, half a block before the next take begins, so segments of different takes
neither overlap nor touch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from ops.errors import ParameterError
from ops.words import I64, U64

UNBOUNDED = 2**31 - 1
"""The largest gap in frames; stands for infinity, since a take has fewer than 2**31 frames."""

_TAKE_BITS = 32
_MAX_FRAMES = 2**31


@dataclass(frozen=True)
class Segments:
    """Maximal segments on the axis of positions: ascending, neither overlapping nor touching (Eq. 3.6).

    starts, stops: int64 (n,), positions; segment i holds the positions starts[i] .. stops[i] - 1.
    """

    starts: I64
    stops: I64

    def __post_init__(self) -> None:
        if self.starts.dtype != np.int64 or self.stops.dtype != np.int64:
            raise ParameterError("segments", "int64", (self.starts.dtype, self.stops.dtype))
        if self.starts.ndim != 1 or self.starts.shape != self.stops.shape:
            raise ParameterError("segments", "as many starts as stops", (self.starts.shape, self.stops.shape))
        if (self.starts >= self.stops).any() or (self.starts[1:] <= self.stops[:-1]).any():
            raise ParameterError("segments", "not empty, ascending and apart (see `merge`)", "others")

    @classmethod
    def known(cls, starts: I64, stops: I64) -> Segments:
        """Segments that are maximal and int64 because of how they were made: not checked, which takes longer than a
        search in some minutes of motion."""
        made = cls.__new__(cls)
        made.__dict__["starts"], made.__dict__["stops"] = starts, stops
        return made

    def __len__(self) -> int:
        return len(self.starts)

    @property
    def frames(self) -> int:
        """How many frames the segments hold together."""
        return int((self.stops - self.starts).sum())


def to_axis(take_index: npt.ArrayLike, frame: npt.ArrayLike) -> I64:
    """Put frames of takes on the axis of positions.

    Parameters
    ----------
    take_index: (n,), the rank of each frame's take, from 0.
    frame: (n,), frames or stops, 0 to 2**31.

    Returns
    -------
    int64 (n,), `take_index << 32 | frame`.

    Raises
    ------
    ParameterError: a frame or a take that does not fit on the axis.
    """
    takes = np.asarray(take_index, dtype=np.int64)
    frames = np.asarray(frame, dtype=np.int64)
    if frames.size and (frames.min() < 0 or frames.max() > _MAX_FRAMES):
        raise ParameterError("frame", f"0 to {_MAX_FRAMES}", (int(frames.min()), int(frames.max())))
    if takes.size and (takes.min() < 0 or takes.max() >= _MAX_FRAMES):
        raise ParameterError("take_index", f"0 to {_MAX_FRAMES - 1}", (int(takes.min()), int(takes.max())))
    return (takes << _TAKE_BITS) + frames


def from_axis(segments: Segments) -> tuple[I64, I64, I64]:
    """Take segments off the axis: take indices, starts and stops in frames of the take, int64 (n,)."""
    takes = segments.starts >> _TAKE_BITS
    return takes, segments.starts - (takes << _TAKE_BITS), segments.stops - (takes << _TAKE_BITS)


def gap_bounds(distance: int, stiffness: float) -> tuple[int, int]:
    """Return the admissible gap of a distance and a stiffness (thesis, Eq. 3.3, 4.5 and 4.6).

    Parameters
    ----------
    distance: d in analysis frames, 0 to `UNBOUNDED`.
    stiffness: sigma, 0 (any later frame) to 1 (exactly d frames later).

    Returns
    -------
    (d_min, d_max) = (ceil(sigma d), floor(d / sigma)), both included; (0, `UNBOUNDED`) for sigma = 0.
    Products are rounded to 1e-9 first: in plain float64, floor(7 / 0.07) is 99.

    Raises
    ------
    ParameterError: a distance or a stiffness out of its domain.
    """
    if isinstance(distance, bool) or distance != int(distance) or not 0 <= distance <= UNBOUNDED:
        raise ParameterError("distance", f"a whole number of frames from 0 to {UNBOUNDED}", distance)
    if not 0.0 <= stiffness <= 1.0:
        raise ParameterError("stiffness", "between 0 and 1", stiffness)
    if stiffness == 0.0:
        return 0, UNBOUNDED
    low = math.ceil(round(stiffness * distance, 9))
    longest = distance / stiffness
    return low, UNBOUNDED if longest >= UNBOUNDED else math.floor(round(longest, 9))


def nominal_gap(low: int, high: int) -> tuple[float, float]:
    """Return the distance and stiffness that a gap range stands for (thesis, Eq. 4.7 and 4.8).

    Parameters
    ----------
    low, high: the admissible gap in frames, both included; `UNBOUNDED` is no upper bound.

    Returns
    -------
    (distance, stiffness): sqrt(low high) and sqrt(low / high); (inf, 0) without an upper bound, and (0, 1)
    for the gap [0, 0], where the equation divides nothing by nothing and only the same frame is admitted.
    """
    _check_gap(low, high)
    if high >= UNBOUNDED:
        return math.inf, 0.0
    if high == 0:
        return 0.0, 1.0
    return math.sqrt(low * high), math.sqrt(low / high)


def merge(starts: I64, stops: I64) -> Segments:
    """Unite segments, so that those which overlap or touch become one.

    Parameters
    ----------
    starts, stops: int64 (n,), positions, half-open, in any order; empty segments (start = stop) vanish.

    Returns
    -------
    The union as maximal segments.

    Raises
    ------
    ParameterError: a stop before its start.
    """
    starts, stops = np.asarray(starts, np.int64), np.asarray(stops, np.int64)
    if (stops < starts).any():
        raise ParameterError("stops", "not before their starts", "an earlier one")
    full = stops > starts
    if not full.all():
        starts, stops = starts[full], stops[full]
    if (starts[1:] < starts[:-1]).any():
        order = np.argsort(starts, kind="stable")
        starts, stops = starts[order], stops[order]
    if not len(starts):
        return Segments(starts, stops)
    reached = np.maximum.accumulate(stops)
    return _close_up(starts, reached)


def keyframe_list(starts: I64, stops: I64, words: U64, mask: int, value: int) -> Segments:
    """Return the inverted keyframe list of a keyframe: the union of its words' runs (Eq. 3.4 to 3.6).

    The keyframe stands for every word with `word & mask == value`; bits outside the mask are wildcards. The
    words that occur are filtered, never the 2**wildcards possible ones made.

    Parameters
    ----------
    starts, stops: int64 (n,), positions of runs of one feature set, pairwise disjoint: in order of position,
        or list by list as an inverted index keeps them. The former is linear; the latter costs the sorting
        of what matches.
    words: uint64 (n,), the word of each run.
    mask, value: the keyframe, bits of the feature set.

    Returns
    -------
    Maximal segments: runs of different matching words that touch are one segment.

    Raises
    ------
    ParameterError: a value with bits outside its mask, which no word could match.
    """
    if value & ~mask or mask < 0 or mask >= 2**64:
        raise ParameterError("value", f"within the bits of the mask {mask:#x}", value)
    matching = (words & np.uint64(mask)) == np.uint64(value)
    return join_runs(starts[matching], stops[matching])


def join_runs(starts: I64, stops: I64) -> Segments:
    """Unite runs that touch; unlike those of `merge`, they are pairwise disjoint, and none is empty.

    Parameters
    ----------
    starts, stops: int64 (n,), positions, half-open, in any order.
    """
    if (starts[1:] < starts[:-1]).any():
        # Runs are disjoint, so starts and stops sorted each for itself still belong together.
        starts, stops = np.sort(starts, kind="stable"), np.sort(stops, kind="stable")
    return _close_up(starts, stops)


def survivors(lists: Sequence[Segments], gaps: Sequence[tuple[int, int]]) -> list[Segments]:
    """Keep of each keyframe list the frames from which the rest of the query can be completed.

    Parameters
    ----------
    lists: K >= 1 keyframe lists.
    gaps: K - 1 admissible gaps (low, high) in frames, both included; anything from `UNBOUNDED` up has no
        upper bound.

    Returns
    -------
    K lists of segments. A frame survives in list k if it can be the k-th of a chain of frames that meets the
    keyframes k to K under their gaps; so the last list survives whole, and the first one holds the first
    frames of all hits.

    Raises
    ------
    ParameterError: no list, a number of gaps other than K - 1, or a gap that is no range.
    """
    starts, stops, offsets = _all_survivors(*_joined(lists, gaps))
    pieces = [slice(offsets[k], offsets[k + 1]) for k in range(len(lists))]
    return [Segments(starts[piece], stops[piece]) for piece in reversed(pieces)]


def search(lists: Sequence[Segments], gaps: Sequence[tuple[int, int]]) -> Segments:
    """Find the union of all hit relevant ranges of a keyframe query (thesis, Eq. 3.2 and 3.3, Section 3.5).

    Backwards, each list keeps the frames from which the rest of the query can be completed; forwards, the
    last frame of each surviving start segment [s, e] goes on to the largest survivor that each gap admits,
    which is E(e), the farthest end of a hit. E never falls as the frame rises, so the hits that begin in [s,
    e] cover [s, E(e)]. Both ways are a walk of two pointers, O(K * sum of list lengths) whatever the
    stiffness, without recursion.

    Parameters
    ----------
    lists: K >= 1 keyframe lists, see `keyframe_list`.
    gaps: K - 1 admissible gaps (low, high) in frames, both included, see `gap_bounds`; anything from
        `UNBOUNDED` up has no upper bound.

    Returns
    -------
    The ranges from the first to the last keyframe of all hits; ranges that overlap or touch are one.

    Raises
    ------
    ParameterError: no list, a number of gaps other than K - 1, or a gap that is no range.
    """
    joined = _joined(lists, gaps)
    starts, stops, offsets = _all_survivors(*joined)
    return Segments(*_ranges(starts, stops, offsets, joined[4]))


def checked_gaps(gaps: Sequence[tuple[int, int]], keyframes: int) -> I64:
    """Return the gaps of a query as an array, clamped to `UNBOUNDED`.

    Parameters
    ----------
    gaps: admissible gaps (low, high) in frames, both included. keyframes: K.

    Returns
    -------
    int64 (K - 1, 2).

    Raises
    ------
    ParameterError: a number of gaps other than K - 1, or a gap that is no range.
    """
    if len(gaps) != keyframes - 1:
        raise ParameterError("gaps", f"{keyframes - 1}, one fewer than keyframes", len(gaps))
    for low, high in gaps:
        _check_gap(low, high)
    clamped = [(min(low, UNBOUNDED), min(high, UNBOUNDED)) for low, high in gaps]
    return np.array(clamped, dtype=np.int64).reshape(-1, 2)


def _check_gap(low: int, high: int) -> None:
    if not 0 <= low <= high:
        raise ParameterError("gap", "a range [low, high] of frames with 0 <= low <= high", (low, high))


def _joined(lists: Sequence[Segments], gaps: Sequence[tuple[int, int]]) -> tuple[I64, I64, I64, I64, I64]:
    if not lists:
        raise ParameterError("lists", "at least one keyframe list", 0)
    bounds = checked_gaps(gaps, len(lists))
    offsets = np.zeros(len(lists) + 1, dtype=np.int64)
    np.cumsum([len(one) for one in lists], out=offsets[1:])
    return (
        np.concatenate([one.starts for one in lists]),
        np.concatenate([one.stops for one in lists]),
        offsets,
        np.ascontiguousarray(bounds[:, 0]),
        np.ascontiguousarray(bounds[:, 1]),
    )


def _close_up(starts: I64, stops: I64) -> Segments:
    """Unite touching neighbours of segments whose starts and stops both ascend."""
    if len(starts) < 2:
        return Segments(starts, stops)
    apart = starts[1:] > stops[:-1]
    return Segments(starts[np.concatenate(([True], apart))], stops[np.concatenate((apart, [True]))])


@njit(cache=True, nogil=True)
def _all_survivors(starts, stops, offsets, low, high):  # type: ignore[no-untyped-def]
    # Survivors are written from the last list to the first: those of list k lie at found[K-1-k] ..
    # found[K-k].
    count = len(offsets) - 1
    last = offsets[count - 1]
    used = offsets[count] - last
    room = max(2 * used, offsets[count])
    out_starts = np.empty(room, np.int64)
    out_stops = np.empty(room, np.int64)
    out_starts[:used] = starts[last:]
    out_stops[:used] = stops[last:]
    found = np.zeros(count + 1, np.int64)
    found[1] = used
    for back in range(1, count):
        k = count - 1 - back
        later, end = found[back - 1], found[back]
        # A cut of m segments by n others leaves fewer than m + n pieces.
        needed = end + (offsets[k + 1] - offsets[k]) + (end - later)
        if needed > len(out_starts):
            grown_starts = np.empty(2 * needed, np.int64)
            grown_stops = np.empty(2 * needed, np.int64)
            grown_starts[:end] = out_starts[:end]
            grown_stops[:end] = out_stops[:end]
            out_starts, out_stops = grown_starts, grown_stops
        found[back + 1] = _cut(
            starts, stops, offsets[k], offsets[k + 1], out_starts, out_stops, later, end, low[k], high[k]
        )
    return out_starts, out_stops, found


@njit(cache=True, nogil=True)
def _cut(starts, stops, i, i_end, out_starts, out_stops, j, j_end, low, high):  # type: ignore[no-untyped-def]
    # Segments i .. i_end against the later survivors j .. j_end, each widened to the frames from which it
    # can be reached.
    n = j_end
    while i < i_end and j < j_end:
        reach_start = out_starts[j] - high
        reach_stop = out_stops[j] - low
        j += 1
        while j < j_end and out_starts[j] - high <= reach_stop:
            reach_stop = out_stops[j] - low
            j += 1
        while i < i_end and stops[i] <= reach_start:
            i += 1
        while i < i_end and starts[i] < reach_stop:
            out_starts[n] = max(starts[i], reach_start)
            out_stops[n] = min(stops[i], reach_stop)
            n += 1
            if stops[i] > reach_stop:
                break
            i += 1
    return n


@njit(cache=True, nogil=True)
def _ranges(starts, stops, found, high):  # type: ignore[no-untyped-def]
    count = len(found) - 1
    first, first_end = found[count - 1], found[count]
    out_starts = np.empty(first_end - first, np.int64)
    out_stops = np.empty(first_end - first, np.int64)
    pointers = found[:count].copy()
    n = 0
    for i in range(first, first_end):
        frame = stops[i] - 1
        for k in range(1, count):
            piece = count - 1 - k
            farthest = frame + high[k - 1]
            p = pointers[piece]
            while p + 1 < found[piece + 1] and starts[p + 1] <= farthest:
                p += 1
            pointers[piece] = p
            frame = min(stops[p] - 1, farthest)
        if n > 0 and starts[i] <= out_stops[n - 1]:
            out_stops[n - 1] = frame + 1
        else:
            out_starts[n] = starts[i]
            out_stops[n] = frame + 1
            n += 1
    return out_starts[:n], out_stops[:n]
