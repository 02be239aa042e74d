"""This module selects template columns greedily, as a baseline for the genetic algorithm."""

from __future__ import annotations

import numpy as np

from kinedex.ops.keyframes.genetic_algorithm import evaluate
from kinedex.ops.keyframes.training_task import MAX_KEYFRAMES, EvolutionSettings, Individual, LearningRun, TrainingTask

TOLERANCES = (0.5, 1.0)
"""Tolerances by which a new gap may be shorter or longer, relative to the spacing of columns."""


def forward_selection(task: TrainingTask, settings: EvolutionSettings) -> LearningRun:
    """Learn a query by greedy forward selection of template columns, using the rank of the genetic algorithm.

    The first column is the one with the highest rank as a single keyframe. Then, repeatedly, the column that raises the
    rank most is added; the gaps to its neighbours have one of the `TOLERANCES`. The search ends if no column raises the
    rank, or at `MAX_KEYFRAMES`. In a tie, the leftmost column is chosen. The result is deterministic.

    Parameters
    ----------
    task : TrainingTask
        The clips and the template columns.
    settings : EvolutionSettings
        The settings of fitness and rank.

    Returns
    -------
    LearningRun
        The selected query; the history has a row for each column.
    """
    columns = task.columns.tolist()
    single = [_Candidate([column], [], task, settings) for column in columns]
    best = max(single, key=lambda one: one.rank)
    evaluated = len(columns)
    trace = [best.history_row()]
    while len(best.columns) < min(MAX_KEYFRAMES, len(columns)):
        longer = [
            best.with_column(column, tolerance)
            for column in columns
            if column not in best.columns
            for tolerance in TOLERANCES
        ]
        evaluated += len(longer)
        better = max(longer, key=lambda one: one.rank)
        if better.rank <= best.rank:
            break
        best = better
        trace.append(best.history_row())
    return LearningRun(best.query, best.fitness, best.rank, np.array(trace, np.float64), evaluated)


class _Candidate:
    """A query under construction: template columns in order, gap tolerances between them, and results on the clips."""

    def __init__(
        self, columns: list[int], tolerances: list[float], task: TrainingTask, settings: EvolutionSettings
    ) -> None:
        self.columns, self.tolerances, self.task, self.settings = columns, tolerances, task, settings
        self.found, self.wrong, self.fitness, self.rank = evaluate(task, self.query, settings)

    @property
    def query(self) -> Individual:
        """Return the keyframe query of these columns."""
        columns = np.array(self.columns, np.int64)
        spacing = np.diff(columns)
        slack = np.round(spacing * np.array(self.tolerances)).astype(np.int64)
        return Individual(
            self.task.masks[columns], self.task.values[columns], columns,
            np.maximum(spacing - slack, 0), spacing + slack,
        )  # fmt: skip

    def with_column(self, column: int, tolerance: float) -> _Candidate:
        """Return a candidate with one more column, whose gaps have the given tolerance."""
        at = sum(before < column for before in self.columns)
        tolerances = list(self.tolerances)
        if 0 < at < len(self.columns):
            tolerances[at - 1 : at] = [tolerance, tolerance]
        else:
            tolerances.insert(at, tolerance)
        return _Candidate([*self.columns[:at], column, *self.columns[at:]], tolerances, self.task, self.settings)

    def history_row(self) -> tuple[float, float, float, float]:
        """Return a row of a history: precision, recall, and the fitness twice (as mean and as best)."""
        precision = self.found / (self.found + self.wrong) if self.found else 0.0
        return precision, self.found / self.task.positives, self.fitness, self.fitness
