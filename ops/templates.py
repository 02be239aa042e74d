"""Motion templates: what the clips of a class have in common, learned by warping and averaging."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numba as nb
import numpy as np
import numpy.typing as npt

from ops.errors import ParameterError
from ops.warping import accumulate, trace_back
from ops.words import U64, bits

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]
Columns = npt.NDArray[Any]  # float64 of soft templates, uint64 of hard ones; only a method looks inside

MOST_ROUNDS = 10
CONVERGED = 0.005
TOLERANCE = 1e-9
_HEAVY = 1.5 - TOLERANCE  # averaging leaves 1.4999999999999998 where 1.5 is meant
_LIGHT = 0.75 - TOLERANCE


@dataclass(frozen=True)
class Template:
    """A motion template of N columns.

    values: float64 (N, f) in [0, 1]; column i − 1 of the matrix is F_i. weights: float64 (N,), about 1.
    """

    values: F64
    weights: F64

    def __len__(self) -> int:
        return len(self.values)


@dataclass(frozen=True)
class QuantisedTemplate:
    """A template of 0, 1 and wildcards: bit i − 1 of `mask` says that F_i counts, of `value` what it is.

    mask, value: uint64 (N,); value has no bit outside mask.
    """

    mask: U64
    value: U64

    def __post_init__(self) -> None:
        if len(self.mask) != len(self.value) or not len(self.mask):
            raise ParameterError("template", "one mask and one value per column", (len(self.mask), len(self.value)))
        if np.any(self.value & ~self.mask):
            raise ParameterError("value", "0 wherever mask is 0", "a value behind a wildcard")

    def __len__(self) -> int:
        return len(self.mask)

    @property
    def fixed(self) -> float:
        """How many entries of a column are no wildcards, on average."""
        return float(np.bitwise_count(self.mask).mean())

    def values(self, features: int) -> F64:
        """The columns as numbers, float64 (N, f): 0, 1, and 0.5 for a wildcard."""
        fixed, ones = bits(self.mask, features), bits(self.value, features)
        return np.where(fixed == 1, ones, 0.5)


@dataclass(frozen=True)
class Learned:
    """A template and how it came about.

    template: the class template. rounds: how often all templates were averaged.
    costs: the largest DTW cost between two templates, divided by the reference's total weight, before each
    round and after the last: rounds + 1 numbers (a single one, 0, where there is one clip).
    """

    template: Template
    rounds: int
    costs: tuple[float, ...]


def learn_soft(clips: Sequence[U64], features: int) -> Learned:
    """Learn the soft motion template of a class (thesis, 2.3; Müller and Röder 2006).

    Values are weighted means over the clips; the local cost is the mean over features of |x − y|.

    Parameters
    ----------
    clips: the words of each training clip, uint64 (L_i,), in the order of the clips' names.
    features: number of features f, 1 to 64.

    Returns
    -------
    Learned. With one clip the template is that clip.

    Raises
    ------
    ParameterError: without clips, with an empty clip, or with bits beyond the features.
    """
    return _learn(clips, features, _Soft(features))


def learn_hard(clips: Sequence[U64], features: int) -> Learned:
    """Learn the hard motion template of a class (diploma thesis, 3.3.1, Eq. 3.1 to 3.6).

    Values are 0, 0.5 (a wildcard) and 1; the local cost counts the contradictions. The classical DTW cost
    between the template and every one of its clips is 0 (Claim 3.1 there). Parameters as in `learn_soft`.
    """
    return _learn(clips, features, _Hard(features))


def quantise(template: Template, delta: float) -> QuantisedTemplate:
    """Replace values ≤ delta by 0, values ≥ 1 − delta by 1, and the rest by a wildcard (thesis, 2.3).

    Parameters
    ----------
    template: at most 64 features.
    delta: 0 ≤ delta < 0.5; 0 keeps only what does not vary at all. Compared with a tolerance of 1e-9.
    """
    if not 0 <= delta < 0.5:
        raise ParameterError("delta", "at least 0 and below 0.5", delta)
    shifts = np.arange(template.values.shape[1], dtype=np.uint64)
    ones = template.values >= 1 - delta - TOLERANCE
    zeros = template.values <= delta + TOLERANCE
    value = np.bitwise_or.reduce(ones.astype(np.uint64) << shifts, axis=1)
    mask = np.bitwise_or.reduce((ones | zeros).astype(np.uint64) << shifts, axis=1)
    return QuantisedTemplate(mask, value)


@dataclass(frozen=True)
class Weighted:
    """Columns in a method's own form, with their weights (float64)."""

    columns: Columns
    weights: F64


