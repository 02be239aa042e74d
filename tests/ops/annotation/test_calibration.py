"""The threshold that divides a class from others best, beside a search over all of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.annotation.calibration import best_threshold, threshold_scores
from kinedex.ops.errors import ParameterError

costs = st.lists(st.integers(0, 40).map(lambda n: n / 40) | st.just(np.inf), max_size=12)


def measure(own: list[float], others: list[float], tau: float) -> float:
    hits, false = sum(cost < tau for cost in own), sum(cost < tau for cost in others)
    return 2 * hits / (hits + false + len(own))


@given(costs.filter(lambda own: bool(np.isfinite(own).any())), costs)
def test_no_threshold_divides_better(own: list[float], others: list[float]):
    tau, score = best_threshold(np.array(own), np.array(others))
    assert tau > 0
    assert score == pytest.approx(measure(own, others, tau))
    assert score >= max(measure(own, others, tried / 160) for tried in range(1, 400)) - 1e-12


@given(costs.filter(lambda own: bool(np.isfinite(own).any())), costs)
def test_scores_are_those_of_a_threshold_above_each_distance(own: list[float], others: list[float]):
    distances, scores = threshold_scores(np.array(own), np.array(others))
    assert distances.tolist() == sorted({one for one in [*own, *others] if np.isfinite(one)})
    expected = [measure(own, others, one + 1 / 160) for one in distances]  # distances are 1/40 apart
    assert scores.tolist() == pytest.approx(expected)


def test_the_middle_of_the_widest_gap_is_taken():
    assert best_threshold(np.array([0.02, 0.04]), np.array([0.1, 0.3])) == (pytest.approx(0.07), 1.0)
    assert best_threshold(np.array([0.1]), np.array([np.inf])) == (pytest.approx(0.15), 1.0)
    # 0.02 | 0.03 other | 0.05: with one false, or with one missed
    tau, score = best_threshold(np.array([0.02, 0.05]), np.array([0.03, 0.4]))
    assert tau == pytest.approx(0.225)
    assert score == pytest.approx(0.8)
    with pytest.raises(ParameterError, match="own must be distances from 0, at least one of them finite"):
        best_threshold(np.array([np.inf]), np.array([0.1]))
