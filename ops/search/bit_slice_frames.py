"""These kernels search keyframes frame by frame within candidate windows, and collect the ranges of hits.

These kernels number the n blocks of all windows consecutively, even if the blocks are not adjacent in the archive:
index[i] is the number of block i in the bit slices, and follow[i] is the number of later blocks in its window. Bitmaps
have one uint64 for each block.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from kinedex.ops.bits import count_bits, filled_below, highest_bit, lowest_bit
from kinedex.ops.cache_prefetch import prefetch
from kinedex.ops.ranges import TAKE_BITS
from kinedex.ops.search.bit_slices import ALL_BITS, BLOCK, NO_BITS, SHIFT


@njit(cache=True, nogil=True)
def mark_followed(follow, onward):  # type: ignore[no-untyped-def]
    """Set all bits of each block that is followed by another block of its window, and no bits of other blocks."""
    for i in range(np.uint64(len(follow))):
        onward[i] = ALL_BITS if follow[i] else NO_BITS


GROUP = 128
"""The number of blocks that are prefetched from memory while as many blocks before them are searched."""


@njit(cache=True, nogil=True)
def match_all(bits, height, index, granules, at, keyframes, spare, remaining):  # type: ignore[no-untyped-def]
    """Find the frames of all keyframes, group by group of blocks, and return False if a keyframe has none.

    Parameters
    ----------
    bits, height, index, at, spare
        See `match`.
    granules : uint8 array (K, b)
        The granules of each keyframe, from block `at` on.
    keyframes : (uint64 array, uint64 array, int64 array, int64 array, int64 array)
        Keyframe k uses the words rows[edges[k]] to rows[edges[k + 1]] of a block, XORed with the same range of flips.
        After rows, flips and edges come the order in which to search the keyframes, and the words of a block to
        prefetch.
    remaining : uint64 array (K, n or more)
        Output: the bitmaps of the frames of the keyframes; incomplete if a keyframe has no frame.

    Returns
    -------
    bool
    """
    rows, flips, edges, order, fetched = keyframes
    size, some = len(index), 0
    seen = np.zeros(len(order), np.bool_)
    _fetch(bits, height, index[:GROUP], fetched)
    for begin in range(0, size, GROUP):
        end = min(begin + GROUP, size)
        _fetch(bits, height, index[end : end + GROUP], fetched)
        here = index[begin:end]
        for k in order:
            asked = slice(edges[k], edges[k + 1])
            found = match(bits, height, here, granules[k], at, rows[asked], flips[asked], spare, remaining[k, begin:])
            if found and not seen[k]:
                seen[k] = True
                some += 1
            elif not found and end - begin == size:
                return False
    return some == len(order)


@njit(cache=True, nogil=True)
def _fetch(bits, height, index, fetched):  # type: ignore[no-untyped-def]
    """Prefetch the given words of the given blocks from memory."""
    if len(fetched):
        for i in range(len(index)):
            for word in fetched:
                prefetch(bits, index[i] * height + word)


@njit(cache=True, nogil=True)
def match(bits, height, index, granules, at, rows, flips, spare, remaining):  # type: ignore[no-untyped-def]
    """Find the frames of a keyframe, and return True if there are any.

    Parameters
    ----------
    bits : uint64 array
        See `BitSlices`.
    height : int
        The number of words of a block there.
    index : int64 array (n,)
        The blocks of all windows.
    granules : uint8 array
        The granules of the keyframe, from block `at` on; a block without granules is skipped.
    at : int
        The first block of `granules`.
    rows : uint64 array (r,)
        The words of a block that the keyframe uses, a multiple of four.
    flips : uint64 array (r,)
        All bits set for a feature that the keyframe requires to be off, no bits for one that it requires to be on.
    spare : uint64 array (3, n or more)
        Working memory.
    remaining : uint64 array (n or more,)
        Output: the bitmap of the frames.

    Returns
    -------
    bool
    """
    many = np.uint64(0)
    where, chosen, some = spare[0], spare[1], spare[2]
    for i in range(np.uint64(len(index))):
        remaining[i] = NO_BITS
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
        remaining[chosen[i]] = some[i]
        any_left |= some[i]
    return any_left != NO_BITS


@njit(cache=True, nogil=True)
def complete(here, later, follow, longest, low, high, spare):  # type: ignore[no-untyped-def]
    """Keep the frames of a keyframe from which a frame of the next keyframe can be reached; return True if any is left.

    The later bitmap is widened to the gap [0, high - low] by doubling, then shifted by `low`, within windows.

    Parameters
    ----------
    here, later : uint64 array (n or more,)
        The frames of the keyframe, which are reduced in place, and the remaining frames of the next keyframe.
    follow : int32 array (n,)
        The number of blocks that follow each block in its window.
    longest : int
        The number of blocks of the longest window.
    low, high : int
        The gap in frames, both ends included.
    spare : uint64 array (3, n or more)
        Working memory; the last row from `mark_followed`.

    Returns
    -------
    bool
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
    """Set all bits up to the last set bit of each window, as for an unbounded gap."""
    after = NO_BITS
    for i in range(len(follow) - 1, -1, -1):
        if follow[i] == 0:
            after = NO_BITS
        bitmap[i] = after | filled_below(bitmap[i])
        after = ALL_BITS if bitmap[i] else NO_BITS


