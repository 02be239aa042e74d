"""Margins around the hits of a query, and the template columns that its keyframes fit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.search.gaps import UNBOUNDED
from kinedex.ops.search.preselection import fit_keyframes, template_margins
from tests.oracles.preselection import best_placement, placement_cost


def bools(patterns: list[str]) -> tuple[np.ndarray, np.ndarray]:
    letters = np.array([list(pattern) for pattern in patterns])
    return letters != "*", letters == "1"


@pytest.mark.parametrize(
    ("first", "last", "columns", "stiffness", "expected"),
    [
        (0, 9, 10, 1.0, (2, 3)),
        (6, 10, 20, 0.5, (14, 22)),
        (6, 10, 20, 0.1, (14, 22)),
        (7, 13, 20, 0.7, (12, 12)),
        (0, 0, 1, 0.0, (2, 4)),
    ],
)
def test_the_margin_is_what_the_template_has_outside_its_keyframes(
    first: int, last: int, columns: int, stiffness: float, expected: tuple[int, int]
) -> None:
    assert template_margins(first, last, columns, stiffness) == expected


def test_margins_out_of_their_domain_are_refused() -> None:
    for wrong in ((3, 2, 9, 0.5), (0, 9, 9, 0.5), (-1, 2, 9, 0.5), (0, 1, 9, 1.5)):
        with pytest.raises(ParameterError):
            template_margins(*wrong)


def test_keyframes_find_their_columns() -> None:
    template = np.array([[0, 0], [0, 1], [1, 1], [1, 0], [0, 0]], float)
    fit = fit_keyframes(template, *bools(["01", "10"]), [(0, UNBOUNDED)])
    assert fit == (1, 3)


def test_of_equally_good_columns_the_leftmost_is_taken() -> None:
    template = np.array([[1.0], [0.0], [1.0], [1.0], [0.0], [0.0]])
    assert fit_keyframes(template, *bools(["1", "0"]), [(1, 2)]) == (0, 1)
    assert fit_keyframes(template, *bools(["*", "*"]), [(2, 9)]) == (0, 2)


def test_gaps_too_long_for_the_template_leave_the_order_only() -> None:
    fit = fit_keyframes(np.array([[0.0], [1.0], [0.5]]), *bools(["1", "1"]), [(5, 9)])
    assert fit == (1, 1)


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_the_fit_is_the_best_of_all_placements(data: st.DataObject) -> None:
    features = data.draw(st.integers(1, 3))
    value = st.sampled_from([0.0, 0.25, 0.5, 1.0])
    column = st.lists(value, min_size=features, max_size=features)
    template = data.draw(st.lists(column, min_size=1, max_size=7))
    pattern = st.text("01*", min_size=features, max_size=features)
    patterns = data.draw(st.lists(pattern, min_size=1, max_size=4))
    gap = st.tuples(st.integers(0, 4), st.one_of(st.integers(0, 5), st.just(UNBOUNDED)))
    gaps = [(low, low + more) for low, more in (data.draw(gap) for _ in patterns[1:])]
    fit = fit_keyframes(np.array(template), *bools(patterns), gaps)
    expected = best_placement(template, patterns, gaps)
    if expected is None:
        expected = best_placement(template, patterns, [(0, UNBOUNDED)] * len(gaps))
    assert expected is not None
    # Thirds are not exact in a computer; placements that differ by less than 1e-9 are equally good.
    assert placement_cost(template, patterns, fit) == pytest.approx(float(expected[1]), abs=1e-9)
    if all(pattern.count("*") != features - 3 for pattern in patterns):
        assert fit == expected[0]


def test_fitting_refuses_shapes_that_do_not_belong_together() -> None:
    masks, values = bools(["01", "1*"])
    for wrong in (
        lambda: fit_keyframes(np.zeros((0, 2)), masks, values, [(0, 1)]),
        lambda: fit_keyframes(np.zeros((4, 3)), masks, values, [(0, 1)]),
        lambda: fit_keyframes(np.zeros((4, 2)), masks, values, []),
    ):
        with pytest.raises(ParameterError):
            wrong()
