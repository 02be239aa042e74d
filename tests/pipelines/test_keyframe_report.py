"""The page about learned keyframe queries shows what the runs did, and needs nothing from outside."""

from __future__ import annotations

import numpy as np
import pytest

from ops.learning.consensus import Consensus
from ops.learning.fitness import Query
from ops.learning.lessons import Run
from pipelines.keyframes.learning import Chosen, Outcome
from pipelines.report.keyframes import agreement_image, bars, courses, keyframes_page, stiffnesses
from tests.pipelines.labelled import BODY
from tests.pipelines.study import Reading


def outcome() -> Outcome:
    query = Query(
        np.array([0b100, 1 << 20], np.uint64), np.array([0b100, 0], np.uint64), np.array([2, 9]),
        np.array([4]), np.array([16]),
    )  # fmt: skip
    matrix = np.full((12, 40), 0.5)
    matrix[2, 2] = 0.75
    found = Consensus("consensus", query, 1.0, 0.99, 0.5, 0.9, 0.99, matrix)
    return Outcome("kick", found, (Chosen(query, 3, 4),), 0.9, 1.0, 12, ("a", "b"), 7)


def test_the_page_tells_each_class_with_its_query_in_words() -> None:
    history = np.array([[0.2, 1.0, 0.5, 0.6], [0.8, 0.9, 0.85, 1.0]])
    run = Run(outcome().consensus.query, 1.0, 0.99, history, 60)
    page = keyframes_page("Keyframes of kicks", [outcome()], {"kick": [run, run]}, BODY)
    reading = Reading(page)
    for text in ("Keyframes of kicks", "consensus of 7 runs", "rhand_above_neck →4–16→ −lknee_bent", "1 gap between"):
        assert text in reading.text
    assert all(reference.startswith("data:") for reference in reading.references)
    assert page == keyframes_page("Keyframes of kicks", [outcome()], {"kick": [run, run]}, BODY)


def test_generations_are_averaged_over_runs_and_shorter_runs_go_on_as_they_ended() -> None:
    long = np.array([[0.0, 1.0, 0.0, 0.0], [0.5, 1.0, 0.5, 0.5], [1.0, 1.0, 1.0, 1.0]])
    found = {course.name: course for course in courses([long, long[:2]])}
    assert found["precision"].last == pytest.approx(0.75)
    assert found["recall"].last == 1.0
    assert found["precision"].path.startswith("M0.0 200.0L320.0 100.0L640.0 50.0")
    assert courses([]) == []


def test_stiffness_is_that_of_the_gap_range() -> None:
    found = stiffnesses([outcome()], BODY)
    assert found == [pytest.approx(0.5)]
    counted = bars(found)
    assert [bar.count for bar in counted] == [0, 0, 0, 0, 0, 1, 0, 0, 0, 0]
    assert bars([])[0].count == 0


def test_agreement_is_stretched_and_emptiness_is_grey() -> None:
    assert agreement_image(outcome().consensus.matrix) != agreement_image(np.full((12, 40), 0.5))
    assert agreement_image(np.full((12, 40), 0.5)).startswith("data:image/png;base64,")
