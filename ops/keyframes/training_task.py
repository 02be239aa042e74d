"""This module defines the learner's task and settings, and the result of a run (thesis, Chapter 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.errors import ParameterError
from kinedex.ops.keyframes.fitness import TrainingFrames
from kinedex.ops.keyframes.individuals import Individual
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import I64, U64

PARENTS = 5
"""The number r of parents of a generation (thesis, Section 4.4)."""

OFFSPRING = PARENTS * (PARENTS - 1) // 2
"""The number of offspring of a generation, one for each pair of parents."""

MOST_KEYFRAMES = 12
"""The largest number of keyframes of any individual, which the thesis does not limit."""

HISTORY_COLUMNS = ("precision", "recall", "fitness", "best")
"""The columns of a history, which has a row for each generation: means over its individuals, and the best fitness."""


@dataclass(frozen=True)
class EvolutionSettings:
    """The settings of the genetic algorithm, with the values of the thesis.

    Parameters
    ----------
    population, generations : int
        M and G (thesis, Section 4.4).
    least_keyframes : int
        The least number of keyframes of an initial individual; no mutation goes below it. Recombination, the consensus
        and the greedy learner may, as in the thesis.
    open_share : float
        The largest share of a keyframe's entries that a generalisation turns into wildcards at a time; one entry where
        it is 0.
    parsimony, gap_cost : float
        The costs of each fixed entry, and of each frame between the ends of a gap, when individuals are compared.
    outside_cost : float
        The cost of the share of the template that lies before the first or after the last keyframe, as this part has to
        be searched around each hit.
    tempo : float
        The fraction by which gaps are narrowed when positive clips are tested, so that they would also be retrieved at
        another tempo.
    """

    population: int = 50
    generations: int = 100
    least_keyframes: int = 2
    open_share: float = 0.0
    parsimony: float = 0.0
    gap_cost: float = 0.0
    outside_cost: float = 0.0
    tempo: float = 0.0

    @property
    def budget(self) -> int:
        """Return the number of individuals that a run creates."""
        return self.population + self.generations * OFFSPRING


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
        The columns of the strictly quantised template, restricted to the features that may be used.
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
        """Return the template columns that fix a feature and so can become keyframes, int64 (n,)."""
        return np.flatnonzero(self.masks).astype(np.int64)


@dataclass(frozen=True)
class LearningRun:
    """The result of one run of a learner.

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
    """Make a training task of clips and a template.

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
    """Replace template entries by wildcards unless they are equal for some columns before and after.

    Parameters
    ----------
    template : QuantisedTemplate
        A template of N columns.
    steady : int
        The number of columns on either side; beyond its ends the first and last column are repeated.

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
