"""These kernels compute order statistics by Hoare's selection.

They compile much faster than `np.sort`, `np.median` and `np.percentile`, and need no sorted copy.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64


@njit(cache=True, nogil=True, error_model="numpy")
def order_statistic(values: F64, rank: int) -> float:
    """Return the value of a rank; the values are reordered.

    Parameters
    ----------
    values : float64 array (n,)
        The values, which are reordered in place. NaN ranks above all numbers.
    rank : int
        The rank, from 0 for the smallest value to n − 1.

    Returns
    -------
    float
        The value at this index of a sorted copy.
    """
    low, high = 0, len(values) - 1
    place = 0
    while place <= high:
        if values[place] == values[place]:
            place += 1
        else:
            values[place], values[high] = values[high], values[place]
            high -= 1
    if rank > high:
        return np.nan
    while low < high:
        middle = values[(low + high) >> 1]
        i, j = low, high
        while i <= j:
            while values[i] < middle:
                i += 1
            while values[j] > middle:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if rank <= j:
            high = j
        elif rank >= i:
            low = i
        else:
            break
    return values[rank]


@njit(cache=True, nogil=True, error_model="numpy")
def median(values: F64) -> float:
    """Return the median of at least one value; the values are reordered."""
    count = len(values)
    lower = order_statistic(values, (count - 1) // 2)
    return lower if count % 2 else 0.5 * (lower + order_statistic(values, count // 2))


@njit(cache=True, nogil=True, error_model="numpy")
def percentile(values: F64, percent: float) -> float:
    """Return a percentile of at least one value, interpolated linearly; the values are reordered."""
    place = 1.0 + (len(values) - 1) * (percent / 100.0)
    rank = math.floor(place)
    share = place - rank
    lower = order_statistic(values, rank - 1)
    return lower * (1.0 - share) + order_statistic(values, rank) * share if share > 0.0 else lower
