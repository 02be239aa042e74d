"""Average precision against its definition, and by hand."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.evaluation.metrics import average_precision, precision_recall
from tests.oracles import ranking as naive


@given(st.lists(st.booleans(), max_size=20), st.integers(0, 5))
def test_average_precision_equals_its_naive_twin(relevant: list[bool], missed: int):
    total = sum(relevant) + missed
    expected = naive.average_precision(relevant, total)
    assert average_precision(relevant, total) == pytest.approx(expected, nan_ok=True)


def test_a_ranking_by_hand():
    precision, recall = precision_recall([True, False, True], 4)
    assert precision.tolist() == [1, 1 / 2, 2 / 3]
    assert recall.tolist() == [1 / 4, 1 / 4, 1 / 2]
    assert average_precision([True, False, True], 4) == pytest.approx((1 + 2 / 3) / 4)
    assert average_precision([], 3) == 0
    assert math.isnan(average_precision([False], 0))
    with pytest.raises(ParameterError, match="at least 2"):
        average_precision([True, True], 1)
