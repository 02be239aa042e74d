"""Sums of a window against the whole curve, in memory that is full of numbers which are no sums."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.distances.costs import encode, template_columns
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.distances.window_sums import make_window, path_start, sum_window
from tests.ops.distances.test_dtw import as_words_with_gaps, quantised, takes_with_gaps, templates
from tests.oracles.dtw import curve_and_starts


@given(
    templates,
    st.lists(takes_with_gaps, min_size=1, max_size=3),
    st.sampled_from([0.0, 0.02, 0.1, 0.3, 1.0]),
    st.data(),
)
def test_sums_within_the_limit_are_exact_and_the_others_above_it_whatever_was_there_before(
    template: list[list[int | None]], takes: list[list[list[int] | None]], share: float, data: st.DataObject
):
    words = np.concatenate([as_words_with_gaps(take) for take in takes])
    if not len(words):
        return
    one, coded = quantised(template), encode(words)
    columns = len(one)
    (curve,) = distance_curves([one], words)
    _, starts = curve_and_starts(template, [frame for take in takes for frame in take])
    limit = share * columns
    window = make_window(len(words) + 2, columns, len(coded.vocabulary))
    window.sums[2:] = -1e9
    found = np.empty(len(words), np.int64)
    for _ in range(3):
        end = data.draw(st.integers(0, len(words) - 1))
        stop = data.draw(st.integers(end + 1, len(words)))
        begin = max(end - 2 * (columns - 1), 0)
        sums = np.empty(stop - end)
        sum_window(coded.vocabulary, coded.codes, template_columns(one), begin, end, sums, limit, window)
        within = sums <= limit
        np.testing.assert_array_equal(sums[within] / columns, curve[end:stop][within])
        assert (curve[end:stop][~within] * columns > limit * (1 - 1e-9)).all()
        window.trail[:] = -1
        ends = np.flatnonzero(within & (sums < np.inf)) + end
        for e in ends.tolist():
            found[e] = path_start(window, coded.codes, begin, e, e, found)
        np.testing.assert_array_equal(found[ends], np.array(starts, np.float64)[ends])
