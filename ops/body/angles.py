"""This module computes sines and cosines of arrays of angles in compiled loops that vectorise."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64

LARGEST = 1e6
"""The greatest angle in radians for which `sincos` is accurate; beyond it, the reduction by turns loses digits."""

# A quarter turn in three pieces. The first two have 33 bits, so that their products with a count of quarter turns below
# 2**20 are exact (Cody and Waite, "Software Manual for the Elementary Functions", 1980).
_QUARTERS = 2.0 / math.pi
_FIRST = float.fromhex("0x1.921fb544p+0")
_SECOND = float.fromhex("0x1.0b4611a6p-34")
_THIRD = float.fromhex("0x1.3198a2e037073p-69")

# Taylor's series. Within an eighth of a turn the first term that is left out is below 1e-18 of the sum.
_S1, _S2, _S3, _S4, _S5, _S6, _S7, _S8 = ((-1) ** k / math.factorial(2 * k + 1) for k in range(1, 9))
_C2, _C3, _C4, _C5, _C6, _C7, _C8 = ((-1) ** k / math.factorial(2 * k) for k in range(2, 9))


@njit(cache=True, nogil=True, _nrt=False)
def sincos(angles: F64, sines: F64, cosines: F64) -> None:
    """Compute sines and cosines of angles in radians into given arrays, with errors below 0.8 units of the last place.

    Angles are at most `LARGEST` from zero: see `sincos_far`. An infinity or a NaN gives NaN.
    """
    for t in range(angles.shape[0]):
        angle = angles[t]
        quarters = np.rint(angle * _QUARTERS)
        # The remainder of the angle in two parts: x, and the rounding error of x.
        near = angle - quarters * _FIRST
        second = quarters * _SECOND
        x = near - second
        rest = ((near - x) - second) - quarters * _THIRD
        whole = x + rest
        rest = (x - whole) + rest
        x = whole
        z = x * x
        series = _S2 + z * (_S3 + z * (_S4 + z * (_S5 + z * (_S6 + z * (_S7 + z * _S8)))))
        cube = z * x
        sine = x - ((z * (0.5 * rest - cube * series) - rest) - cube * _S1)
        series = z * (_C2 + z * (_C3 + z * (_C4 + z * (_C5 + z * (_C6 + z * (_C7 + z * _C8))))))
        half = 0.5 * z
        near_one = 1.0 - half
        cosine = near_one + (((1.0 - near_one) - half) + (z * series - x * rest))
        # Every quarter turn swaps the two and changes one sign.
        swapped = quarters * 0.5 != np.rint(quarters * 0.5)
        quadrant = quarters - 4.0 * np.floor(quarters * 0.25)
        upright = cosine if swapped else sine
        level = sine if swapped else cosine
        sines[t] = -upright if quadrant >= 2.0 else upright
        cosines[t] = -level if quadrant == 1.0 or quadrant == 2.0 else level


@njit(cache=True, nogil=True, _nrt=False)
def sincos_far(angles: F64, sines: F64, cosines: F64) -> None:
    """Compute sines and cosines of angles of any size, one by one, with the C library."""
    for t in range(angles.shape[0]):
        sines[t] = np.sin(angles[t])
        cosines[t] = np.cos(angles[t])
