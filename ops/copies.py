"""Copies of rows and tables in kernels.

They compile in a fraction of the time that an assignment of arrays takes, which brings the code of broadcasting and of
its error messages with it.
"""

from __future__ import annotations

from typing import Any

import numpy.typing as npt
from numba import njit

Array = npt.NDArray[Any]


@njit(cache=True, nogil=True, error_model="numpy")
def copy_row(target: Array, source: Array | tuple[float, ...]) -> None:
    """Write the values (n,) of a row into another one, or those of a tuple of one type."""
    for i in range(len(source)):
        target[i] = source[i]


@njit(cache=True, nogil=True, error_model="numpy")
def copy_table(target: Array, source: Array) -> None:
    """Write the values (n, m) of a table into another one."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]
