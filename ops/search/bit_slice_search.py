"""This module searches keyframe queries on bit slices, 64 frames at a time; it is the search that stores use.

A slice is a bitmap over frames that marks where a feature is on. The frames that match a keyframe are the AND of the
slices of the features that must be on and of the complements of those that must be off. The frames from which the
remaining keyframes of a query can be reached are the AND of this bitmap with that of the next keyframe, widened by the
gap, which takes a few shifts. No lists are merged or sorted, and wildcards need no work.

The search first uses the coarse slices (`ops.search.bit_slice_windows`), which have an eighth of the length. A granule
of 8 frames can contain a match of a keyframe only if each feature has the required value in some frame of the granule.
The remaining granules, a small part of an archive, are searched frame by frame (`ops.search.bit_slice_frames`), in
windows as long as the gaps allow.
`ops.search.keyframe_search` finds the same ranges with the lists of the thesis.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from kinedex.ops.bits import lowest_bit
from kinedex.ops.errors import ParameterError
from kinedex.ops.search.bit_slice_frames import add_ranges, complete, mark_followed, match_all
from kinedex.ops.search.bit_slice_windows import BLOCKS_PER_WORD, coarse_starts, windows
from kinedex.ops.search.bit_slices import ALL_BITS, BLOCK, NO_BITS, BitSlices
from kinedex.ops.search.gaps import UNBOUNDED, checked_gaps
from kinedex.ops.words import I64

CHUNK = 4096
"""Approximate number of blocks, of whole takes, that are searched together, so that their bitmaps fit the L1 cache."""

CACHED = 2**20
"""Number of words of slices (8 MiB) above which they are prefetched, as smaller ones fit a processor's cache."""

LINE = 8
"""The number of uint64 values in a cache line."""


def search_slices(
    slices: BitSlices,
    masks: Sequence[int],
    values: Sequence[int],
    gaps: Sequence[tuple[int, int]],
    takes: tuple[int, int] | None = None,
) -> I64:
    """Return the union of the ranges of all hits of a keyframe query (thesis, Section 3.5).

    A backward pass reduces the bitmap of each keyframe to the frames from which the remaining keyframes can be reached.
    A forward pass starts at the last frame of each remaining segment of the first keyframe, and proceeds to the largest
    remaining frame that each gap allows, as in `ops.search.keyframe_search.search_lists`. The work is
    O(K * frames / 512), plus O(K * frames / 64) for the remaining windows. The function does not write to the slices
    and releases the interpreter lock, so that several threads may search parts of them at the same time.

    Parameters
    ----------
    slices : BitSlices
        T takes; take t has index t on the axis of positions.
    masks, values : sequence of int
        K >= 1 keyframes in bits of whole words.
    gaps : sequence of (int, int)
        K - 1 admissible gaps (low, high) in frames, both ends included; from `UNBOUNDED` on there is no upper bound.
    takes : (int, int), optional
        Search only the takes from takes[0] to takes[1] - 1, without a copy. The concatenated results of consecutive
        parts equal the result for all takes.

    Returns
    -------
    int64 array (n, 2)
        The ranges from the first to the last keyframe of all hits, as segments of the axis of positions
        (`ops.ranges`); ranges that overlap or touch are merged. No keyframe matches an invalid frame, but gaps may
        contain invalid frames.

    Raises
    ------
    ParameterError
        If there is no keyframe, a mask has bits beyond the features, a value has bits outside its mask, the gaps are
        invalid, or the takes do not exist.
    """
    begin, end = (0, len(slices)) if takes is None else takes
    if not 0 <= begin <= end <= len(slices):
        raise ParameterError("takes", f"a part of the {len(slices)} takes", (begin, end))
    count = len(masks)
    query = _as_array([*masks, *values], [bound for gap in gaps for bound in gap])
    if count and len(values) == count and len(gaps) == count - 1 and len(query) == 4 * count - 2:
        arrays = slices.bits, slices.coarse, slices.first, slices.ends
        ranges, valid = _search(*arrays, slices.features, query, begin, end, CHUNK, CACHED)
        if valid:
            return ranges
    raise _query_error(slices, masks, values, gaps)


def _as_array(bits: list[int], bounds: list[int]) -> I64:
    """Return masks, values and gaps as one array, which is faster to pass to a kernel than three."""
    try:
        return np.array([*bits, *bounds], np.int64)
    except OverflowError:
        # no gap needs to exceed UNBOUNDED, and no keyframe has so many bits; the kernel rejects -1
        small = [bit if 0 <= bit < 2**63 else -1 for bit in bits]
        return np.array([*small, *(max(-1, min(bound, UNBOUNDED)) for bound in bounds)], np.int64)


