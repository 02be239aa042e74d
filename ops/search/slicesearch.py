"""Keyframe search on bit slices, 64 frames at a time, where the coarse slices leave any frames to look at.

A keyframe's list, as a bitmap over frames, is the AND of the slices of its features (their complement where it wants
one off). The frames from which the rest of a query can be completed are the AND of that with the next keyframe's,
widened by the gap; and widening takes a few shifts. No list is merged or sorted, and wildcards cost nothing.

All of that is done with the coarse slices first (`ops.search.windows`), an eighth as long: a granule in which each
feature is as wanted at some time may hold the keyframe, one in which one never is cannot. What can be completed there
is looked at frame by frame, in windows as long as the gaps admit: a small part of an archive.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from ops.errors import ParameterError
from ops.search.bitslices import ALL_BITS, BLOCK, NO_BITS, BitSlices
from ops.search.keyframes import Segments, checked_gaps
from ops.search.windows import coarse_plan, coarse_starts, highest, lowest, windows

CHUNK = 2048
"""About how many blocks of whole takes are searched together: their bitmaps stay in a processor's nearest cache."""


def keyframe_segments(slices: BitSlices, mask: int, value: int) -> Segments:
    """The inverted list of a keyframe (thesis, Eq. 3.4 to 3.6): where `word & mask == value`, as maximal segments.

    Parameters
    ----------
    slices: T takes; take t has index t on the axis of positions.
    mask, value: bits of whole words.

    Raises
    ------
    ParameterError: a mask beyond the features, or a value beyond the mask.
    """
    return search_slices(slices, [mask], [value], [])


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
    count = len(masks)
    if not count or count != len(values):
        raise ParameterError("keyframes", "at least one, as many masks as values", (count, len(values)))
    for mask, value in zip(masks, values, strict=True):
        if mask < 0 or mask >> slices.features or value & ~mask:
            raise ParameterError(
                "keyframe", f"a mask within {slices.features} features, a value within it", (mask, value)
            )
    begin, end = (0, len(slices)) if takes is None else takes
    if not 0 <= begin <= end <= len(slices):
        raise ParameterError("takes", f"a part of the {len(slices)} takes", (begin, end))
    bounds = checked_gaps(gaps, count)
    keyframes = np.array([masks, values], np.int64)
    arrays = slices.bits, slices.coarse, slices.first, slices.left
    return Segments.known(*_search(*arrays, slices.features, keyframes, bounds, begin, end, CHUNK))