class _Method(Protocol):
    """What soft and hard templates do differently."""

    def start(self, words: U64) -> Columns: ...
    def local_cost(self, first: Columns, second: Columns) -> F64: ...
    def average(self, reference: Weighted, others: Sequence[Weighted], paths: Sequence[I64]) -> Weighted: ...
    def merge(self, left: Columns, right: Columns, left_weight: float, right_weight: float) -> Columns: ...
    def values(self, columns: Columns) -> F64: ...


def _learn(clips: Sequence[U64], features: int, method: _Method) -> Learned:
    _validate(clips, features)
    templates = [Weighted(method.start(clip), np.ones(len(clip))) for clip in clips]
    costs: list[float] = []
    rounds = 0
    while len(clips) > 1:
        largest, averaged = _round(templates, method)
        costs.append(largest)
        # The first round always counts: before it, "all alike" would let the first clip stand for the class.
        unchanged = rounds > 0 and abs(largest - costs[-2]) <= TOLERANCE
        if rounds == MOST_ROUNDS or (rounds > 0 and (largest < CONVERGED or unchanged)):
            break
        templates = averaged
        rounds += 1
    first = templates[0]
    return Learned(Template(method.values(first.columns), first.weights), rounds, tuple(costs or [0.0]))


def _validate(clips: Sequence[U64], features: int) -> None:
    if not 1 <= features <= 64:
        raise ParameterError("features", "from 1 to 64", features)
    if not clips:
        raise ParameterError("clips", "at least one clip", 0)
    for clip in clips:
        if not len(clip):
            raise ParameterError("clips", "clips of at least one frame", 0)
        if features < 64 and int(clip.max()) >> features:
            raise ParameterError("clips", f"words of {features} bits", int(clip.max()))


def _round(templates: Sequence[Weighted], method: _Method) -> tuple[float, list[Weighted]]:
    """Make every template the reference once; return the largest relative cost and the averages."""
    largest = 0.0
    averaged = []
    for index, reference in enumerate(templates):
        others = [other for place, other in enumerate(templates) if place != index]
        weight = float(reference.weights.sum())
        paths = []
        for other in others:
            local = method.local_cost(reference.columns, other.columns)
            cost, steps = accumulate(local, reference.weights, other.weights)
            paths.append(trace_back(steps))
            largest = max(largest, cost / weight)
        averaged.append(rebalance(method.average(reference, others, paths), method.merge))
    return largest, averaged


def rebalance(template: Weighted, merge: Callable[[Columns, Columns, float, float], Columns]) -> Weighted:
    """Bring the column weights back to about 1: expand, contract, expand (diploma thesis, Eq. 3.5).

    A column of weight w ≥ 1.5 becomes round(w) columns of weight w / round(w), half to even. Then, from the
    left, a column lighter than 0.75 merges with its lighter neighbour (the left one of equals) until none is.
    """
    return _expand(_contract(_expand(template), merge))


def _expand(template: Weighted) -> Weighted:
    copies = np.where(template.weights >= _HEAVY, np.rint(np.round(template.weights, 9)), 1).astype(np.int64)
    return Weighted(np.repeat(template.columns, copies, axis=0), np.repeat(template.weights / copies, copies))


