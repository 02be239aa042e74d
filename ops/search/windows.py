"""Where a keyframe query may have hits, by the coarse slices: windows of whole blocks, outside of which nothing can be.

A granule is a few frames (`ops.search.bitslices.GRANULE`), with one bit in each coarse bitmap. Frame f lies in granule
⌊f / G⌋, so a gap of low to high frames leads ⌊low / G⌋ to ⌈high / G⌉ granules on. Everything here errs to one side:
what is dropped is in no hit; what is kept may be in none, also because gaps may lead into the next take here.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ops.bits import count_bits
from ops.search.bitslices import ALL_BITS, BLOCK, GRANULE, GRANULES, NO_BITS

_IN_WORD = BLOCK // GRANULES
"""The blocks whose granules make up a word of a coarse bitmap."""
_OF_BLOCK = np.uint64(2**GRANULES - 1)


@njit(cache=True, nogil=True)
def coarse_plan(features, keyframes):  # type: ignore[no-untyped-def]
    """Return the coarse rows that each keyframe asks for, and the order in which to look for keyframes.

    Parameters
    ----------
    features: f. keyframes: int64 (2, K), masks and values.

    Returns
    -------
    rows: int64, keyframe k has rows[edges[k]] .. rows[edges[k + 1]], filled up to whole quarters.
    edges: int64 (K + 1,).
    order: int64 (K,), those that ask for most first, since they are rare. Only the speed depends on it.
    """
    count = keyframes.shape[1]
    rows = np.empty((features // 4 + 1) * 4 * count, np.int64)
    edges, order = np.zeros(count + 1, np.int64), np.empty(count, np.int64)
    n = 0
    for k in range(count):
        for feature in range(features):
            if keyframes[0, k] >> feature & 1:
                rows[n] = feature if keyframes[1, k] >> feature & 1 else features + feature
                n += 1
        while n % 4 or n == edges[k]:
            rows[n] = 2 * features
            n += 1
        edges[k + 1] = n
        i = k
        while i > 0 and edges[order[i - 1] + 1] - edges[order[i - 1]] < n - edges[k]:
            order[i] = order[i - 1]
            i -= 1
        order[i] = k
    return rows, edges, order


@njit(cache=True, nogil=True)
def coarse_starts(coarse, features, begin, end, rows, edges, order, gaps, found, spare):  # type: ignore[no-untyped-def]
    """Find the granules of the blocks begin .. end in which a hit may begin; False where there are none.

    Parameters
    ----------
    coarse, features: of bit slices. rows, edges, order: from `coarse_plan`. gaps: int64 (K − 1, 2).
    found: uint64 (K, n), written to: for each keyframe the granules in which it may be, from the word that holds those
        of block `begin` on, where the rest of the query may be completed. spare: uint64 (2 or more, n).
    """
    stride = len(coarse) // (2 * features + 1)
    at = begin // _IN_WORD
    size = (end + _IN_WORD - 1) // _IN_WORD - at
    for k in order:
        if not _all_rows(coarse, stride, at, size, rows, edges[k], edges[k + 1], found[k]):
            return False
    for k in range(len(order) - 2, -1, -1):
        if not _complete(found[k], found[k + 1], size, spare[0], spare[1], gaps[k, 0], gaps[k, 1]):
            return False
    # other takes than were asked for may have granules in the first and the last word
    found[0, 0] &= ALL_BITS << np.uint64(begin % _IN_WORD * GRANULES)
    if end % _IN_WORD:
        found[0, size - 1] &= ALL_BITS >> np.uint64((_IN_WORD - end % _IN_WORD) * GRANULES)
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
def windows(found, left, begin, end, span, index, follow, marks):  # type: ignore[no-untyped-def]
    """Collect the blocks that all hits lie in: from the granules that hits may begin in, as far as the gaps lead.

    Parameters
    ----------
    found: uint64 (K, n), from `coarse_starts` for the blocks begin .. end. left: of bit slices.
    span: the sum of all gaps' upper bounds, in frames.
    index: int64 (end − begin,), written to: the blocks, ascending. follow: int32, how many blocks of the window are
        left after each. marks: uint8 (K, end − begin), the granules of each block in which a keyframe may be.

    Returns
    -------
    How many blocks there are, and how many the longest window has. All keyframes may be in each window.
    """
    at = begin // _IN_WORD
    n, longest = 0, 0
    opened, closed, last_of_take = -1, -1, -1
    for i in range((end + _IN_WORD - 1) // _IN_WORD - at):
        word = found[0, i]
        while word:
            place = lowest(word) // GRANULES
            granules = (word >> np.uint64(place * GRANULES)) & _OF_BLOCK
            word &= ~(_OF_BLOCK << np.uint64(place * GRANULES))
            block = (at + i) * _IN_WORD + place
            if block > last_of_take or block > closed + 1:
                n, longest = _keep(found, at, opened, closed, index, follow, marks, n, longest)
                opened = block
            last_of_take = block + left[block]
            frame = (highest(granules) + 1) * GRANULE - 1
            closed = min(last_of_take, block + (frame + span) // BLOCK)
    return _keep(found, at, opened, closed, index, follow, marks, n, longest)


@njit(cache=True, nogil=True)
def _keep(found, at, opened, closed, index, follow, marks, n, longest):  # type: ignore[no-untyped-def]
    # One window, the blocks opened .. closed, both included, unless a keyframe cannot be in it.
    if opened < 0:
        return n, longest
    size = closed + 1 - opened
    for k in range(len(found)):
        some = NO_BITS
        for i in range(size):
            block = opened + i
            granules = (found[k, block // _IN_WORD - at] >> np.uint64(block % _IN_WORD * GRANULES)) & _OF_BLOCK
            marks[k, n + i] = granules
            some |= granules
        if some == NO_BITS:
            return n, longest
    for i in range(size):
        index[n + i], follow[n + i] = opened + i, size - 1 - i
    return n + size, max(longest, size)


@njit(cache=True, nogil=True)
def lowest(word):  # type: ignore[no-untyped-def]
    """The number of the lowest bit that is set: how many lie below it."""
    return count_bits((word - np.uint64(1)) & ~word)


@njit(cache=True, nogil=True)
def highest(word):  # type: ignore[no-untyped-def]
    """The number of the highest bit that is set: one less than how many there are up to it."""
    for width in (1, 2, 4, 8, 16, 32):
        word |= word >> np.uint64(width)
    return count_bits(word) - 1