@njit(cache=True, nogil=True)
def _search(bits, coarse, first, left, features, keyframes, gaps, begin, end, chunk):  # type: ignore[no-untyped-def]
    count = keyframes.shape[1]
    on, off, edges = _plan(features, keyframes)
    rows, row_edges, order = coarse_plan(features, keyframes)
    span = gaps[:, 1].sum()
    starts, stops, n = np.empty(256, np.int64), np.empty(256, np.int64), 0
    best, scanned = np.empty(count, np.int64), np.empty(count, np.int64)
    room = 0
    candidates, marks = np.empty((count, 0), np.uint64), np.empty((count, 0), np.uint8)
    kept, spare = np.empty((count, 0), np.uint64), np.empty((3, 0), np.uint64)
    index, follow, chosen = np.empty(0, np.int64), np.empty(0, np.int32), np.empty(0, np.int64)
    take = begin
    while take < end:
        stop = _chunk_end(first, take, end, chunk)
        size = first[stop] - first[take]
        if size > room:
            room = max(size, min(first[end] - first[begin], chunk))
            candidates, marks = np.empty((count, room // 8 + 2), np.uint64), np.empty((count, room), np.uint8)
            kept, spare = np.empty((count, room), np.uint64), np.empty((3, room), np.uint64)
            index, follow, chosen = np.empty(room, np.int64), np.empty(room, np.int32), np.empty(room, np.int64)
        found, longest = 0, 0
        if coarse_starts(coarse, features, first[take], first[stop], rows, row_edges, order, gaps, candidates, spare):
            found, longest = windows(candidates, left, first[take], first[stop], span, index, follow, marks)
        alive = found > 0
        if alive:
            _note_bounds(follow, found, spare[2])
        for k in order:
            if alive:
                alive = _match(
                    bits, features + 1, index, marks[k], found, on, off, edges[k], edges[k + 1], chosen, spare, kept[k]
                )
        k = count - 2
        while alive and k >= 0:
            alive = _complete(
                kept[k], kept[k + 1], found, spare[0], spare[1], spare[2], follow, longest, gaps[k, 0], gaps[k, 1]
            )
            k -= 1
        if alive:
            best[:], scanned[:] = 0, 0
            starts, stops, n = _ranges(kept, found, index, follow, first, take, gaps, best, scanned, starts, stops, n)
        take = stop
    return starts[:n].copy(), stops[:n].copy()


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
def _plan(features, keyframes):  # type: ignore[no-untyped-def]
    # For each keyframe k the features it wants on, on[edges[k, 0] .. edges[k + 1, 0]], and off, off[edges[k, 1] ..],
    # each filled up to whole quarters: with the valid frames, which are always among the former, and with the last one.
    count = keyframes.shape[1]
    room = (features // 4 + 2) * 4 * count
    on, off = np.empty(room, np.uint64), np.empty(room, np.uint64)
    edges = np.zeros((count + 1, 2), np.int64)
    m, n = 0, 0
    for k in range(count):
        for feature in range(features):
            if keyframes[0, k] >> feature & 1:
                if keyframes[1, k] >> feature & 1:
                    on[m] = feature
                    m += 1
                else:
                    off[n] = feature
                    n += 1
        on[m] = features
        m += 1
        while m % 4:
            on[m] = features
            m += 1
        while n % 4:
            off[n] = off[n - 1]
            n += 1
        edges[k + 1, 0], edges[k + 1, 1] = m, n
    return on, off, edges


@njit(cache=True, nogil=True)
def _note_bounds(follow, found, onward):  # type: ignore[no-untyped-def]
    for i in range(np.uint64(found)):
        onward[i] = ALL_BITS if follow[i] else NO_BITS


@njit(cache=True, nogil=True)
def _match(bits, height, index, marks, found, on, off, begin, end, chosen, spare, kept):  # type: ignore[no-untyped-def]
    # The keyframe's frames in the blocks index[:found], into kept; False where there are none. Only blocks with a mark
    # are looked at; four features at a time.
    many = 0
    where, some = spare[0], spare[1]
    for i in range(np.uint64(found)):
        kept[i] = NO_BITS
        chosen[many] = i
        where[many] = np.uint64(index[i] * height)
        many += marks[i] != 0
    for four in range(begin[0], end[0], 4):
        one, two, three, last = on[four], on[four + 1], on[four + 2], on[four + 3]
        if four == begin[0]:
            for i in range(np.uint64(many)):
                at = where[i]
                some[i] = (bits[at + one] & bits[at + two]) & (bits[at + three] & bits[at + last])
        else:
            for i in range(np.uint64(many)):
                at = where[i]
                some[i] &= (bits[at + one] & bits[at + two]) & (bits[at + three] & bits[at + last])
    for four in range(begin[1], end[1], 4):
        one, two, three, last = off[four], off[four + 1], off[four + 2], off[four + 3]
        for i in range(np.uint64(many)):
            at = where[i]
            some[i] &= ~((bits[at + one] | bits[at + two]) | (bits[at + three] | bits[at + last]))
    any_left = NO_BITS
    for i in range(np.uint64(many)):
        kept[chosen[i]] = some[i]
        any_left |= some[i]
    return any_left != NO_BITS


@njit(cache=True, nogil=True)
def _complete(here, later, size, moved, widened, onward, follow, longest, low, high):  # type: ignore[no-untyped-def]
    # Keep of a keyframe's frames those from which those of the next one can be reached; False where there are none. The
    # later bitmap is widened to the gap [0, high - low] by doubling, then moved by `low`, within windows of `longest`
    # blocks at most.
    frames = longest * BLOCK
    if low >= frames:
        return False
    count = np.uint64(size)
    for i in range(count):
        widened[i] = later[i]
    width = min(high, frames) - low + 1
    covered = 1
    while covered < width:
        by = min(covered, width - covered)
        if by < BLOCK:
            _widen(widened, size, onward, by)
        else:
            _move(widened, size, moved, follow, by)
            for i in range(count):
                widened[i] |= moved[i]
        covered += by
    if low:
        _move(widened, size, moved, follow, low)
        widened = moved
    any_left = NO_BITS
    for i in range(count):
        found = here[i] & widened[i]
        here[i] = found
        any_left |= found
    return any_left != NO_BITS


@njit(cache=True, nogil=True)
def _widen(bitmap, size, onward, by):  # type: ignore[no-untyped-def]
    # Add to a bitmap itself, moved less than a block to earlier frames of the same window. A block reads itself and the
    # next, which has not been changed yet.
    end, one = np.uint64(size - 1), np.uint64(1)
    by = np.uint64(by)
    upper = np.uint64(BLOCK) - by
    for i in range(end):
        bitmap[i] |= bitmap[i] >> by | (bitmap[i + one] & onward[i]) << upper
    bitmap[end] |= bitmap[end] >> by


@njit(cache=True, nogil=True)
def _move(bitmap, size, moved, follow, by):  # type: ignore[no-untyped-def]
    # A bitmap moved to earlier frames, within windows: a block takes from later ones of its own window only.
    blocks, rest = np.uint64(min(by // BLOCK, size)), np.uint64(by % BLOCK)
    upper, one = np.uint64(BLOCK) - rest, np.uint64(1)
    count, at_least = np.uint64(size), np.int32(by // BLOCK)
    if rest == NO_BITS:
        for i in range(count - blocks):
            moved[i] = bitmap[i + blocks] if follow[i] >= at_least else NO_BITS
    elif count > blocks:
        end = count - blocks - one
        for i in range(end):
            near = bitmap[i + blocks] >> rest if follow[i] >= at_least else NO_BITS
            moved[i] = near | (bitmap[i + blocks + one] << upper if follow[i] > at_least else NO_BITS)
        moved[end] = bitmap[end + blocks] >> rest if follow[end] >= at_least else NO_BITS
    for i in range(count - blocks, count):
        moved[i] = NO_BITS


@njit(cache=True, nogil=True)
def _ranges(kept, found, index, follow, first, take, gaps, best, scanned, starts, stops, n):  # type: ignore[no-untyped-def]
    # The segments of the first bitmap, each from its start to the farthest end of a hit that begins in it. In the
    # bitmap of each later keyframe, `best` is the last survivor found and `scanned` how far it was looked for; frames
    # never fall, so no block is looked at twice.
    one = np.uint64(1)
    start = -1
    carry = np.uint64(0)
    for i in range(found):
        word = kept[0, i]
        edges = word ^ ((word << one) | carry)
        carry = word >> np.uint64(BLOCK - 1) if follow[i] else NO_BITS
        while edges or (start >= 0 and follow[i] == 0):
            edge = (i + 1) * BLOCK
            if edges:
                edge = i * BLOCK + lowest(edges)
                edges &= edges - one
            if start < 0:
                start = edge
                continue
            last = (i + follow[i] + 1) * BLOCK - 1
            stop = _farthest(kept, gaps, edge - 1, last, best, scanned) + 1
            take = _take_of(first, take, index[i])
            # from here on the axis of positions, where takes lie 2**32 apart
            move = (take << 32) + (index[i] - first[take] - i) * BLOCK
            if n > 0 and start + move <= stops[n - 1]:
                stops[n - 1] = max(stops[n - 1], stop + move)
            else:
                if n == len(starts):
                    starts, stops = _doubled(starts), _doubled(stops)
                starts[n], stops[n] = start + move, stop + move
                n += 1
            start = -1
    return starts, stops, n


@njit(cache=True, nogil=True)
def _take_of(first, take, block):  # type: ignore[no-untyped-def]
    # The take, from `take` on, that has a block: at first in strides that double, then by halves.
    stride = 1
    while take + stride < len(first) and first[take + stride] <= block:
        take += stride
        stride *= 2
    while stride:
        if take + stride < len(first) and first[take + stride] <= block:
            take += stride
        stride //= 2
    return take


@njit(cache=True, nogil=True)
def _farthest(kept, gaps, frame, last, best, scanned):  # type: ignore[no-untyped-def]
    # E(frame): always on to the largest survivor that the gap admits, in a window whose last bit is `last`.
    for k in range(1, len(best)):
        limit = min(frame + gaps[k - 1, 1], last)
        if limit >= scanned[k]:
            block = limit // BLOCK
            word = kept[k, block] & (ALL_BITS >> np.uint64(BLOCK - 1 - limit % BLOCK))
            while word == 0 and block * BLOCK > scanned[k]:
                block -= 1
                word = kept[k, block]
            if word:
                best[k] = block * BLOCK + highest(word)
            scanned[k] = limit + 1
        frame = best[k]
    return frame


@njit(cache=True, nogil=True)
def _doubled(array):  # type: ignore[no-untyped-def]
    larger = np.empty(2 * len(array), np.int64)
    larger[: len(array)] = array
    return larger
