"""Annotation: local minima, modified curves, labels, growing; against the naive twin and by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.annotation.segments import Matches, Segment, annotate, local_minima
from kinedex.ops.errors import ParameterError
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


def as_matches(modified: list[list[float]]) -> Matches:
    """Matches of one frame each, whose modified curves are the ones given."""
    frames = [np.flatnonzero(np.isfinite(np.array(curve, float))) for curve in modified]
    return Matches.of([(at, at, np.array(curve, float)[at]) for at, curve in zip(frames, modified, strict=True)])


def segments_of(modified: list[list[float]], classes: list[int], tau: float = INF) -> list[Segment]:
    length = len(modified[0]) if modified else 0
    (found,) = annotate(as_matches(modified), np.array(classes, int), np.array([0, length]), tau)
    return found


def assert_equal(found: list[Segment], expected: list[tuple[int, int, int, float, int, float]]) -> None:
    assert [(s.start, s.stop, s.class_index, s.subclass) for s in found] == [(*s[:3], s[4]) for s in expected]
    assert [s.cost for s in found] == pytest.approx([s[3] for s in expected], abs=1e-9)
    assert [s.margin for s in found] == pytest.approx([s[5] for s in expected], abs=1e-9)


@given(curves(), st.data())
def test_segments_equal_the_naive_twin(drawn: list[list[float]], data: st.DataObject):
    classes = data.draw(st.lists(st.integers(0, 2), min_size=len(drawn), max_size=len(drawn)))
    assert_equal(segments_of(drawn, classes, 0.15), naive.annotate(drawn, classes, 0.15))


@given(st.lists(curves(), min_size=1, max_size=3), st.data())
def test_minima_spread_over_their_paths_and_takes_do_not_touch(takes: list[list[list[float]]], data: st.DataObject):
    subclasses = max(map(len, takes))
    classes = data.draw(st.lists(st.integers(0, 2), min_size=subclasses, max_size=subclasses))
    offsets = np.cumsum([0, *(len(take[0]) for take in takes)])
    ends: list[list[int]] = [[] for _ in range(subclasses)]
    starts, costs = [list[int]() for _ in range(subclasses)], [list[float]() for _ in range(subclasses)]
    modified = []
    for take, shift in zip(takes, offsets.tolist(), strict=False):
        modified.append([[INF] * len(take[0]) for _ in range(subclasses)])
        for s, curve in enumerate(take):
            begins = {end: data.draw(st.integers(0, end)) for end in naive.minima(curve, 0.15)}
            modified[-1][s] = naive.modified(curve, begins, 0.15)
            ends[s] += [shift + end for end in begins]
            starts[s] += [shift + start for start in begins.values()]
            costs[s] += [curve[end] for end in begins]
    matches = Matches.of(
        [(np.array(a, int), np.array(b, int), np.array(c, float)) for a, b, c in zip(starts, ends, costs, strict=True)]
    )
    found = annotate(matches, np.array(classes), offsets, np.array([0.15, 0.2, 0.13]))
    for own, curves_of_take in zip(found, modified, strict=True):
        assert_equal(own, naive.annotate(curves_of_take, classes, [0.15, 0.2, 0.13]))


def test_many_islands_in_long_takes_are_all_there():
    rng = np.random.default_rng(0)
    modified = np.where(rng.random((3, 3000)) < 0.3, rng.choice([0.0, 0.05, 0.1], (3, 3000)), INF).tolist()
    assert_equal(segments_of(modified, [0, 1, 0], 0.15), naive.annotate(modified, [0, 1, 0], 0.15))


def test_every_frame_of_a_low_plateau_is_a_minimum_and_the_ends_of_the_take_count():
    assert local_minima(np.array([0.1, 0.1, 0.2, 0.05, 0.05, 0.06, 0.01]), 0.13).tolist() == [0, 1, 3, 4, 6]
    assert local_minima(np.array([0.12, 0.13]), 0.12).tolist() == []
    assert local_minima(np.array([INF, INF]), 0.13).tolist() == []


def test_a_class_is_as_near_as_its_nearest_subclass_and_the_first_class_wins_a_tie():
    modified = [[0.1, 0.1, INF], [0.1, INF, 0.1], [0.02, INF, INF]]
    assert segments_of(modified, [0, 1, 1]) == [
        Segment(0, 1, 1, 0.02, 2),
        Segment(0, 2, 0, 0.1, 0),  # labelled at 1, where the other class has nothing, and grown
        Segment(2, 3, 1, 0.1, 1),
    ]


def test_a_run_grows_down_the_slopes_beside_it_over_frames_of_another_class_but_not_into_infinity():
    mine = [INF, 0.01, 0.02, 0.03, 0.03, 0.02, 0.06, INF]
    other = [INF, 0.0, 0.0, 0.05, 0.05, 0.0, 0.0, INF]
    segments = segments_of([mine, other], [0, 1])
    assert Segment(1, 6, 0, 0.01, 0) in segments  # labelled at 3 and 4, grown to 1 and 5, not up to 6
    assert [s for s in segments if s.class_index == 1] == [Segment(1, 3, 1, 0.0, 1), Segment(5, 7, 1, 0.0, 1)]


def test_segments_of_one_class_that_come_to_touch_are_one_with_the_least_cost():
    mine = [0.05, 0.05, 0.03, 0.03, 0.05, 0.05]
    other = [INF, INF, 0.01, 0.01, INF, INF]
    first, second = segments_of([mine, other], [0, 1])
    assert (first.start, first.stop, first.cost) == (0, 6, 0.03)
    assert (second.start, second.stop) == (2, 4)


def test_nothing_below_the_threshold_is_nothing_annotated():
    assert segments_of([[INF] * 5] * 2, [0, 1]) == []
    assert annotate(Matches.of([]), np.empty(0, int), np.array([0, 5, 5])) == [[], []]


def test_wrong_input_is_refused_in_words():
    with pytest.raises(ParameterError, match="threshold must be above 0"):
        local_minima(np.zeros(3), 0)
    with pytest.raises(ParameterError, match="classes must be"):
        annotate(as_matches([[0.0], [0.0]]), np.array([0]), np.array([0, 1]))
    with pytest.raises(ParameterError, match="threshold must be one for each of 2 classes"):
        annotate(as_matches([[0.0], [0.0]]), np.array([0, 1]), np.array([0, 1]), np.array([0.1]))
