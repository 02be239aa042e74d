"""This module performs classical dynamic time warping (DTW) of two weighted sequences.

It also warps many pairs of templates, whose columns are concatenated in a stack. Of equally cheap paths, the choice may
depend on which sequence comes first; therefore each path is stored as seen from both templates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba as nb
import numpy as np

from kinedex.ops.arrays import F64, I64, U8, U64, Array
from kinedex.ops.bits import count_bits
from kinedex.ops.errors import ParameterError

DIAGONAL, FIRST, SECOND, EITHER = np.uint8(0), np.uint8(1), np.uint8(2), np.uint8(3)
"""The step that enters a cell: both sequences advance, only the first, or only the second. EITHER means that the last
two steps are equally cheap; then the sequence from which the path is seen advances.
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

    A cell (k, l) of the path costs `local_cost[k, l]` times the mean of the two column weights. Of equally cheap paths,
    the choice is made step by step from the end of the path: (1,1) is preferred to (1,0), in which only the first
    sequence advances, and (1,0) is preferred to (0,1).

    Parameters
    ----------
    local_cost : float64 array (K, L)
        Local costs, finite and not negative.
    first_weights : float64 array (K,)
        Weights of the columns of the first sequence, positive.
    second_weights : float64 array (L,)
        Weights of the columns of the second sequence, positive.

    Returns
    -------
    Alignment
        The alignment, whose path has between max(K, L) and K + L − 1 cells.

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

    A cell depends on the previous cell of its row, and a chain of dependent sums and comparisons takes about ten times
    as long as independent ones. Therefore four rows are computed together, each one column behind the row above.

    Parameters
    ----------
    accumulated : float64 array (BLOCK + 1, L + 2 MARGIN)
        Accumulated costs. The first row holds the row above, with column c at index c + 1 and ∞ at index 0 (see
        `begin_rows`). At the end it is replaced by the last row that was filled.
    weighted : float64 array (BLOCK, L + 2 MARGIN)
        The local costs times the mean of the two column weights, column c at c + MARGIN; finite everywhere.
    entered : uint8 array (R, L)
        The resulting steps of R rows.
    """
    rows, width = entered.shape
    above, one, two, three, four = accumulated[0], accumulated[1], accumulated[2], accumulated[3], accumulated[4]
    w_one, w_two, w_three, w_four = weighted[0], weighted[1], weighted[2], weighted[3]
    a = b = c = d = np.inf  # the last cell of each row
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
        FIRST or SECOND, the sequence from which the path is seen. A step in which only this sequence advances is
        written as FIRST, and a step in which only the other sequence advances as SECOND.
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


@dataclass(frozen=True)
class Weighted:
    """Template columns in the representation of a method, with their weights.

    Parameters
    ----------
    columns : array (N, ·)
        The columns, in the form that the method uses.
    weights : float64 array (N,)
        The weight of each column.
    """

    columns: Array  # float64 (N, f) for soft templates, uint64 (N, 2) for hard ones; only a method interprets them
    weights: F64


@dataclass(frozen=True)
class Stack:
    """Concatenated templates: template i has the columns offsets[i] to offsets[i + 1] − 1.

    Parameters
    ----------
    columns : array (M, ·)
        The columns of all templates, in the form of `Weighted`.
    weights : float64 array (M,)
        The weight of each column.
    offsets : int64 array (n + 1,)
        The first column of each template, and the number of all columns.
    """

    columns: Array
    weights: F64
    offsets: I64

    @classmethod
    def of(cls, templates: Sequence[Weighted]) -> Stack:
        """Return a stack of templates: columns and weights concatenated, with the offsets of the templates."""
        offsets = np.concatenate(([0], np.cumsum([len(one.weights) for one in templates]))).astype(np.int64)
        columns = np.ascontiguousarray(np.concatenate([one.columns for one in templates]))
        return cls(columns, np.concatenate([one.weights for one in templates]), offsets)

    def __len__(self) -> int:
        return len(self.offsets) - 1

    @property
    def lengths(self) -> I64:
        """Return the number of columns of each template."""
        return np.diff(self.offsets)

    def chosen(self, indices: I64) -> Stack:
        """Return a stack of the templates with the given indices, in their order."""
        pieces = [slice(int(self.offsets[i]), int(self.offsets[i + 1])) for i in indices]
        return Stack.of([Weighted(self.columns[piece], self.weights[piece]) for piece in pieces])


@dataclass(frozen=True)
class Paths:
    """The warping paths of P pairs of templates, each path stored twice, as seen from either template.

    Parameters
    ----------
    costs : float64 array (P,)
        The DTW cost of each pair, which is the same for both paths.
    steps : uint8 array
        The concatenated steps of all paths.
    starts, counts : int64 array (P, 2)
        The first step and the length of each path, read from the first template of its pair and from the second.
    """

    costs: F64
    steps: U8
    starts: I64
    counts: I64

    @classmethod
    def joined(cls, pieces: Sequence[Paths]) -> Paths:
        """Concatenate the paths of several pieces."""
        shifts = np.concatenate(([0], np.cumsum([len(piece.steps) for piece in pieces])))
        return cls(
            np.concatenate([piece.costs for piece in pieces]),
            np.concatenate([piece.steps for piece in pieces]),
            np.concatenate([piece.starts + shift for piece, shift in zip(pieces, shifts, strict=False)]),
            np.concatenate([piece.counts for piece in pieces]),
        )


def all_pairs(count: int) -> I64:
    """Return all pairs i < j of `count` templates, int64 (P, 2), sorted by i and then j."""
    return np.stack(np.triu_indices(count, 1), axis=1).astype(np.int64)


def reference_pairs(count: int, references: I64) -> I64:
    """Return all pairs i < j of `count` templates with at least one reference, int64 (P, 2), sorted by i and then j."""
    pairs = all_pairs(count)
    kept: I64 = pairs[np.isin(pairs, references).any(axis=1)]
    return kept


def path_offsets(stack: Stack, pairs: I64) -> I64:
    """Return the memory offsets (2 P + 1,) of each pair's two paths, which have at most K + L − 1 steps each."""
    longest = stack.lengths[pairs].sum(axis=1) - 1
    return np.concatenate(([0], np.cumsum(np.repeat(longest, 2)))).astype(np.int64)


