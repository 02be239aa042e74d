"""This module stacks templates and warps pairs of them; each path is stored as seen from both templates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba as nb
import numpy as np

from kinedex.ops.arrays import F64, I64, U8, Array
from kinedex.ops.bits import count_bits
from kinedex.ops.templates.warping import (
    BLOCK,
    FIRST,
    MARGIN,
    SECOND,
    advance_rows,
    begin_rows,
    row_memory,
    trace_back,
)
from kinedex.ops.words import U64

# float64 (N, f) for soft templates, uint64 (N, 2) for hard ones; only a method interprets them


@dataclass(frozen=True)
class Weighted:
    """Template columns in a method's own representation, with their weights.

    Parameters
    ----------
    columns : array (N, ·)
        The columns, in the form that the method uses.
    weights : float64 array (N,)
        The weight of each column.
    """

    columns: Array
    weights: F64


@dataclass(frozen=True)
class Stack:
    """Concatenated templates: template i has the columns offsets[i] to offsets[i + 1] − 1.

    Parameters
    ----------
    columns : array (M, ·)
        As those of `Weighted`.
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
        """Return a stack of some of the templates, in the given order."""
        pieces = [slice(int(self.offsets[i]), int(self.offsets[i + 1])) for i in indices]
        return Stack.of([Weighted(self.columns[piece], self.weights[piece]) for piece in pieces])


@dataclass(frozen=True)
class Paths:
    """The warping paths of P pairs of templates, each stored as seen from both.

    Parameters
    ----------
    costs : float64 array (P,)
        The DTW cost, which is the same from both sides.
    steps : uint8 array
        All paths one after the other.
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
    """Return the memory offsets of each pair's two paths, int64 (2 P + 1,); a path has at most K + L − 1 steps."""
    longest = stack.lengths[pairs].sum(axis=1) - 1
    return np.concatenate(([0], np.cumsum(np.repeat(longest, 2)))).astype(np.int64)


def compact(costs: F64, counts: I64, steps: U8, offsets: I64) -> Paths:
    """Return the paths in memory without gaps."""
    kept = np.concatenate([steps[start : start + count] for start, count in zip(offsets, counts, strict=False)])
    starts = np.concatenate(([0], np.cumsum(counts)))[:-1]
    return Paths(costs, kept, starts.reshape(-1, 2), counts.reshape(-1, 2))


@nb.njit(cache=True, nogil=True)
def soft_costs(column: F64, turned: F64, first: int, total: float, out: F64) -> None:
    """Fill in the sum over features of |x − y|, divided by `total`, of one column against others (kernel).

    Four features at a time are added in the features' order, so the sums equal those of a plain loop to the last bit.

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
    soft: F64 | None, hard: U64 | None, total: float, weights: F64, offsets: I64, pairs: I64, places: I64
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
    places : int64 array (2 P + 1,)
        The result of `path_offsets`.
    """
    costs = np.empty(len(pairs))
    counts = np.empty(2 * len(pairs), np.int64)
    steps = np.empty(places[-1], np.uint8)
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
        counts[2 * p] = trace_back(walked, FIRST, steps[places[2 * p] : places[2 * p + 1]])
        counts[2 * p + 1] = trace_back(walked, SECOND, steps[places[2 * p + 1] : places[2 * p + 2]])
    return costs, counts, steps
