"""The best hits, looked for block by block, against the whole curve and a sorted list."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.distances.costs import encode
from kinedex.ops.distances.pruning import coarse_bounds
from kinedex.ops.distances.sweep import BLOCK
from kinedex.ops.ranking import best_hits
from kinedex.ops.ranking.block_search import gather_blocks
from kinedex.ops.words import TakeWords
from tests.ops.distances.test_dtw import as_words_with_gaps, feature_weights, quantised, takes_with_gaps, templates
from tests.oracles import ranking as naive

thresholds = st.sampled_from([0.05, 0.1, 0.3, 0.5, 1.0])


@given(templates, st.lists(takes_with_gaps, min_size=1, max_size=4), thresholds, st.integers(1, 6), st.data())
def test_the_first_hits_of_blocks_are_those_of_the_naive_twin(
    template: list[list[int | None]],
    takes: list[list[list[int] | None]],
    threshold: float,
    most: int,
    data: st.DataObject,
):
    offsets = np.concatenate(([0], np.cumsum([len(take) for take in takes]))).astype(np.int64)
    laid = np.concatenate([np.empty(0, np.uint64), *(as_words_with_gaps(take) for take in takes)])
    archive = best_hits._archive(TakeWords(np.arange(len(takes)), offsets, laid), None, None, None)
    one = quantised(template)
    made_for = threshold * data.draw(st.sampled_from([1.0, 2.0]))
    (coarse,) = coarse_bounds([one], archive.coded, np.array([made_for]), archive.ranges)
    hits = best_hits._best_below(one, archive, threshold, most, coarse)
    expected = naive.ranked(template, takes, threshold)[:most]
    assert list(zip(hits.takes.tolist(), hits.starts.tolist(), hits.stops.tolist(), strict=True)) == [
        found[:3] for found in expected
    ]
    np.testing.assert_allclose(hits.costs, [found[3] for found in expected], rtol=0, atol=1e-12)


@given(templates, feature_weights, takes_with_gaps, thresholds, st.integers(1, 6), st.data())
def test_the_first_hits_of_blocks_are_the_first_of_all_hits_within_ranges_and_in_any_order(
    template: list[list[int | None]],
    weights: list[float],
    take: list[list[int] | None],
    threshold: float,
    most: int,
    data: st.DataObject,
):
    words = np.tile(as_words_with_gaps(take), 3)
    edges = np.arange(4, dtype=np.int64) * len(take)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(take)), min_size=4, max_size=4)))
    own = np.array(cuts, np.int64).reshape(2, 2)
    ranges = np.concatenate([own + edge for edge in edges[:-1]])
    order = np.array(data.draw(st.permutations(range(3))), np.int64)
    archive = best_hits._archive(TakeWords(np.arange(3), edges, words), ranges, None, order)
    one = quantised(template, weights)
    (coarse,) = coarse_bounds([one], archive.coded, np.array([threshold]), archive.ranges)
    first = best_hits._best_below(one, archive, threshold, most, coarse)
    every = best_hits._all_below(one, archive, threshold, None, coarse)
    for name in ("takes", "starts", "stops", "costs"):
        np.testing.assert_array_equal(getattr(first, name), getattr(every, name)[:most])
    assert first.frames == every.frames


@given(
    st.lists(st.integers(1, 40), min_size=1, max_size=8),
    st.lists(st.integers(0, 255), min_size=40, max_size=40),
    st.integers(1, 255),
    st.integers(1, 60),
)
def test_groups_hold_every_frame_of_their_blocks_once_and_stay_within_ranges(
    lengths: list[int], sums: list[int], below: int, columns: int
):
    edges = np.concatenate(([0], np.cumsum(lengths))).astype(np.int64)
    ranges = np.stack([edges[:-1], edges[1:]], axis=1)
    least = np.array(sums, np.uint8)[: -(-int(edges[-1]) // BLOCK)]
    takes = np.arange(len(ranges), dtype=np.int64) // 2
    groups = gather_blocks(np.flatnonzero(least < below), least, ranges, takes, columns)
    held = np.zeros(edges[-1], np.int64)
    for start, stop, opens, closes, take, bound in groups.tolist():
        assert opens <= start < stop <= closes
        assert stop - start <= columns + 8 + BLOCK
        assert takes[edges[:-1] == opens].tolist() == [take]
        held[start:stop] += 1
        blocks = least[start // BLOCK : (stop - 1) // BLOCK + 1]
        assert bound == blocks.min()
    assert held.max(initial=0) <= 1
    assert held[np.repeat(least < below, BLOCK)[: edges[-1]]].all()


def test_a_motionless_take_is_computed_in_short_windows_whose_minima_know_their_neighbours():
    rng = np.random.default_rng(4)
    still = np.full(400, 0b1011, np.uint64)
    still[rng.integers(0, 400, 60)] ^= np.uint64(2)
    words = TakeWords(np.arange(1), np.array([0, 400]), still)
    one = quantised([[1, 1, 0, 1], [1, 0, 0, 1], [1, 1, 0, 1], [1, None, 0, 1]])
    archive = best_hits._archive(words, None, encode(still), None)
    (coarse,) = coarse_bounds([one], archive.coded, np.array([0.2]), archive.ranges)
    first = best_hits._best_below(one, archive, 0.2, 200, coarse)
    every = best_hits.rank(one, words, 0.2)
    assert 100 < len(every) < 200
    for name in ("takes", "starts", "stops", "costs"):
        np.testing.assert_array_equal(getattr(first, name), getattr(every, name))
