"""Intervals are wide where little is known, and hold the truth as often as they state."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.evaluation.reliability import wilson
from studies.two_stage_interval import two_stage_interval


@given(st.integers(1, 300).flatmap(lambda total: st.tuples(st.integers(0, total), st.just(total))))
def test_the_ends_are_the_shares_that_lie_z_standard_errors_away(counts: tuple[int, int]) -> None:
    hits, total = counts
    low, high = wilson(hits, total)
    assert 0.0 <= low <= hits / total <= high <= 1.0
    for end in (low, high):
        if 0.0 < end < 1.0:
            assert abs(hits / total - end) == pytest.approx(1.959964 * math.sqrt(end * (1 - end) / total), abs=1e-6)


def test_all_of_few_is_not_certain_and_all_of_many_nearly() -> None:
    assert wilson(6, 6)[0] == pytest.approx(0.6097, abs=1e-4)
    assert wilson(600, 600)[0] > 0.99
    assert wilson(0, 0) == (0.0, 1.0)
    assert wilson(5, 10, level=0.5)[1] < wilson(5, 10)[1]


def units(shares: list[float], count: int) -> list[np.ndarray]:
    return [np.array([[n < share * count, 1] for n in range(count)], np.int64) for share in shares]


def test_groups_that_differ_make_the_interval_wider_than_units_alone() -> None:
    alike = two_stage_interval([units([0.5, 0.5, 0.5], 40)])
    apart = two_stage_interval([units([0.0, 0.5, 1.0], 40)])
    assert alike[0] < 0.5 < alike[1]
    assert apart[1] - apart[0] > 2 * (alike[1] - alike[0])
    # what differs between strata was not drawn, and so does not count
    between = two_stage_interval([units([share] * 3, 40) for share in (0.0, 0.5, 1.0)])
    assert between[1] - between[0] < alike[1] - alike[0]


def test_the_interval_holds_the_truth_about_as_often_as_it_says() -> None:
    random = np.random.default_rng(4)
    held = 0
    for trial in range(60):
        people = [random.random(30) < random.beta(8, 2) for _ in range(12)]
        groups = [np.stack([hits, np.ones(30)], axis=1).astype(np.int64) for hits in people]
        low, high = two_stage_interval([groups], draws=400, seed=trial)
        held += low <= 0.8 <= high
    assert 51 <= held <= 60


def test_wholes_weigh_and_the_same_seed_gives_the_same() -> None:
    takes = [np.array([[10, 100], [0, 300]], np.int64)]
    found = two_stage_interval([takes], seed=1)
    assert found == two_stage_interval([takes], seed=1)
    assert found == (0.0, 0.1)
    assert all(math.isnan(end) for end in two_stage_interval([]))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: wilson(3, 2), "hits must be between 0 and the total"),
        (lambda: wilson(1, 2, 1.0), "level must be above 0 and below 1"),
        (lambda: two_stage_interval([], draws=0), "draws must be 1 or more"),
        (lambda: two_stage_interval([[np.array([[1, 0]])]]), "wholes above 0"),
    ],
)
def test_wrong_numbers_are_refused(call: object, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        call()  # type: ignore[operator]
