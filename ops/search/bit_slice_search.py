"""Keyframe search on bit slices, 64 frames at a time, where the coarse slices leave any frames to look at.

A keyframe's list, as a bitmap over frames, is the AND of the slices of its features (their complement where it wants
one off). The frames from which the rest of a query can be completed are the AND of that with the next keyframe's,
widened by the gap; and widening takes a few shifts. No list is merged or sorted, and wildcards cost nothing.

All of that is done with the coarse slices first (`ops.search.candidate_windows`), an eighth as long: a granule in
which each
feature is as wanted at some time may hold the keyframe, one in which one never is cannot. What can be completed there
is looked at frame by frame, in windows as long as the gaps admit: a small part of an archive.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from kinedex.ops.errors import ParameterError
from kinedex.ops.search.bit_slices import ALL_BITS, NO_BITS, BitSlices
from kinedex.ops.search.candidate_windows import IN_WORD, coarse_starts, lowest, windows
from kinedex.ops.search.frame_search import add_ranges, complete, match, note_bounds
from kinedex.ops.search.gaps import UNBOUNDED, checked_gaps
from kinedex.ops.search.segments import Segments
from kinedex.ops.words import I64

CHUNK = 4096
"""About how many blocks of whole takes are searched together: their bitmaps stay in a processor's nearest cache."""


def search_slices(
    slices: BitSlices,
    masks: Sequence[int],
    values: Sequence[int],
    gaps: Sequence[tuple[int, int]],
    takes: tuple[int, int] | None = None,
) -> Segments:
    """Find the union of all hit relevant ranges of a keyframe query (thesis, Eq. 3.2 and 3.3, Section 3.5).

    Backwards, each keyframe's bitmap keeps the frames from which the rest of the query can be completed; forwards, the
    last frame of each surviving start segment goes on to the largest survivor that each gap admits, as in
    `ops.search.keyframes.search`. O(K · frames / 512), and O(K · frames / 64) of what that leaves; no recursion.
    Nothing is written to the slices and Python's lock is let go of: threads may search parts of them at the same time.

    Parameters
    ----------
    slices: T takes; take t has index t on the axis of positions.
    masks, values: K >= 1 keyframes in bits of whole words (features of several sets go into one).
    gaps: K − 1 admissible gaps (low, high) in frames, both included; anything from `UNBOUNDED` up has no upper bound.
    takes: search takes[0] .. takes[1] only, or None for all. Parts that follow each other find, one after the other,
        what the whole finds; nothing is copied.

    Returns
    -------
    The ranges from the first to the last keyframe of all hits, on the axis of positions; ranges that overlap or touch
    are one. No hit begins or ends in an invalid frame, and no keyframe matches there; its gaps may span them.

    Raises
    ------
    ParameterError: no keyframe, a mask beyond the features, a value beyond its mask, gaps that do not fit, or takes
        that are not there.
    """
    begin, end = (0, len(slices)) if takes is None else takes
    if not 0 <= begin <= end <= len(slices):
        raise ParameterError("takes", f"a part of the {len(slices)} takes", (begin, end))
    count = len(masks)
    query = _as_array([*masks, *values], [bound for gap in gaps for bound in gap])
    if count and len(values) == count and len(gaps) == count - 1 and len(query) == 4 * count - 2:
        arrays = slices.bits, slices.coarse, slices.first, slices.left
        starts, stops, makes_sense = _search(*arrays, slices.features, query, begin, end, CHUNK)
        if makes_sense:
            return Segments.known(starts, stops)
    raise _what_makes_no_sense(slices, masks, values, gaps)


def _as_array(bits: list[int], bounds: list[int]) -> I64:
    try:
        return np.array([*bits, *bounds], np.int64)
    except OverflowError:
        # no gap needs to be longer than UNBOUNDED, and no keyframe has so many bits: -1 is refused as well
        small = [bit if 0 <= bit < 2**63 else -1 for bit in bits]
        return np.array([*small, *(max(-1, min(bound, UNBOUNDED)) for bound in bounds)], np.int64)


def _what_makes_no_sense(
    slices: BitSlices, masks: Sequence[int], values: Sequence[int], gaps: Sequence[tuple[int, int]]
) -> ParameterError:
    """Say in words what compiled code has found out, in a fraction of the time."""
    if not masks or len(masks) != len(values):
        return ParameterError("keyframes", "at least one, as many masks as values", (len(masks), len(values)))
    for mask, value in zip(masks, values, strict=True):
        if mask < 0 or mask >> slices.features or value & ~mask:
            return ParameterError(
                "keyframe", f"a mask within {slices.features} features, a value within it", (mask, value)
            )
    checked_gaps(gaps, len(masks))
    return ParameterError("gaps", "pairs of whole numbers", gaps)


