"""Classical warping against its naive twin and against the enumeration of all paths."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.templates.warping import align
from tests.oracles import warping as naive

coarse = st.sampled_from([0.0, 0.25, 0.5, 1.0])  # few values, so that ties are common
weight = st.sampled_from([0.75, 1.0, 4 / 3])


@st.composite
def problems(draw: st.DrawFn, longest: int = 9) -> tuple[list[list[float]], list[float], list[float]]:
    rows, columns = draw(st.integers(1, longest)), draw(st.integers(1, longest))
    cost = draw(st.lists(st.lists(coarse, min_size=columns, max_size=columns), min_size=rows, max_size=rows))
    return (
        cost,
        draw(st.lists(weight, min_size=rows, max_size=rows)),
        draw(st.lists(weight, min_size=columns, max_size=columns)),
    )


@given(problems())
def test_alignment_and_path_equal_the_naive_twin(problem: tuple[list[list[float]], list[float], list[float]]):
    cost, first, second = problem
    found = align(np.array(cost), np.array(first), np.array(second))
    total, path = naive.align(cost, first, second)
    assert found.cost == total
    assert [tuple(cell) for cell in found.path.tolist()] == path


@given(problems(longest=4))
def test_no_path_is_cheaper(problem: tuple[list[list[float]], list[float], list[float]]):
    cost, first, second = problem
    found = align(np.array(cost), np.array(first), np.array(second))
    assert found.cost == pytest.approx(naive.cheapest_by_enumeration(cost, first, second), abs=1e-12)


def test_equal_columns_are_aligned_along_the_diagonal_and_then_by_the_first_sequence():
    same = align(np.zeros((4, 2)), np.ones(4), np.ones(2))
    assert same.cost == 0
    assert same.path.tolist() == [[0, 0], [1, 0], [2, 0], [3, 1]]


def test_a_wrong_matrix_is_refused_in_words():
    with pytest.raises(ParameterError, match="local_cost must be"):
        align(np.zeros((0, 3)), np.ones(0), np.ones(3))
    with pytest.raises(ParameterError, match="weights must be"):
        align(np.zeros((2, 3)), np.ones(3), np.ones(3))
    with pytest.raises(ParameterError, match="finite and not negative"):
        align(np.array([[np.nan]]), np.ones(1), np.ones(1))
