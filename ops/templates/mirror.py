"""This module exchanges left and right in words and template columns by permuting their features."""

from __future__ import annotations

import numpy as np

from kinedex.ops.arrays import I64
from kinedex.ops.errors import ParameterError
from kinedex.ops.words import MOST_FEATURES, NO_WORD, U64


def rearrange(words: U64, order: I64) -> U64:
    """Permute the bits of words.

    Parameters
    ----------
    words : uint64 array (N,)
        One word a frame; bits beyond the order's length are 0; `NO_WORD` where the frame is invalid.
    order : int64 array (f,)
        A permutation of 0 … f − 1: bit i of a result is bit order[i] of its word.

    Returns
    -------
    uint64 array (N,)
        `NO_WORD` is unchanged.

    Raises
    ------
    ParameterError
        If the order is no permutation.
    """
    if len(order) > MOST_FEATURES or not np.array_equal(np.sort(order), np.arange(len(order))):
        raise ParameterError("order", f"a permutation of at most {MOST_FEATURES} bits", order.tolist())
    moved = np.zeros_like(words)
    # Bits that move by the same distance are moved together, as there are only a few different distances.
    shifts = np.asarray(order) - np.arange(len(order))
    for shift in np.unique(shifts).tolist():
        mask = np.uint64(sum(1 << i for i in np.flatnonzero(shifts == shift).tolist()))
        moved |= (words >> np.uint64(shift) if shift >= 0 else words << np.uint64(-shift)) & mask
    return np.where(words == NO_WORD, NO_WORD, moved)
