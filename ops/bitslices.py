"""Bit slices: the words of an archive as one bitmap per feature, and keyframe search on them, 64 frames at a time.

A keyframe's list, as a bitmap over frames, is the AND of the slices of its features (their complement where it wants
one off). The frames from which the rest of a query can be completed are the AND of that with the next keyframe's,
widened by the gap; and widening takes a few shifts. No list is merged or sorted, and wildcards cost nothing.

Each take begins in a block of its own (64 frames, one uint64) and ends with at least one frame to spare, so that
nothing of two takes ever touches. Takes are searched in groups: one in which a keyframe does not occur at all, the
rarest being looked for first, is left at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from numba import njit

from ops.errors import ParameterError
from ops.keyframes import Segments, checked_gaps
from ops.words import I64, MOST_FEATURES, NO_WORD, U64

I32 = npt.NDArray[np.int32]

BLOCK = 64
GROUP_BLOCKS = 64
"""About how many blocks of whole takes are searched together. Chosen by measurement: with 16 the loops are too short,
with 512 too few groups can be left early."""

NEAR = 2**20
"""Words of slices that stay in a processor's cache, or so; more are fetched group by group, in order."""

_VALID = MOST_FEATURES
_VALID_BIT = np.uint64(1 << _VALID)
_NONE, _ALL = np.uint64(0), np.uint64(2**64 - 1)
_LOW_HALF = np.uint64(0xFFFF_FFFF)


@dataclass(frozen=True)
class BitSlices:
    """The words of T takes, sliced by feature.

    bits: uint64 (B · (f + 1),), group after group; a group of b blocks has f + 1 rows of b: bit j of a block of row n
    is feature F_(n + 1) in one frame, and the last row says which frames are valid (no feature is on in the others).
    What is searched together lies together. groups: int64 (G + 1,), group g has the takes groups[g] .. groups[g + 1].
    first: int64 (T + 1,), take t has the blocks first[t] .. first[t + 1]. frames: int64 (T,), the length of each take.
    left: int32 (B,), how many blocks of its take follow a block. features: f.
    """

    bits: U64
    groups: I64
    first: I64
    frames: I64
    left: I32
    features: int

    def __post_init__(self) -> None:
        if self.bits.shape != (len(self.left) * (self.features + 1),) or self.first[-1] != len(self.left):
            raise ParameterError("bits", f"{self.features + 1} for each of the blocks", self.bits.shape)

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def bytes(self) -> int:
        """The memory that the arrays take."""
        arrays = (self.bits, self.groups, self.first, self.frames, self.left, self.onward)
        return sum(array.nbytes for array in arrays)

    @property
    def rows(self) -> U64:
        """uint64 (f + 1, B), a copy with the rows of all groups joined."""
        edges = self.first[self.groups]
        pieces = [
            self.bits[start * (self.features + 1) : stop * (self.features + 1)].reshape(self.features + 1, stop - start)
            for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
        ]
        return np.concatenate([np.zeros((self.features + 1, 0), np.uint64), *pieces], axis=1)

    @cached_property
    def onward(self) -> U64:
        """uint64 (B,), all bits of a block that is not the last of its take."""
        return np.where(self.left > 0, _ALL, _NONE)

    @cached_property
    def often(self) -> I64:
        """int64 (f + 1,), in how many frames each feature is on; the last: how many frames are valid."""
        return _count_rows(self.bits, self.first[self.groups], self.features + 1)


