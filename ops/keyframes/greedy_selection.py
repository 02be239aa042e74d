"""A simpler learner to compare with: template columns are taken one by one, the best first, as long as it helps."""

from __future__ import annotations

import numpy as np

from kinedex.ops.keyframes.genetic_algorithm import evaluate
from kinedex.ops.keyframes.individuals import Individual
from kinedex.ops.keyframes.training_task import EvolutionSettings, LearningRun, TrainingTask

TOLERANCES = (0.5, 1.0)
"""Shares of the spacing by which a new gap may be shorter or longer."""


def forward_selection(material: TrainingTask, evolution: EvolutionSettings) -> LearningRun:
    """Select template columns greedily, by the rank that the genetic algorithm goes by.

    The first column is the one that ranks best alone; then always the column is added, with gaps to its neighbours of
    one of the `TOLERANCES`, that raises the rank most, until none does or there are `most_keyframes`. Of equal ones the
    leftmost. It is deterministic: there is nothing random in it. The history has a row for each column taken.
    """
    columns = material.columns.tolist()
    single = [Candidate([column], [], material) for column in columns]
    best = max(single, key=lambda one: one.ranked(evolution))
    evaluated = len(columns)
    trace = [best.course(evolution)]
    while len(best.places) < min(evolution.most_keyframes, len(columns)):
        longer = [
            best.with_column(column, tolerance)
            for column in columns
            if column not in best.places
            for tolerance in TOLERANCES
        ]
        evaluated += len(longer)
        better = max(longer, key=lambda one: one.ranked(evolution))
        if better.ranked(evolution) <= best.ranked(evolution):
            break
        best = better
        trace.append(best.course(evolution))
    history = np.array(trace, np.float64)
    return LearningRun(best.query, best.fitness(evolution), best.ranked(evolution), history, evaluated)


class Candidate:
    """Columns in order, with the tolerances of the gaps between them."""

    def __init__(self, places: list[int], tolerances: list[float], material: TrainingTask) -> None:
        self.places, self.tolerances, self.material = places, tolerances, material
        self._judged: tuple[float, float, float, float] | None = None

    @property
    def query(self) -> Individual:
        """The keyframe query of these columns."""
        places = np.array(self.places, np.int64)
        spacing = np.diff(places)
        slack = np.round(spacing * np.array(self.tolerances)).astype(np.int64)
        return Individual(
            self.material.masks[places], self.material.values[places], places,
            np.maximum(spacing - slack, 0), spacing + slack,
        )  # fmt: skip

    def with_column(self, column: int, tolerance: float) -> Candidate:
        """The same with one more column; its gaps have this tolerance."""
        at = sum(place < column for place in self.places)
        tolerances = list(self.tolerances)
        if 0 < at < len(self.places):
            tolerances[at - 1 : at] = [tolerance, tolerance]
        else:
            tolerances.insert(at, tolerance)
        return Candidate([*self.places[:at], column, *self.places[at:]], tolerances, self.material)

    def ranked(self, evolution: EvolutionSettings) -> float:
        """The rank by which individuals are compared."""
        return self._results(evolution)[3]

    def fitness(self, evolution: EvolutionSettings) -> float:
        """F_beta on the clips."""
        return self._results(evolution)[2]

    def course(self, evolution: EvolutionSettings) -> tuple[float, float, float, float]:
        """A row of a history, `HISTORY_COLUMNS`: precision, recall, and twice the fitness."""
        found, wrong, fitness, _ = self._results(evolution)
        wanted = float(self.material.weights[: self.material.positives].sum())
        return found / (found + wrong) if found else 0.0, found / wanted, fitness, fitness

    def _results(self, evolution: EvolutionSettings) -> tuple[float, float, float, float]:
        if self._judged is None:
            self._judged = evaluate(self.material, self.query, evolution)
        return self._judged
