"""These kernels count and locate the bits that are set in a word."""

from __future__ import annotations

import numba as nb
import numpy as np

_1, _2, _4, _56 = np.uint64(1), np.uint64(2), np.uint64(4), np.uint64(56)
_ODD = np.uint64(0x5555_5555_5555_5555)
_PAIRS = np.uint64(0x3333_3333_3333_3333)
_NIBBLES = np.uint64(0x0F0F_0F0F_0F0F_0F0F)
_ONES = np.uint64(0x0101_0101_0101_0101)


@nb.njit(cache=True, nogil=True)
def count_bits(bits: np.uint64) -> np.int64:
    """Count the bits that are set, 0 to 64, in arithmetic that compilers recognise as one instruction."""
    bits = bits - ((bits >> _1) & _ODD)
    bits = (bits & _PAIRS) + ((bits >> _2) & _PAIRS)
    bits = (bits + (bits >> _4)) & _NIBBLES
    return np.int64((bits * _ONES) >> _56)


@nb.njit(cache=True, nogil=True)
def lowest_bit(bits: np.uint64) -> np.int64:
    """Return the position of the lowest bit that is set; `bits` must not be 0."""
    return count_bits((bits - _1) & ~bits)


@nb.njit(cache=True, nogil=True)
def highest_bit(bits: np.uint64) -> np.int64:
    """Return the position of the highest bit that is set; `bits` must not be 0."""
    return count_bits(filled_below(bits)) - 1


@nb.njit(cache=True, nogil=True)
def filled_below(bits: np.uint64) -> np.uint64:
    """Return a word in which all bits up to the highest one that is set in `bits` are set."""
    for width in (1, 2, 4, 8, 16, 32):
        bits |= bits >> np.uint64(width)
    return bits