@njit(cache=True, nogil=True)
def _search(bits, coarse, first, left, features, query, begin, end, chunk):  # type: ignore[no-untyped-def]
    starts, stops, n = np.empty(256, np.int64), np.empty(256, np.int64), np.int64(0)
    count = (len(query) + 2) // 4
    masks, values, gaps = query[:count], query[count : 2 * count], query[2 * count :].reshape(-1, 2)
    if not _makes_sense(features, masks, values, gaps):
        return starts[:0], stops[:0], False
    rows, coarse_rows, flips, edges, order = _plan(features, masks, values)
    span = np.int64(0)
    for k in range(count - 1):
        span += gaps[k, 1]
    room = 0
    candidates = np.empty((count, 0), np.uint64)
    kept, spare = np.empty((count, 0), np.uint64), np.empty((3, 0), np.uint64)
    index, follow = np.empty(0, np.int64), np.empty(0, np.int32)
    take = begin
    while take < end:
        stop = _chunk_end(first, take, end, chunk)
        size = first[stop] - first[take]
        if size > room:
            room = max(size, min(first[end] - first[begin], chunk))
            candidates = np.empty((count, room // 8 + 2), np.uint64)
            kept, spare = np.empty((count, room), np.uint64), np.empty((3, room + 8), np.uint64)
            index, follow = np.empty(room, np.int64), np.empty(room, np.int32)
        blocks = first[take], first[stop]
        if coarse_starts(coarse, features, blocks, coarse_rows, edges, order, gaps, candidates, spare):
            found, longest = windows(candidates[0], left, blocks, span, index, follow)
            here, after, granules = index[:found], follow[:found], candidates.view(np.uint8)
            at = blocks[0] // IN_WORD * IN_WORD
            alive = True
            for k in order:
                if alive:
                    asked = slice(edges[k], edges[k + 1])
                    wanted = rows[asked], flips[asked]
                    alive = match(bits, features + 1, here, granules[k], at, *wanted, spare, kept[k])
            if alive:
                note_bounds(after, spare[2])
            for k in range(count - 2, -1, -1):
                alive = alive and complete(kept[k], kept[k + 1], after, longest, gaps[k, 0], gaps[k, 1], spare)
            if alive:
                starts, stops, n = add_ranges(kept, here, after, first, take, gaps, starts, stops, n)
        take = stop
    return starts[:n].copy(), stops[:n].copy(), True


@njit(cache=True, nogil=True)
def _makes_sense(features, masks, values, gaps):  # type: ignore[no-untyped-def]
    # The keyframes' features are there, and gaps are ranges; which are cut to UNBOUNDED.
    for k in range(len(masks)):
        if masks[k] < 0 or masks[k] >> features or values[k] & ~masks[k]:
            return False
    for k in range(len(gaps)):
        if not 0 <= gaps[k, 0] <= gaps[k, 1]:
            return False
        gaps[k, 0], gaps[k, 1] = min(gaps[k, 0], UNBOUNDED), min(gaps[k, 1], UNBOUNDED)
    return True


@njit(cache=True, nogil=True)
def _chunk_end(first, take, end, chunk):  # type: ignore[no-untyped-def]
    # The last take that still fits into a chunk; one at least.
    low, high = take + 1, end
    while low < high:
        middle = (low + high + 1) // 2
        if first[middle] - first[take] <= chunk:
            low = middle
        else:
            high = middle - 1
    return low


@njit(cache=True, nogil=True)
def _plan(features, masks, values):  # type: ignore[no-untyped-def]
    # The rows that keyframe k asks for, rows[edges[k]] .. rows[edges[k + 1]], with all bits to flip where it wants the
    # feature off; and the coarse rows beside them. Where no feature is asked to be on (none is in an invalid frame),
    # the row of valid frames is among them. Filled up to whole quarters. order: those keyframes first that ask for
    # most, since they are rare; only the speed depends on it.
    count = len(masks)
    room = (features // 4 + 1) * 4 * count
    rows, coarse_rows, flips = np.empty(room, np.uint64), np.empty(room, np.int64), np.empty(room, np.uint64)
    edges, order = np.zeros(count + 1, np.int64), np.empty(count, np.int64)
    n = 0
    for k in range(count):
        wanted = np.uint64(masks[k])
        while wanted:
            feature = lowest(wanted)
            wanted &= wanted - np.uint64(1)
            on = values[k] >> feature & 1
            rows[n], flips[n] = feature, NO_BITS if on else ALL_BITS
            coarse_rows[n] = feature if on else features + feature
            n += 1
        if values[k] == 0:
            rows[n], flips[n], coarse_rows[n] = features, NO_BITS, 2 * features
            n += 1
        while n % 4:
            rows[n], flips[n], coarse_rows[n] = rows[n - 1], flips[n - 1], coarse_rows[n - 1]
            n += 1
        edges[k + 1] = n
        i = k
        while i > 0 and edges[order[i - 1] + 1] - edges[order[i - 1]] < n - edges[k]:
            order[i] = order[i - 1]
            i -= 1
        order[i] = k
    return rows, coarse_rows, flips, edges, order
