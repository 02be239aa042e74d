"""How individuals of the genetic algorithm come about: drawn, chosen, recombined, mutated (thesis, 4.3 and 4.4).

An individual is a row of arrays. All operators work in place and allocate nothing; random numbers come from the
generator that they are given.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.bits import count_bits
from kinedex.ops.keyframes.fitness import INNER
from kinedex.ops.words import I64, U64


class Population(NamedTuple):
    """Individuals as arrays, one row each.

    counts: int64 (P,), how many keyframes (K). masks, values: uint64 (P, most). positions: int64 (P, most), template
    columns. lows, highs: int64 (P, most), the K − 1 gaps. results: float64 (P, 4), the weight of positive and of
    negative clips retrieved, the fitness, and the rank by which individuals are compared.
    """

    counts: I64
    masks: U64
    values: U64
    positions: I64
    lows: I64
    highs: I64
    results: npt.NDArray[np.float64]


class TemplateColumns(NamedTuple):
    """What keyframes are made of: the template's masks and values (N,), its usable columns, the features allowed."""

    masks: U64
    values: U64
    usable: I64
    allowed: np.uint64


class OperatorSettings(NamedTuple):
    """The settings of the operators (see `ops.keyframes.training_task.EvolutionSettings`)."""

    mean: float
    deviation: float
    least: int
    tolerance: float
    centre: float
    gap_step: float
    open_share: float
    keyframe_odds: float = 1 / 3
    entry_odds: float = 1 / 3


