"""This module packs, unpacks and holds words, which are bit vectors with one bit per feature for each frame.

It also defines how templates and keyframes apply to a take whose body lacks joints. A mask with the bits of a word
marks the features that are known in a take. An unknown feature is 0 in the words, but this carries no information. For
such a take, the entries of templates and keyframes for unknown features become wildcards; if too few other entries
remain, the template or query is not applied to the take. The kernels do not use masks: takes with the same mask are
searched together, by templates and queries that are restricted to the known features.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from kinedex.ops.arrays import I64 as I64
from kinedex.ops.arrays import U8, Bool
from kinedex.ops.arrays import U64 as U64
from kinedex.ops.errors import ParameterError

NO_WORD = np.uint64(0xFFFF_FFFF_FFFF_FFFF)
"""The word of an invalid frame, which belongs to no run, template or hit. All other words have at most 63 features and
therefore differ from this word. `cut` leaves it unchanged, and Parquet files store it as null.
"""

MAX_FEATURES = 63
"""Maximum number of features a word can have."""

ALL_KNOWN = np.uint64(0xFFFF_FFFF_FFFF_FFFF)
"""The mask of known features of a take whose body has all joints."""

MIN_KNOWN = 0.6
"""Minimum fraction of known fixed entries for which a template or query is applied to a take."""


@dataclass(frozen=True)
class TakeWords:
    """The words of T takes, concatenated.

    Parameters
    ----------
    take_ids : int64 array (T,)
        The ids of the takes, ascending.
    offsets : int64 array (T + 1,)
        Take i has the frames offsets[i] to offsets[i + 1] − 1.
    words : uint64 array (N,)
        The words of all frames: bit i − 1 is feature F_i; `NO_WORD` if the frame is invalid.
    known : uint64 array (T,), optional
        The mask of the known features of each take, with the bits of a word. The bits of unknown features are 0 in its
        words, without carrying information. None if all features are known in every take.

    Raises
    ------
    ParameterError
        If the offsets do not fit the takes or the words, or there is not one mask for each take.
    """

    take_ids: I64
    offsets: I64
    words: U64
    known: U64 | None = None

    def __post_init__(self) -> None:
        if len(self.offsets) != len(self.take_ids) + 1:
            raise ParameterError("offsets", "one longer than take_ids", len(self.offsets))
        if self.offsets[-1] != len(self.words):
            raise ParameterError("offsets", f"ending at the {len(self.words)} words", int(self.offsets[-1]))
        if self.known is not None and len(self.known) != len(self.take_ids):
            raise ParameterError("known", "one mask for each take", len(self.known))

    def __len__(self) -> int:
        return len(self.take_ids)

    def take(self, index: int) -> U64:
        """Return the words of the take at this position (not take_id), without a copy."""
        return self.words[self.offsets[index] : self.offsets[index + 1]]

    @property
    def frames(self) -> I64:
        """Return the number of frames of each take, int64 (T,)."""
        return np.diff(self.offsets)

    @property
    def masks(self) -> list[int]:
        """Return the different masks of known features, the largest first; only `ALL_KNOWN` if no take lacks any."""
        return [int(ALL_KNOWN)] if self.known is None else np.unique(self.known)[::-1].tolist()

    @property
    def best_known(self) -> U64:
        """Return the words of the takes with all features known, or of all takes if there are none."""
        return self.knowing(int(ALL_KNOWN))[1].words if int(ALL_KNOWN) in self.masks else self.words

    def knowing(self, mask: int) -> tuple[I64, TakeWords]:
        """Return the takes whose known features equal a mask, with words that no longer carry masks.

        Parameters
        ----------
        mask : int
            One of `masks`.

        Returns
        -------
        places : int64 array
            The positions of the takes.
        words : TakeWords
            The concatenated words of these takes; a copy, unless the result has all takes.
        """
        if self.known is None:
            return np.arange(len(self)), self
        positions = np.flatnonzero(self.known == np.uint64(mask))
        if len(positions) == len(self):
            return positions, replace(self, known=None)
        offsets = np.concatenate(([0], np.cumsum(self.frames[positions])))
        words = np.concatenate([np.empty(0, np.uint64), *map(self.take, positions.tolist())])
        return positions, TakeWords(self.take_ids[positions], offsets, words)


def cut(words: U64, first_feature: int, features: int) -> U64:
    """Extract the bits of one feature set from words, shifted down to bit 0.

    Parameters
    ----------
    words : uint64 array (N,)
        The words.
    first_feature : int
        The number of the set's lowest feature, from 1.
    features : int
        The number of features of the set, 1 to 63.

    Returns
    -------
    uint64 array (N,)
        The bits of the set in each word; `NO_WORD` is unchanged.

    Raises
    ------
    ParameterError
        If the set is not within 63 bits.
    """
    if not 1 <= first_feature <= MAX_FEATURES or not 1 <= features <= MAX_FEATURES + 1 - first_feature:
        raise ParameterError("feature set", f"within bits 1 to {MAX_FEATURES}", (first_feature, features))
    mask = np.uint64((1 << features) - 1)
    return np.where(words == NO_WORD, NO_WORD, (words >> np.uint64(first_feature - 1)) & mask)


def bits(words: U64, features: int) -> U8:
    """Unpack words to a feature matrix.

    Parameters
    ----------
    words : uint64 array (N,)
        The words.
    features : int
        The number of features f.

    Returns
    -------
    uint8 array (N, f)
        The bits as 0 and 1; column i − 1 is feature F_i.
    """
    shifts = np.arange(features, dtype=np.uint64)
    return ((words[:, None] >> shifts) & np.uint64(1)).astype(np.uint8)


def pack(matrix: Bool | U8) -> U64:
    """Pack a feature matrix to words; the inverse of `bits`.

    Parameters
    ----------
    matrix : bool or uint8 array (N, f)
        The bits as 0 and 1.

    Returns
    -------
    uint64 array (N,)
    """
    shifts = np.arange(matrix.shape[1], dtype=np.uint64)
    return (
        np.bitwise_or.reduce(matrix.astype(np.uint64) << shifts, axis=1)
        if matrix.shape[1]
        else np.zeros(len(matrix), np.uint64)
    )


def known_share(masks: Iterable[int], known: int) -> float:
    """Return the fraction of fixed entries whose features are known; 1 if no entry is fixed.

    Parameters
    ----------
    masks : iterable of int
        The fixed bits of each column or keyframe.
    known : int
        The mask of the known features.
    """
    fixed = [int(mask) for mask in masks]
    total = sum(mask.bit_count() for mask in fixed)
    return sum((mask & known).bit_count() for mask in fixed) / total if total else 1.0


def is_applied(masks: Iterable[int], known: int) -> bool:
    """Return whether the fraction of known fixed entries (`known_share`) is at least `MIN_KNOWN`."""
    return known_share(masks, known) >= MIN_KNOWN


def known_bits(known: int, features: int) -> Bool:
    """Return a mask of the known features among f features, bool (f,)."""
    return np.array([known >> bit & 1 for bit in range(features)], np.bool_)


def compacted(words: U64, known: int, features: int) -> U64:
    """Return words of the known features only, with their bits moved together in order.

    Parameters
    ----------
    words : uint64 array (L,)
        Complete words; `NO_WORD` is kept.
    known : int
        The mask of the known features.
    features : int
        The number of features of complete words.
    """
    result = np.zeros(len(words), np.uint64)
    for place, bit in enumerate(np.flatnonzero(known_bits(known, features)).tolist()):
        result |= ((words >> np.uint64(bit)) & np.uint64(1)) << np.uint64(place)
    return np.where(words == NO_WORD, NO_WORD, result)


def rearrange(words: U64, order: I64) -> U64:
    """Permute the bits of words.

    Parameters
    ----------
    words : uint64 array (N,)
        One word for each frame, or `NO_WORD` if the frame is invalid; bits from f on are 0.
    order : int64 array (f,)
        A permutation of 0 … f − 1: bit i of a result is bit order[i] of its word.

    Returns
    -------
    uint64 array (N,)
        The permuted words; `NO_WORD` is unchanged.

    Raises
    ------
    ParameterError
        If the order is not a permutation.
    """
    if len(order) > MAX_FEATURES or not np.array_equal(np.sort(order), np.arange(len(order))):
        raise ParameterError("order", f"a permutation of at most {MAX_FEATURES} bits", order.tolist())
    moved = np.zeros_like(words)
    # Bits that move by the same distance are moved together, as there are only a few different distances.
    shifts = np.asarray(order) - np.arange(len(order))
    for shift in np.unique(shifts).tolist():
        mask = np.uint64(sum(1 << i for i in np.flatnonzero(shifts == shift).tolist()))
        moved |= (words >> np.uint64(shift) if shift >= 0 else words << np.uint64(-shift)) & mask
    return np.where(words == NO_WORD, NO_WORD, moved)
