"""Classical dynamic time warping of two weighted sequences, with the path."""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
import numpy.typing as npt

from ops.errors import ParameterError

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

_DIAGONAL, _FIRST, _SECOND = np.uint8(0), np.uint8(1), np.uint8(2)


@dataclass(frozen=True)
class Alignment:
    """The cheapest warping path between two sequences.

    cost: sum of the weighted local costs along the path.
    path: int64 (P, 2), columns of the first and the second sequence, from (0, 0) to the last columns.
    """

    cost: float
    path: I64


def align(local_cost: F64, first_weights: F64, second_weights: F64) -> Alignment:
    """Align two sequences by classical DTW with steps (1,1), (1,0), (0,1).

    A cell (k, l) of the path costs `local_cost[k, l]` times the mean of the two column weights. Among equally
    cheap paths the one is taken that, read from its end, prefers (1,1), then (1,0) (the first sequence
    advances), then (0,1).

    Parameters
    ----------
    local_cost: float64 (K, L), finite and not negative.
    first_weights, second_weights: float64 (K,) and (L,), positive.

    Returns
    -------
    Alignment; its path has between max(K, L) and K + L − 1 cells.

    Raises
    ------
    ParameterError: if a sequence is empty, the shapes disagree, or a cost is negative or not finite.
    """
    if local_cost.ndim != 2 or 0 in local_cost.shape:
        raise ParameterError("local_cost", "a matrix with at least one row and column", local_cost.shape)
    if (len(first_weights), len(second_weights)) != local_cost.shape:
        got = (len(first_weights), len(second_weights))
        raise ParameterError("weights", f"as many as the {local_cost.shape} columns", got)
    if not np.isfinite(local_cost).all() or local_cost.min() < 0:
        raise ParameterError("local_cost", "finite and not negative", float(local_cost.min()))
    total, steps = accumulate(
        np.ascontiguousarray(local_cost, np.float64),
        np.ascontiguousarray(first_weights, np.float64),
        np.ascontiguousarray(second_weights, np.float64),
    )
    return Alignment(float(total), trace_back(steps))


@nb.njit(cache=True, nogil=True)
def accumulate(local_cost: F64, first_weights: F64, second_weights: F64) -> tuple[float, npt.NDArray[np.uint8]]:
    """Return the cost of the best path and, per cell, the step that enters it (kernel of `align`)."""
    rows, columns = local_cost.shape
    steps = np.empty((rows, columns), np.uint8)
    above = np.full(columns, np.inf)
    here = np.empty(columns)
    for k in range(rows):
        for column in range(columns):
            best = np.inf
            step = _DIAGONAL
            if k == 0 and column == 0:
                best = 0.0
            if k > 0 and column > 0:
                best = above[column - 1]
            if k > 0 and above[column] < best:
                best = above[column]
                step = _FIRST
            if column > 0 and here[column - 1] < best:
                best = here[column - 1]
                step = _SECOND
            weight = 0.5 * (first_weights[k] + second_weights[column])
            here[column] = best + local_cost[k, column] * weight
            steps[k, column] = step
        above, here = here, above
    return above[columns - 1], steps


@nb.njit(cache=True, nogil=True)
def trace_back(steps: npt.NDArray[np.uint8]) -> I64:
    """Return the path that the steps of `accumulate` describe, from its start to its end."""
    rows, columns = steps.shape
    path = np.empty((rows + columns - 1, 2), np.int64)
    position = rows + columns - 1
    k, column = rows - 1, columns - 1
    while True:
        position -= 1
        path[position, 0] = k
        path[position, 1] = column
        if k == 0 and column == 0:
            break
        step = steps[k, column]
        if step != _SECOND:
            k -= 1
        if step != _FIRST:
            column -= 1
    return path[position:]