def new_population(rows: int, most: int) -> Population:
    """Workspace for so many individuals of up to so many keyframes."""
    shape = (rows, most)
    bits, numbers = np.uint64, np.int64
    return Population(
        np.zeros(rows, numbers), np.zeros(shape, bits), np.zeros(shape, bits), np.zeros(shape, numbers),
        np.zeros(shape, numbers), np.zeros(shape, numbers), np.zeros((rows, 4)),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def draw_individual(rng, people, row, columns, breeding, taken):  # type: ignore[no-untyped-def]
    """Algorithm 2: K from a normal distribution, K different columns, gaps around their spacing."""
    most = min(people.masks.shape[1], len(columns.usable))
    count = max(breeding.least, int(np.round(breeding.mean + breeding.deviation * rng.standard_normal())))
    count = max(1, min(count, most))
    _choose(rng, taken, len(columns.usable), count)
    for k in range(count):
        column = columns.usable[taken[k]]
        people.masks[row, k] = columns.masks[column]
        people.values[row, k] = columns.values[column]
        people.positions[row, k] = column
    people.counts[row] = count
    for k in range(count - 1):
        _draw_gap(rng, people, row, k, breeding)


@njit(**INNER)
def _draw_gap(rng, people, row, k, breeding):  # type: ignore[no-untyped-def]
    spacing = people.positions[row, k + 1] - people.positions[row, k]
    middle = spacing * breeding.centre
    low = middle - np.round(0.5 * spacing * rng.random() * breeding.tolerance)
    high = middle + np.round(0.5 * spacing * rng.random() * breeding.tolerance)
    # half a spacing may lie between two frames; the range holds the frames inside
    people.lows[row, k] = max(0, int(np.ceil(low)))
    people.highs[row, k] = max(people.lows[row, k], int(np.floor(high)))


@njit(**INNER)
def _choose(rng, taken, total, count):  # type: ignore[no-untyped-def]
    """Put `count` different numbers below `total` into taken, ascending (Floyd's sampling)."""
    for n in range(count):
        j = total - count + n
        fresh = int(rng.random() * (j + 1))
        for i in range(n):
            if taken[i] == fresh:
                fresh = j
                break
        i = n
        while i > 0 and taken[i - 1] > fresh:
            taken[i] = taken[i - 1]
            i -= 1
        taken[i] = fresh


@njit(cache=True, nogil=True)
def select_parents(fitness, rows, chosen, offset):  # type: ignore[no-untyped-def]
    """Stochastic universal sampling (Baker 1987): pointers at equal distances over the fitness of these rows."""
    total = 0.0
    for row in rows:
        total += fitness[row]
    count = len(chosen)
    flat = total <= 0.0
    if flat:
        total = float(len(rows))
    place = 0
    passed = 1.0 if flat else fitness[rows[0]]
    for number in range(count):
        pointer = (offset + number) * total / count
        while passed <= pointer and place < len(rows) - 1:
            place += 1
            passed += 1.0 if flat else fitness[rows[place]]
        chosen[number] = rows[place]


@njit(cache=True, nogil=True)
def crossover(rng, people, one, other, row, breeding, taken):  # type: ignore[no-untyped-def]
    """Merge some keyframes of each parent in the order of their columns; gaps as at the beginning (Figure 4.1 a)."""
    people.counts[row] = 0
    for parent in (one, other):
        part = 1 + int(rng.random() * people.counts[parent])
        _choose(rng, taken, people.counts[parent], part)
        for i in range(part):
            k = taken[i]
            _insert(people, row, people.masks[parent, k], people.values[parent, k], people.positions[parent, k])
    for k in range(people.counts[row] - 1):
        _draw_gap(rng, people, row, k, breeding)


@njit(**INNER)
def _insert(people, row, mask, value, position):  # type: ignore[no-untyped-def]
    """Insert a keyframe by its column and say where; −1 where it is there already, or where there is no room."""
    count = people.counts[row]
    for k in range(count):
        same = people.masks[row, k] == mask and people.values[row, k] == value
        if same and people.positions[row, k] == position:
            return -1
    if count == people.masks.shape[1]:
        return -1
    k = count
    while k > 0 and people.positions[row, k - 1] > position:
        people.masks[row, k] = people.masks[row, k - 1]
        people.values[row, k] = people.values[row, k - 1]
        people.positions[row, k] = people.positions[row, k - 1]
        k -= 1
    people.masks[row, k] = mask
    people.values[row, k] = value
    people.positions[row, k] = position
    people.counts[row] = count + 1
    return k


@njit(cache=True, nogil=True)
def mutate(rng, people, row, columns, breeding):  # type: ignore[no-untyped-def]
    """Apply one of the mutations of Figure 4.1 (b); adding and removing are as likely, so are fixing and opening."""
    kind = rng.random()
    first = rng.random() < 0.5
    if kind < breeding.keyframe_odds and first:
        _add_keyframe(rng, people, row, columns, breeding)
    elif kind < breeding.keyframe_odds:
        _remove_keyframe(rng, people, row, breeding.least)
    elif kind < breeding.keyframe_odds + breeding.entry_odds:
        _change_entries(rng, people, row, columns.allowed, first, breeding.open_share)
    else:
        mutate_gaps(rng, people, row, breeding.gap_step)


@njit(**INNER)
def _add_keyframe(rng, people, row, columns, breeding):  # type: ignore[no-untyped-def]
    column = columns.usable[int(rng.random() * len(columns.usable))]
    k = _insert(people, row, columns.masks[column], columns.values[column], column)
    if k < 0:
        return
    # the gap that the new keyframe divides is drawn anew on both sides, the others stay
    last = people.counts[row] - 1
    for j in range(last - 1, k, -1):
        people.lows[row, j] = people.lows[row, j - 1]
        people.highs[row, j] = people.highs[row, j - 1]
    if k > 0:
        _draw_gap(rng, people, row, k - 1, breeding)
    if k < last:
        _draw_gap(rng, people, row, k, breeding)


@njit(**INNER)
def _remove_keyframe(rng, people, row, least):  # type: ignore[no-untyped-def]
    count = people.counts[row]
    if count <= least:
        return
    k = int(rng.random() * count)
    lows, highs = people.lows[row], people.highs[row]
    if 0 < k < count - 1:
        # what both gaps admitted together is admitted now
        lows[k - 1] += lows[k]
        highs[k - 1] += highs[k]
    for j in range(k, count - 2):
        lows[j] = lows[j + 1]
        highs[j] = highs[j + 1]
    for j in range(k, count - 1):
        people.masks[row, j] = people.masks[row, j + 1]
        people.values[row, j] = people.values[row, j + 1]
        people.positions[row, j] = people.positions[row, j + 1]
    people.counts[row] = count - 1


@njit(**INNER)
def _change_entries(rng, people, row, allowed, specialise, share):  # type: ignore[no-untyped-def]
    """Fix a wildcard of a keyframe, or open a fixed entry; of the latter several at once, up to a share of them."""
    k = int(rng.random() * people.counts[row])
    masks, values = people.masks[row], people.values[row]
    total = count_bits(allowed & ~masks[k] if specialise else masks[k])
    times = 1
    if not specialise and share > 0.0:
        times += int(rng.random() * share * total)
    for _ in range(times):
        # a keyframe keeps one entry at least
        if total == 0 or (not specialise and total == 1):
            return
        bit = _bit(allowed & ~masks[k] if specialise else masks[k], int(rng.random() * total))
        total -= 1
        if specialise:
            masks[k] |= bit
            if rng.random() < 0.5:
                values[k] |= bit
        else:
            masks[k] &= ~bit
            values[k] &= ~bit


@njit(**INNER)
def _bit(bits, number):  # type: ignore[no-untyped-def]
    """The bit of this number, from 0, among those that are on."""
    for _ in range(number):
        bits &= bits - np.uint64(1)
    return bits & (~bits + np.uint64(1))


@njit(cache=True, nogil=True)
def mutate_gaps(rng, people, row, gap_step):  # type: ignore[no-untyped-def]
    """Change both ends of every gap at random, by up to a share of the keyframes' spacing and at least a frame."""
    for k in range(people.counts[row] - 1):
        step = max(1.0, gap_step * (people.positions[row, k + 1] - people.positions[row, k]))
        low = people.lows[row, k] + int(np.round((2.0 * rng.random() - 1.0) * step))
        high = people.highs[row, k] + int(np.round((2.0 * rng.random() - 1.0) * step))
        people.lows[row, k] = max(0, min(low, high))
        people.highs[row, k] = max(0, low, high)


@njit(**INNER)
def copy_individual(people, source, target):  # type: ignore[no-untyped-def]
    """Copy an individual and its results into another row."""
    people.counts[target] = people.counts[source]
    for k in range(people.counts[source]):
        people.masks[target, k] = people.masks[source, k]
        people.values[target, k] = people.values[source, k]
        people.positions[target, k] = people.positions[source, k]
        people.lows[target, k] = people.lows[source, k]
        people.highs[target, k] = people.highs[source, k]
    for i in range(people.results.shape[1]):
        people.results[target, i] = people.results[source, i]
