"""Minima within short ranges are those of whole curves, range by range."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.annotation.segments import local_minima
from kinedex.ops.distances import range_minima as within
from kinedex.ops.distances.costs import encode
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.distances.pruning import coarse_bounds
from kinedex.ops.distances.range_minima import minima_within
from kinedex.ops.errors import ParameterError
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import NO_WORD
from tests.ops.distances.test_dtw import as_words_with_gaps, feature_weights, quantised, takes_with_gaps, templates
from tests.ops.ranking.test_best_hits import spoiled, walk
from tests.oracles.paths import start_frames
from tests.plain_python import slow_as_python


def assert_those_of_whole_curves(
    several: list[QuantisedTemplate], words: np.ndarray, taus: np.ndarray, ranges: list[np.ndarray]
) -> None:
    found = minima_within(several, words, taus, ranges)
    assert len(found) == len(several)
    coarse = coarse_bounds(several, encode(words), taus * 1.2, np.array([[0, len(words)]]))
    bounded = minima_within(
        several, words, taus, ranges, coarse=[None if s == 1 else one for s, one in enumerate(coarse)]
    )
    for one, other in zip(found.parts(), bounded.parts(), strict=True):
        for mine, theirs in zip(one, other, strict=True):
            np.testing.assert_array_equal(mine, theirs)
    for template, tau, own, part in zip(several, taus.tolist(), ranges, found.parts(), strict=True):
        (curve,) = distance_curves([template], words, own)
        ends = np.concatenate([np.empty(0, np.int64), *(local_minima(curve[a:b], tau) + a for a, b in own.tolist())])
        np.testing.assert_array_equal(part[1], ends)
        np.testing.assert_array_equal(part[2], curve[ends])
        np.testing.assert_array_equal(part[0], start_frames(template, words, ends, own))


weighted = st.tuples(templates, st.none() | feature_weights).map(lambda drawn: quantised(*drawn))


@given(st.lists(weighted, max_size=3), takes_with_gaps, st.data())
def test_minima_are_those_of_whole_curves(
    several: list[QuantisedTemplate], take: list[list[int] | None], data: st.DataObject
):
    cuts = st.lists(st.integers(0, len(take)), min_size=4, max_size=4).map(sorted)
    ranges = [np.array(data.draw(cuts), np.int64).reshape(2, 2) for _ in several]
    taus = np.array([data.draw(st.sampled_from([0.05, 0.2, 1.0])) for _ in several], np.float64)
    assert_those_of_whole_curves(several, as_words_with_gaps(take), taus, ranges)


@slow_as_python
@pytest.mark.parametrize("seed", range(3))
def test_long_ranges_of_many_words_are_gone_over_in_pieces(seed: int):
    rng = np.random.default_rng(seed)
    words = walk(rng, 30_000, 30)
    words[rng.integers(0, len(words), 5)] = NO_WORD
    assert len(np.unique(words)) > within._PIECE + 2 * 70
    several = [spoiled(rng, words[begin : begin + columns], 30) for begin, columns in ((9_000, 1), (20_000, 70))]
    ranges = [
        np.array([[0, 3 * within._PIECE], [3 * within._PIECE, len(words)]]),
        np.array([[19_000, 21_500], [22_000, 22_010]]),
    ]
    assert_those_of_whole_curves(several, words, np.array([0.2, 0.3]), ranges)


def test_a_threshold_for_each_template_is_asked_for():
    template = quantised([[0, 0, 0, 0, 0]])
    with pytest.raises(ParameterError, match="thresholds must be above 0, one for each of 1 templates"):
        minima_within([template], np.zeros(3, np.uint64), np.zeros(1), [np.array([[0, 3]])])
    with pytest.raises(ParameterError, match="ranges must be"):
        minima_within([template], np.zeros(3, np.uint64), np.ones(1), [np.array([[0, 4]])])
