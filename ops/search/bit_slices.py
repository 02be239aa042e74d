"""This module makes bit slices, which hold the words of an archive as one bitmap per feature, 64 frames in a uint64.

Each take begins in a new block (64 frames, one uint64) and ends with at least one spare frame, so that segments of
different takes never touch. A coarse copy has one bit for every 8 frames. `ops.search.bit_slice_search` searches both.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.errors import ParameterError
from kinedex.ops.words import I64, MAX_FEATURES, NO_WORD, U64

I32 = npt.NDArray[np.int32]

BLOCK = 64
"""The number of frames in a block."""
SHIFT = 6
"""The shift that converts a frame number to a block number."""
GRANULE = 8
"""The number of frames in a granule, which has one bit of the coarse copy. It was chosen by measurement: with 16, the
copy is half as large, but twice as many blocks have to be searched.
"""
GRANULES = BLOCK // GRANULE
"""The number of granules in a block, which form a byte."""

_VALID = MAX_FEATURES
_VALID_BIT = np.uint64(1 << _VALID)
NO_BITS, ALL_BITS = np.uint64(0), np.uint64(2**64 - 1)
_LOW_HALF = np.uint64(0xFFFF_FFFF)
_LOWEST_OF_EACH = np.uint64(sum(1 << GRANULE * i for i in range(GRANULES)))
_GATHER = np.uint64(sum(1 << (BLOCK - GRANULES) - (GRANULE - 1) * i for i in range(GRANULES)) % 2**64)


@dataclass(frozen=True)
class BitSlices:
    """The words of T takes, sliced by feature: flat, read-only arrays that may be pages of a file shared by processes.

    Parameters
    ----------
    bits : uint64 array (B * (f + 1),)
        The blocks one after the other, each with f + 1 words: bit j of word n is feature F_(n + 1) in frame j of the
        block. The last word of a block marks the valid frames; in other frames all features are off. In this order,
        data that is read together is adjacent.
    coarse : uint64 array ((2 f + 1) * ceil(B / 8),)
        Rows of bitmaps over granules of 8 frames (`GRANULE`), one after the other; block b has the bits 8 b to 8 b + 7
        of a row. Row n marks the granules in which F_(n + 1) is on in some frame, row f + n those in which it is off in
        some valid frame, and the last row those with a valid frame.
    first : int64 array (T + 1,)
        Take t has the blocks first[t] to first[t + 1] - 1.
    frames : int64 array (T,)
        The length of each take.
    left : int32 array (B,)
        The number of blocks of its take that follow each block.
    features : int
        The number of features f.
    """

    bits: U64
    coarse: U64
    first: I64
    frames: I64
    left: I32
    features: int

    def __post_init__(self) -> None:
        blocks = len(self.left)
        if self.bits.shape != (blocks * (self.features + 1),) or self.first[-1] != blocks:
            raise ParameterError("bits", f"{self.features + 1} for each of the blocks", self.bits.shape)
        if self.coarse.shape != ((2 * self.features + 1) * coarse_words(blocks),):
            raise ParameterError("coarse", f"{2 * self.features + 1} rows over all blocks", self.coarse.shape)
        # arrays in memory are made read-only too, as kernels would be compiled a second time for writable ones
        for array in self.arrays.values():
            array.flags.writeable = False

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """Return the arrays by name, such that `BitSlices(**arrays, features=f)` is equal."""
        return {name: getattr(self, name) for name in ("bits", "coarse", "first", "frames", "left")}

    @property
    def bytes(self) -> int:
        """Return the size of the arrays in bytes."""
        return sum(array.nbytes for array in self.arrays.values())

    @cached_property
    def ends(self) -> U64:
        """Return the last blocks of all takes as pairs of words, uint64 (2 * ceil(B / 64),).

        The first number of a pair is a word of the bitmap that marks these blocks, and the second is the number of
        takes that end before this word. A search uses this array instead of `first` and `left` to look up the take of a
        block and the number of blocks that follow in it, because this array fits into a processor's cache.
        """
        marked = np.zeros(-(-len(self.left) // BLOCK) * BLOCK, np.bool_)
        marked[self.first[1:] - 1] = True
        words = np.packbits(marked, bitorder="little").view("<u8")
        takes = np.searchsorted(self.first[1:], np.arange(len(words)) * BLOCK, side="right")
        ends = np.stack([words, takes.astype(np.uint64)], axis=1, dtype=np.uint64).ravel()
        ends.flags.writeable = False
        return ends

    @property
    def rows(self) -> U64:
        """Return a bitmap over all blocks for each feature, and one of the valid frames, uint64 (f + 1, B)."""
        return self.bits.reshape(-1, self.features + 1).T

    @property
    def granules(self) -> npt.NDArray[np.uint8]:
        """Return the coarse copy by blocks, uint8 (2 f + 1, B or more), with zeros after the last block."""
        little = self.coarse.reshape(2 * self.features + 1, -1).astype("<u8", copy=False)
        return little.view(np.uint8)


def coarse_words(blocks: int) -> int:
    """Return the number of uint64 in one row of the coarse copy."""
    return -(-blocks * GRANULES // BLOCK)


def slice_words(words: U64, offsets: I64, features: int) -> BitSlices:
    """Convert the words of takes to bit slices.

    Parameters
    ----------
    words : uint64 array (N,)
        The concatenated whole words of T takes; `NO_WORD` for an invalid frame.
    offsets : int64 array (T + 1,)
        Take t has the words offsets[t] to offsets[t + 1] - 1.
    features : int
        The number of features f, 1 to 63.

    Returns
    -------
    BitSlices

    Raises
    ------
    ParameterError
        If the offsets do not fit the words, or the number of features is out of range.
    """
    if not 1 <= features <= MAX_FEATURES:
        raise ParameterError("features", f"from 1 to {MAX_FEATURES}", features)
    frames = np.diff(offsets)
    if len(offsets) == 0 or offsets[0] != 0 or offsets[-1] != len(words) or (frames < 0).any():
        raise ParameterError("offsets", f"ascending from 0 to the {len(words)} words", offsets[[0, -1]].tolist())
    first = np.zeros(len(offsets), np.int64)
    np.cumsum(frames // BLOCK + 1, out=first[1:])
    blocks = int(first[-1])
    bits = np.empty(blocks * (features + 1), np.uint64)
    coarse = np.zeros((2 * features + 1, coarse_words(blocks)), np.uint64)
    _slice(
        np.ascontiguousarray(words, np.uint64), np.ascontiguousarray(offsets, np.int64), first, features, bits, coarse
    )
    left = np.repeat(first[1:], np.diff(first)) - 1 - np.arange(blocks)
    return BitSlices(bits, coarse.ravel(), first, frames.astype(np.int64), left.astype(np.int32), features)


def unsliced_words(slices: BitSlices, takes: I64, starts: I64, words: U64, ranges: I64 | None = None) -> None:
    """Write the words of the given takes of bit slices into an array; the inverse of `slice_words`.

    Parameters
    ----------
    slices : BitSlices
        The slices.
    takes : int64 array (S,)
        The takes, as positions among those of the slices.
    starts : int64 array (S,)
        The index of the first word of each take in the array.
    words : uint64 array (N,)
        The array; `NO_WORD` is written for an invalid frame, and other elements are left unchanged.
    ranges : int64 array (R, 2), optional
        Half-open ranges of indices of the array, ascending and disjoint, in which words are needed; words outside the
        ranges may be left unchanged. None to write all words.

    Raises
    ------
    ParameterError
        If a take does not exist, or does not fit into the array at its index.
    """
    if len(takes) and not 0 <= takes.min() <= takes.max() < len(slices):
        raise ParameterError("takes", f"from 0 to {len(slices) - 1}", takes[:4].tolist())
    if len(starts) != len(takes) or (len(takes) and not (starts.min() >= 0)):
        raise ParameterError("starts", f"one place from 0 on for each of {len(takes)} takes", starts[:4].tolist())
    stops = starts + slices.frames[takes]
    if len(takes) and int(stops.max()) > len(words):
        raise ParameterError("words", f"long enough for {len(takes)} takes", len(words))
    wanted = np.stack([starts, stops], axis=1) if ranges is None else np.ascontiguousarray(ranges, np.int64)
    # outside the kernel: numba's version of searchsorted would load SciPy with the kernel
    nearest = np.searchsorted(wanted[:, 1], starts, side="right")
    _unslice(slices.bits, slices.first, slices.frames, slices.features, takes, starts, wanted, nearest, words)


@njit(cache=True, nogil=True)
def _unslice(bits, first, frames, features, takes, starts, ranges, nearest, words):  # type: ignore[no-untyped-def]
    square = np.zeros(BLOCK, np.uint64)
    for place in range(len(takes)):
        take, begin = takes[place], starts[place]
        end = begin + frames[take]
        low = nearest[place]
        done = 0  # blocks before this one have been written
        while low < len(ranges) and ranges[low, 0] < end:
            left, right = max(ranges[low, 0], begin) - begin, min(ranges[low, 1], end) - begin
            low += 1
            if left >= right:
                continue
            for block in range(max(done, left // BLOCK), (right - 1) // BLOCK + 1):
                _write_block(bits, features, first[take] + block, min(BLOCK, frames[take] - block * BLOCK), square,
                             words[begin + block * BLOCK :])  # fmt: skip
                done = block + 1


@njit(cache=True, nogil=True)
def _write_block(bits, features, block, count, square, words):  # type: ignore[no-untyped-def]
    at = block * (features + 1)
    valid = bits[at + features]
    square[features:] = 0
    for row in range(features):
        square[row] = bits[at + row]
    transpose(square)
    for j in range(count):
        words[j] = square[j]
    if valid == ALL_BITS:
        return
    for j in range(count):
        if not valid >> np.uint64(j) & np.uint64(1):
            words[j] = NO_WORD


@njit(cache=True, nogil=True)
def _slice(words, offsets, first, features, bits, coarse):  # type: ignore[no-untyped-def]
    square = np.empty(BLOCK, np.uint64)
    granules = np.zeros(2 * features + 1, np.uint64)
    for take in range(len(first) - 1):
        for block in range(first[take], first[take + 1]):
            start = offsets[take] + (block - first[take]) * BLOCK
            for j in range(BLOCK):
                square[j] = 0
                if start + j < offsets[take + 1] and words[start + j] != NO_WORD:
                    square[j] = words[start + j] | _VALID_BIT
            transpose(square)
            valid, shift = square[_VALID], np.uint64(block * GRANULES % BLOCK)
            square[features] = valid
            for feature in range(features):
                granules[feature] |= _coarsened(square[feature]) << shift
            for feature in range(features):
                granules[features + feature] |= _coarsened(valid & ~square[feature]) << shift
            granules[2 * features] |= _coarsened(valid) << shift
            to = block * (features + 1)
            for row in range(features + 1):
                bits[to + row] = square[row]
            if (block + 1) * GRANULES % BLOCK == 0 or block + 1 == first[-1]:
                for row in range(2 * features + 1):
                    coarse[row, block * GRANULES // BLOCK] = granules[row]
                    granules[row] = 0


@njit(cache=True, nogil=True)
def _coarsened(bits):  # type: ignore[no-untyped-def]
    """Return one bit for each granule that has any bit set.

    The bits of a granule are folded onto its lowest bit. The lowest bits of all granules are then gathered in the top
    byte by a multiplication without carries.
    """
    width = GRANULE // 2
    while width:
        bits |= bits >> np.uint64(width)
        width //= 2
    return ((bits & _LOWEST_OF_EACH) * _GATHER) >> np.uint64(BLOCK - GRANULES)


@njit(cache=True, nogil=True)
def transpose(square):  # type: ignore[no-untyped-def]
    """Exchange bit j of row i with bit i of row j, by swapping quarters of ever smaller squares."""
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
