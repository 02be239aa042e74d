"""Keyframe search on bit slices, 64 frames at a time.

A keyframe's list, as a bitmap over frames, is the AND of the slices of its features (their complement where it wants
one off). The frames from which the rest of a query can be completed are the AND of that with the next keyframe's,
widened by the gap; and widening takes a few shifts. No list is merged or sorted, and wildcards cost nothing.

Takes are searched in groups: one in which a keyframe does not occur at all, the rarest being looked for first, is left
at once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from ops.bits import count_bits
from ops.errors import ParameterError
from ops.search.bitslices import ALL_BITS, BLOCK, NO_BITS, BitSlices
from ops.search.keyframes import Segments, checked_gaps

NEAR = 2**20
"""Words of slices that stay in a processor's cache, or so; more are fetched group by group, in order."""


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
    slices: BitSlices, masks: Sequence[int], values: Sequence[int], gaps: Sequence[tuple[int, int]]
) -> Segments:
    """Find the union of all hit relevant ranges of a keyframe query (thesis, Eq. 3.2 and 3.3, Section 3.5).

    Backwards, each keyframe's bitmap keeps the frames from which the rest of the query can be completed; forwards, the
    last frame of each surviving start segment goes on to the largest survivor that each gap admits, as in
    `ops.search.keyframes.search`. O(K · frames / 64), less what is left early; no recursion.

    Parameters
    ----------
    slices: T takes; take t has index t on the axis of positions.
    masks, values: K >= 1 keyframes in bits of whole words (features of several sets go into one).
    gaps: K − 1 admissible gaps (low, high) in frames, both included; anything from `UNBOUNDED` up has no upper bound.

    Returns
    -------
    The ranges from the first to the last keyframe of all hits, on the axis of positions; ranges that overlap or touch
    are one. No hit begins or ends in an invalid frame, and no keyframe matches there; its gaps may span them.

    Raises
    ------
    ParameterError: no keyframe, a mask beyond the features, a value beyond its mask, or gaps that do not fit.
    """
    if not masks or len(masks) != len(values):
        raise ParameterError("keyframes", "at least one, as many masks as values", (len(masks), len(values)))
    for mask, value in zip(masks, values, strict=True):
        if mask < 0 or mask >> slices.features or value & ~mask:
            raise ParameterError(
                "keyframe", f"a mask within {slices.features} features, a value within it", (mask, value)
            )
    bounds = checked_gaps(gaps, len(masks))
    wanted = np.array([masks, values], np.uint64)
    arrays = slices.bits, slices.first, slices.left, slices.onward, slices.groups, slices.often
    starts, stops = _search(*arrays, wanted[0], wanted[1], bounds, len(slices.bits) > NEAR)
    return Segments(starts, stops)


@njit(cache=True, nogil=True)
def _search(bits, first, left, onward, groups, often, masks, values, gaps, far):  # type: ignore[no-untyped-def]
    count = len(masks)
    rows, flips, offsets, order = _plan(often, masks, values)
    widest = 0
    for group in range(len(groups) - 1):
        widest = max(widest, first[groups[group + 1]] - first[groups[group]])
    kept = np.empty(count * widest, np.uint64)
    moved, widened = np.empty(widest, np.uint64), np.empty(widest, np.uint64)
    best, scanned = np.empty(count, np.int64), np.empty(count, np.int64)
    starts, stops = np.empty(64, np.int64), np.empty(64, np.int64)
    features = len(often) - 1
    n = 0
    for group in range(len(groups) - 1):
        base = first[groups[group]]
        size = first[groups[group + 1]] - base
        if far:
            moved[0] = _fetch(bits, base * (features + 1), size * (features + 1))
        alive = True
        for k in order:
            alive = _match(bits, features + 1, base, size, rows, flips, offsets[k], offsets[k + 1], kept, k * widest)
            if not alive:
                break
        k = count - 2
        while alive and k >= 0:
            alive = _complete(
                kept, k * widest, widest, size, moved, widened, onward, left, base, gaps[k, 0], gaps[k, 1]
            )
            k -= 1
        if alive:
            best[:], scanned[:] = 0, 0
            starts, stops, n = _ranges(kept, widest, first, groups[group], size, gaps, best, scanned, starts, stops, n)
    return starts[:n].copy(), stops[:n].copy()


@njit(cache=True, nogil=True)
def _fetch(bits, begin, count):  # type: ignore[no-untyped-def]
    # Reads one word of each line of the cache, in order, so that memory sends the next ones before they are asked for.
    # What is returned means nothing; the caller keeps it, so that the reading is not left out as useless.
    start, end, step = np.uint64(begin), np.uint64(begin + count), np.uint64(8)
    some = NO_BITS
    while start < end:
        some |= bits[start]
        start += step
    return some


