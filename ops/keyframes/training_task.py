"""What a keyframe query is learned from, by which numbers, and what comes of it (thesis, Chapter 4)."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import ParameterError
from kinedex.ops.keyframes.fitness import TrainingFrames
from kinedex.ops.keyframes.individuals import Individual
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import I64, U64

F64 = npt.NDArray[np.float64]
InitialGaps = Literal["around", "printed"]

HISTORY_COLUMNS = ("precision", "recall", "fitness", "best")
"""What a run remembers of each generation: means over its individuals, and the fitness of the best one."""


@dataclass(frozen=True)
class EvolutionSettings:
    """The numbers of the algorithm, with the thesis's values.

    population, parents, generations: M, r and G. beta: of the fitness. keyframes_mean, keyframes_sd: of the number of
    keyframes of an initial individual, which is at least `least_keyframes`; nor does a mutation remove one where there
    are no more than these. Recombination, the consensus and the greedy learner may give fewer, as in the thesis (its
    Algorithm 2 only has a least number). None ever has more than `most_keyframes`, which the thesis does not limit.
    gap_tolerance: the upper end of U(0, 2) in Algorithm 2. initial_gaps: "around" the template's own spacing, or, as
    "printed", around half of it. gap_step: a mutation changes each end of a gap by up to this share of the spacing.
    open_share: a generalisation opens up to this share of a keyframe's entries at once; one where it is 0.
    parsimony, gap_cost: what each fixed entry of a query, and each frame between the ends of a gap, take off its
    fitness when individuals are compared. outside_cost: what the share of the template before the first and after the
    last keyframe takes off likewise: it is what has to be searched around a hit. tempo: a positive clip counts as
    retrieved only if it is so even with gaps narrowed by this much, as if it were slower or faster. mutations: the odds
    of a mutation of keyframes, of entries, and of gaps; the thesis chooses at random.
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
    outside_cost: float = 0.0
    tempo: float = 0.0
    mutations: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        checks = (
            ("population", self.population >= 1, "at least 1"),
            ("parents", self.parents >= 2, "at least 2"),
            ("generations", self.generations >= 0, "0 or more"),
            ("beta", self.beta > 0, "above 0"),
            ("keyframes_sd", self.keyframes_sd >= 0, "0 or more"),
            ("least_keyframes", self.least_keyframes >= 1, "at least 1"),
            (
                "most_keyframes",
                self.most_keyframes >= self.least_keyframes,
                f"at least least_keyframes, which is {self.least_keyframes}",
            ),
            ("gap_tolerance", self.gap_tolerance >= 0, "0 or more"),
            ("initial_gaps", self.initial_gaps in ("around", "printed"), "around or printed"),
            ("gap_step", self.gap_step >= 0, "0 or more"),
            ("open_share", 0 <= self.open_share <= 1, "between 0 and 1"),
            ("parsimony", self.parsimony >= 0, "0 or more"),
            ("gap_cost", self.gap_cost >= 0, "0 or more"),
            ("outside_cost", self.outside_cost >= 0, "0 or more"),
            ("tempo", self.tempo >= 0, "0 or more"),
            ("mutations", min(self.mutations) >= 0 and sum(self.mutations) > 0, "0 or more each, and one above 0"),
        )
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, str) and not np.isfinite(value).all():
                raise ParameterError(field.name, "a number, not infinite", value)
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
class TrainingTask:
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
class LearningRun:
    """The outcome of one run.

    query: its fittest individual. fitness: F_beta. rank: the same less what parsimony takes off, by which individuals
    are compared. history: float64 (G + 1, 4), `HISTORY_COLUMNS` of each generation.
    evaluated: how many individuals were.
    """

    query: Individual
    fitness: float
    rank: float
    history: F64
    evaluated: int


def make_training_task(
    frames: TrainingFrames,
    positives: int,
    template: QuantisedTemplate,
    allowed: int,
    weights: F64 | None = None,
) -> TrainingTask:
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
    return TrainingTask(frames, positives, weights, masks, template.value & masks, allowed)


def steady_entries(template: QuantisedTemplate, steady: int) -> QuantisedTemplate:
    """Open the entries of a template that are not the same for some columns before and after.

    Parameters
    ----------
    steady: how many columns on either side; beyond its ends a template goes on as it is there.
    """
    mask = template.mask.copy()
    columns = np.arange(len(template))
    for shift in range(-steady, steady + 1):
        other = np.clip(columns + shift, 0, len(template) - 1)
        mask &= template.mask[other] & ~(template.value ^ template.value[other])
    return QuantisedTemplate(mask, template.value & mask)
