"""This module defines the recurrence of subsequence DTW with steps (1,1), (1,2), (2,1) (thesis, Section 5.2).

With c the local cost of column n in frame f, the cheapest path that ends there costs

    D(n, f) = min(D(n − 1, f − 1) + c, D(n − 1, f − 2) + c, D(n − 2, f − 1) + 2 c).

A (2,1) step counts the local cost twice, so that every complete path through a template of N columns has a total weight
of N. The kernels that use these functions keep one row of costs for each frame, with two additional cells before the
first column: D(n, f) has the index n + 2 in the row of frame f.
"""

from __future__ import annotations

import numba as nb
import numpy as np

from kinedex.ops.arrays import F64

COARSE_CAP = 255
"""The greatest 8-bit number, at which sums of coarse units saturate."""

_COARSE_CAP = np.uint8(COARSE_CAP)


@nb.njit(inline="always")
def path_cost(straight, slow, fast, cost):  # type: ignore[no-untyped-def]
    """Return the cost of the cheapest path to a cell, in the number type of the local cost (inlined kernel).

    Parameters
    ----------
    straight, slow, fast : number
        The costs of the cells that the steps (1,1), (1,2) and (2,1) come from.
    cost : number
        The local cost of the cell.
    """
    number = type(cost)
    single = number((straight if straight < slow else slow) + cost)
    double = number(fast + number(cost + cost))
    return double if double < single else single


@nb.njit(inline="always")
def coarse_path_cost(straight, slow, fast, cost):  # type: ignore[no-untyped-def]
    """Return `path_cost` for whole units in 8 bits, with additions that saturate at `COARSE_CAP` (inlined kernel).

    Saturating additions can be reordered: c + min(D(n − 1, f − 1), D(n − 1, f − 2), D(n − 2, f − 1) + c) has the same
    result and saves one operation. `path_cost` with saturating additions would take 1.3 times as long (`python -m
    benchmarks.recurrence`).
    """
    far = np.uint8(fast + cost)
    far = far if far >= cost else _COARSE_CAP
    near = straight if straight < slow else slow
    near = near if near < far else far
    total = np.uint8(near + cost)
    return total if total >= cost else _COARSE_CAP


@nb.njit(cache=True, nogil=True)
def step_back(sums: F64, frame: int, n: int, cost: float) -> tuple[int, int]:
    """Return the numbers of frames and columns that the last step of the cheapest path to a cell spans (kernel).

    Of equally cheap steps, the first in the order (1,1), (1,2), (2,1) is chosen.

    Parameters
    ----------
    sums : float64 array (F + 2, N + 2)
        The costs of paths; those of frame f are in row f + 2.
    frame, n : int
        The frame and the column of the cell.
    cost : float
        The local cost of the cell.
    """
    straight, slow = sums[frame + 1, n + 1] + cost, sums[frame, n + 1] + cost
    fast = sums[frame + 1, n] + (cost + cost)
    if fast < straight and fast < slow:
        return 1, 2
    return (2, 1) if slow < straight else (1, 1)
