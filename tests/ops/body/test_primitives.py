"""Thresholds as ranges: a condition holds for the same numbers as its comparison."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.body import primitives as p
from kinedex.ops.body.feature_rules import ABOVE, AT_LEAST, AT_MOST, BELOW, WITHIN

LIMITS = st.floats(-1e300, 1e300)


@given(LIMITS, LIMITS, st.floats(allow_infinity=False))
def test_bounds_hold_what_the_comparison_holds(low: float, high: float, x: float) -> None:
    for near in (x, low, high, float(np.nextafter(low, np.inf)), float(np.nextafter(low, -np.inf))):
        expected = {
            ABOVE: near > low,
            AT_LEAST: near >= low,
            BELOW: near < low,
            AT_MOST: near <= low,
            WITHIN: low <= near <= high,
        }
        for comparison, holds in expected.items():
            least, greatest = p.bounds(comparison, low, high)
            assert (least <= near <= greatest) == holds


@pytest.mark.parametrize(
    ("values", "on"),
    [
        ([0.0, 2.0, 1.0, 0.4, 1.0, 2.0], [0, 1, 1, 0, 0, 1]),  # on by the strong, off by the weak condition
        ([2.0, 0.4, 2.0, 2.0], [1, 0, 1, 1]),
        ([2.0, np.nan, 1.0, 2.0, np.nan, 2.0], [1, 0, 0, 1, 0, 1]),  # NaN is neither
        ([1.0, 1.0], [0, 0]),
    ],
)
def test_a_feature_turns_on_strongly_and_stays_on_weakly(values: list[float], on: list[int]) -> None:
    weak, strong, words, state = (np.zeros(len(values), np.uint64) for _ in range(4))
    p.add_bit(np.array(values), 0.5, np.inf, 3, weak)
    p.add_bit(np.array(values), 1.5, np.inf, 3, strong)
    for part in (slice(0, 2), slice(2, None)):  # the state goes from one part to the next
        p.hysteresis(weak[part], strong[part], state[:2], words[part])
    assert words.tolist() == [0b1000 * bit for bit in on]
