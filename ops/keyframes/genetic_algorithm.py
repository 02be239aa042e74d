"""This module implements the genetic algorithm that learns a keyframe query from clips (thesis, Algorithm 3)."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64, U64
from kinedex.ops.bits import count_bits
from kinedex.ops.keyframes.fitness import INNER, find_bitmaps, fitness_of, new_workspace, retrieve
from kinedex.ops.keyframes.genetic_operators import (
    OperatorSettings,
    Population,
    TemplateColumns,
    copy_individual,
    crossover,
    draw_individual,
    mutate,
    mutate_gaps,
    new_population,
    select_parents,
)
from kinedex.ops.keyframes.training_task import (
    HISTORY_COLUMNS,
    MAX_KEYFRAMES,
    OFFSPRING,
    PARENTS,
    EvolutionSettings,
    Individual,
    LearningRun,
    TrainingTask,
)

BETA = 2.0
"""The weight of recall relative to precision in the fitness (thesis, Eq. 4.11)."""


def evolve(task: TrainingTask, settings: EvolutionSettings, seed: int | tuple[int, ...]) -> LearningRun:
    """Run the genetic algorithm once (thesis, Section 4.4, Algorithm 3).

    Parameters
    ----------
    task : TrainingTask
        The clips and the template columns.
    settings : EvolutionSettings
        The settings of the algorithm.
    seed : int or tuple of int
        The seed of the random numbers; the same seed gives the same run, on any machine and in any process.

    Returns
    -------
    LearningRun
        The individual of the highest rank in the last generation; of equal ones the oldest. Parents are selected by
        fitness, and survivors by rank; without costs these are the same, as in the thesis.
    """
    population = new_population(settings.population + OFFSPRING, MAX_KEYFRAMES)
    history = np.zeros((settings.generations + 1, len(HISTORY_COLUMNS)))
    space = new_workspace(task.frames, MAX_KEYFRAMES)
    sizes = (settings.population, PARENTS, settings.generations)
    operators = OperatorSettings(least=settings.least_keyframes, open_share=float(settings.open_share))
    best, evaluated = _evolve(
        _random(seed), population, _columns(task), space, history, sizes, operators, _criteria(settings, task)
    )  # fmt: skip
    return _learning_run(population, best, history, evaluated)


def random_search(task: TrainingTask, settings: EvolutionSettings, seed: int | tuple[int, ...]) -> LearningRun:
    """Return the best of as many random individuals (Algorithm 2) as a run evaluates, as a baseline.

    Parameters
    ----------
    task, settings, seed
        As in `evolve`.

    Returns
    -------
    LearningRun
    """
    return evolve(task, replace(settings, population=settings.budget, generations=0), seed)


def tune_gaps(
    task: TrainingTask, query: Individual, settings: EvolutionSettings, seed: int | tuple[int, ...]
) -> LearningRun:
    """Optimise the gaps of a query by random mutations (thesis, Section 4.4).

    One mutation is tried at a time, and kept unless it lowers the rank. The number of trials equals the number of
    offspring of a run; it is 0 if the query has no gap. The history has a row for every group of trials with as many
    trials as a generation has offspring.

    Parameters
    ----------
    task, settings, seed
        As in `evolve`.
    query : Individual
        The query, whose keyframes are not changed.

    Returns
    -------
    LearningRun
    """
    most = max(MAX_KEYFRAMES, len(query))
    population = new_population(2, most)
    _set_row(population, 0, query)
    history = np.zeros((settings.generations + 1, len(HISTORY_COLUMNS)))
    space = new_workspace(task.frames, most)
    tries = OFFSPRING if len(query) > 1 else 0
    _tune(
        _random(seed), population, np.arange(2), space, history, tries, _criteria(settings, task)
    )  # fmt: skip
    return _learning_run(population, 0, history, 1 + tries * settings.generations)


def evaluate(task: TrainingTask, query: Individual, settings: EvolutionSettings) -> tuple[float, float, float, float]:
    """Return the numbers of positive and negative clips that a query retrieves, its fitness, and its rank."""
    population = new_population(1, len(query))
    _set_row(population, 0, query)
    space = new_workspace(task.frames, len(query))
    _evaluate(population, 0, space, _criteria(settings, task))
    found, wrong, fitness, rank = population.results[0].tolist()
    return found, wrong, fitness, rank


def rank_bound(task: TrainingTask, query: Individual, settings: EvolutionSettings) -> float:
    """Return an upper bound of a query's rank over all gaps: the rank with perfect fitness and gaps of zero width."""
    outside = (int(query.positions[0]) + len(task.masks) - 1 - int(query.positions[-1])) / len(task.masks)
    return 1.0 - settings.parsimony * query.fixed - settings.outside_cost * outside