def compact(costs: F64, counts: I64, steps: U8, offsets: I64) -> Paths:
    """Copy the steps of all paths to contiguous memory, and return them as `Paths`."""
    kept = np.concatenate([steps[start : start + count] for start, count in zip(offsets, counts, strict=False)])
    starts = np.concatenate(([0], np.cumsum(counts)))[:-1]
    return Paths(costs, kept, starts.reshape(-1, 2), counts.reshape(-1, 2))


@nb.njit(cache=True, nogil=True)
def soft_costs(column: F64, turned: F64, first: int, total: float, out: F64) -> None:
    """Fill in the sum over features of |x − y|, divided by `total`, of one column against others (kernel).

    Features are added four at a time but in their order, so that the sums equal those of a plain loop to the last bit.

    Parameters
    ----------
    column : float64 array (f,)
        The values of the column.
    turned : float64 array (f, M)
        All columns, transposed.
    first : int
        The first of the other columns.
    total : float
        The total weight of the features.
    out : float64 array (L,)
        The results for the columns first, first + 1, …
    """
    width = len(out)
    out[:] = 0.0
    features = len(column)
    i = 0
    while i + 4 <= features:
        a, b, c, d = column[i], column[i + 1], column[i + 2], column[i + 3]
        # A slice of a row of a contiguous array is known to be contiguous, which the compiler needs to vectorise.
        row_a = turned[i][first : first + width]
        row_b = turned[i + 1][first : first + width]
        row_c = turned[i + 2][first : first + width]
        row_d = turned[i + 3][first : first + width]
        for k in range(width):
            out[k] = (((out[k] + abs(a - row_a[k])) + abs(b - row_b[k])) + abs(c - row_c[k])) + abs(d - row_d[k])
        i += 4
    while i < features:
        a = column[i]
        row_a = turned[i][first : first + width]
        for k in range(width):
            out[k] += abs(a - row_a[k])
        i += 1
    for k in range(width):
        out[k] /= total


@nb.njit(cache=True, nogil=True)
def align_pairs(
    soft: F64 | None, hard: U64 | None, total: float, weights: F64, offsets: I64, pairs: I64, positions: I64
) -> tuple[F64, I64, U8]:
    """Align pairs of templates; return costs, path lengths, and steps as seen from both templates (kernel).

    The compiler removes the branch of the method whose columns are None.

    Parameters
    ----------
    soft : float64 array (f, M), optional
        The columns of soft templates, transposed; None for hard templates.
    hard : uint64 array (M, 2), optional
        The columns of hard templates, whose cost is the number of contradictions; None for soft templates.
    total : float
        The divisor of the costs, see `soft_costs`.
    weights : float64 array (M,)
        The weight of each column.
    offsets : int64 array (n + 1,)
        The first column of each template, and the number of all columns.
    pairs : int64 array (P, 2)
        The indices of the two templates of each pair.
    positions : int64 array (2 P + 1,)
        The result of `path_offsets`.
    """
    costs = np.empty(len(pairs))
    counts = np.empty(2 * len(pairs), np.int64)
    steps = np.empty(positions[-1], np.uint8)
    longest = 0
    for i in range(len(offsets) - 1):
        longest = max(longest, offsets[i + 1] - offsets[i])
    entered = np.empty((longest, longest), np.uint8)
    accumulated, block = row_memory(longest)
    for p in range(len(pairs)):
        first, second = offsets[pairs[p, 0]], offsets[pairs[p, 1]]
        height, width = offsets[pairs[p, 0] + 1] - first, offsets[pairs[p, 1] + 1] - second
        begin_rows(accumulated)
        for top in range(0, height, BLOCK):
            rows = min(BLOCK, height - top)
            for row in range(rows):
                k, weighted = first + top + row, block[row][MARGIN : MARGIN + width]
                weight = weights[k]
                if soft is not None:
                    soft_costs(soft[:, k], soft, second, total, weighted)
                    for column in range(width):
                        weighted[column] *= 0.5 * (weight + weights[second + column])
                if hard is not None:
                    ones, zeros = hard[k, 0], hard[k, 1]
                    for column in range(width):
                        other = second + column
                        against = (ones & hard[other, 1]) | (zeros & hard[other, 0])
                        weighted[column] = count_bits(against) / total * (0.5 * (weight + weights[other]))
            advance_rows(accumulated, block, entered[top : top + rows, :width])
        costs[p] = accumulated[0, width]
        walked = entered[:height, :width]
        counts[2 * p] = trace_back(walked, FIRST, steps[positions[2 * p] : positions[2 * p + 1]])
        counts[2 * p + 1] = trace_back(walked, SECOND, steps[positions[2 * p + 1] : positions[2 * p + 2]])
    return costs, counts, steps
