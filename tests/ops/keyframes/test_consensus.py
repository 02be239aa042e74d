"""One query of many runs: what recurs is kept, and never less fit than the runs are in the median."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinedex.ops.errors import ParameterError
from kinedex.ops.keyframes.consensus import AGREEMENTS, agreement_matrix, find_consensus, recurring_keyframes
from kinedex.ops.keyframes.genetic_algorithm import rank_bound, tune_gaps
from kinedex.ops.keyframes.training_task import EvolutionSettings, Individual, TrainingTask
from tests.ops.keyframes.test_genetic_algorithm import check_consensus, material


def query(*keyframes: tuple[int, int, int]) -> Individual:
    positions, masks, values = (np.array(part) for part in zip(*keyframes, strict=True))
    gaps = np.zeros(len(keyframes) - 1, np.int64)
    return Individual(masks.astype(np.uint64), values.astype(np.uint64), positions, gaps, gaps + 9)


RUNS = [
    query((3, 0b011, 0b001), (10, 0b100, 0b100)),
    query((4, 0b011, 0b001), (11, 0b110, 0b100)),
    query((3, 0b001, 0b001), (17, 0b010, 0b010)),
]


def test_keyframes_add_up_to_a_matrix_in_which_a_wildcard_is_one_half() -> None:
    matrix = agreement_matrix(RUNS, 20, 3)
    assert matrix.shape == (20, 3)
    assert matrix[3].tolist() == pytest.approx([0.5 + 2 * 0.5 / 3, 0.5 - 0.5 / 3, 0.5])
    assert matrix[11].tolist() == pytest.approx([0.5, 0.5 - 0.5 / 3, 0.5 + 0.5 / 3])
    assert (matrix[[0, 5, 19]] == 0.5).all()


def test_what_recurs_is_kept_in_the_median_order() -> None:
    found = recurring_keyframes(RUNS, 0.6, 1, 3)
    assert found is not None
    assert found.positions.tolist() == [3, 10]
    assert found.masks.tolist() == [0b011, 0b100]
    assert found.values.tolist() == [0b001, 0b100]
    assert found.gaps == [(0, 14)]
    strict = recurring_keyframes(RUNS, 1.0, 1, 3)
    assert strict is not None
    assert strict.masks.tolist() == [0b001, 0b100]


def test_runs_that_agree_on_nothing_have_no_consensus() -> None:
    assert recurring_keyframes([query((3, 1, 1)), query((3, 1, 0))], 0.5, 1, 3) is None


def columns_of(given: TrainingTask, *positions: int) -> Individual:
    """A query of template columns, spaced as they are there or up to twice as far."""
    at = np.array(positions)
    return Individual(given.masks[at], given.values[at], at, np.diff(at), 2 * np.diff(at))


def test_the_consensus_is_no_worse_than_the_median_or_else_the_best_run() -> None:
    given, evolution = material(seed=3), EvolutionSettings(generations=8)
    made = [columns_of(given, *given.columns[[first, last]].tolist()) for first, last in ((0, 3), (0, 4), (1, 4))]
    runs = [tune_gaps(given, query, evolution, seed) for seed, query in enumerate(made)]
    assert check_consensus(given, runs, evolution).origin == "consensus"


def test_runs_with_nothing_in_common_have_the_best_of_them_instead() -> None:
    given, evolution = material(seed=3), EvolutionSettings(generations=8)
    made = [columns_of(given, *given.columns[[first, last]].tolist()) for first, last in ((0, 3), (1, 4))]
    runs = [
        replace(tune_gaps(given, query, evolution, 1), rank=rank) for rank, query in zip((5.0, 6.0), made, strict=True)
    ]
    found = find_consensus(given, runs, evolution, 1, 5)
    assert (found.origin, found.rank, found.query.key()) == ("best run", 6.0, runs[1].query.key())


def test_the_consensus_may_have_to_be_as_fit_as_the_best_run() -> None:
    given, evolution = material(seed=3), EvolutionSettings(generations=8)
    made = [columns_of(given, *given.columns[[first, last]].tolist()) for first, last in ((0, 3), (0, 3), (1, 4))]
    runs = [tune_gaps(given, query, evolution, seed) for seed, query in enumerate(made)]
    better = [*runs, replace(runs[0], rank=2.0)]
    assert find_consensus(given, better, evolution, 1, 5).origin == "consensus"
    found = find_consensus(given, better, evolution, 1, 5, "best")
    assert (found.origin, found.rank) == ("best run", 2.0)


@pytest.mark.parametrize("costs", [{}, {"parsimony": 0.01, "gap_cost": 0.001, "outside_cost": 0.3}])
def test_nothing_is_lost_by_not_tuning_what_cannot_win(costs: dict[str, float]) -> None:
    given, evolution = material(seed=3), EvolutionSettings(generations=8, **costs)  # type: ignore[arg-type]
    made = [columns_of(given, *given.columns[list(at)].tolist()) for at in ((0, 9, 20), (1, 9, 21), (0, 10), (12,))]
    made += [open_entries(query, 3) for query in made]
    runs = [tune_gaps(given, query, evolution, seed) for seed, query in enumerate(made)]
    every = [recurring_keyframes([run.query for run in runs], agreement, 1, 8) for agreement in AGREEMENTS]
    tuned = [tune_gaps(given, query, evolution, 5) for query in every if query is not None]
    assert all(run.rank <= rank_bound(given, run.query, evolution) + 1e-12 for run in [*tuned, *runs])
    best = max(tuned, key=lambda run: run.rank)
    for at_least, floor in (("median", np.median([run.rank for run in runs])), ("best", max(run.rank for run in runs))):
        found = find_consensus(given, runs, evolution, 1, 5, at_least)  # type: ignore[arg-type]
        assert found.origin == ("consensus" if best.rank >= floor else "best run")
        if found.origin == "consensus":
            assert found.query.key() == best.query.key()


def open_entries(query: Individual, bits: int) -> Individual:
    """The same with fewer entries."""
    mask = np.uint64((1 << bits) - 1)
    return replace(query, masks=query.masks & mask, values=query.values & mask)


def test_without_runs_there_is_nothing_to_agree_on() -> None:
    with pytest.raises(ParameterError, match="runs must be at least one"):
        find_consensus(material(), [], EvolutionSettings(), 1, 5)
