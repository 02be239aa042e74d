"""These kernels find the candidate windows of a keyframe query, the runs of blocks that may contain hits.

A granule consists of G = `ops.search.bit_slices.GRANULE` frames and has one bit in each coarse bitmap. Frame f lies in
granule floor(f / G), so a gap of low to high frames is a gap of floor(low / G) to ceil(high / G) granules. The search
is conservative: a granule that is dropped belongs to no hit, but a granule that is kept may also belong to none, for
instance because gaps may lead into the next take.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from kinedex.ops.bits import filled_below, highest_bit, lowest_bit
from kinedex.ops.search.bit_slices import ALL_BITS, BLOCK, GRANULE, GRANULES, NO_BITS, SHIFT

BLOCKS_PER_WORD = BLOCK // GRANULES
"""The number of blocks whose granules fill a word of a coarse bitmap."""
_BLOCK_BITS = np.uint64(2**GRANULES - 1)


@njit(cache=True, nogil=True)
def coarse_starts(coarse, features, blocks, rows, edges, order, gaps, found, spare):  # type: ignore[no-untyped-def]
    """Find the granules in a range of blocks in which a hit may begin, and return True if there are any.

    Parameters
    ----------
    coarse, features
        See `BitSlices`.
    blocks : (int, int)
        The blocks from blocks[0] to blocks[1] - 1 are searched.
    rows : int64 array
        Keyframe k uses the coarse rows rows[edges[k]] to rows[edges[k + 1]], a multiple of four.
    edges : int64 array (K + 1,)
        The boundaries of each keyframe's part of `rows`.
    order : int64 array (K,)
        The order in which the keyframes are searched.
    gaps : int64 array (K - 1, 2)
        Admissible gaps in frames.
    found : uint64 array (K, n)
        Output: bitmaps of the granules that may match each keyframe and from which the remaining keyframes may be
        reached, starting with the word that contains the granules of the first block.
    spare : uint64 array (2 or more, n)
        Working memory.

    Returns
    -------
    bool
    """
    begin, end = blocks
    stride = len(coarse) // (2 * features + 1)
    at = begin // BLOCKS_PER_WORD
    size = (end + BLOCKS_PER_WORD - 1) // BLOCKS_PER_WORD - at
    for k in order:
        if not _all_rows(coarse, stride, at, size, rows, edges[k], edges[k + 1], found[k]):
            return False
    for k in range(len(order) - 2, -1, -1):
        if not _complete(found[k], found[k + 1], size, spare[0], spare[1], gaps[k, 0], gaps[k, 1]):
            return False
    # the first and the last word may also contain granules of takes that are not searched
    found[0, 0] &= ALL_BITS << np.uint64(begin % BLOCKS_PER_WORD * GRANULES)
    if end % BLOCKS_PER_WORD:
        found[0, size - 1] &= ALL_BITS >> np.uint64((BLOCKS_PER_WORD - end % BLOCKS_PER_WORD) * GRANULES)
    return True


@njit(cache=True, nogil=True)
def _all_rows(coarse, stride, at, size, rows, begin, end, found):  # type: ignore[no-untyped-def]
    """Intersect four rows at a time, with unsigned indices so that the compiler vectorises the loop."""
    count = np.uint64(size)
    for four in range(begin, end, 4):
        one, two = np.uint64(rows[four] * stride + at), np.uint64(rows[four + 1] * stride + at)
        three, last = np.uint64(rows[four + 2] * stride + at), np.uint64(rows[four + 3] * stride + at)
        any_left = NO_BITS
        if four == begin:
            for i in range(count):
                word = (coarse[one + i] & coarse[two + i]) & (coarse[three + i] & coarse[last + i])
                found[i] = word
                any_left |= word
        else:
            for i in range(count):
                word = found[i] & (coarse[one + i] & coarse[two + i]) & (coarse[three + i] & coarse[last + i])
                found[i] = word
                any_left |= word
        if any_left == NO_BITS:
            return False
    return True


@njit(cache=True, nogil=True)
def _complete(here, later, size, widened, moved, low, high):  # type: ignore[no-untyped-def]
    """Keep the granules of a keyframe from which one of the next keyframe can be reached; return True if any is kept.

    The gap between the keyframes is `low` to `high` frames.
    """
    longest = size * BLOCK
    nearest, farthest = low // GRANULE, min((high + GRANULE - 1) // GRANULE, longest)
    if nearest >= longest:
        return False
    count = np.uint64(size)
    for i in range(count):
        widened[i] = later[i]
    width = farthest - nearest + 1
    covered = 1
    if farthest == longest:
        _fill(widened, size)
        covered = width
    while covered < width:
        by = min(covered, width - covered)
        if by < BLOCK:
            _widen(widened, size, by)
        else:
            _move(widened, size, moved, by)
            for i in range(count):
                widened[i] |= moved[i]
        covered += by
    if nearest:
        _move(widened, size, moved, nearest)
        widened = moved
    any_left = NO_BITS
    for i in range(count):
        found = here[i] & widened[i]
        here[i] = found
        any_left |= found
    return any_left != NO_BITS


@njit(cache=True, nogil=True)
def _fill(bitmap, size):  # type: ignore[no-untyped-def]
    """Set all bits up to the last set bit, as for an unbounded gap."""
    after = NO_BITS
    for i in range(size - 1, -1, -1):
        bitmap[i] = after | filled_below(bitmap[i])
        after = ALL_BITS if bitmap[i] else NO_BITS


@njit(cache=True, nogil=True)
def _widen(bitmap, size, by):  # type: ignore[no-untyped-def]
    """Unite a bitmap with itself shifted by less than a word to earlier granules, in place."""
    end, one = np.uint64(size - 1), np.uint64(1)
    by = np.uint64(by)
    upper = np.uint64(BLOCK) - by
    for i in range(end):
        bitmap[i] |= bitmap[i] >> by | bitmap[i + one] << upper
    bitmap[end] |= bitmap[end] >> by


@njit(cache=True, nogil=True)
def _move(bitmap, size, moved, by):  # type: ignore[no-untyped-def]
    """Write a bitmap shifted to earlier granules."""
    words, rest = np.uint64(min(by // BLOCK, size)), np.uint64(by % BLOCK)
    upper, one, count = np.uint64(BLOCK) - rest, np.uint64(1), np.uint64(size)
    if rest == NO_BITS:
        for i in range(count - words):
            moved[i] = bitmap[i + words]
    elif count > words:
        end = count - words - one
        for i in range(end):
            moved[i] = bitmap[i + words] >> rest | bitmap[i + words + one] << upper
        moved[end] = bitmap[end + words] >> rest
    for i in range(count - words, count):
        moved[i] = NO_BITS


@njit(cache=True, nogil=True)
def windows(found, ends, blocks, span, index, follow):  # type: ignore[no-untyped-def]
    """Collect the blocks that may contain hits: from granules in which hits may begin, as far as the gaps allow.

    Parameters
    ----------
    found : uint64 array (n,)
        The granules of the first keyframe, from `coarse_starts`.
    ends : uint64 array
        See `BitSlices`.
    blocks : (int, int)
        The blocks that were searched.
    span : int
        The sum of the upper bounds of all gaps, in frames.
    index : int64 array (b + 2 or more,)
        Output: the blocks, ascending, followed by -1.
    follow : int32 array (b or more,)
        Output: the number of blocks of the same window that follow each block.

    Returns
    -------
    (int, int)
        The number of blocks, and the number of blocks of the longest window.
    """
    begin, end = blocks
    at = begin // BLOCKS_PER_WORD * BLOCKS_PER_WORD
    n, after = 0, 0
    for i in range(np.uint64((end - at + BLOCKS_PER_WORD - 1) // BLOCKS_PER_WORD)):
        word = found[i]
        while word:
            place = lowest_bit(word) // GRANULES
            granules = (word >> np.uint64(place * GRANULES)) & _BLOCK_BITS
            word &= ~(_BLOCK_BITS << np.uint64(place * GRANULES))
            block = at + np.int64(i) * BLOCKS_PER_WORD + place
            frame = (highest_bit(granules) + 1) * GRANULE - 1
            stop = block + 1 + _within_take(ends, block, frame + span >> SHIFT)
            after = max(after, block)
            many = max(stop - after, 0)
            # one or two blocks are handled without a branch, as it would be mispredicted in a large archive
            index[n], index[n + 1] = after, after + 1
            for more in range(2, many):
                index[n + more] = after + more
            n += many
            after += many
    index[n] = -1
    longest, follows = 0, 0
    for i in range(n - 1, -1, -1):
        block = index[i]
        follows = (follows + 1) * ((index[i + 1] == block + 1) & (1 - _is_last(ends, block)))
        follow[i] = follows
        longest = max(longest, follows + 1)
    return n, longest


@njit(cache=True, nogil=True)
def _is_last(ends, block):  # type: ignore[no-untyped-def]
    """Return 1 for the last block of a take, else 0."""
    return np.int64(ends[block >> SHIFT << 1] >> np.uint64(block & BLOCK - 1) & np.uint64(1))


@njit(cache=True, nogil=True)
def _within_take(ends, block, many):  # type: ignore[no-untyped-def]
    """Return the number of blocks of the same take that follow a block, at most `many`."""
    at = block >> SHIFT << 1
    word = ends[at] >> np.uint64(block & BLOCK - 1)
    if word:
        return min(many, lowest_bit(word))
    follow = BLOCK - (block & BLOCK - 1)
    while follow < many:
        at += 2
        if ends[at]:
            return min(many, follow + lowest_bit(ends[at]))
        follow += BLOCK
    return many
