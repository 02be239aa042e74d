"""Paths of distance curves against the way back through the whole matrix, the least curve, and essential minima."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.distances.curve_path import curve_paths, essential_minima, least_curve
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.errors import ParameterError
from tests.ops.distances.test_dtw import as_words_with_gaps, quantised, takes_with_gaps, templates
from tests.oracles.allocation import essential
from tests.oracles.dtw import curve_and_starts, local_cost


@given(templates, takes_with_gaps)
def test_a_path_starts_where_the_twin_says_and_costs_what_the_curve_says(
    template: list[list[int | None]], take: list[list[int] | None]
):
    if not take:
        return
    words, one = as_words_with_gaps(take), quantised(template)
    (curve,) = distance_curves([one], words)
    _, starts = curve_and_starts(template, take)
    ends = np.flatnonzero(curve < np.inf)
    for end, path in zip(ends.tolist(), curve_paths(one, words, ends), strict=True):
        assert (path.start, len(path.columns)) == (starts[end], end + 1 - path.start)
        assert (path.columns[0], path.columns[-1]) == (0, len(template) - 1)
        on_path = [frame for frame, n in enumerate(path.columns, path.start) if n == int(n)]
        columns = [int(path.columns[frame - path.start]) for frame in on_path]
        steps = np.diff(columns, prepend=-1)
        cost = sum(s * local_cost(template[n], take[f]) for s, n, f in zip(steps, columns, on_path, strict=True))
        assert cost / len(template) == pytest.approx(curve[end])
        apart = np.diff(on_path)
        assert set(zip(steps[1:].tolist(), apart.tolist(), strict=True)) <= {(1, 1), (1, 2), (2, 1)}


def test_a_frame_where_no_path_ends_is_refused():
    one = quantised([[1], [1], [1]])
    with pytest.raises(ParameterError, match="finite"):
        curve_paths(one, np.ones(5, np.uint64), np.array([0]))


def test_the_least_curve_is_the_first_of_equals():
    curves = np.array([[np.inf, 0.3, 0.2, 0.1], [np.inf, 0.3, 0.1, 0.2]])
    least = least_curve(curves)
    np.testing.assert_array_equal(least.costs, [np.inf, 0.3, 0.1, 0.1])
    np.testing.assert_array_equal(least.curves, [-1, 0, 1, 0])


def test_of_the_minima_of_figure_6_8_frames_12_and_7_are_essential():
    starts, ends = np.array([3, 9, 9, 3]), np.array([7, 12, 13, 8])
    assert ends[essential_minima(starts, ends, np.array([0.06, 0.01, 0.02, 0.065]))].tolist() == [12, 7]


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 20), st.sampled_from([0.0, 0.1, 0.2])), max_size=12))
def test_essential_minima_are_those_of_the_twin(minima: list[tuple[int, int, float]]):
    rows = [(start, start + length, cost) for start, length, cost in minima]
    starts, ends = np.array([r[0] for r in rows], np.int64), np.array([r[1] for r in rows], np.int64)
    assert essential_minima(starts, ends, np.array([r[2] for r in rows])).tolist() == essential(rows)