# ---- between individuals and arrays ----------------------------------------------------------------------


class _Criteria(NamedTuple):
    """The criteria by which individuals are judged: clips of a `TrainingTask`, and settings of fitness and rank.

    The first `positives` clips belong to the class. `columns` is the number of template columns, and `outside_cost` is
    the cost of a column outside the keyframes.
    """

    on: U64
    off: U64
    valid: U64
    first: I64
    positives: int
    parsimony: float
    gap_cost: float
    outside_cost: float
    tempo: float
    columns: int


def _random(seed: int | tuple[int, ...]) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))


def _columns(task: TrainingTask) -> TemplateColumns:
    return TemplateColumns(task.masks, task.values, task.columns, np.uint64(task.allowed))


def _criteria(settings: EvolutionSettings, task: TrainingTask) -> _Criteria:
    frames, columns = task.frames, len(task.masks)
    return _Criteria(
        frames.on, frames.off, frames.valid, frames.first, task.positives, float(settings.parsimony),
        float(settings.gap_cost), settings.outside_cost / columns, float(settings.tempo), columns,
    )  # fmt: skip


def _learning_run(population: Population, row: int, history: F64, evaluated: int) -> LearningRun:
    """Return the individual of a row as the result of a run."""
    count = int(population.counts[row])
    query = Individual(
        population.masks[row, :count].copy(),
        population.values[row, :count].copy(),
        population.positions[row, :count].copy(),
        population.lows[row, : count - 1].copy(),
        population.highs[row, : count - 1].copy(),
    )
    fitness, rank = population.results[row, 2:].tolist()
    return LearningRun(query, fitness, rank, history, int(evaluated))


def _set_row(population: Population, row: int, query: Individual) -> None:
    """Write an individual to a row."""
    count = len(query)
    population.counts[row] = count
    for part, given in zip(population[1:4], (query.masks, query.values, query.positions), strict=True):
        part[row, :count] = given
    for part, given in zip(population[4:6], (query.lows, query.highs), strict=True):
        part[row, : count - 1] = given


# ---- kernels ---------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def _evolve(rng, population, columns, space, history, sizes, operators, criteria):  # type: ignore[no-untyped-def]
    """Evolve a population, and return the row of the best individual and the number of evaluated individuals."""
    size, parents, generations = sizes
    rows, most = population.masks.shape
    order = np.arange(rows)
    chosen = np.zeros(parents, np.int64)
    spare = np.zeros(max(most, len(columns.usable)), np.int64)
    evaluated = 0
    for row in range(size):
        draw_individual(rng, population, row, columns, operators, spare)
        evaluated += _evaluate_new(population, order, row, space, criteria)
    _sort(order, population, min(1, size), size)
    _record(history[0], order, population, size, criteria.positives)
    for generation in range(1, generations + 1):
        select_parents(population.results[:, 2], order[:size], chosen, rng.random())
        place = size
        for one in range(parents):
            for other in range(one + 1, parents):
                row = order[place]
                crossover(rng, population, chosen[one], chosen[other], row, operators, spare)
                mutate(rng, population, row, columns, operators)
                evaluated += _evaluate_new(population, order, place, space, criteria)
                place += 1
        _sort(order, population, size, rows)
        _record(history[generation], order, population, size, criteria.positives)
    return order[0], evaluated


@njit(cache=True, nogil=True)
def _tune(rng, population, rows, space, history, tries, criteria):  # type: ignore[no-untyped-def]
    """Improve the gaps of the first row by mutations that are tried in the second row."""
    # rows come in an array: for literal arguments, numba would compile the called kernel once per value
    best, changed, one = rows[0], rows[1], len(rows) - 1
    _evaluate(population, best, space, criteria)
    for generation in range(len(history)):
        if generation > 0:
            for _ in range(tries):
                copy_individual(population, best, changed)
                mutate_gaps(rng, population, changed)
                _evaluate(population, changed, space, criteria)
                if population.results[changed, 3] >= population.results[best, 3]:
                    copy_individual(population, changed, best)
        _record(history[generation], rows, population, one, criteria.positives)