def slice_words(words: U64, offsets: I64, features: int) -> BitSlices:
    """Slice the words of takes by feature.

    Parameters
    ----------
    words: uint64 (N,), whole words of T takes, one take after the other; `NO_WORD` for an invalid frame.
    offsets: int64 (T + 1,), take t has the words offsets[t] .. offsets[t + 1].
    features: number of features f, 1 to 63.

    Raises
    ------
    ParameterError: offsets that do not fit the words, or a number of features out of range.
    """
    if not 1 <= features <= MOST_FEATURES:
        raise ParameterError("features", f"from 1 to {MOST_FEATURES}", features)
    frames = np.diff(offsets)
    if len(offsets) == 0 or offsets[0] != 0 or offsets[-1] != len(words) or (frames < 0).any():
        raise ParameterError("offsets", f"ascending from 0 to the {len(words)} words", offsets[[0, -1]].tolist())
    first = np.zeros(len(offsets), np.int64)
    np.cumsum(frames // BLOCK + 1, out=first[1:])
    groups = _groups(first)
    bits = np.empty(int(first[-1]) * (features + 1), np.uint64)
    _slice(
        np.ascontiguousarray(words, np.uint64), np.ascontiguousarray(offsets, np.int64), first, groups, features, bits
    )
    left = np.repeat(first[1:], np.diff(first)) - 1 - np.arange(first[-1])
    return BitSlices(bits, groups, first, frames.astype(np.int64), left.astype(np.int32), features)


def _groups(first: I64) -> I64:
    """Where each group begins: takes of `GROUP_BLOCKS` blocks or so."""
    takes = len(first) - 1
    ends = np.arange(GROUP_BLOCKS, first[-1] + GROUP_BLOCKS, GROUP_BLOCKS)
    return np.unique(np.concatenate([[0], np.searchsorted(first, ends), [takes]])).clip(max=takes)


def slice_runs(takes: I64, starts: I64, stops: I64, words: U64, frames: I64, features: int) -> BitSlices:
    """Slice takes that are given by the word runs of all feature sets.

    Parameters
    ----------
    takes: int64 (R,), the position of each run's take. starts, stops: int64 (R,), frames of the take.
    words: uint64 (R,), bits of whole words: those of one feature set, shifted up to its place.
    frames: int64 (T,), the length of each take; a frame in no run is invalid. features: number of features, 1 to 63.

    Raises
    ------
    ParameterError: a run beyond its take, or a number of features out of range.
    """
    if len(takes) and not (
        takes.min() >= 0
        and takes.max() < len(frames)
        and starts.min() >= 0
        and (starts < stops).all()
        and (stops <= frames[takes]).all()
    ):
        raise ParameterError("runs", "within their takes, none of them empty", "others")
    offsets = np.zeros(len(frames) + 1, np.int64)
    np.cumsum(frames, out=offsets[1:])
    laid = np.full(int(offsets[-1]), NO_WORD)
    _lay(laid, offsets[takes] + starts, offsets[takes] + stops, words)
    return slice_words(laid, offsets, features)


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
    `ops.keyframes.search`. O(K · frames / 64), less what is left early; no recursion.

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
def _lay(laid, starts, stops, words):  # type: ignore[no-untyped-def]
    for run in range(len(starts)):
        for frame in range(starts[run], stops[run]):
            laid[frame] = words[run] if laid[frame] == NO_WORD else laid[frame] | words[run]


@njit(cache=True, nogil=True)
def _slice(words, offsets, first, groups, features, bits):  # type: ignore[no-untyped-def]
    square = np.empty(BLOCK, np.uint64)
    for group in range(len(groups) - 1):
        base = first[groups[group]]
        size = first[groups[group + 1]] - base
        for take in range(groups[group], groups[group + 1]):
            for block in range(first[take], first[take + 1]):
                start = offsets[take] + (block - first[take]) * BLOCK
                for j in range(BLOCK):
                    square[j] = 0
                    if start + j < offsets[take + 1] and words[start + j] != NO_WORD:
                        square[j] = words[start + j] | _VALID_BIT
                _transpose(square)
                to = base * (features + 1) + block - base
                for feature in range(features):
                    bits[to + feature * size] = square[feature]
                bits[to + features * size] = square[_VALID]


@njit(cache=True, nogil=True)
def _count_rows(bits, edges, rows):  # type: ignore[no-untyped-def]
    counts = np.zeros(rows, np.int64)
    for group in range(len(edges) - 1):
        size = edges[group + 1] - edges[group]
        for row in range(rows):
            start = edges[group] * rows + row * size
            for i in range(start, start + size):
                counts[row] += _count(bits[i])
    return counts


@njit(cache=True, nogil=True)
def _transpose(square):  # type: ignore[no-untyped-def]
    # Bit j of row i changes places with bit i of row j, by swapping quarters of ever smaller squares.
    width = 32
    mask = _LOW_HALF
    while width:
        shift = np.uint64(width)
        i = 0
        while i < BLOCK:
            swapped = ((square[i] >> shift) ^ square[i + width]) & mask
            square[i] ^= swapped << shift
            square[i + width] ^= swapped
            i = (i + width + 1) & ~width
        width >>= 1
        mask ^= mask << np.uint64(width)


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
    some = _NONE
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
                rows[i], flips[i], shares[i] = feature, _NONE if on else _ALL, share
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
    any_left = _NONE
    for i in range(count):
        found = kept[here + i] & widened[i]
        kept[here + i] = found
        any_left |= found
    return any_left != _NONE


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
    if rest == _NONE:
        for i in range(count - blocks):
            moved[i] = bitmap[i + blocks] if left[start + i] >= at_least else _NONE
    else:
        end = count - blocks - one
        for i in range(end):
            near = bitmap[i + blocks] >> rest if left[start + i] >= at_least else _NONE
            moved[i] = near | (bitmap[i + blocks + one] << upper if left[start + i] > at_least else _NONE)
        moved[end] = bitmap[end + blocks] >> rest if left[start + end] >= at_least else _NONE
    for i in range(count - blocks, count):
        moved[i] = _NONE


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
    return _count((word - np.uint64(1)) & ~word)


@njit(cache=True, nogil=True)
def _highest(word):  # type: ignore[no-untyped-def]
    # The number of the highest bit that is set: one less than how many there are up to it.
    for width in (1, 2, 4, 8, 16, 32):
        word |= word >> np.uint64(width)
    return _count(word) - 1


@njit(cache=True, nogil=True)
def _count(word):  # type: ignore[no-untyped-def]
    # How many bits are set, in sums of ever wider fields; the compiler knows this and has one instruction for it.
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555_5555_5555_5555))
    word = (word & np.uint64(0x3333_3333_3333_3333)) + ((word >> np.uint64(2)) & np.uint64(0x3333_3333_3333_3333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F_0F0F_0F0F_0F0F)
    word += word >> np.uint64(8)
    word += word >> np.uint64(16)
    word += word >> np.uint64(32)
    return np.int64(word & np.uint64(0x7F))
