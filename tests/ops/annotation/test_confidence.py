"""Confidence: learned from segments of which it is known whether they are right, against plain loops."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.annotation.confidence import (
    CLASS_SPREAD,
    OFFSET_SPREAD,
    SLOPE_SPREAD,
    Prior,
    learn_confidence,
)
from kinedex.ops.errors import ParameterError
from tests.oracles import confidence as oracle

PRIOR = Prior(("cost",), (0.2,), (0.1,), 0.5, (-1.0,))
known = st.lists(st.tuples(st.floats(0, 0.5), st.integers(0, 1), st.booleans()), max_size=5)


@given(known)
@settings(max_examples=15, deadline=None)
def test_coefficients_and_their_uncertainty_are_those_of_a_plain_search(rows: list[tuple[float, int, bool]]) -> None:
    evidence = np.array([one[0] for one in rows]).reshape(-1, 1)
    classes = np.array([one[1] for one in rows], np.int64)
    right = np.array([one[2] for one in rows], bool)
    found = learn_confidence(PRIOR, evidence, classes, right, 2)
    design = [[1.0, (cost - 0.2) / 0.1, float(label == 0), float(label == 1)] for cost, label, _ in rows]
    spread = [OFFSET_SPREAD, SLOPE_SPREAD, CLASS_SPREAD, CLASS_SPREAD]

    def loss(point: list[float]) -> float:
        return oracle.loss(point, design, right.tolist(), [0.5, -1.0, 0.0, 0.0], spread)

    point = oracle.least(loss, [0.0] * 4)
    assert found.coefficients == pytest.approx(point, abs=1e-3)
    assert found.covariance @ np.array(oracle.curvature(loss, point)) == pytest.approx(np.eye(4), abs=0.01)
    for row, sure in zip(design, found.of(evidence, classes).tolist(), strict=True):
        odds = float(np.array(row) @ point)
        variance = float(np.array(row) @ found.covariance @ np.array(row))
        assert sure == pytest.approx(1 / (1 + math.exp(-odds / math.sqrt(1 + math.pi * variance / 8))), abs=1e-3)


def test_known_segments_make_sure_and_a_class_without_any_is_less_sure() -> None:
    cost = np.linspace(0.05, 0.35, 200)
    right, classes = cost < 0.2, np.zeros(200, np.int64)
    one = learn_confidence(PRIOR, cost[:, None], classes, right, 2)
    low, high = one.of(np.array([[0.05], [0.35]]), np.array([0, 0]))
    (other,) = one.of(np.array([[0.05]]), np.array([1]))
    assert low > 0.9
    assert high < 0.1
    assert 0.5 < other < low


def test_that_all_were_right_is_no_certainty() -> None:
    sure = learn_confidence(PRIOR, np.full((30, 1), 0.2), np.zeros(30, np.int64), np.ones(30, bool), 1)
    (value,) = sure.of(np.array([[0.2]]), np.array([0]))
    assert 0.9 < value < 1


def test_wrong_arguments_are_named() -> None:
    evidence, classes, right = np.ones((2, 1)), np.array([0, 1]), np.ones(2, bool)
    with pytest.raises(ParameterError, match="right"):
        learn_confidence(PRIOR, evidence, classes, right[:1], 2)
    with pytest.raises(ParameterError, match="classes"):
        learn_confidence(PRIOR, evidence, classes, right, 1)
