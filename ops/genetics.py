"""One run of the genetic algorithm that learns a keyframe query from positive and negative clips (thesis, 4)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from ops.breeding import (
    Breeding,
    Columns,
    People,
    change_gaps,
    copy_individual,
    count_ones,
    draw_individual,
    mutate,
    recombine,
    room_for_people,
    sample_universally,
)
from ops.errors import ParameterError
from ops.fitness import Query, TrainingFrames, find_bitmaps, fitness_of, retrieve, room_for
from ops.templates import QuantisedTemplate
from ops.words import I64, U64

F64 = npt.NDArray[np.float64]
InitialGaps = Literal["around", "printed"]

HISTORY = ("precision", "recall", "fitness", "best")
"""What a run remembers of each generation: means over its individuals, and the fitness of the best one."""


@dataclass(frozen=True)
class Evolution:
    """The numbers of the algorithm, with the thesis's values.

    population, parents, generations: M, r and G. beta: of the fitness. keyframes_mean, keyframes_sd: of the number of
    keyframes of an initial individual, which is at least `least_keyframes`; none ever has more than `most_keyframes`.
    gap_tolerance: the upper end of U(0, 2) in Algorithm 2. initial_gaps: "around" the template's own spacing, or, as
    "printed", around half of it. gap_step: a mutation changes each end of a gap by up to this share of the spacing.
    open_share: a generalisation opens up to this share of a keyframe's entries at once; one where it is 0.
    parsimony, gap_cost: what each fixed entry of a query, and each frame between the ends of a gap, take off its
    fitness when individuals are compared. tempo: a positive clip counts as retrieved only if it is so even with gaps
    narrowed by this much, as if it were slower or faster.
    """

    population: int = 50
    parents: int = 5
    generations: int = 100
    beta: float = 2.0
    keyframes_mean: float = 3.0
    keyframes_sd: float = 2.0
    least_keyframes: int = 2
    most_keyframes: int = 12
    gap_tolerance: float = 2.0
    initial_gaps: InitialGaps = "around"
    gap_step: float = 0.5
    open_share: float = 0.0
    parsimony: float = 0.0
    gap_cost: float = 0.0
    tempo: float = 0.0

    def __post_init__(self) -> None:
        checks = (
            ("population", self.population >= 1, "at least 1"),
            ("parents", self.parents >= 2, "at least 2"),
            ("generations", self.generations >= 0, "0 or more"),
            ("beta", self.beta > 0, "above 0"),
            ("keyframes_sd", self.keyframes_sd >= 0, "0 or more"),
            ("least_keyframes", self.least_keyframes >= 1, "at least 1"),
            ("most_keyframes", self.most_keyframes >= self.least_keyframes, "at least least_keyframes"),
            ("gap_tolerance", self.gap_tolerance >= 0, "0 or more"),
            ("initial_gaps", self.initial_gaps in ("around", "printed"), "around or printed"),
            ("gap_step", self.gap_step >= 0, "0 or more"),
            ("open_share", 0 <= self.open_share <= 1, "between 0 and 1"),
            ("parsimony", self.parsimony >= 0, "0 or more"),
            ("gap_cost", self.gap_cost >= 0, "0 or more"),
            ("tempo", self.tempo >= 0, "0 or more"),
        )
        for name, holds, expected in checks:
            if not holds:
                raise ParameterError(name, expected, getattr(self, name))

    @property
    def offspring(self) -> int:
        """How many individuals a generation makes: r (r − 1) / 2."""
        return self.parents * (self.parents - 1) // 2

    @property
    def budget(self) -> int:
        """How many individuals a run makes in all."""
        return self.population + self.generations * self.offspring


@dataclass(frozen=True)
class Material:
    """What a query is learned from.

    frames: the T clips, those of the class first. positives: how many these are. weights: float64 (T,), what each clip
    counts (1 in the thesis). masks, values: uint64 (N,), the strict template's columns, cut down to the features that
    may be used. allowed: those features as a mask.
    """

    frames: TrainingFrames
    positives: int
    weights: F64
    masks: U64
    values: U64
    allowed: int

    @property
    def columns(self) -> I64:
        """The template columns that fix anything, and so can be keyframes."""
        return np.flatnonzero(self.masks).astype(np.int64)


@dataclass(frozen=True)
class Run:
    """The outcome of one run.

    query: its fittest individual. fitness: F_beta. rank: the same less what parsimony takes off, by which individuals
    are compared. history: float64 (G + 1, 4), `HISTORY` of each generation. evaluated: how many individuals were.
    """

    query: Query
    fitness: float
    rank: float
    history: F64
    evaluated: int


def make_material(
    frames: TrainingFrames,
    positives: int,
    template: QuantisedTemplate,
    allowed: int,
    weights: F64 | None = None,
) -> Material:
    """Put together what a query is learned from.

    Parameters
    ----------
    frames: T clips. positives: how many of them are of the class, at least one; they come first.
    template: the class template, quantised strictly (δ = 0 in the thesis).
    allowed: the features that keyframes may fix, bit i − 1 for F_i.
    weights: float64 (T,) above 0; 1 each unless given.

    Raises
    ------
    ParameterError: shapes that do not belong together, no positive clip, or a template that fixes none of the features.
    """
    count = len(frames)
    weights = np.ones(count) if weights is None else np.asarray(weights, np.float64)
    if len(weights) != count:
        raise ParameterError("weights", f"one for each of the {count} clips", len(weights))
    if not 1 <= positives <= count:
        raise ParameterError("positives", f"1 to {count} clips", positives)
    if (weights <= 0).any():
        raise ParameterError("weights", "above 0", float(weights.min()))
    allowed &= (1 << len(frames.on)) - 1
    masks = template.mask & np.uint64(allowed)
    if not masks.any():
        raise ParameterError("template", "with one fixed entry at least among the features allowed", "wildcards alone")
    return Material(frames, positives, weights, masks, template.value & masks, allowed)


def evolve(material: Material, evolution: Evolution, seed: int | tuple[int, ...]) -> Run:
    """Run the genetic algorithm once (thesis, Algorithm 3).

    Parameters
    ----------
    material: clips and template columns.
    evolution: the numbers of the algorithm.
    seed: what the random numbers follow from; the same seed gives the same run, on any machine and in any process.

    Returns
    -------
    The fittest individual of the last generation; of equally fit ones the oldest.
    """
    people = room_for_people(evolution.population + evolution.offspring, evolution.most_keyframes)
    history = np.zeros((evolution.generations + 1, len(HISTORY)))
    room = room_for(material.frames, evolution.most_keyframes)
    sizes = (evolution.population, evolution.parents, evolution.generations)
    best, evaluated = _evolve(
        _random(seed), people, _clips(material), _columns(material), room, history, sizes, _breeding(evolution),
        _judging(evolution),
    )  # fmt: skip
    return _run(people, best, history, evaluated)


def random_search(material: Material, evolution: Evolution, seed: int | tuple[int, ...]) -> Run:
    """Draw as many initial individuals as a run makes individuals in all, and keep the fittest (Algorithm 2 alone)."""
    return evolve(material, replace(evolution, population=evolution.budget, generations=0), seed)


def tune_gaps(material: Material, query: Query, evolution: Evolution, seed: int | tuple[int, ...]) -> Run:
    """Improve the gaps of a query by the same mutations, one at a time, keeping what is no worse.

    As many are tried as a run makes offspring. The history has the best one after each generation's worth.
    """
    most = max(evolution.most_keyframes, len(query))
    people = room_for_people(2, most)
    _put(people, 0, query)
    history = np.zeros((evolution.generations + 1, len(HISTORY)))
    room = room_for(material.frames, most)
    tries = evolution.offspring
    _tune(
        _random(seed), people, _clips(material), room, history, tries, evolution.generations, evolution.gap_step,
        _judging(evolution),
    )  # fmt: skip
    return _run(people, 0, history, 1 + tries * evolution.generations)


def judge(material: Material, query: Query, evolution: Evolution) -> tuple[float, float, float, float]:
    """The weight of positive and of negative clips that a query retrieves, its fitness and its rank, as in a run."""
    people = room_for_people(1, len(query))
    _put(people, 0, query)
    _evaluate(people, 0, _clips(material), room_for(material.frames, len(query)), _judging(evolution))
    found, wrong, fitness, rank = people.results[0].tolist()
    return found, wrong, fitness, rank


# ---- between queries and arrays --------------------------------------------------------------------------


class _Clips(NamedTuple):
    """The clips of a `Material`; wanted: the weight of the positive ones."""

    on: U64
    off: U64
    valid: U64
    first: I64
    positives: int
    weights: F64
    wanted: float


class _Judging(NamedTuple):
    """The numbers by which individuals are judged."""

    beta: float
    parsimony: float
    gap_cost: float
    tempo: float


def _random(seed: int | tuple[int, ...]) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))


def _clips(material: Material) -> _Clips:
    frames, weights = material.frames, material.weights
    wanted = float(weights[: material.positives].sum())
    return _Clips(frames.on, frames.off, frames.valid, frames.first, material.positives, weights, wanted)


def _columns(material: Material) -> Columns:
    return Columns(material.masks, material.values, material.columns, np.uint64(material.allowed))


def _breeding(evolution: Evolution) -> Breeding:
    return Breeding(
        float(evolution.keyframes_mean),
        float(evolution.keyframes_sd),
        evolution.least_keyframes,
        float(evolution.gap_tolerance),
        0.5 if evolution.initial_gaps == "printed" else 1.0,
        float(evolution.gap_step),
        float(evolution.open_share),
    )


def _judging(evolution: Evolution) -> _Judging:
    numbers = (evolution.beta, evolution.parsimony, evolution.gap_cost, evolution.tempo)
    return _Judging(*(float(number) for number in numbers))


def _run(people: People, row: int, history: F64, evaluated: int) -> Run:
    count = int(people.counts[row])
    query = Query(
        people.masks[row, :count].copy(),
        people.values[row, :count].copy(),
        people.positions[row, :count].copy(),
        people.lows[row, : count - 1].copy(),
        people.highs[row, : count - 1].copy(),
    )
    fitness, rank = people.results[row, 2:].tolist()
    return Run(query, fitness, rank, history, int(evaluated))


def _put(people: People, row: int, query: Query) -> None:
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
    _sort(order, people, 0, population)
    _remember(history[0], order, people, population, clips.wanted)
    for generation in range(1, generations + 1):
        sample_universally(people.results[:, 2], order[:population], chosen, rng.random())
        place = population
        for one in range(parents):
            for other in range(one + 1, parents):
                row = order[place]
                recombine(rng, people, chosen[one], chosen[other], row, breeding, taken)
                mutate(rng, people, row, columns, breeding)
                evaluated += _evaluate_new(people, order, place, clips, room, judging)
                place += 1
        _sort(order, people, population, rows)
        _remember(history[generation], order, people, population, clips.wanted)
    return order[0], evaluated


@njit(cache=True, nogil=True)
def _tune(rng, people, clips, room, history, tries, generations, gap_step, judging):  # type: ignore[no-untyped-def]
    best = np.zeros(1, np.int64)
    _evaluate(people, 0, clips, room, judging)
    _remember(history[0], best, people, 1, clips.wanted)
    for generation in range(1, generations + 1):
        for _ in range(tries):
            copy_individual(people, 0, 1)
            change_gaps(rng, people, 1, gap_step)
            _evaluate(people, 1, clips, room, judging)
            if people.results[1, 3] >= people.results[0, 3]:
                copy_individual(people, 1, 0)
        _remember(history[generation], best, people, 1, clips.wanted)


@njit(cache=True, nogil=True)
def _evaluate_new(people, order, place, clips, room, judging):  # type: ignore[no-untyped-def]
    """Evaluate the individual at this place, unless an equal one before it was; returns how many were evaluated."""
    row = order[place]
    for before in range(place):
        if _equal(people, order[before], row):
            for i in range(people.results.shape[1]):
                people.results[row, i] = people.results[order[before], i]
            return 0
    _evaluate(people, row, clips, room, judging)
    return 1


@njit(cache=True, nogil=True)
def _equal(people, one, other):  # type: ignore[no-untyped-def]
    count = people.counts[one]
    if count != people.counts[other]:
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
    rank = fitness
    for k in range(count):
        rank -= judging.parsimony * count_ones(people.masks[row, k])
        if k < count - 1:
            rank -= judging.gap_cost * (highs[k] - lows[k])
    people.results[row, 0] = found
    people.results[row, 1] = wrong
    people.results[row, 2] = fitness
    people.results[row, 3] = rank


@njit(cache=True, nogil=True)
def _sort(order, people, begin, end):  # type: ignore[no-untyped-def]
    # Insertion from `begin`: what stands before it is in order, and the older goes first among equals.
    for place in range(max(begin, 1), end):
        row = order[place]
        rank = people.results[row, 3]
        i = place
        while i > 0 and people.results[order[i - 1], 3] < rank:
            order[i] = order[i - 1]
            i -= 1
        order[i] = row


@njit(cache=True, nogil=True)
def _remember(means, order, people, population, wanted):  # type: ignore[no-untyped-def]
    for place in range(population):
        found, wrong = people.results[order[place], 0], people.results[order[place], 1]
        if found > 0.0:
            means[0] += found / (found + wrong) / population
            means[1] += found / wanted / population
        means[2] += people.results[order[place], 2] / population
    means[3] = people.results[order[0], 2]
