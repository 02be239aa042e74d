"""These kernels copy rows and tables.

They compile much faster than an assignment of arrays, which also compiles broadcasting and its error messages.
"""

from __future__ import annotations

from numba import njit

from kinedex.ops.arrays import Array


@njit(cache=True, nogil=True, error_model="numpy")
def copy_row(target: Array, source: Array | tuple[float, ...]) -> None:
    """Copy the values (n,) of a row, or of a tuple of numbers of one type, into another row."""
    for i in range(len(source)):
        target[i] = source[i]


@njit(cache=True, nogil=True, error_model="numpy")
def copy_table(target: Array, source: Array) -> None:
    """Copy the values (n, m) of a table into another table."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]
