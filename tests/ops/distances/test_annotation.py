"""Annotation: local minima, modified curves, labels, growing; against the naive twin and by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ops.distances.annotation import Segment, annotate, local_minima, spread_minima
from ops.errors import ParameterError
from tests.oracles import annotation as naive

INF = math.inf
# Few values, so that plateaus and ties are common; one of them differs from another by rounding only.
cost = st.sampled_from([0.0, 0.05, 0.1, 0.1 + 1e-12, 0.12, 0.2, INF])


@st.composite
def curves(draw: st.DrawFn, several: int = 4) -> list[list[float]]:
    length = draw(st.integers(1, 14))
    return draw(st.lists(st.lists(cost, min_size=length, max_size=length), min_size=1, max_size=several))


@given(curves(several=1), st.sampled_from([0.05, 0.11, 0.13, 1.0]))
def test_local_minima_equal_the_naive_twin(drawn: list[list[float]], tau: float):
    assert local_minima(np.array(drawn[0]), tau).tolist() == naive.minima(drawn[0], tau)


@given(curves(several=1), st.data())
def test_a_minimum_lowers_its_whole_path(drawn: list[list[float]], data: st.DataObject):
    curve = drawn[0]
    ends = naive.minima(curve, 0.13)
    starts = {end: data.draw(st.integers(0, end)) for end in ends}
    spread = spread_minima(np.array(curve), np.array([starts[end] for end in ends], int), np.array(ends, int))
    assert spread.tolist() == naive.modified(curve, starts, 0.13)


@given(curves(), st.data())
def test_segments_equal_the_naive_twin(drawn: list[list[float]], data: st.DataObject):
    classes = data.draw(st.lists(st.integers(0, 2), min_size=len(drawn), max_size=len(drawn)))
    found = annotate(np.array(drawn), np.array(classes))
    expected = naive.annotate(drawn, classes)
    assert [(s.start, s.stop, s.class_index, s.subclass) for s in found] == [(*s[:3], s[4]) for s in expected]
    assert [s.cost for s in found] == pytest.approx([s[3] for s in expected], abs=1e-9)


def test_every_frame_of_a_low_plateau_is_a_minimum_and_the_ends_of_the_take_count():
    assert local_minima(np.array([0.1, 0.1, 0.2, 0.05, 0.05, 0.06, 0.01]), 0.13).tolist() == [0, 1, 3, 4, 6]
    assert local_minima(np.array([0.12, 0.13]), 0.12).tolist() == []
    assert local_minima(np.array([INF, INF]), 0.13).tolist() == []


def test_a_class_is_as_near_as_its_nearest_subclass_and_the_first_class_wins_a_tie():
    modified = np.array([[0.1, 0.1, INF], [0.1, INF, 0.1], [0.02, INF, INF]])
    assert annotate(modified, np.array([0, 1, 1])) == [
        Segment(0, 1, 1, 0.02, 2),
        Segment(0, 2, 0, 0.1, 0),  # labelled at 1, where the other class has nothing, and grown
        Segment(2, 3, 1, 0.1, 1),
    ]


def test_a_run_grows_down_the_slopes_beside_it_over_frames_of_another_class_but_not_into_infinity():
    mine = [INF, 0.01, 0.02, 0.03, 0.03, 0.02, 0.06, INF]
    other = [INF, 0.0, 0.0, 0.05, 0.05, 0.0, 0.0, INF]
    segments = annotate(np.array([mine, other]), np.array([0, 1]))
    assert Segment(1, 6, 0, 0.01, 0) in segments  # labelled at 3 and 4, grown to 1 and 5, not up to 6
    assert [s for s in segments if s.class_index == 1] == [Segment(1, 3, 1, 0.0, 1), Segment(5, 7, 1, 0.0, 1)]


def test_segments_of_one_class_that_come_to_touch_are_one_with_the_least_cost():
    mine = np.array([0.05, 0.05, 0.03, 0.03, 0.05, 0.05])
    other = np.array([INF, INF, 0.01, 0.01, INF, INF])
    first, second = annotate(np.array([mine, other]), np.array([0, 1]))
    assert (first.start, first.stop, first.cost) == (0, 6, 0.03)
    assert (second.start, second.stop) == (2, 4)


def test_nothing_below_the_threshold_is_nothing_annotated():
    assert annotate(np.full((2, 5), INF), np.array([0, 1])) == []
    assert annotate(np.empty((0, 5)), np.empty(0, int)) == []


def test_wrong_input_is_refused_in_words():
    with pytest.raises(ParameterError, match="threshold must be above 0"):
        local_minima(np.zeros(3), 0)
    with pytest.raises(ParameterError, match="starts must be"):
        spread_minima(np.zeros(3), np.array([2]), np.array([1]))
    with pytest.raises(ParameterError, match="classes must be"):
        annotate(np.zeros((2, 3)), np.array([0]))
