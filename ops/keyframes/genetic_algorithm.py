"""One run of the genetic algorithm that learns a keyframe query from positive and negative clips (thesis, 4)."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

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
from kinedex.ops.keyframes.individuals import Individual
from kinedex.ops.keyframes.training_task import HISTORY_COLUMNS, EvolutionSettings, LearningRun, TrainingTask
from kinedex.ops.words import I64, U64

F64 = npt.NDArray[np.float64]


def evolve(material: TrainingTask, evolution: EvolutionSettings, seed: int | tuple[int, ...]) -> LearningRun:
    """Run the genetic algorithm once (thesis, Algorithm 3).

    Parameters
    ----------
    material: clips and template columns.
    evolution: the numbers of the algorithm.
    seed: what the random numbers follow from; the same seed gives the same run, on any machine and in any process.

    Returns
    -------
    The individual of the last generation that ranks highest; of equal ones the oldest. Parents are drawn by fitness,
    and those that rank highest survive; without costs both are the same, as in the thesis.
    """
    people = new_population(evolution.population + evolution.offspring, evolution.most_keyframes)
    history = np.zeros((evolution.generations + 1, len(HISTORY_COLUMNS)))
    room = new_workspace(material.frames, evolution.most_keyframes)
    sizes = (evolution.population, evolution.parents, evolution.generations)
    best, evaluated = _evolve(
        _random(seed), people, _clips(material), _columns(material), room, history, sizes, _breeding(evolution),
        _judging(evolution, material),
    )  # fmt: skip
    return _run(people, best, history, evaluated)


def random_search(material: TrainingTask, evolution: EvolutionSettings, seed: int | tuple[int, ...]) -> LearningRun:
    """Draw as many initial individuals as a run makes individuals in all, and keep the fittest (Algorithm 2 alone)."""
    return evolve(material, replace(evolution, population=evolution.budget, generations=0), seed)


def tune_gaps(
    material: TrainingTask, query: Individual, evolution: EvolutionSettings, seed: int | tuple[int, ...]
) -> LearningRun:
    """Improve the gaps of a query by the same mutations, one at a time, keeping what is no worse.

    As many are tried as a run makes offspring, none where there is no gap. The history has the best one after each
    generation's worth.
    """
    most = max(evolution.most_keyframes, len(query))
    people = new_population(2, most)
    _put(people, 0, query)
    history = np.zeros((evolution.generations + 1, len(HISTORY_COLUMNS)))
    room = new_workspace(material.frames, most)
    tries = evolution.offspring if len(query) > 1 else 0
    _tune(
        _random(seed), people, np.arange(2), _clips(material), room, history, tries, evolution.gap_step,
        _judging(evolution, material),
    )  # fmt: skip
    return _run(people, 0, history, 1 + tries * evolution.generations)


def evaluate(
    material: TrainingTask, query: Individual, evolution: EvolutionSettings
) -> tuple[float, float, float, float]:
    """The weight of positive and of negative clips that a query retrieves, its fitness and its rank, as in a run."""
    people = new_population(1, len(query))
    _put(people, 0, query)
    _evaluate(people, 0, _clips(material), new_workspace(material.frames, len(query)), _judging(evolution, material))
    found, wrong, fitness, rank = people.results[0].tolist()
    return found, wrong, fitness, rank


def rank_bound(material: TrainingTask, query: Individual, evolution: EvolutionSettings) -> float:
    """The rank of a query that tells all clips apart with gaps of one length: no other gaps make it rank higher."""
    outside = (int(query.positions[0]) + len(material.masks) - 1 - int(query.positions[-1])) / len(material.masks)
    return 1.0 - evolution.parsimony * query.fixed - evolution.outside_cost * outside


# ---- between queries and arrays --------------------------------------------------------------------------


class _Clips(NamedTuple):
    """The clips of a `TrainingTask`; wanted: the weight of the positive ones."""

    on: U64
    off: U64
    valid: U64
    first: I64
    positives: int
    weights: F64
    wanted: float


class _Judging(NamedTuple):
    """The numbers by which individuals are judged. columns: of the template. outside_cost: of one column."""

    beta: float
    parsimony: float
    gap_cost: float
    outside_cost: float
    tempo: float
    columns: int


def _random(seed: int | tuple[int, ...]) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))


def _clips(material: TrainingTask) -> _Clips:
    frames, weights = material.frames, material.weights
    wanted = float(weights[: material.positives].sum())
    return _Clips(frames.on, frames.off, frames.valid, frames.first, material.positives, weights, wanted)


def _columns(material: TrainingTask) -> TemplateColumns:
    return TemplateColumns(material.masks, material.values, material.columns, np.uint64(material.allowed))


def _breeding(evolution: EvolutionSettings) -> OperatorSettings:
    return OperatorSettings(
        float(evolution.keyframes_mean),
        float(evolution.keyframes_sd),
        evolution.least_keyframes,
        float(evolution.gap_tolerance),
        0.5 if evolution.initial_gaps == "printed" else 1.0,
        float(evolution.gap_step),
        float(evolution.open_share),
        evolution.mutations[0] / sum(evolution.mutations),
        evolution.mutations[1] / sum(evolution.mutations),
    )


def _judging(evolution: EvolutionSettings, material: TrainingTask) -> _Judging:
    columns = len(material.masks)
    return _Judging(
        float(evolution.beta),
        float(evolution.parsimony),
        float(evolution.gap_cost),
        evolution.outside_cost / columns,
        float(evolution.tempo),
        columns,
    )


def _run(people: Population, row: int, history: F64, evaluated: int) -> LearningRun:
    count = int(people.counts[row])
    query = Individual(
        people.masks[row, :count].copy(),
        people.values[row, :count].copy(),
        people.positions[row, :count].copy(),
        people.lows[row, : count - 1].copy(),
        people.highs[row, : count - 1].copy(),
    )
    fitness, rank = people.results[row, 2:].tolist()
    return LearningRun(query, fitness, rank, history, int(evaluated))


def _put(people: Population, row: int, query: Individual) -> None:
    count = len(query)
    people.counts[row] = count
    for part, given in zip(people[1:4], (query.masks, query.values, query.positions), strict=True):
        part[row, :count] = given
    for part, given in zip(people[4:6], (query.lows, query.highs), strict=True):
        part[row, : count - 1] = given


# ---- kernels ---------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def _evolve(rng, people, clips, columns, room, history, sizes, breeding, judging):  # type: ignore[no-untyped-def]
    population, parents, generations = sizes
    rows, most = people.masks.shape
    order = np.arange(rows)
    chosen = np.zeros(parents, np.int64)
    taken = np.zeros(max(most, len(columns.usable)), np.int64)
    evaluated = 0
    for row in range(population):
        draw_individual(rng, people, row, columns, breeding, taken)
        evaluated += _evaluate_new(people, order, row, clips, room, judging)
    _sort(order, people, min(1, population), population)
    _remember(history[0], order, people, population, clips.wanted)
    for generation in range(1, generations + 1):
        select_parents(people.results[:, 2], order[:population], chosen, rng.random())
        place = population
        for one in range(parents):
            for other in range(one + 1, parents):
                row = order[place]
                crossover(rng, people, chosen[one], chosen[other], row, breeding, taken)
                mutate(rng, people, row, columns, breeding)
                evaluated += _evaluate_new(people, order, place, clips, room, judging)
                place += 1
        _sort(order, people, population, rows)
        _remember(history[generation], order, people, population, clips.wanted)
    return order[0], evaluated


@njit(cache=True, nogil=True)
def _tune(rng, people, rows, clips, room, history, tries, gap_step, judging):  # type: ignore[no-untyped-def]
    # Rows come in an array: with a number written into a call, numba would compile what is called once for each.
    best, changed, one = rows[0], rows[1], len(rows) - 1
    _evaluate(people, best, clips, room, judging)
    for generation in range(len(history)):
        if generation > 0:
            for _ in range(tries):
                copy_individual(people, best, changed)
                mutate_gaps(rng, people, changed, gap_step)
                _evaluate(people, changed, clips, room, judging)
                if people.results[changed, 3] >= people.results[best, 3]:
                    copy_individual(people, changed, best)
        _remember(history[generation], rows, people, one, clips.wanted)


@njit(**INNER)
def _evaluate_new(people, order, place, clips, room, judging):  # type: ignore[no-untyped-def]
    """Evaluate the individual at this place, unless an equal one before it was; returns how many were evaluated."""
    row = order[place]
    for before in range(place):
        if _equal(people, order[before], row, judging.outside_cost > 0.0):
            for i in range(people.results.shape[1]):
                people.results[row, i] = people.results[order[before], i]
            return 0
    _evaluate(people, row, clips, room, judging)
    return 1


@njit(**INNER)
def _equal(people, one, other, placed):  # type: ignore[no-untyped-def]
    count = people.counts[one]
    if count != people.counts[other]:
        return False
    if placed:
        # the same query from other columns leaves more or less of the template outside, so it ranks otherwise
        last = count - 1
        if people.positions[one, 0] != people.positions[other, 0]:
            return False
        if people.positions[one, last] != people.positions[other, last]:
            return False
    for k in range(count):
        if people.masks[one, k] != people.masks[other, k] or people.values[one, k] != people.values[other, k]:
            return False
        gap = people.lows[one, k] != people.lows[other, k] or people.highs[one, k] != people.highs[other, k]
        if k < count - 1 and gap:
            return False
    return True


@njit(cache=True, nogil=True)
def _evaluate(people, row, clips, room, judging):  # type: ignore[no-untyped-def]
    count = people.counts[row]
    lows, highs = people.lows[row], people.highs[row]
    find_bitmaps(clips.on, clips.off, clips.valid, people.masks[row], people.values[row], count, room)
    for k in range(count - 1):
        # a positive clip has to be retrieved even if it were slower or faster by this much
        room.lows[k] = int(np.ceil(lows[k] * (1.0 + judging.tempo) - 1e-9))
        room.highs[k] = int(np.floor(highs[k] / (1.0 + judging.tempo) + 1e-9))
    retrieve(count, room.lows, room.highs, lows, highs, clips.first, clips.positives, room)
    found = 0.0
    wrong = 0.0
    for t in range(len(room.hit)):
        if room.hit[t]:
            if t < clips.positives:
                found += clips.weights[t]
            else:
                wrong += clips.weights[t]
    fitness = fitness_of(found, wrong, clips.wanted, judging.beta)
    outside = people.positions[row, 0] + judging.columns - 1 - people.positions[row, count - 1]
    rank = fitness - judging.outside_cost * outside
    for k in range(count):
        rank -= judging.parsimony * count_bits(people.masks[row, k])
        if k < count - 1:
            rank -= judging.gap_cost * (highs[k] - lows[k])
    people.results[row, 0] = found
    people.results[row, 1] = wrong
    people.results[row, 2] = fitness
    people.results[row, 3] = rank


@njit(**INNER)
def _sort(order, people, begin, end):  # type: ignore[no-untyped-def]
    # Insertion from `begin`: what stands before it is in order, and the older goes first among equals.
    for place in range(begin, end):
        row = order[place]
        rank = people.results[row, 3]
        i = place
        while i > 0 and people.results[order[i - 1], 3] < rank:
            order[i] = order[i - 1]
            i -= 1
        order[i] = row


@njit(**INNER)
def _remember(means, order, people, population, wanted):  # type: ignore[no-untyped-def]
    for place in range(population):
        found, wrong = people.results[order[place], 0], people.results[order[place], 1]
        if found > 0.0:
            means[0] += found / (found + wrong) / population
            means[1] += found / wanted / population
        means[2] += people.results[order[place], 2] / population
    means[3] = people.results[order[0], 2]