def _query_error(
    slices: BitSlices, masks: Sequence[int], values: Sequence[int], gaps: Sequence[tuple[int, int]]
) -> ParameterError:
    """Return the error for a query that the faster compiled check has rejected."""
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
def _search(bits, coarse, first, ends, features, query, begin, end, chunk, cached):  # type: ignore[no-untyped-def]
    ranges, n = np.empty((256, 2), np.int64), np.int64(0)
    count = (len(query) + 2) // 4
    masks, values, gaps = query[:count], query[count : 2 * count], query[2 * count :].reshape(-1, 2)
    if not _is_valid(features, masks, values, gaps):
        return ranges[:0].copy(), False
    rows, coarse_rows, flips, edges, order = _plan(features, masks, values)
    fetched = _fetched(rows[: edges[count] * (len(bits) > cached)])
    keyframes = rows, flips, edges, order, fetched
    span = np.int64(0)
    for k in range(count - 1):
        span += gaps[k, 1]
    room = 0
    candidates = np.empty((count, 0), np.uint64)
    remaining, spare = np.empty((count, 0), np.uint64), np.empty((3, 0), np.uint64)
    index, follow = np.empty(0, np.int64), np.empty(0, np.int32)
    take = begin
    while take < end:
        stop = _chunk_end(first, take, end, chunk)
        size = first[stop] - first[take]
        if size > room:
            room = max(size, min(first[end] - first[begin], chunk))
            candidates = np.empty((count, room // 8 + 2), np.uint64)
            remaining, spare = np.empty((count, room), np.uint64), np.empty((3, room + 8), np.uint64)
            index, follow = np.empty(room + 2, np.int64), np.empty(room, np.int32)
        blocks = first[take], first[stop]
        if coarse_starts(coarse, features, blocks, coarse_rows, edges, order, gaps, candidates, spare):
            found, longest = windows(candidates[0], ends, blocks, span, index, follow)
            here, after, granules = index[:found], follow[:found], candidates.view(np.uint8)
            at = blocks[0] // BLOCKS_PER_WORD * BLOCKS_PER_WORD
            alive = match_all(bits, features + 1, here, granules, at, keyframes, spare, remaining)
            if alive:
                mark_followed(after, spare[2])
            for k in range(count - 2, -1, -1):
                alive = alive and complete(
                    remaining[k], remaining[k + 1], after, longest, gaps[k, 0], gaps[k, 1], spare
                )
            if alive:
                ranges, n = add_ranges(remaining, here, after, first, ends, gaps, ranges, n)
        take = stop
    return ranges[:n].copy(), True


@njit(cache=True, nogil=True)
def _is_valid(features, masks, values, gaps):  # type: ignore[no-untyped-def]
    """Return True if the keyframes' features exist and the gaps are ranges; clip the gaps to UNBOUNDED."""
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
    """Return the end of the takes that fit into a chunk together, at least one."""
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
    """Return the rows that keyframes need, and the order in which to search the keyframes.

    Keyframe k needs rows[edges[k]] to rows[edges[k + 1] - 1], with all bits flipped for features that must be off, and
    the corresponding coarse rows. If it requires no feature to be on, the row of valid frames is added, because all
    features are off in invalid frames. The rows are padded to multiples of four. Keyframes with many rows come first in
    the order, since they match few frames; the order affects only the speed.
    """
    count = len(masks)
    room = (features // 4 + 1) * 4 * count
    rows, coarse_rows, flips = np.empty(room, np.uint64), np.empty(room, np.int64), np.empty(room, np.uint64)
    edges, order = np.zeros(count + 1, np.int64), np.empty(count, np.int64)
    n = 0
    for k in range(count):
        wanted = np.uint64(masks[k])
        while wanted:
            feature = lowest_bit(wanted)
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


@njit(cache=True, nogil=True)
def _fetched(rows):  # type: ignore[no-untyped-def]
    """Return about one word for each cache line of a block that contains rows of the keyframes."""
    wanted = NO_BITS
    for row in rows:
        wanted |= np.uint64(1) << row
    fetched, n = np.empty(BLOCK, np.int64), 0
    while wanted:
        row = lowest_bit(wanted)
        wanted &= wanted - np.uint64(1)
        if n == 0 or row - fetched[n - 1] >= LINE or wanted == NO_BITS:
            fetched[n] = row
            n += 1
    return fetched[:n]
