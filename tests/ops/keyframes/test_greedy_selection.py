"""The greedy learner takes columns one by one and never gets worse on the way."""

from __future__ import annotations

import numpy as np

from kinedex.ops.keyframes.genetic_algorithm import evaluate
from kinedex.ops.keyframes.greedy_selection import forward_selection
from kinedex.ops.keyframes.training_task import EvolutionSettings, Individual
from tests.ops.keyframes.test_genetic_algorithm import material


def test_columns_are_added_as_long_as_the_rank_rises() -> None:
    given, evolution = material(seed=6), EvolutionSettings()
    run = forward_selection(given, evolution)
    assert run.fitness == 1.0
    assert (np.diff(run.history[:, 2]) >= 0).all()
    assert len(run.query) == len(run.history)
    precision, recall = run.history[-1, :2].tolist()
    assert (precision, recall) == (1.0, 1.0)
    assert (run.history[:, 1] > 0).all()
    assert evaluate(given, run.query, evolution)[2:] == (run.fitness, run.rank)
    again = forward_selection(given, evolution)
    assert again.query.key() == run.query.key()


def test_it_is_never_worse_than_the_best_single_column() -> None:
    given, evolution = material(seed=8), EvolutionSettings()
    run = forward_selection(given, evolution)
    for column in given.columns.tolist():
        masks, values = given.masks[[column]], given.values[[column]]
        none = np.empty(0, np.int64)
        single = Individual(masks, values, np.array([column]), none, none)
        assert run.rank >= evaluate(given, single, evolution)[3]
