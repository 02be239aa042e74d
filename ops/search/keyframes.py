"""Keyframe search: exact and linear, over merged segments of feature words (thesis, Chapter 3)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from kinedex.ops.errors import ParameterError
from kinedex.ops.search.gaps import checked_gaps
from kinedex.ops.search.segments import Segments, join_runs
from kinedex.ops.words import I64, U64


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
