"""Inside windows, frame by frame: where keyframes are, from where the rest of a query can be completed, and ranges.

The n blocks of all windows lie one after the other here, whatever lies between them in the archive: index[i] is block i
in the bit slices, follow[i] how many blocks of its window come after it. Bitmaps have one uint64 for each block.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from kinedex.ops.bits import count_bits
from kinedex.ops.search.bit_slices import ALL_BITS, BLOCK, NO_BITS, SHIFT
from kinedex.ops.search.candidate_windows import filled, highest, lowest


@njit(cache=True, nogil=True)
def note_bounds(follow, onward):  # type: ignore[no-untyped-def]
    """Write all bits where a block is followed by one of its own window, none where it is the last."""
    for i in range(np.uint64(len(follow))):
        onward[i] = ALL_BITS if follow[i] else NO_BITS


@njit(cache=True, nogil=True)
def match(bits, height, index, granules, at, rows, flips, spare, kept):  # type: ignore[no-untyped-def]
    """Find a keyframe's frames; False where there are none.

    Parameters
    ----------
    bits: of bit slices. height: words of a block there. index: int64 (n,).
    granules: uint8, those of the keyframe, from block `at` on; a block without any is not looked at.
    rows, flips: uint64 (r,), the words of a block that the keyframe asks for, and what turns each into what is wanted;
        four at a time. spare: uint64 (3, n or more). kept: uint64 (n or more,), the bitmap that is written.
    """
    many = np.uint64(0)
    where, chosen, some = spare[0], spare[1], spare[2]
    for i in range(np.uint64(len(index))):
        kept[i] = NO_BITS
        chosen[many], where[many] = i, index[i] * height
        many += np.uint64(granules[index[i] - at] != 0)
    for four in range(0, len(rows), 4):
        one, two, three, last = rows[four], rows[four + 1], rows[four + 2], rows[four + 3]
        flip_one, flip_two, flip_three, flip_last = flips[four], flips[four + 1], flips[four + 2], flips[four + 3]
        if four == 0:
            for i in range(many):
                word = where[i]
                found = (bits[word + one] ^ flip_one) & (bits[word + two] ^ flip_two)
                some[i] = found & (bits[word + three] ^ flip_three) & (bits[word + last] ^ flip_last)
        else:
            for i in range(many):
                word = where[i]
                found = (bits[word + one] ^ flip_one) & (bits[word + two] ^ flip_two)
                some[i] &= found & (bits[word + three] ^ flip_three) & (bits[word + last] ^ flip_last)
    any_left = NO_BITS
    for i in range(many):
        kept[chosen[i]] = some[i]
        any_left |= some[i]
    return any_left != NO_BITS


@njit(cache=True, nogil=True)
def complete(here, later, follow, longest, low, high, spare):  # type: ignore[no-untyped-def]
    """Keep of a keyframe's frames those from which those of the next one can be reached; False where there are none.

    The later bitmap is widened to the gap [0, high - low] by doubling, then moved by `low`, within windows of `longest`
    blocks at most.

    Parameters
    ----------
    here, later: uint64 (n or more,). follow: int32 (n,). low, high: the gap in frames.
    spare: uint64 (3, n or more), the last of them from `note_bounds`.
    """
    frames = longest * BLOCK
    if low >= frames:
        return False
    size, count = len(follow), np.uint64(len(follow))
    moved, widened, onward = spare[0], spare[1], spare[2]
    for i in range(count):
        widened[i] = later[i]
    width = min(high, frames) - low + 1
    covered = 1
    if high >= frames:
        _fill(widened, follow)
        covered = width
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
def _fill(bitmap, follow):  # type: ignore[no-untyped-def]
    # All that lies before the last bit of a window, which is what a gap without a bound leads back to.
    after = NO_BITS
    for i in range(len(follow) - 1, -1, -1):
        if follow[i] == 0:
            after = NO_BITS
        bitmap[i] = after | filled(bitmap[i])
        after = ALL_BITS if bitmap[i] else NO_BITS


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
def add_ranges(kept, index, follow, first, take, gaps, starts, stops, n):  # type: ignore[no-untyped-def]
    """Add the segments of the first bitmap, each from its start to the farthest end of a hit that begins in it.

    Parameters
    ----------
    kept: uint64 (K, n or more), of all keyframes, from `complete`. index: int64 (n,). follow: int32 (n,).
    first: of bit slices. take: one that begins before all windows. gaps: int64 (K − 1, 2).
    starts, stops, n: the n ranges so far, on the axis of positions, with room for more.

    Returns
    -------
    starts, stops, n: the same arrays or larger ones.
    """
    room = 0
    for i in range(np.uint64(len(index))):
        room += count_bits(kept[0, i] & ~(kept[0, i] << np.uint64(1)))
    hits = np.empty((room, 3), np.int64)
    many = _segments(kept[0], follow, hits)
    for k in range(len(gaps)):
        _farthest(kept[k + 1], gaps[k, 1], hits, many)
    for hit in range(many):
        block = hits[hit, 0] >> SHIFT
        while first[take + 1] <= index[block]:
            take = _take_of(first, take, index[block])
        # from here on the axis of positions, where takes lie 2**32 apart
        move = (take << 32) + (index[block] - first[take] - block << SHIFT)
        start, stop = hits[hit, 0] + move, hits[hit, 1] + 1 + move
        if n > 0 and start <= stops[n - 1]:
            stops[n - 1] = max(stops[n - 1], stop)
        else:
            if n == len(starts):
                starts, stops = _doubled(starts), _doubled(stops)
            starts[n], stops[n] = start, stop
            n += 1
    return starts, stops, n


@njit(cache=True, nogil=True)
def _segments(bitmap, follow, hits):  # type: ignore[no-untyped-def]
    # The stretches of bits that are set, each with its first, its last, and the last of its window.
    one = np.uint64(1)
    carry = NO_BITS
    edge = 0
    for i in range(np.uint64(len(follow))):
        word = bitmap[i]
        edges = word ^ ((word << one) | carry)
        carry = word >> np.uint64(BLOCK - 1)
        here = np.int64(i) << SHIFT
        while edges:
            hits[edge >> 1, edge & 1] = here + lowest(edges) - (edge & 1)
            hits[edge >> 1, 2] = (np.int64(i) + follow[i] + 1 << SHIFT) - 1
            edges &= edges - one
            edge += 1
        if carry and follow[i] == 0:
            hits[edge >> 1, 1] = here + BLOCK - 1
            edge += 1
            carry = NO_BITS
    return edge >> 1


@njit(cache=True, nogil=True)
def _farthest(bitmap, high, hits, many):  # type: ignore[no-untyped-def]
    # Each hit goes on to the largest survivor that the gap admits, in its window. `best` is the last one found,
    # `scanned` how far was looked; frames never fall, so no block is looked at twice.
    best, scanned = 0, 0
    for hit in range(np.uint64(many)):
        limit = min(hits[hit, 1] + high, hits[hit, 2])
        if limit >= scanned:
            block = limit >> SHIFT
            word = bitmap[block] & (ALL_BITS >> np.uint64(BLOCK - 1 - (limit & BLOCK - 1)))
            while word == 0 and block << SHIFT > scanned:
                block -= 1
                word = bitmap[block]
            if word:
                best = (block << SHIFT) + highest(word)
            scanned = limit + 1
        hits[hit, 1] = best


@njit(cache=True, nogil=True)
def _take_of(first, take, block):  # type: ignore[no-untyped-def]
    # The take, from `take` on, that has a block: in strides that double as long as they lead no further than to it.
    stride = 1
    while take + stride < len(first) and first[take + stride] <= block:
        take += stride
        stride *= 2
    return take


@njit(cache=True, nogil=True)
def _doubled(array):  # type: ignore[no-untyped-def]
    # in a loop: the assignment of a slice takes as long to compile as everything else that is done here
    larger = np.empty(2 * len(array), np.int64)
    for i in range(len(array)):
        larger[i] = array[i]
    return larger