@njit(cache=True, nogil=True)
def _widen(bitmap, size, onward, by):  # type: ignore[no-untyped-def]
    """Unite a bitmap with itself shifted by less than a block to earlier frames of the same window.

    Each block is computed from itself and the next block, which has not been changed yet.
    """
    end, one = np.uint64(size - 1), np.uint64(1)
    by = np.uint64(by)
    upper = np.uint64(BLOCK) - by
    for i in range(end):
        bitmap[i] |= bitmap[i] >> by | (bitmap[i + one] & onward[i]) << upper
    bitmap[end] |= bitmap[end] >> by


@njit(cache=True, nogil=True)
def _move(bitmap, size, moved, follow, by):  # type: ignore[no-untyped-def]
    """Write a bitmap shifted to earlier frames; a block takes bits from later blocks of its own window only."""
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
def add_ranges(remaining, index, follow, first, ends, gaps, ranges, n):  # type: ignore[no-untyped-def]
    """Add the ranges of hits to a list of ranges, and unite those that overlap or touch.

    Each run of set bits in the bitmap of the first keyframe gives a range, from the first frame of the run to the
    farthest end of a hit that begins in it.

    Parameters
    ----------
    remaining : uint64 array (K, n or more)
        The remaining frames of all keyframes, from `complete`.
    index : int64 array (b,)
        The blocks of all windows.
    follow : int32 array (b,)
        The number of blocks that follow each block in its window.
    first : int64 array (T + 1,)
        See `BitSlices`.
    ends : uint64 array
        See `BitSlices`.
    gaps : int64 array (K - 1, 2)
        Admissible gaps in frames.
    ranges : int64 array (m, 2)
        The first n rows are the ranges so far, on the axis of positions.
    n : int
        The number of ranges so far.

    Returns
    -------
    (int64 array, int)
        The ranges, in the same array or a larger one, and their number.
    """
    room = 0
    for i in range(np.uint64(len(index))):
        room += count_bits(remaining[0, i] & ~(remaining[0, i] << np.uint64(1)))
    hits = np.empty((room, 3), np.int64)
    many = _segments(remaining[0], follow, hits)
    for k in range(len(gaps)):
        _farthest(remaining[k + 1], gaps[k, 1], hits, many)
    for hit in range(many):
        block = hits[hit, 0] >> SHIFT
        take = _take_of(ends, index[block])
        # from here on, frames are positions on the axis, where takes lie 2**TAKE_BITS apart
        move = (take << TAKE_BITS) + (index[block] - first[take] - block << SHIFT)
        start, stop = hits[hit, 0] + move, hits[hit, 1] + 1 + move
        if n > 0 and start <= ranges[n - 1, 1]:
            ranges[n - 1, 1] = max(ranges[n - 1, 1], stop)
        else:
            if n == len(ranges):
                ranges = _doubled(ranges)
            ranges[n, 0], ranges[n, 1] = start, stop
            n += 1
    return ranges, n


@njit(cache=True, nogil=True)
def _segments(bitmap, follow, hits):  # type: ignore[no-untyped-def]
    """Write for each segment of a bitmap its first frame, its last frame, and the last frame of its window."""
    one = np.uint64(1)
    carry = NO_BITS
    edge = 0
    for i in range(np.uint64(len(follow))):
        word = bitmap[i]
        edges = word ^ ((word << one) | carry)
        carry = word >> np.uint64(BLOCK - 1)
        here = np.int64(i) << SHIFT
        while edges:
            hits[edge >> 1, edge & 1] = here + lowest_bit(edges) - (edge & 1)
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
    """Advance the end of each hit to the largest remaining frame that the gap allows, in its window."""
    # `best` is the last such frame found; frames below `scanned` have been searched. The ends are non-decreasing, so no
    # block is searched twice
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
                best = (block << SHIFT) + highest_bit(word)
            scanned = limit + 1
        hits[hit, 1] = best


@njit(cache=True, nogil=True)
def _take_of(ends, block):  # type: ignore[no-untyped-def]
    """Return the take that contains a block, which is the number of takes that end before the block."""
    at = block >> SHIFT << 1
    before = ends[at] & ((np.uint64(1) << np.uint64(block & BLOCK - 1)) - np.uint64(1))
    return np.int64(ends[at + 1]) + count_bits(before)


@njit(cache=True, nogil=True)
def _doubled(ranges):  # type: ignore[no-untyped-def]
    """Copy ranges into an array twice as long."""
    # in a loop: a slice assignment would take as long to compile as all other kernels of this module
    larger = np.empty((2 * len(ranges), 2), np.int64)
    for i in range(len(ranges)):
        larger[i, 0], larger[i, 1] = ranges[i, 0], ranges[i, 1]
    return larger