@njit(**INNER)
def _evaluate_new(population, order, place, space, criteria):  # type: ignore[no-untyped-def]
    """Evaluate an individual unless an equal one precedes it in the order; return 1 if it was evaluated."""
    row = order[place]
    for before in range(place):
        if _equal(population, order[before], row, criteria.outside_cost > 0.0):
            for i in range(population.results.shape[1]):
                population.results[row, i] = population.results[order[before], i]
            return 0
    _evaluate(population, row, space, criteria)
    return 1


@njit(**INNER)
def _equal(population, one, other, placed):  # type: ignore[no-untyped-def]
    """Return True if two individuals are equal, in the columns of their outer keyframes too if `placed`."""
    count = population.counts[one]
    if count != population.counts[other]:
        return False
    if placed:
        # an equal query from other columns leaves another part of the template outside, so its rank differs
        last = count - 1
        if population.positions[one, 0] != population.positions[other, 0]:
            return False
        if population.positions[one, last] != population.positions[other, last]:
            return False
    for k in range(count):
        if (
            population.masks[one, k] != population.masks[other, k]
            or population.values[one, k] != population.values[other, k]
        ):
            return False
        gap = (
            population.lows[one, k] != population.lows[other, k]
            or population.highs[one, k] != population.highs[other, k]
        )
        if k < count - 1 and gap:
            return False
    return True


@njit(cache=True, nogil=True)
def _evaluate(population, row, space, criteria):  # type: ignore[no-untyped-def]
    """Evaluate an individual, and write the clips retrieved, its fitness, and its rank."""
    count = population.counts[row]
    lows, highs = population.lows[row], population.highs[row]
    find_bitmaps(criteria.on, criteria.off, criteria.valid, population.masks[row], population.values[row], count, space)
    for k in range(count - 1):
        # a positive clip must be retrieved even if it were slower or faster by the tempo tolerance
        space.lows[k] = int(np.ceil(lows[k] * (1.0 + criteria.tempo) - 1e-9))
        space.highs[k] = int(np.floor(highs[k] / (1.0 + criteria.tempo) + 1e-9))
    retrieve(count, space.lows, space.highs, lows, highs, criteria.first, criteria.positives, space)
    found = 0.0
    wrong = 0.0
    for t in range(len(space.hit)):
        if space.hit[t]:
            if t < criteria.positives:
                found += 1.0
            else:
                wrong += 1.0
    fitness = fitness_of(found, wrong, float(criteria.positives), BETA)
    outside = population.positions[row, 0] + criteria.columns - 1 - population.positions[row, count - 1]
    rank = fitness - criteria.outside_cost * outside
    for k in range(count):
        rank -= criteria.parsimony * count_bits(population.masks[row, k])
        if k < count - 1:
            rank -= criteria.gap_cost * (highs[k] - lows[k])
    population.results[row, 0] = found
    population.results[row, 1] = wrong
    population.results[row, 2] = fitness
    population.results[row, 3] = rank


@njit(**INNER)
def _sort(order, population, begin, end):  # type: ignore[no-untyped-def]
    """Sort by rank by insertion, starting from `begin`; the rows before it are sorted, and ties stay in order."""
    for place in range(begin, end):
        row = order[place]
        rank = population.results[row, 3]
        i = place
        while i > 0 and population.results[order[i - 1], 3] < rank:
            order[i] = order[i - 1]
            i -= 1
        order[i] = row


@njit(**INNER)
def _record(means, order, population, size, wanted):  # type: ignore[no-untyped-def]
    """Write a row of the history: means over the individuals, and the fitness of the best one."""
    for place in range(size):
        found, wrong = population.results[order[place], 0], population.results[order[place], 1]
        if found > 0.0:
            means[0] += found / (found + wrong) / size
            means[1] += found / wanted / size
        means[2] += population.results[order[place], 2] / size
    means[3] = population.results[order[0], 2]
