"""This module defines the task and the settings of the query learner, and the result of a run (thesis, Chapter 4).

The individuals of the genetic algorithm are keyframe queries.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64, I64, U64
from kinedex.ops.errors import ParameterError
from kinedex.ops.keyframes.fitness import TrainingFrames
from kinedex.ops.templates.templates import QuantisedTemplate

PARENTS = 5
"""The number r of parents of a generation (thesis, Section 4.4)."""

OFFSPRING = PARENTS * (PARENTS - 1) // 2
"""The number of offspring of a generation, one for each pair of parents."""

MAX_KEYFRAMES = 12
"""The largest number of keyframes of any individual, which the thesis does not limit."""

HISTORY_COLUMNS = ("precision", "recall", "fitness", "best")
"""The columns of a history, which has a row for each generation: means over its individuals, and the best fitness."""


@dataclass(frozen=True)
class EvolutionSettings:
    """The settings of the genetic algorithm, with the values of the thesis.

    Parameters
    ----------
    population, generations : int
        The numbers M of individuals and G of generations (thesis, Section 4.4).
    least_keyframes : int
        The minimum number of keyframes of an initial individual and after a mutation. Recombination, the consensus and
        the greedy learner may result in fewer, as in the thesis.
    open_share : float
        The largest fraction of a keyframe's entries that one generalisation turns into wildcards; 0 for a single entry.
    parsimony, gap_cost : float
        The costs of each fixed entry, and of each frame between the ends of a gap, when individuals are compared.
    outside_cost : float
        The cost of a template whose columns are all outside the keyframes, before the first or after the last one. It
        is charged in proportion to the columns outside, because these must be searched around each hit.
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
        The features that may be used as a mask, bit i - 1 for F_i.
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
        The F_beta measure of the query.
    rank : float
        The fitness minus the costs, by which individuals are compared.
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
    """Replace entries by wildcards unless they are equal in a number of columns before and after.

    Parameters
    ----------
    template : QuantisedTemplate
        A template of N columns.
    steady : int
        The number of columns on either side; at the ends of the template, the first and last column are repeated.

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


@dataclass(frozen=True)
class Individual:
    """A keyframe query over complete words: K keyframes at template columns, and the gaps between them.

    Parameters
    ----------
    masks, values : uint64 array (K,)
        The keyframes; bit i - 1 is F_i.
    positions : int64 array (K,)
        The template columns of the keyframes, in non-descending order.
    lows, highs : int64 array (K - 1,)
        The admissible gaps in frames, both ends included (thesis, Eq. 4.3 and 4.4).

    Raises
    ------
    ParameterError
        If the lengths do not match, a gap is not a range, or a value has bits outside its mask.
    """

    masks: U64
    values: U64
    positions: I64
    lows: I64
    highs: I64

    def __post_init__(self) -> None:
        count = len(self.masks)
        if not count or len(self.values) != count or len(self.positions) != count:
            raise ParameterError("query", "one mask, value and position a keyframe, and one keyframe at least", count)
        if len(self.lows) != count - 1 or len(self.highs) != count - 1:
            raise ParameterError("query", f"{count - 1} gaps, one fewer than keyframes", len(self.lows))
        if np.any(self.lows < 0) or np.any(self.lows > self.highs):
            raise ParameterError("gap", "a range [low, high] of frames with 0 <= low <= high", (self.lows, self.highs))
        if np.any(self.values & ~self.masks):
            raise ParameterError("value", "0 wherever mask is 0", "a value behind a wildcard")

    def __len__(self) -> int:
        return len(self.masks)

    @property
    def fixed(self) -> int:
        """Return the number of entries that the keyframes fix in total."""
        return int(np.bitwise_count(self.masks).sum())

    @property
    def gaps(self) -> list[tuple[int, int]]:
        """Return the gaps as pairs (low, high), as searches expect them."""
        return list(zip(self.lows.tolist(), self.highs.tolist(), strict=True))

    def key(self) -> tuple[bytes, ...]:
        """Return a hashable key that is equal for equal individuals."""
        return tuple(part.tobytes() for part in (self.masks, self.values, self.positions, self.lows, self.highs))
