"""This module has a zero-phase Butterworth filter of order 2, which runs forwards and backwards.

Its results are those of scipy's `butter` and `sosfiltfilt`; importing these takes longer than filtering a take.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64
from kinedex.ops.errors import ParameterError

MIN_PADDING = 9
"""Default number of values by which both ends are extended, by odd (point) reflection."""


def lowpass(values: F64, rate_hz: float, cutoff_hz: float, padding: int = MIN_PADDING) -> F64:
    """Return values filtered by a zero-phase low-pass.

    Parameters
    ----------
    values : float64 array (T,) or (T, K)
        Evenly spaced values, all of them known.
    rate_hz : float
        Values per second.
    cutoff_hz : float
        The frequency in Hz at which both passes together halve the amplitude; it must be below half of the rate.
    padding : int, optional
        Number of values by which both ends are extended; less than T.

    Returns
    -------
    float64 array (T,) or (T, K)

    Raises
    ------
    ParameterError
        The frequency is not between 0 and half of the rate, or there are not more values than padding.
    """
    if not 0.0 < cutoff_hz < 0.5 * rate_hz:
        raise ParameterError("cutoff_hz", f"between 0 and {0.5 * rate_hz:g}, half of the rate", cutoff_hz)
    if len(values) <= padding:
        raise ParameterError("values", f"more than {padding}", len(values))
    columns = np.asarray(values, np.float64).reshape(len(values), -1)
    before = 2.0 * columns[:1] - columns[padding:0:-1]
    after = 2.0 * columns[-1:] - columns[-2 : -padding - 2 : -1]
    extended = np.concatenate([before, columns, after])
    _forth_and_back(extended, math.tan(math.pi * cutoff_hz / rate_hz))
    return extended[padding : len(extended) - padding].reshape(values.shape)


@njit(cache=True, nogil=True, error_model="numpy")
def _forth_and_back(values: F64, warped: float) -> None:
    """Filter each column in place, forwards and then backwards, as if its first value had always been there before."""
    square = warped * warped
    scale = 1.0 / (1.0 + math.sqrt(2.0) * warped + square)
    b0, b1, b2 = square * scale, 2.0 * square * scale, square * scale
    a1, a2 = 2.0 * (square - 1.0) * scale, (1.0 - math.sqrt(2.0) * warped + square) * scale
    still = (b1 - a1 * b0 + b2 - a2 * b0) / (1.0 + a1 + a2)
    count = len(values)
    for column in range(values.shape[1]):
        for way in range(2):
            start = values[0, column] if way == 0 else values[count - 1, column]
            first, second = still * start, ((1.0 + a1) * still - (b1 - a1 * b0)) * start
            for k in range(count):
                at = k if way == 0 else count - 1 - k
                value = values[at, column]
                filtered = b0 * value + first
                first = b1 * value - a1 * filtered + second
                second = b2 * value - a2 * filtered
                values[at, column] = filtered
