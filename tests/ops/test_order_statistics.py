"""Order statistics against sorted copies."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.order_statistics import median, order_statistic, percentile

VALUES = st.lists(st.one_of(st.integers(-3, 3).map(float), st.floats(-1e6, 1e6), st.just(np.inf)), min_size=1)


@given(values=VALUES, gaps=st.integers(0, 3), data=st.data())
def test_a_rank_has_the_value_of_a_sorted_copy(values: list[float], gaps: int, data: st.DataObject) -> None:
    given_values = np.array(data.draw(st.permutations([*values, *[np.nan] * gaps])))
    rank = data.draw(st.integers(0, len(given_values) - 1))
    found = given_values.copy()
    np.testing.assert_equal(order_statistic(found, rank), np.sort(given_values)[rank])
    np.testing.assert_array_equal(np.sort(found), np.sort(given_values))


@given(values=st.lists(st.floats(-1e6, 1e6), min_size=1), percent=st.sampled_from([0.0, 10.0, 50.0, 90.0, 100.0]))
def test_medians_and_percentiles_are_those_of_numpy(values: list[float], percent: float) -> None:
    assert median(np.array(values)) == np.median(values)
    assert percentile(np.array(values), percent) == pytest.approx(np.percentile(values, percent), rel=1e-12, abs=1e-9)