def _contract(template: Weighted, merge: Callable[[Columns, Columns, float, float], Columns]) -> Weighted:
    columns: list[Columns] = list(template.columns)
    weights: list[float] = template.weights.tolist()
    place = 0
    while place < len(weights) and len(weights) > 1:
        if weights[place] >= _LIGHT:
            place += 1
            continue
        before = weights[place - 1] if place > 0 else np.inf
        after = weights[place + 1] if place + 1 < len(weights) else np.inf
        place -= before <= after + TOLERANCE  # now the left one of the two that merge
        columns[place] = merge(columns[place], columns[place + 1], weights[place], weights[place + 1])
        weights[place] += weights[place + 1]
        del columns[place + 1], weights[place + 1]
    return Weighted(np.array(columns), np.array(weights))


@dataclass(frozen=True)
class _Soft:
    """Columns are float64 (N, f): the share of the clips' weight that has a 1."""

    features: int

    def start(self, words: U64) -> Columns:
        return bits(words, self.features).astype(np.float64)

    def local_cost(self, first: Columns, second: Columns) -> F64:
        return mean_difference(first, np.ascontiguousarray(second.T))

    def average(self, reference: Weighted, others: Sequence[Weighted], paths: Sequence[I64]) -> Weighted:
        weights = reference.weights.copy()
        total = reference.columns * weights[:, None]
        for other, path in zip(others, paths, strict=True):
            add_warped(total, weights, other.columns, _shares(other.weights, path), path)
        return Weighted(total / weights[:, None], weights / (len(others) + 1))

    def merge(self, left: Columns, right: Columns, left_weight: float, right_weight: float) -> Columns:
        return (left * left_weight + right * right_weight) / (left_weight + right_weight)

    def values(self, columns: Columns) -> F64:
        return columns.astype(np.float64)


@dataclass(frozen=True)
class _Hard:
    """Columns are uint64 (N, 2): the bits that are always 1, and those that are always 0.

    What two columns agree on is then the bitwise and of both, however many are combined and in what order.
    """

    features: int

    def start(self, words: U64) -> Columns:
        every = np.uint64((1 << self.features) - 1)
        return np.stack([words, ~words & every], axis=1)

    def local_cost(self, first: Columns, second: Columns) -> F64:
        against = (first[:, None, 0] & second[None, :, 1]) | (first[:, None, 1] & second[None, :, 0])
        return np.bitwise_count(against).astype(np.float64)

    def average(self, reference: Weighted, others: Sequence[Weighted], paths: Sequence[I64]) -> Weighted:
        weights = reference.weights.copy()
        columns = reference.columns.copy()
        for other, path in zip(others, paths, strict=True):
            first_use = np.searchsorted(path[:, 0], np.arange(len(columns)))
            columns &= np.bitwise_and.reduceat(other.columns[path[:, 1]], first_use, axis=0)
            np.add.at(weights, path[:, 0], _shares(other.weights, path)[path[:, 1]])
        return Weighted(columns, weights / (len(others) + 1))

    def merge(self, left: Columns, right: Columns, left_weight: float, right_weight: float) -> Columns:
        return left & right

    def values(self, columns: Columns) -> F64:
        ones, zeros = bits(columns[:, 0], self.features), bits(columns[:, 1], self.features)
        return (1.0 + ones - zeros) / 2


def _shares(weights: F64, path: I64) -> F64:
    """Split each column's weight evenly among the reference columns that use it."""
    return weights / np.bincount(path[:, 1], minlength=len(weights))


@nb.njit(cache=True, nogil=True)
def mean_difference(first: F64, second_transposed: F64) -> F64:
    """Return the mean over features of |x − y| for every pair of columns (kernel)."""
    rows, features = first.shape
    columns = second_transposed.shape[1]
    cost = np.zeros((rows, columns))
    for k in range(rows):
        for i in range(features):
            x = first[k, i]
            for column in range(columns):
                cost[k, column] += abs(x - second_transposed[i, column])
        for column in range(columns):
            cost[k, column] /= features
    return cost


@nb.njit(cache=True, nogil=True)
def add_warped(total: F64, weights: F64, columns: F64, shares: F64, path: I64) -> None:
    """Add the columns of a warped template to the weighted sums of the reference, in place (kernel)."""
    for cell in range(len(path)):
        k, column = path[cell, 0], path[cell, 1]
        share = shares[column]
        weights[k] += share
        for i in range(columns.shape[1]):
            total[k, i] += share * columns[column, i]
