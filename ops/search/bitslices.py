"""Bit slices: the words of an archive as one bitmap per feature, 64 frames to a word of memory.

Each take begins in a block of its own (64 frames, one uint64) and ends with at least one frame to spare, so that
nothing of two takes ever touches. `ops.search.slicesearch` searches them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from ops.bits import count_bits
from ops.errors import ParameterError
from ops.words import I64, MOST_FEATURES, NO_WORD, U64

I32 = npt.NDArray[np.int32]

BLOCK = 64
GROUP_BLOCKS = 64
"""About how many blocks of whole takes are searched together. Chosen by measurement: with 16 the loops are too short,
with 512 too few groups can be left early."""

_VALID = MOST_FEATURES
_VALID_BIT = np.uint64(1 << _VALID)
NO_BITS, ALL_BITS = np.uint64(0), np.uint64(2**64 - 1)
_LOW_HALF = np.uint64(0xFFFF_FFFF)


@dataclass(frozen=True)
class BitSlices:
    """The words of T takes, sliced by feature.

    bits: uint64 (B · (f + 1),), group after group; a group of b blocks has f + 1 rows of b: bit j of a block of row n
    is feature F_(n + 1) in one frame, and the last row says which frames are valid (no feature is on in the others).
    What is searched together lies together. groups: int64 (G + 1,), group g has the takes groups[g] .. groups[g + 1].
    first: int64 (T + 1,), take t has the blocks first[t] .. first[t + 1]. frames: int64 (T,), the length of each take.
    left: int32 (B,), how many blocks of its take follow a block. onward: uint64 (B,), all bits of a block that is not
    the last of its take. often: int64 (f + 1,), in how many frames each feature is on; the last: how many are valid.
    features: f.

    Nobody writes to the arrays: they may be a file's pages, which all processes of a machine share.
    """

    bits: U64
    groups: I64
    first: I64
    frames: I64
    left: I32
    onward: U64
    often: I64
    features: int

    def __post_init__(self) -> None:
        if self.bits.shape != (len(self.left) * (self.features + 1),) or self.first[-1] != len(self.left):
            raise ParameterError("bits", f"{self.features + 1} for each of the blocks", self.bits.shape)
        # also those in memory: kernels would be compiled once more for arrays that can be written to
        for array in self._arrays:
            array.flags.writeable = False

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def bytes(self) -> int:
        """The memory that the arrays take."""
        return sum(array.nbytes for array in self._arrays)

    @property
    def _arrays(self) -> tuple[U64 | I64 | I32, ...]:
        return self.bits, self.groups, self.first, self.frames, self.left, self.onward, self.often

    @property
    def rows(self) -> U64:
        """uint64 (f + 1, B), a copy with the rows of all groups joined."""
        edges = self.first[self.groups]
        pieces = [
            self.bits[start * (self.features + 1) : stop * (self.features + 1)].reshape(self.features + 1, stop - start)
            for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
        ]
        return np.concatenate([np.zeros((self.features + 1, 0), np.uint64), *pieces], axis=1)


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
    left = (np.repeat(first[1:], np.diff(first)) - 1 - np.arange(first[-1])).astype(np.int32)
    onward = np.where(left > 0, ALL_BITS, NO_BITS)
    often = _count_rows(bits, first[groups], features + 1)
    return BitSlices(bits, groups, first, frames.astype(np.int64), left, onward, often, features)


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
                counts[row] += count_bits(bits[i])
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
