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
    PRIORS,
    SLOPE_SPREAD,
    Prior,
    evidence_of,
    learn_confidence,
)
from kinedex.ops.annotation.decoding import STANDING_OUT
from kinedex.ops.annotation.segments import Segment
from kinedex.ops.errors import ParameterError
from tests.oracles import confidence as oracle

PRIOR = Prior(("cost",), (0.2,), (0.1,), 0.5, (-1.0,))
known = st.lists(st.tuples(st.floats(0, 0.5), st.integers(0, 1), st.booleans(), st.floats(0.1, 1)), max_size=5)


@given(known)
@settings(max_examples=15, deadline=None)
def test_coefficients_and_their_uncertainty_are_those_of_a_plain_search(
    rows: list[tuple[float, int, bool, float]],
) -> None:
    evidence = np.array([one[0] for one in rows]).reshape(-1, 1)
    classes = np.array([one[1] for one in rows], np.int64)
    right, weights = np.array([one[2] for one in rows], bool), np.array([one[3] for one in rows])
    found = learn_confidence(PRIOR, evidence, classes, right, weights, 2)
    design = [[1.0, (cost - 0.2) / 0.1, float(label == 0), float(label == 1)] for cost, label, _, _ in rows]
    spread = [OFFSET_SPREAD, SLOPE_SPREAD, CLASS_SPREAD, CLASS_SPREAD]

    def loss(point: list[float]) -> float:
        return oracle.loss(point, design, right.tolist(), weights.tolist(), [0.5, -1.0, 0.0, 0.0], spread)

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
    one = learn_confidence(PRIOR, cost[:, None], classes, right, np.ones(200), 2)
    low, high = one.of(np.array([[0.05], [0.35]]), np.array([0, 0]))
    (other,) = one.of(np.array([[0.05]]), np.array([1]))
    assert low > 0.9
    assert high < 0.1
    assert 0.5 < other < low


def test_segments_that_weigh_nothing_change_nothing() -> None:
    cost, classes = np.linspace(0.05, 0.35, 20)[:, None], np.zeros(20, np.int64)
    nothing = learn_confidence(PRIOR, cost, classes, np.ones(20, bool), np.zeros(20), 1)
    bare = learn_confidence(PRIOR, np.empty((0, 1)), np.empty(0, np.int64), np.empty(0, bool), np.empty(0), 1)
    assert nothing.of(cost, classes) == pytest.approx(bare.of(cost, classes))


def test_that_all_were_right_is_no_certainty() -> None:
    sure = learn_confidence(PRIOR, np.full((30, 1), 0.2), np.zeros(30, np.int64), np.ones(30, bool), np.ones(30), 1)
    (value,) = sure.of(np.array([[0.2]]), np.array([0]))
    assert 0.9 < value < 1


@given(
    st.lists(st.tuples(st.integers(0, 20), st.integers(1, 20)), min_size=1, max_size=6),
    st.lists(st.tuples(st.integers(0, 20), st.integers(1, 20)), max_size=3),
)
@settings(max_examples=30, deadline=None)
def test_evidence_of_segments(first: list[tuple[int, int]], second: list[tuple[int, int]]) -> None:
    takes = [[Segment(a, a + n, 0, 0.04, 1, 0.5, 1.5) for a, n in own] for own in (first, second)]
    names = ("others", "pace", "haste", "length", "cost", "fixed", "margin", "lead", "value")
    found = evidence_of(names, takes, np.array([0, 40, 80]), [7, 10], [0.5, 0.75]).tolist()
    for own in (first, second):
        for a, n in own:
            alone = min(0.5 / -math.expm1(-1.5 / n / STANDING_OUT), 1.0)
            pace = math.log(n / 10)
            count = oracle.others([(b, b + m) for b, m in own], a, a + n)
            expected = [count, pace, abs(pace), math.log(n), 0.2, 0.75, 0.5, math.sqrt(1.5 / n * alone), math.log(1.5)]
            assert found.pop(0) == pytest.approx(expected)
    assert evidence_of(names, [[], []], np.array([0, 40, 80]), [7], [0.5]).shape == (0, len(names))


def test_a_segment_in_which_no_path_ends_has_evidence_too() -> None:
    (row,) = evidence_of(("cost",), [[Segment(0, 5, 0, math.nan, 0)]], np.array([0, 9]), [5], [0.5])
    assert np.isfinite(row).all()


def test_priors_name_evidence_that_there_is() -> None:
    for prior in PRIORS.values():
        found = evidence_of(prior.evidence, [[Segment(0, 5, 0, 0.1, 0, 0.5, 1.0)]], np.array([0, 9]), [5], [0.5])
        assert found.shape == (1, len(prior.centres)) == (1, len(prior.scales)) == (1, len(prior.slopes))


def test_wrong_arguments_are_named() -> None:
    evidence, classes, right, weights = np.ones((2, 1)), np.array([0, 1]), np.ones(2, bool), np.ones(2)
    with pytest.raises(ParameterError, match="right"):
        learn_confidence(PRIOR, evidence, classes, right[:1], weights, 2)
    with pytest.raises(ParameterError, match="classes"):
        learn_confidence(PRIOR, evidence, classes, right, weights, 1)
