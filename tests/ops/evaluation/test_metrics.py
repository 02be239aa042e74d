"""Metrics: the worked numbers of the thesis, the naive twin with sets, and the undefined cases."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.evaluation.metrics import Counts, compare, f_measure, pooled
from tests.oracles import metrics as naive

segment = st.tuples(st.integers(0, 20), st.integers(1, 6)).map(lambda drawn: (drawn[0], sum(drawn)))
segments = st.fixed_dictionaries({"walk": st.lists(segment, max_size=4), "kick": st.lists(segment, max_size=4)})


def closed(*ranges: tuple[int, int]) -> list[tuple[int, int]]:
    """Turn the thesis's ranges, from 1 and closed at both ends, into ours."""
    return [(start - 1, stop) for start, stop in ranges]


def test_the_worked_numbers_of_figure_5_3():
    counts = pooled(
        [
            compare(closed((1, 3), (6, 7)), closed((2, 4), (8, 10))),
            compare(closed((4, 9), (11, 12)), closed((5, 8))),
        ]
    )
    assert (counts.p1, counts.r1) == (6 / 13, 6 / 10)
    assert (counts.p2, counts.r2) == (2 / 4, 2 / 3)
    assert counts.f1 == pytest.approx(2 * (6 / 13) * 0.6 / (6 / 13 + 0.6))
    assert counts == Counts(6, 13, 10, 2, 4, 2, 3)


@given(segments, segments)
def test_measures_equal_those_of_sets(automatic: naive.Segments, manual: naive.Segments):
    counts = pooled(compare(automatic[name], manual[name]) for name in automatic)
    expected = naive.measures(automatic, manual)
    for name, value in expected.items():
        assert getattr(counts, name) == pytest.approx(value, nan_ok=True)
    assert counts.f1 == pytest.approx(
        2 * counts.frames_both / (counts.frames_automatic + counts.frames_manual)
        if counts.frames_automatic + counts.frames_manual
        else math.nan,
        nan_ok=True,
    )


def test_annotating_nothing_leaves_precision_undefined_and_the_f_measure_0():
    counts = compare([], [(0, 4)])
    assert math.isnan(counts.p1)
    assert math.isnan(counts.p2)
    assert (counts.r1, counts.f1, counts.r2, counts.f2) == (0, 0, 0, 0)


def test_a_class_that_is_neither_found_nor_there_has_no_measures():
    counts = compare(np.empty((0, 2), np.int64), [])
    assert all(math.isnan(value) for value in (counts.p1, counts.r1, counts.f1, counts.p2, counts.r2, counts.f2))
    assert f_measure(0, 0) == 0


def test_frames_count_once_and_segments_each():
    counts = compare([(0, 5), (3, 8)], [(7, 9)])
    assert counts == Counts(1, 8, 2, 1, 2, 1, 1)


def test_an_empty_segment_is_refused():
    with pytest.raises(ParameterError, match="manual must be segments"):
        compare([], [(3, 3)])
