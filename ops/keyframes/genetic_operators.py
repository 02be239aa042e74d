"""This module implements the genetic operators: initialisation, selection, recombination, mutation (thesis, 4.3, 4.4).

An individual is a row of arrays. All operators work in place without allocating; random numbers come from the generator
that is passed in.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64, U64
from kinedex.ops.bits import count_bits
from kinedex.ops.keyframes.fitness import INNER

GAP_STEP = 0.5
"""The largest change of either end of a gap by a mutation, relative to the spacing of columns."""


class Population(NamedTuple):
    """P individuals as arrays, one row each.

    Parameters
    ----------
    counts : int64 array (P,)
        The number of keyframes K of each individual.
    masks, values : uint64 array (P, most)
        The keyframes, which are the first K entries of a row.
    positions : int64 array (P, most)
        The template columns of the keyframes.
    lows, highs : int64 array (P, most)
        The K - 1 gaps.
    results : float64 array (P, 4)
        The numbers of positive and of negative clips retrieved, the fitness, and the rank by which individuals are
        compared.
    """

    counts: I64
    masks: U64
    values: U64
    positions: I64
    lows: I64
    highs: I64
    results: F64


class TemplateColumns(NamedTuple):
    """The columns of a class template, from which keyframes are made.

    Parameters
    ----------
    masks, values : uint64 array (N,)
        The columns.
    usable : int64 array (n,)
        The columns that fix any feature.
    allowed : uint64
        The features that keyframes may fix.
    """

    masks: U64
    values: U64
    usable: I64
    allowed: np.uint64


class OperatorSettings(NamedTuple):
    """The settings of the operators, with the values of the thesis.

    Parameters
    ----------
    mean, deviation : float
        Mean and standard deviation of the number of keyframes of an initial individual.
    least : int
        The smallest number of keyframes.
    tolerance : float
        The upper end of the uniform distribution from which tolerances of gaps are drawn, U(0, 2) in Algorithm 2.
    centre : float
        The centre of initial gaps, as a fraction of the spacing of the columns.
    open_share : float
        The largest fraction of a keyframe's entries that a generalisation turns into wildcards at a time.
    keyframe_odds, entry_odds : float
        The probabilities that a mutation changes keyframes, and that it changes entries; other mutations change gaps.
    """

    mean: float = 3.0
    deviation: float = 2.0
    least: int = 2
    tolerance: float = 2.0
    centre: float = 1.0
    open_share: float = 0.0
    keyframe_odds: float = 1 / 3
    entry_odds: float = 1 / 3


def new_population(rows: int, most: int) -> Population:
    """Allocate a population of `rows` individuals with at most `most` keyframes each."""
    shape = (rows, most)
    bits, numbers = np.uint64, np.int64
    return Population(
        np.zeros(rows, numbers), np.zeros(shape, bits), np.zeros(shape, bits), np.zeros(shape, numbers),
        np.zeros(shape, numbers), np.zeros(shape, numbers), np.zeros((rows, 4)),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def draw_individual(rng, population, row, columns, settings, spare):  # type: ignore[no-untyped-def]
    """Draw an initial individual: K template columns and gaps around their spacing (thesis, Algorithm 2)."""
    most = min(population.masks.shape[1], len(columns.usable))
    count = max(settings.least, int(np.round(settings.mean + settings.deviation * rng.standard_normal())))
    count = max(1, min(count, most))
    _choose(rng, spare, len(columns.usable), count)
    for k in range(count):
        column = columns.usable[spare[k]]
        population.masks[row, k] = columns.masks[column]
        population.values[row, k] = columns.values[column]
        population.positions[row, k] = column
    population.counts[row] = count
    for k in range(count - 1):
        _draw_gap(rng, population, row, k, settings)


@njit(**INNER)
def _draw_gap(rng, population, row, k, settings):  # type: ignore[no-untyped-def]
    """Draw the gap between two keyframes around the spacing of their columns, at random."""
    spacing = population.positions[row, k + 1] - population.positions[row, k]
    middle = spacing * settings.centre
    low = middle - np.round(0.5 * spacing * rng.random() * settings.tolerance)
    high = middle + np.round(0.5 * spacing * rng.random() * settings.tolerance)
    # half a spacing may be fractional; the range holds the whole frames inside
    population.lows[row, k] = max(0, int(np.ceil(low)))
    population.highs[row, k] = max(population.lows[row, k], int(np.floor(high)))


@njit(**INNER)
def _choose(rng, chosen, total, count):  # type: ignore[no-untyped-def]
    """Write `count` different numbers below `total` to `chosen`, ascending (Floyd's sampling)."""
    for n in range(count):
        j = total - count + n
        fresh = int(rng.random() * (j + 1))
        for i in range(n):
            if chosen[i] == fresh:
                fresh = j
                break
        i = n
        while i > 0 and chosen[i - 1] > fresh:
            chosen[i] = chosen[i - 1]
            i -= 1
        chosen[i] = fresh


@njit(cache=True, nogil=True)
def select_parents(fitness, rows, chosen, offset):  # type: ignore[no-untyped-def]
    """Select parents by stochastic universal sampling, with equally spaced pointers over the fitness (Baker 1987)."""
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
def crossover(rng, population, one, other, row, settings, spare):  # type: ignore[no-untyped-def]
    """Recombine two parents: merge random keyframes of each by their columns, with new gaps (thesis, Figure 4.1 a)."""
    population.counts[row] = 0
    for parent in (one, other):
        part = 1 + int(rng.random() * population.counts[parent])
        _choose(rng, spare, population.counts[parent], part)
        for i in range(part):
            k = spare[i]
            _insert(
                population,
                row,
                population.masks[parent, k],
                population.values[parent, k],
                population.positions[parent, k],
            )
    for k in range(population.counts[row] - 1):
        _draw_gap(rng, population, row, k, settings)


@njit(**INNER)
def _insert(population, row, mask, value, position):  # type: ignore[no-untyped-def]
    """Insert a keyframe by its column and return its index, or -1 if it is a duplicate or the individual is full."""
    count = population.counts[row]
    for k in range(count):
        same = population.masks[row, k] == mask and population.values[row, k] == value
        if same and population.positions[row, k] == position:
            return -1
    if count == population.masks.shape[1]:
        return -1
    k = count
    while k > 0 and population.positions[row, k - 1] > position:
        population.masks[row, k] = population.masks[row, k - 1]
        population.values[row, k] = population.values[row, k - 1]
        population.positions[row, k] = population.positions[row, k - 1]
        k -= 1
    population.masks[row, k] = mask
    population.values[row, k] = value
    population.positions[row, k] = position
    population.counts[row] = count + 1
    return k


@njit(cache=True, nogil=True)
def mutate(rng, population, row, columns, settings):  # type: ignore[no-untyped-def]
    """Apply a random mutation (thesis, Figure 4.1 b); each kind is as likely as its reverse."""
    kind = rng.random()
    first = rng.random() < 0.5
    if kind < settings.keyframe_odds and first:
        _add_keyframe(rng, population, row, columns, settings)
    elif kind < settings.keyframe_odds:
        _remove_keyframe(rng, population, row, settings.least)
    elif kind < settings.keyframe_odds + settings.entry_odds:
        _change_entries(rng, population, row, columns.allowed, first, settings.open_share)
    else:
        mutate_gaps(rng, population, row)


@njit(**INNER)
def _add_keyframe(rng, population, row, columns, settings):  # type: ignore[no-untyped-def]
    """Insert a random template column as a keyframe."""
    column = columns.usable[int(rng.random() * len(columns.usable))]
    k = _insert(population, row, columns.masks[column], columns.values[column], column)
    if k < 0:
        return
    # the gaps on both sides of the new keyframe are redrawn, the others are kept
    last = population.counts[row] - 1
    for j in range(last - 1, k, -1):
        population.lows[row, j] = population.lows[row, j - 1]
        population.highs[row, j] = population.highs[row, j - 1]
    if k > 0:
        _draw_gap(rng, population, row, k - 1, settings)
    if k < last:
        _draw_gap(rng, population, row, k, settings)


@njit(**INNER)
def _remove_keyframe(rng, population, row, least):  # type: ignore[no-untyped-def]
    """Remove a random keyframe of the individual in a row, unless it has only `least` keyframes."""
    count = population.counts[row]
    if count <= least:
        return
    k = int(rng.random() * count)
    lows, highs = population.lows[row], population.highs[row]
    if 0 < k < count - 1:
        # the new gap allows the sum of what both gaps allowed
        lows[k - 1] += lows[k]
        highs[k - 1] += highs[k]
    for j in range(k, count - 2):
        lows[j] = lows[j + 1]
        highs[j] = highs[j + 1]
    for j in range(k, count - 1):
        population.masks[row, j] = population.masks[row, j + 1]
        population.values[row, j] = population.values[row, j + 1]
        population.positions[row, j] = population.positions[row, j + 1]
    population.counts[row] = count - 1


@njit(**INNER)
def _change_entries(rng, population, row, allowed, specialise, share):  # type: ignore[no-untyped-def]
    """Specialise a keyframe by fixing a wildcard, or generalise it by turning one entry or more into wildcards.

    At most the fraction `share` of the entries is turned into wildcards, but always one, unless it is the last one.
    """
    k = int(rng.random() * population.counts[row])
    masks, values = population.masks[row], population.values[row]
    total = count_bits(allowed & ~masks[k] if specialise else masks[k])
    times = 1
    if not specialise and share > 0.0:
        times += int(rng.random() * share * total)
    for _ in range(times):
        # a keyframe keeps at least one fixed entry
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
    """Return the set bit with a given number, counted from 0 among the set bits."""
    for _ in range(number):
        bits &= bits - np.uint64(1)
    return bits & (~bits + np.uint64(1))


@njit(cache=True, nogil=True)
def mutate_gaps(rng, population, row):  # type: ignore[no-untyped-def]
    """Change both ends of every gap at random, by up to a fraction of the spacing of the columns or one frame."""
    for k in range(population.counts[row] - 1):
        step = max(1.0, GAP_STEP * (population.positions[row, k + 1] - population.positions[row, k]))
        low = population.lows[row, k] + int(np.round((2.0 * rng.random() - 1.0) * step))
        high = population.highs[row, k] + int(np.round((2.0 * rng.random() - 1.0) * step))
        population.lows[row, k] = max(0, min(low, high))
        population.highs[row, k] = max(0, low, high)


@njit(**INNER)
def copy_individual(population, source, target):  # type: ignore[no-untyped-def]
    """Copy an individual and its results into another row."""
    population.counts[target] = population.counts[source]
    for k in range(population.counts[source]):
        population.masks[target, k] = population.masks[source, k]
        population.values[target, k] = population.values[source, k]
        population.positions[target, k] = population.positions[source, k]
        population.lows[target, k] = population.lows[source, k]
        population.highs[target, k] = population.highs[source, k]
    for i in range(population.results.shape[1]):
        population.results[target, i] = population.results[source, i]
