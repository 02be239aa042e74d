"""The task of learning a keyframe query, the settings of the learner, and the outcome of a run (thesis, Chapter 4)."""

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
"""The columns of a history, with a row for each generation: means over its individuals, and the fitness of the best."""


@dataclass(frozen=True)
class EvolutionSettings:
    """The settings of the genetic algorithm, with the values of the thesis.

    Parameters
    ----------
    population, parents, generations : int
        M, r and G (thesis, Section 4.4).
    beta : float
        The number of times that recall weighs as much as precision in the fitness (thesis, Eq. 4.11).
    keyframes_mean, keyframes_sd : float
        Mean and standard deviation of the number of keyframes of an initial individual (thesis, Algorithm 2).
    least_keyframes : int
        The least number of keyframes of an initial individual; no mutation goes below it. Recombination, the consensus
        and the greedy learner may, as in the thesis.
    most_keyframes : int
        The largest number of keyframes of any individual, which the thesis does not limit.
    gap_tolerance : float
        The upper end of U(0, 2) in Algorithm 2.
    initial_gaps : {"around", "printed"}
        Initial gaps lie around the spacing of the template's columns, or around half of it, as Algorithm 2 is printed.
    gap_step : float
        The largest change of an end of a gap by a mutation, as a share of the spacing.
    open_share : float
        The largest share of a keyframe's entries that a generalisation opens at once; one entry where it is 0.
    parsimony, gap_cost : float
        The costs of each fixed entry, and of each frame between the ends of a gap, when individuals are compared.
    outside_cost : float
        The cost of the share of the template before the first and after the last keyframe, which has to be searched
        around each hit.
    tempo : float
        A positive clip counts as retrieved only if it is so with gaps narrowed by this share, as if it were slower or
        faster.
    mutations : (float, float, float)
        The odds of a mutation of keyframes, of entries, and of gaps; the thesis chooses at random.

    Raises
    ------
    ParameterError
        If a setting is out of its domain.
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
        """The number of individuals that a generation makes, r (r - 1) / 2."""
        return self.parents * (self.parents - 1) // 2

    @property
    def budget(self) -> int:
        """The number of individuals that a run makes in all."""
        return self.population + self.generations * self.offspring


@dataclass(frozen=True)
class TrainingTask:
    """The clips and the template columns from which a query is learned.

    Parameters
    ----------
    frames : TrainingFrames
        The T clips, those of the class first.
    positives : int
        The number of clips of the class.
    masks, values : uint64 array (N,)
        The columns of the strictly quantised template, cut down to the features that may be used.
    allowed : int
        These features as a mask, bit i - 1 for F_i.
    """

    frames: TrainingFrames
    positives: int
    masks: U64
    values: U64
    allowed: int

    @property
    def columns(self) -> I64:
        """The template columns that fix a feature and so can be keyframes, int64 (n,)."""
        return np.flatnonzero(self.masks).astype(np.int64)


@dataclass(frozen=True)
class LearningRun:
    """The outcome of one run of a learner.

    Parameters
    ----------
    query : Individual
        The individual that ranks highest.
    fitness : float
        Its F_beta.
    rank : float
        Its fitness less the costs, by which individuals are compared.
    history : float64 array (G + 1, 4)
        The `HISTORY_COLUMNS` of each generation.
    evaluated : int
        The number of individuals that were evaluated.
    """

    query: Individual
    fitness: float
    rank: float
    history: F64
    evaluated: int


def make_training_task(
    frames: TrainingFrames, positives: int, template: QuantisedTemplate, allowed: int
) -> TrainingTask:
    """Combine clips and a template into a training task.

    Parameters
    ----------
    frames : TrainingFrames
        T clips.
    positives : int
        The number of clips of the class, at least one; they come first.
    template : QuantisedTemplate
        The class template, quantised strictly (delta = 0 in the thesis, Section 4.3).
    allowed : int
        The features that keyframes may fix, bit i - 1 for F_i.

    Returns
    -------
    TrainingTask

    Raises
    ------
    ParameterError
        If there is no positive clip, or the template fixes none of the features.
    """
    if not 1 <= positives <= len(frames):
        raise ParameterError("positives", f"1 to {len(frames)} clips", positives)
    allowed &= (1 << len(frames.on)) - 1
    masks = template.mask & np.uint64(allowed)
    if not masks.any():
        raise ParameterError("template", "with one fixed entry at least among the features allowed", "wildcards alone")
    return TrainingTask(frames, positives, masks, template.value & masks, allowed)


def steady_entries(template: QuantisedTemplate, steady: int) -> QuantisedTemplate:
    """Turn the entries of a template that are not equal for some columns before and after into wildcards.

    Parameters
    ----------
    template : QuantisedTemplate
        A template of N columns.
    steady : int
        The number of columns on either side; beyond its ends a template continues as it is there.

    Returns
    -------
    QuantisedTemplate
    """
    mask = template.mask.copy()
    columns = np.arange(len(template))
    for shift in range(-steady, steady + 1):
        other = np.clip(columns + shift, 0, len(template) - 1)
        mask &= template.mask[other] & ~(template.value ^ template.value[other])
    return QuantisedTemplate(mask, template.value & mask)
