"""The page about learned keyframe queries shows what the runs did, and needs nothing from outside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kinedex.ops.keyframes.consensus import Consensus
from kinedex.ops.keyframes.training_task import Individual, LearningRun
from kinedex.pipelines.keyframes.query_learning import ChosenQuery, Outcome
from kinedex.reports.keyframes_page import PANEL, bars, history_curves, keyframes_page, matrix_of, stiffnesses
from tests.pipelines.labelled import BODY
from tests.pipelines.study import Reading


def outcome() -> Outcome:
    query = Individual(
        np.array([0b100, 1 << 20], np.uint64), np.array([0b100, 0], np.uint64), np.array([2, 9]),
        np.array([4]), np.array([16]),
    )  # fmt: skip
    matrix = np.full((12, 40), 0.5)
    matrix[2, 2] = 0.75
    found = Consensus("consensus", query, 1.0, 0.99, 0.5, 0.9, 0.99, matrix)
    return Outcome("kick", found, (ChosenQuery(query, 3, 4),), 0.9, 1.0, 12, ("a", "b"), 7)


def test_the_page_tells_each_class_with_its_query_in_words() -> None:
    history = np.array([[0.2, 1.0, 0.5, 0.6], [0.8, 0.9, 0.85, 1.0]])
    run = LearningRun(outcome().consensus.query, 1.0, 0.99, history, 60)
    page = keyframes_page("Keyframes of kicks", [outcome()], {"kick": [run, run]}, BODY, 30.0)
    reading = Reading(page)
    for text in (
        "Keyframes of kicks",
        "consensus of 7 runs",
        "rhand_above_neck →4–16→ −lknee_bent",
        "1 gap between",
        "2 of 2 (0.34–1.00)",
        "0.1, 0.1 s",
    ):
        assert text in reading.text
    # links lead to places of the page itself, and nothing comes from outside
    assert all(f'id="{reference[1:]}"' in page and reference[0] == "#" for reference in reading.references)
    assert page == keyframes_page("Keyframes of kicks", [outcome()], {"kick": [run, run]}, BODY, 30.0)


def test_generations_are_averaged_over_runs_and_shorter_runs_go_on_as_they_ended() -> None:
    long = np.array([[0.0, 1.0, 0.0, 0.0], [0.5, 1.0, 0.5, 0.5], [1.0, 1.0, 1.0, 1.0]])
    found = {course.name: course for course in history_curves([long, long[:2]])}
    assert found["precision"].last == pytest.approx(0.75)
    assert found["recall"].last == 1.0
    assert found["precision"].path.startswith("M0.0 200.0L320.0 100.0L640.0 50.0")
    assert history_curves([]) == []


def test_stiffness_is_that_of_the_gap_range() -> None:
    found = stiffnesses([outcome()], BODY)
    assert found == [pytest.approx(0.5)]
    counted = bars(found)
    assert [bar.count for bar in counted] == [0, 0, 0, 0, 0, 1, 0, 0, 0, 0]
    assert bars([])[0].count == 0


def test_a_matrix_has_the_features_that_count_with_all_runs_on_one_side_and_the_queries_on_the_other() -> None:
    found = matrix_of(outcome(), BODY, 30.0)
    # one feature stands out among the runs and is asked for, another one is asked for only
    assert found.names == ("rhand_above_neck", "lknee_bent")
    (all_runs,) = found.runs
    assert (all_runs.on, all_runs.strength, all_runs.y) == (True, 1.0, 0)
    assert all_runs.x == pytest.approx(2 / 12 * PANEL)
    assert all_runs.tip == "rhand_above_neck on in 50% of the runs, column 2"
    first, second = found.queries
    assert (first.on, first.query, second.on) == (True, 1, False)
    assert second.x == pytest.approx(9 / 12 * PANEL)
    assert second.tip == "query 1, keyframe 2: lknee_bent off"


def test_features_that_hardly_any_run_asks_for_are_left_out_of_a_matrix() -> None:
    faint = outcome()
    faint.consensus.matrix[5, 7] = 0.5 - 0.04
    assert len(matrix_of(faint, BODY, 30.0).names) == 2
    faint.consensus.matrix[5, 7] = 0.5 - 0.06
    assert len(matrix_of(faint, BODY, 30.0).names) == 3


def test_what_the_queries_find_of_other_clips_is_counted() -> None:
    page = keyframes_page("x", [replace(outcome(), precision=0.5)], {}, BODY, 30.0)
    assert "2 (precision: 0.15–0.85)" in Reading(page).text
