"""This module performs one round of template learning: warping templates onto each other, averaging, rebalancing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numba as nb
import numpy as np

from kinedex.ops.arrays import F64, I64, U8, U64, Array
from kinedex.ops.templates.warping import (
    FIRST,
    SECOND,
    Paths,
    Stack,
    Weighted,
    align_pairs,
    compact,
    path_offsets,
)
from kinedex.ops.words import bits, pack

TOLERANCE = 1e-9
_HEAVY = 1.5 - TOLERANCE  # averaging can give 1.4999999999999998 for 1.5
_LIGHT = 0.75 - TOLERANCE


@dataclass(frozen=True)
class Soft:
    """The operations of soft templates, whose columns, float64 (N, f), are weighted fractions of clips.

    Parameters
    ----------
    feature_weights : float64 array (f,)
        Weights that are not negative; the local cost is the weighted mean over features of |x − y|.
    """

    feature_weights: F64

    def start(self, words: U64) -> Array:
        """Return the columns of a single clip."""
        return bits(words, len(self.feature_weights)).astype(np.float64)

    def align(self, stack: Stack, pairs: I64) -> Paths:
        """Warp pairs of templates, int64 (P, 2), onto each other."""
        if self._counts_bits(stack.columns):
            return Hard(self.feature_weights).align(replace(stack, columns=self._as_hard(stack.columns)), pairs, True)
        # A feature that never varies, or has weight 0, would add exactly 0 to every cost.
        varies = (stack.columns != stack.columns[0]).any(axis=0) & (self.feature_weights > 0)
        columns = np.ascontiguousarray((stack.columns[:, varies] * self.feature_weights[varies]).T)
        total = float(self.feature_weights.sum())
        offsets = path_offsets(stack, pairs)
        costs, counts, steps = align_pairs(columns, None, total, stack.weights, stack.offsets, pairs, offsets)
        return compact(costs, counts, steps, offsets)

    def _counts_bits(self, columns: Array) -> bool:
        """Return True if costs are exact counts of features: columns of 0 and 1, and weights of 0 and 1."""
        plain = np.isin(self.feature_weights, (0, 1)).all() and ((columns == 0) | (columns == 1)).all()
        return bool(plain)

    def _as_hard(self, columns: Array) -> Array:
        """Convert columns of 0 and 1 to columns of hard templates."""
        return Hard(self.feature_weights).start(pack(columns.astype(np.uint8)))

    def average(self, stack: Stack, reference: int, paths: Paths, pair_of: I64, stands_for: int = 1) -> Weighted:
        """Average the reference and all other templates warped to it.

        Parameters
        ----------
        stack : Stack
            The templates.
        reference : int
            The index of the reference in `stack`.
        paths : Paths
            The warping paths of the pairs.
        pair_of : int64 array (n,)
            For each other template, the index of its pair with the reference.
        stands_for : int
            The number of clips that the reference represents.
        """
        first, last = stack.offsets[reference], stack.offsets[reference + 1]
        weights = stack.weights[first:last] * stands_for
        total = stack.columns[first:last] * weights[:, None]
        add_others(
            total, None, weights, stack.columns, stack.weights, stack.offsets, reference, paths.steps, paths.starts,
            paths.counts, pair_of,
        )  # fmt: skip
        return Weighted(total / weights[:, None], weights / (len(stack) - 1 + stands_for))

    def merge(self, left: Array, right: Array, left_weight: float, right_weight: float) -> Array:
        """Return the merged column of two neighbours."""
        return (left * left_weight + right * right_weight) / (left_weight + right_weight)

    def values(self, columns: Array) -> F64:
        """Return the columns as values, float64 (N, f)."""
        return columns.astype(np.float64)


@dataclass(frozen=True)
class Hard:
    """The operations of hard templates, whose columns are uint64 (N, 2): bits that are always 1, and bits always 0.

    The agreement of any number of columns is their bitwise AND. Features of weight 0 are ignored in costs. Other
    weights are not used, since they would not change which costs are 0.

    Parameters
    ----------
    feature_weights : float64 array (f,)
        Not negative.
    """

    feature_weights: F64

    def start(self, words: U64) -> Array:
        """Return the columns of a single clip."""
        every = np.uint64((1 << len(self.feature_weights)) - 1)
        return np.stack([words, ~words & every], axis=1)

    def align(self, stack: Stack, pairs: I64, shares: bool = False) -> Paths:
        """Warp pairs of templates, int64 (P, 2), onto each other; costs are numbers of contradictions, or fractions."""
        counted = np.bitwise_or.reduce(
            (self.feature_weights > 0).astype(np.uint64) << np.arange(len(self.feature_weights), dtype=np.uint64)
        )
        offsets = path_offsets(stack, pairs)
        columns = stack.columns & counted
        total = float(np.count_nonzero(self.feature_weights)) if shares else 1.0
        costs, counts, steps = align_pairs(None, columns, total, stack.weights, stack.offsets, pairs, offsets)
        return compact(costs, counts, steps, offsets)

    def average(self, stack: Stack, reference: int, paths: Paths, pair_of: I64, stands_for: int = 1) -> Weighted:
        """Return the entries on which the reference and all other templates warped to it agree; see `Soft.average`."""
        first, last = stack.offsets[reference], stack.offsets[reference + 1]
        columns, weights = stack.columns[first:last].copy(), stack.weights[first:last] * stands_for
        add_others(
            None, columns, weights, stack.columns, stack.weights, stack.offsets, reference, paths.steps, paths.starts,
            paths.counts, pair_of,
        )  # fmt: skip
        return Weighted(columns, weights / (len(stack) - 1 + stands_for))

    def merge(self, left: Array, right: Array, left_weight: float, right_weight: float) -> Array:
        """Return the merged column of two neighbours."""
        return left & right

    def values(self, columns: Array) -> F64:
        """Return the columns as values, float64 (N, f): 0, 0.5 and 1."""
        count = len(self.feature_weights)
        ones, zeros = bits(columns[:, 0], count), bits(columns[:, 1], count)
        return (1.0 + ones - zeros) / 2


Method = Soft | Hard


def average_all(method: Method, stack: Stack, paths: Paths, pairs: I64, references: I64) -> list[Weighted]:
    """Average with each of several templates as the reference (thesis, Section 2.3: all), and rebalance the results.

    Parameters
    ----------
    method : Method
        The rule by which aligned columns are averaged.
    stack : Stack
        The templates of the previous round.
    paths : Paths
        The warping paths of the pairs.
    pairs : int64 array (P, 2)
        The pairs of each reference with all other templates, as indices in ascending order.
    references : int64 array (R,)
        The indices of the references.

    Returns
    -------
    list of Weighted
        The new templates, in the order of the references.
    """
    count = len(stack)
    positions = np.full((count, count), -1)
    positions[pairs[:, 0], pairs[:, 1]] = positions[pairs[:, 1], pairs[:, 0]] = np.arange(len(pairs))
    return [rebalance(method.average(stack, i, paths, positions[i]), method.merge) for i in references.tolist()]


def rebalance(template: Weighted, merge: Callable[[Array, Array, float, float], Array]) -> Weighted:
    """Restore column weights to about 1 by expanding, contracting, and expanding (diploma thesis, Eq. 3.5).

    A column of weight w ≥ 1.5 is replaced by round(w) columns of weight w / round(w), with halves rounded to even.
    Then, from the left, each column of weight below 0.75 is merged with its neighbour of lower weight, or with the left
    neighbour if both weigh the same.

    Parameters
    ----------
    template : Weighted
        The template.
    merge : callable
        The rule that merges two neighbouring columns of given weights.
    """
    return _expand(_contract(_expand(template), merge))


def _expand(template: Weighted) -> Weighted:
    copies = np.where(template.weights >= _HEAVY, np.rint(np.round(template.weights, 9)), 1).astype(np.int64)
    return Weighted(np.repeat(template.columns, copies, axis=0), np.repeat(template.weights / copies, copies))


def _contract(template: Weighted, merge: Callable[[Array, Array, float, float], Array]) -> Weighted:
    columns: list[Array] = list(template.columns)
    weights: list[float] = template.weights.tolist()
    place = 0
    while place < len(weights) and len(weights) > 1:
        if weights[place] >= _LIGHT:
            place += 1
            continue
        before = weights[place - 1] if place > 0 else np.inf
        after = weights[place + 1] if place + 1 < len(weights) else np.inf
        place -= before <= after + TOLERANCE  # now the left one of the two columns to merge
        columns[place] = merge(columns[place], columns[place + 1], weights[place], weights[place + 1])
        weights[place] += weights[place + 1]
        del columns[place + 1], weights[place + 1]
    return Weighted(np.array(columns), np.array(weights))


@nb.njit(cache=True, nogil=True)
def share_out(weights: F64, steps: U8, shares: F64) -> None:
    """Split each column's weight evenly among the reference columns that use it (kernel)."""
    shares[:] = 0.0
    m = -1
    for step in steps:
        if step != FIRST:
            m += 1
        shares[m] += 1.0
    for m in range(len(shares)):
        shares[m] = weights[m] / shares[m]


@nb.njit(cache=True, nogil=True)
def add_others(
    total: F64 | None, agreed: U64 | None, weights: F64, columns: Array, column_weights: F64, offsets: I64,
    reference: int, steps: U8, starts: I64, counts: I64, pair_of: I64,
) -> None:  # fmt: skip
    """Add all other templates, warped, to the sums of a soft or to the agreement of a hard reference (kernel).

    The kernel updates `total` for soft or `agreed` for hard templates (the other argument is None), and `weights`.
    """
    for other in range(len(offsets) - 1):
        if other == reference:
            continue
        pair, side = pair_of[other], 0 if reference < other else 1
        path = steps[starts[pair, side] : starts[pair, side] + counts[pair, side]]
        first, last = offsets[other], offsets[other + 1]
        shares = np.empty(last - first)
        share_out(column_weights[first:last], path, shares)
        k, m = -1, -1
        for step in path:
            if step != SECOND:
                k += 1
            if step != FIRST:
                m += 1
            share = shares[m]
            weights[k] += share
            if total is not None:
                for i in range(columns.shape[1]):
                    total[k, i] += share * columns[first + m, i]
            if agreed is not None:
                agreed[k, 0] &= columns[first + m, 0]
                agreed[k, 1] &= columns[first + m, 1]
