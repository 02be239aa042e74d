"""Where a keyframe query may have hits, by the coarse slices: windows of whole blocks, outside of which nothing can be.

A granule is a few frames (`ops.search.bit_slices.GRANULE`), with one bit in each coarse bitmap. Frame f lies in granule
⌊f / G⌋, so a gap of low to high frames leads ⌊low / G⌋ to ⌈high / G⌉ granules on. Everything here errs to one side:
what is dropped is in no hit; what is kept may be in none, also because gaps may lead into the next take here.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from kinedex.ops.bits import count_bits
from kinedex.ops.search.bit_slices import ALL_BITS, BLOCK, GRANULE, GRANULES, NO_BITS, SHIFT

IN_WORD = BLOCK // GRANULES
"""The blocks whose granules make up a word of a coarse bitmap."""
_OF_BLOCK = np.uint64(2**GRANULES - 1)


@njit(cache=True, nogil=True)
def coarse_starts(coarse, features, blocks, rows, edges, order, gaps, found, spare):  # type: ignore[no-untyped-def]
    """Find the granules of blocks[0] .. blocks[1] in which a hit may begin; False where there are none.

    Parameters
    ----------
    coarse, features: of bit slices. gaps: int64 (K − 1, 2).
    rows: the coarse rows that keyframe k asks for are rows[edges[k]] .. rows[edges[k + 1]], whole quarters.
    order: int64 (K,), in which keyframes are looked for.
    found: uint64 (K, n), written to: for each keyframe the granules in which it may be, from the word that holds those
        of the first block on, where the rest of the query may be completed. spare: uint64 (2 or more, n).
    """
    begin, end = blocks
    stride = len(coarse) // (2 * features + 1)
    at = begin // IN_WORD
    size = (end + IN_WORD - 1) // IN_WORD - at
    for k in order:
        if not _all_rows(coarse, stride, at, size, rows, edges[k], edges[k + 1], found[k]):
            return False
    for k in range(len(order) - 2, -1, -1):
        if not _complete(found[k], found[k + 1], size, spare[0], spare[1], gaps[k, 0], gaps[k, 1]):
            return False
    # other takes than were asked for may have granules in the first and the last word
    found[0, 0] &= ALL_BITS << np.uint64(begin % IN_WORD * GRANULES)
    if end % IN_WORD:
        found[0, size - 1] &= ALL_BITS >> np.uint64((IN_WORD - end % IN_WORD) * GRANULES)
    return True


@njit(cache=True, nogil=True)
def _all_rows(coarse, stride, at, size, rows, begin, end, found):  # type: ignore[no-untyped-def]
    # Four rows at a time; indices without a sign, which the compiler can turn into vector instructions.
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
    # Keep of a keyframe's granules those from which one of the next can be reached; False where there are none.
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
    # All that lies before the last bit, which is what a gap without a bound leads back to.
    after = NO_BITS
    for i in range(size - 1, -1, -1):
        bitmap[i] = after | filled(bitmap[i])
        after = ALL_BITS if bitmap[i] else NO_BITS


@njit(cache=True, nogil=True)
def _widen(bitmap, size, by):  # type: ignore[no-untyped-def]
    # Add to a bitmap itself, moved by less than a word. A word reads itself and the next, not changed yet.
    end, one = np.uint64(size - 1), np.uint64(1)
    by = np.uint64(by)
    upper = np.uint64(BLOCK) - by
    for i in range(end):
        bitmap[i] |= bitmap[i] >> by | bitmap[i + one] << upper
    bitmap[end] |= bitmap[end] >> by


@njit(cache=True, nogil=True)
def _move(bitmap, size, moved, by):  # type: ignore[no-untyped-def]
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
def windows(found, left, blocks, span, index, follow):  # type: ignore[no-untyped-def]
    """Collect the blocks that all hits lie in: from the granules that hits may begin in, as far as the gaps lead.

    Parameters
    ----------
    found: uint64 (n,), of the first keyframe, from `coarse_starts` for blocks[0] .. blocks[1]. left: of bit slices.
    span: the sum of all gaps' upper bounds, in frames.
    index: int64 (b or more,), written to: the blocks, ascending. follow: int32, how many blocks of the window are
        left after each.

    Returns
    -------
    How many blocks there are, and how many the longest window has.
    """
    begin, end = blocks
    at = begin // IN_WORD * IN_WORD
    n, after = 0, 0
    for i in range(np.uint64((end - at + IN_WORD - 1) // IN_WORD)):
        word = found[i]
        while word:
            place = lowest(word) // GRANULES
            granules = (word >> np.uint64(place * GRANULES)) & _OF_BLOCK
            word &= ~(_OF_BLOCK << np.uint64(place * GRANULES))
            block = at + np.int64(i) * IN_WORD + place
            frame = (_highest_of_block(granules) + 1) * GRANULE - 1
            stop = block + 1 + min(left[block], frame + span >> SHIFT)
            after = max(after, block)
            while after < stop:
                index[n] = after
                after += 1
                n += 1
    longest, follows = 0, 0
    for i in range(n - 1, -1, -1):
        block = index[i]
        follows = follows + 1 if i + 1 < n and index[i + 1] == block + 1 and left[block] > 0 else 0
        follow[i] = follows
        longest = max(longest, follows + 1)
    return n, longest


@njit(cache=True, nogil=True)
def _highest_of_block(granules):  # type: ignore[no-untyped-def]
    granules |= granules >> np.uint64(1)
    granules |= granules >> np.uint64(2)
    return count_bits(granules | granules >> np.uint64(4)) - 1


@njit(cache=True, nogil=True)
def lowest(word):  # type: ignore[no-untyped-def]
    """The number of the lowest bit that is set: how many lie below it."""
    return count_bits((word - np.uint64(1)) & ~word)


@njit(cache=True, nogil=True)
def highest(word):  # type: ignore[no-untyped-def]
    """The number of the highest bit that is set: one less than how many there are up to it."""
    return count_bits(filled(word)) - 1


@njit(cache=True, nogil=True)
def filled(word):  # type: ignore[no-untyped-def]
    """All bits up to the highest that is set."""
    for width in (1, 2, 4, 8, 16, 32):
        word |= word >> np.uint64(width)
    return word
