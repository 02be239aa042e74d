"""Classical dynamic time warping of two weighted sequences, with the path; read from either of the two."""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import ParameterError

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

U8 = npt.NDArray[np.uint8]

DIAGONAL, FIRST, SECOND, EITHER = np.uint8(0), np.uint8(1), np.uint8(2), np.uint8(3)
"""The step that enters a cell: both sequences advance, only the first, only the second; or the last two are equally
cheap, and then the one is taken in which the sequence advances from whose side the path is read."""


@dataclass(frozen=True)
class Alignment:
    """The cheapest warping path between two sequences.

    Parameters
    ----------
    cost : float
        The sum of the weighted local costs along the path.
    path : int64 array (P, 2)
        Columns of the first and the second sequence, from (0, 0) to the last columns.
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
    local_cost : float64 array (K, L)
        Finite and not negative.
    first_weights : float64 array (K,)
        Positive.
    second_weights : float64 array (L,)
        Positive.

    Returns
    -------
    Alignment
        Its path has between max(K, L) and K + L − 1 cells.

    Raises
    ------
    ParameterError
        If a sequence is empty, the shapes disagree, or a cost is negative or not finite.
    """
    if local_cost.ndim != 2 or 0 in local_cost.shape:
        raise ParameterError("local_cost", "a matrix with at least one row and column", local_cost.shape)
    if (len(first_weights), len(second_weights)) != local_cost.shape:
        got = (len(first_weights), len(second_weights))
        raise ParameterError("weights", f"as many as the {local_cost.shape} columns", got)
    if not np.isfinite(local_cost).all() or local_cost.min() < 0:
        raise ParameterError("local_cost", "finite and not negative", float(local_cost.min()))
    total, entered = _accumulate(
        np.ascontiguousarray(local_cost, np.float64),
        np.ascontiguousarray(first_weights, np.float64),
        np.ascontiguousarray(second_weights, np.float64),
    )
    steps = np.empty(sum(local_cost.shape) - 1, np.uint8)
    count = trace_back(entered, FIRST, steps)
    return Alignment(float(total), _cells(steps[:count]))


def _cells(steps: U8) -> I64:
    """Return the cells of a path, int64 (P, 2), from the steps that enter them."""
    advances = np.stack([steps != SECOND, steps != FIRST], axis=1).astype(np.int64)
    return advances.cumsum(axis=0) - 1


@nb.njit(cache=True, nogil=True)
def _accumulate(local_cost: F64, first_weights: F64, second_weights: F64) -> tuple[float, U8]:
    """Return the cost of the best path and, per cell, the step that enters it (kernel of `align`)."""
    rows, columns = local_cost.shape
    entered = np.empty((rows, columns), np.uint8)
    above = np.full(columns, np.inf)
    here = np.empty(columns)
    entering = np.empty(columns)
    weighted = np.empty(columns)
    for k in range(rows):
        for column in range(columns):
            weighted[column] = local_cost[k, column] * (0.5 * (first_weights[k] + second_weights[column]))
        advance_row(above, here, entering, weighted, entered[k], k == 0)
        above, here = here, above
    return above[columns - 1], entered


@nb.njit(cache=True, nogil=True)
def advance_row(above: F64, here: F64, entering: F64, weighted: F64, entered: U8, first: bool) -> None:
    """Fill one row of accumulated costs and of the steps that enter its cells (kernel).

    Of the three passes only the second depends on the cell before: the others vectorise.

    Parameters
    ----------
    above : float64 array (L,)
        The row before (∞ before the first one).
    here : float64 array (L,)
        The results.
    entering : float64 array (L,)
        Memory.
    weighted : float64 array (L,)
        The local costs times the mean of the two column weights.
    entered : uint8 array (L,)
        The resulting steps.
    first : bool
        Whether this is the first row.
    """
    columns = len(weighted)
    entering[0] = 0.0 if first else above[0]
    for column in range(1, columns):
        diagonal, up = above[column - 1], above[column]
        entering[column] = up if up < diagonal else diagonal
    before = entering[0] + weighted[0]
    here[0] = before
    entered[0] = DIAGONAL if first else FIRST
    for column in range(1, columns):
        least = entering[column]
        before = (before if before < least else least) + weighted[column]
        here[column] = before
    for column in range(1, columns):
        diagonal, up, left = above[column - 1], above[column], here[column - 1]
        step = DIAGONAL
        if up < diagonal:
            step = EITHER if left == up else FIRST
        if left < entering[column]:
            step = SECOND
        entered[column] = step


@nb.njit(cache=True, nogil=True)
def trace_back(entered: U8, preferred: np.uint8, steps: U8) -> int:
    """Write the steps of the best path, in its order, and return their number (kernel).

    Parameters
    ----------
    entered : uint8 array (K, L)
        The step that enters each cell.
    preferred : uint8
        FIRST or SECOND, the sequence that the path is read from; a step in which that one alone advances is written as
        FIRST, and its opposite as SECOND.
    steps : uint8 array
        The results, with room for K + L − 1.
    """
    rows, columns = entered.shape
    swap = preferred == SECOND
    position = rows + columns - 1
    k, column = rows - 1, columns - 1
    while True:
        step = entered[k, column]
        if step == EITHER:
            step = preferred
        position -= 1
        steps[position] = step
        if swap and step != DIAGONAL:
            steps[position] = FIRST if step == SECOND else SECOND
        if k == 0 and column == 0:
            break
        if step != SECOND:
            k -= 1
        if step != FIRST:
            column -= 1
    count = rows + columns - 1 - position
    for place in range(count):
        steps[place] = steps[position + place]
    return count