@njit(cache=True, nogil=True)
def _plan(often, masks, values):  # type: ignore[no-untyped-def]
    # The rows that each keyframe asks for, the most selective first, with all bits to flip where the complement is
    # meant; the row of valid frames is always among them, and fills them up to whole quarters. And the order of the
    # keyframes, the rarest first, as if features were independent. Only the speed depends on these orders.
    features = len(often) - 1
    valid = max(often[features], 1)
    room = (features // 4 + 1) * 4 * len(masks)
    rows, flips = np.empty(room, np.int64), np.zeros(room, np.uint64)
    shares = np.empty(room, np.float64)
    offsets = np.zeros(len(masks) + 1, np.int64)
    rarity = np.ones(len(masks), np.float64)
    n = 0
    for k in range(len(masks)):
        for feature in range(features):
            bit = np.uint64(1) << np.uint64(feature)
            if masks[k] & bit:
                on = (values[k] & bit) != 0
                share = (often[feature] if on else valid - often[feature]) / valid
                rarity[k] *= share
                i = n
                while i > offsets[k] and shares[i - 1] > share:
                    rows[i], flips[i], shares[i] = rows[i - 1], flips[i - 1], shares[i - 1]
                    i -= 1
                rows[i], flips[i], shares[i] = feature, NO_BITS if on else ALL_BITS, share
                n += 1
        n += 1
        rows[n - 1], flips[n - 1] = features, 0
        while (n - offsets[k]) % 4:
            rows[n], flips[n] = features, 0
            n += 1
        offsets[k + 1] = n
    return rows, flips, offsets, np.argsort(rarity)


@njit(cache=True, nogil=True)
def _match(bits, height, base, size, rows, flips, begin, end, kept, at):  # type: ignore[no-untyped-def]
    # The keyframe's frames in the blocks base .. base + size, into kept[at ..]; False as soon as there are none. Four
    # rows at a time; indices without a sign, which the compiler can turn into vector instructions.
    to = np.uint64(at)
    for four in range(begin, end, 4):
        one = np.uint64(base * height + rows[four] * size)
        two = np.uint64(base * height + rows[four + 1] * size)
        three = np.uint64(base * height + rows[four + 2] * size)
        last = np.uint64(base * height + rows[four + 3] * size)
        flip_one, flip_two, flip_three, flip_last = flips[four], flips[four + 1], flips[four + 2], flips[four + 3]
        any_left = np.uint64(0)
        if four == begin:
            for i in range(np.uint64(size)):
                found = (bits[one + i] ^ flip_one) & (bits[two + i] ^ flip_two)
                found &= (bits[three + i] ^ flip_three) & (bits[last + i] ^ flip_last)
                kept[to + i] = found
                any_left |= found
        else:
            for i in range(np.uint64(size)):
                found = kept[to + i] & (bits[one + i] ^ flip_one) & (bits[two + i] ^ flip_two)
                found &= (bits[three + i] ^ flip_three) & (bits[last + i] ^ flip_last)
                kept[to + i] = found
                any_left |= found
        if any_left == 0:
            return False
    return True


@njit(cache=True, nogil=True)
def _complete(kept, at, widest, size, moved, widened, onward, left, base, low, high):  # type: ignore[no-untyped-def]
    # Keep of a keyframe's frames (kept[at ..]) those from which those of the next one can be reached; False where there
    # are none. The later bitmap is widened to the gap [0, high - low] by doubling, then moved by `low`.
    longest = size * BLOCK
    if low >= longest:
        return False
    here, later, count = np.uint64(at), np.uint64(at + widest), np.uint64(size)
    for i in range(count):
        widened[i] = kept[later + i]
    width = min(high, longest) - low + 1
    covered = 1
    while covered < width:
        by = min(covered, width - covered)
        if by < BLOCK:
            _widen(widened, size, onward, base, by)
        else:
            _move(widened, size, moved, left, base, by)
            for i in range(count):
                widened[i] |= moved[i]
        covered += by
    if low:
        _move(widened, size, moved, left, base, low)
        widened = moved
    any_left = NO_BITS
    for i in range(count):
        found = kept[here + i] & widened[i]
        kept[here + i] = found
        any_left |= found
    return any_left != NO_BITS


@njit(cache=True, nogil=True)
def _widen(bitmap, size, onward, base, by):  # type: ignore[no-untyped-def]
    # Add to a bitmap itself, moved less than a block to earlier frames of the same take. A block reads itself and the
    # next, which has not been changed yet.
    start, end, one = np.uint64(base), np.uint64(size - 1), np.uint64(1)
    by = np.uint64(by)
    upper = np.uint64(BLOCK) - by
    for i in range(end):
        bitmap[i] |= bitmap[i] >> by | (bitmap[i + one] & onward[start + i]) << upper
    bitmap[end] |= bitmap[end] >> by


@njit(cache=True, nogil=True)
def _move(bitmap, size, moved, left, base, by):  # type: ignore[no-untyped-def]
    # A bitmap moved to earlier frames, within takes: a block takes from later ones of its own take only.
    blocks, rest = np.uint64(by // BLOCK), np.uint64(by % BLOCK)
    upper, one = np.uint64(BLOCK) - rest, np.uint64(1)
    start, count, at_least = np.uint64(base), np.uint64(size), np.int32(by // BLOCK)
    if rest == NO_BITS:
        for i in range(count - blocks):
            moved[i] = bitmap[i + blocks] if left[start + i] >= at_least else NO_BITS
    else:
        end = count - blocks - one
        for i in range(end):
            near = bitmap[i + blocks] >> rest if left[start + i] >= at_least else NO_BITS
            moved[i] = near | (bitmap[i + blocks + one] << upper if left[start + i] > at_least else NO_BITS)
        moved[end] = bitmap[end + blocks] >> rest if left[start + end] >= at_least else NO_BITS
    for i in range(count - blocks, count):
        moved[i] = NO_BITS


@njit(cache=True, nogil=True)
def _ranges(kept, widest, first, take, size, gaps, best, scanned, starts, stops, n):  # type: ignore[no-untyped-def]
    # The segments of the first bitmap, each from its start to the farthest end of a hit that begins in it. In the
    # bitmap of each later keyframe, `best` is the last survivor found and `scanned` how far it was looked for; frames
    # never fall, so no block is looked at twice.
    base = first[take]
    one = np.uint64(1)
    start = -1
    carry = np.uint64(0)
    for i in range(size):
        edges = kept[i] ^ ((kept[i] << one) | carry)
        carry = kept[i] >> np.uint64(BLOCK - 1)
        while edges:
            edge = i * BLOCK + _lowest(edges)
            edges &= edges - one
            if start < 0:
                start = edge
                continue
            while (first[take + 1] - base) * BLOCK <= start:
                take += 1
            last = (first[take + 1] - base) * BLOCK - 1
            stop = _farthest(kept, widest, gaps, edge - 1, last, best, scanned) + 1
            # from here on the axis of positions, where takes lie 2**32 apart
            move = (take << 32) - (first[take] - base) * BLOCK
            if n > 0 and start + move <= stops[n - 1]:
                stops[n - 1] = stop + move
            else:
                if n == len(starts):
                    starts, stops = _doubled(starts), _doubled(stops)
                starts[n], stops[n] = start + move, stop + move
                n += 1
            start = -1
    return starts, stops, n


@njit(cache=True, nogil=True)
def _farthest(kept, widest, gaps, frame, last, best, scanned):  # type: ignore[no-untyped-def]
    # E(frame): always on to the largest survivor that the gap admits, in a take whose last bit is `last`.
    ones = np.uint64(0xFFFF_FFFF_FFFF_FFFF)
    for k in range(1, len(best)):
        limit = min(frame + gaps[k - 1, 1], last)
        if limit >= scanned[k]:
            block = limit // BLOCK
            word = kept[k * widest + block] & (ones >> np.uint64(BLOCK - 1 - limit % BLOCK))
            while word == 0 and block * BLOCK > scanned[k]:
                block -= 1
                word = kept[k * widest + block]
            if word:
                best[k] = block * BLOCK + _highest(word)
            scanned[k] = limit + 1
        frame = best[k]
    return frame


@njit(cache=True, nogil=True)
def _doubled(array):  # type: ignore[no-untyped-def]
    larger = np.empty(2 * len(array), np.int64)
    larger[: len(array)] = array
    return larger


@njit(cache=True, nogil=True)
def _lowest(word):  # type: ignore[no-untyped-def]
    # The number of the lowest bit that is set: how many lie below it.
    return count_bits((word - np.uint64(1)) & ~word)


@njit(cache=True, nogil=True)
def _highest(word):  # type: ignore[no-untyped-def]
    # The number of the highest bit that is set: one less than how many there are up to it.
    for width in (1, 2, 4, 8, 16, 32):
        word |= word >> np.uint64(width)
    return count_bits(word) - 1
