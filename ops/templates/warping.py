"""This module does classical dynamic time warping of two weighted sequences, with the path seen from either one."""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np

from kinedex.ops.arrays import F64, I64, U8
from kinedex.ops.errors import ParameterError

DIAGONAL, FIRST, SECOND, EITHER = np.uint8(0), np.uint8(1), np.uint8(2), np.uint8(3)
"""The step that enters a cell: both sequences advance, only the first, only the second; or EITHER where the last two
are equally cheap, and the sequence advances from which the path is seen.
"""

BLOCK, MARGIN = 4, 3
"""Accumulated costs are computed in blocks of `BLOCK` rows; the last row is `MARGIN` columns behind the first."""


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
    """Return the cost of the best path and, for each cell, the step that enters it (kernel of `align`)."""
    height, width = local_cost.shape
    entered = np.empty((height, width), np.uint8)
    accumulated, weighted = row_memory(width)
    begin_rows(accumulated)
    for top in range(0, height, BLOCK):
        rows = min(BLOCK, height - top)
        for row in range(rows):
            for column in range(width):
                mean = 0.5 * (first_weights[top + row] + second_weights[column])
                weighted[row, MARGIN + column] = local_cost[top + row, column] * mean
        advance_rows(accumulated, weighted, entered[top : top + rows])
    return accumulated[0, width], entered


@nb.njit(cache=True, nogil=True)
def row_memory(longest: int) -> tuple[F64, F64]:
    """Allocate memory for the accumulated and the weighted costs of a block of rows (kernel)."""
    return np.empty((BLOCK + 1, longest + 2 * MARGIN)), np.zeros((BLOCK, longest + 2 * MARGIN))


@nb.njit(cache=True, nogil=True)
def begin_rows(accumulated: F64) -> None:
    """Initialise the row above the first one, where every path begins before the first column (kernel)."""
    accumulated[:, 0] = np.inf
    accumulated[0, :] = np.inf
    accumulated[0, 0] = 0.0


@nb.njit(cache=True, nogil=True)
def advance_rows(accumulated: F64, weighted: F64, entered: U8) -> None:
    """Fill in up to `BLOCK` rows of accumulated costs and of the steps that enter their cells (kernel).

    A cell depends on the one before it, and such a dependent sum and comparison take as long as ten independent ones.
    So four rows are computed together, each one column behind the row above.

    Parameters
    ----------
    accumulated : float64 array (BLOCK + 1, L + 2 MARGIN)
        In its first row the row above, column c at c + 1, and ∞ at 0 (see `begin_rows`); the last row that was filled
        takes its place.
    weighted : float64 array (BLOCK, L + 2 MARGIN)
        The local costs times the mean of the two column weights, column c at c + MARGIN; finite everywhere.
    entered : uint8 array (R, L)
        The resulting steps of R rows.
    """
    rows, width = entered.shape
    above, one, two, three, four = accumulated[0], accumulated[1], accumulated[2], accumulated[3], accumulated[4]
    w_one, w_two, w_three, w_four = weighted[0], weighted[1], weighted[2], weighted[3]
    a = b = c = d = np.inf  # the last cell of each row, and the one before it
    a_before = b_before = c_before = np.inf
    for column in range(width + MARGIN):
        diagonal = c_before if c_before < c else c
        d = (d if d < diagonal else diagonal) + w_four[column]
        diagonal = b_before if b_before < b else b
        c_before, c = c, (c if c < diagonal else diagonal) + w_three[column + 1]
        diagonal = a_before if a_before < a else a
        b_before, b = b, (b if b < diagonal else diagonal) + w_two[column + 2]
        diagonal = above[column] if above[column] < above[column + 1] else above[column + 1]
        a_before, a = a, (a if a < diagonal else diagonal) + w_one[column + 3]
        one[column + 1] = a
        two[column] = b
        if column > 0:
            three[column - 1] = c
        if column > 1:
            four[column - 2] = d
    accumulated[1:, 0] = np.inf
    for row in range(rows):
        upper, here, steps = accumulated[row], accumulated[row + 1], entered[row]
        for column in range(width):
            diagonal, up, left = upper[column], upper[column + 1], here[column]
            entering = up if up < diagonal else diagonal
            step = DIAGONAL
            if up < diagonal:
                step = EITHER if left == up else FIRST
            if left < entering:
                step = SECOND
            steps[column] = step
    accumulated[0, : width + 1] = accumulated[rows, : width + 1]


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
        The results, of length K + L − 1 or more.
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
