"""Counts above thresholds, against the comparison of segments for each threshold by itself."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.errors import ParameterError
from kinedex.ops.evaluation.metrics import compare
from kinedex.ops.evaluation.threshold_counts import threshold_counts
from kinedex.ops.inertial.disagreement import flagged_ranges

TAUS = [0.0, 5.0, 20.0, 45.0, 179.0]


@pytest.mark.parametrize("seed", range(6))
def test_all_thresholds_count_as_each_by_itself(seed: int) -> None:
    random = np.random.default_rng(seed)
    values = np.abs(np.cumsum(random.normal(0, 8, 400))) % 180
    values[random.random(400) < 0.1] = 20.0  # on a threshold: not above it
    starts = random.integers(0, 390, 7)
    manual = np.stack([starts, np.minimum(starts + random.integers(1, 60, 7), 400)], axis=1)
    found = threshold_counts(values, manual, TAUS)
    assert found == [compare(flagged_ranges(values > tau), manual) for tau in TAUS]


def test_nothing_marked_and_nothing_measured_are_counted() -> None:
    assert threshold_counts(np.empty(0), [], TAUS) == [compare([], []) for _ in TAUS]
    assert threshold_counts(np.full(3, 50.0), [], [45.0]) == [compare([(0, 3)], [])]


def test_wrong_input_is_refused() -> None:
    with pytest.raises(ParameterError, match="ascending"):
        threshold_counts(np.ones(3), [], [2.0, 1.0])
    with pytest.raises(ParameterError, match="values"):
        threshold_counts(np.array([np.nan]), [], [1.0])
    with pytest.raises(ParameterError, match="manual"):
        threshold_counts(np.ones(3), [(2, 4)], [1.0])
