"""Pruned minima and ranked hits against the whole curve and a sorted list."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ops.distances import pruning
from ops.distances.annotation import local_minima
from ops.distances.dtw import distance_curves, start_frames
from ops.distances.pruning import minima_below
from ops.distances.ranking import rank
from ops.errors import ParameterError
from ops.templates.templates import QuantisedTemplate
from ops.words import NO_WORD, TakeWords
from tests.ops.distances.test_dtw import as_words_with_gaps, quantised, takes_with_gaps, templates
from tests.oracles import ranking as naive

thresholds = st.sampled_from([0.05, 0.1, 0.3, 0.5, 1.0])


def laid_out(takes: list[list[list[int] | None]]) -> TakeWords:
    offsets = np.concatenate(([0], np.cumsum([len(take) for take in takes]))).astype(np.int64)
    words = [np.empty(0, np.uint64), *(as_words_with_gaps(take) for take in takes)]
    return TakeWords(np.arange(len(takes), dtype=np.int64), offsets, np.concatenate(words))


@given(templates, st.lists(takes_with_gaps, max_size=3), thresholds, st.sampled_from([None, 1, 2]))
def test_hits_are_those_of_the_naive_twin(
    template: list[list[int | None]], takes: list[list[list[int] | None]], threshold: float, most: int | None
):
    hits = rank(quantised(template), laid_out(takes), threshold, most)
    expected = naive.ranked(template, takes, threshold)[:most]
    assert list(zip(hits.takes.tolist(), hits.starts.tolist(), hits.stops.tolist(), strict=True)) == [
        one[:3] for one in expected
    ]
    np.testing.assert_allclose(hits.costs, [one[3] for one in expected], rtol=0, atol=1e-12)


def walk(rng: np.random.Generator, frames: int, bits: int) -> np.ndarray:
    """Words that change one bit at a time, now and then, as those of motions do."""
    flips = np.where(rng.random(frames) < 0.3, 1 << rng.integers(0, bits, frames), 0)
    return np.bitwise_xor.accumulate(flips.astype(np.uint64))


def spoiled(rng: np.random.Generator, words: np.ndarray, bits: int) -> QuantisedTemplate:
    masks = rng.integers(0, 1 << bits, len(words)).astype(np.uint64)
    noise = (rng.random(len(words)) < 0.1) * (1 << rng.integers(0, bits, len(words)))
    return QuantisedTemplate(masks, (words ^ noise.astype(np.uint64)) & masks)


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="as plain Python it takes minutes")
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("threshold", [0.02, 0.1, 0.25])
def test_pruning_loses_no_minimum_and_says_what_it_skipped(
    seed: int, threshold: float, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(pruning, "_WORTH_A_LOOK", 2.0)  # blocks are looked at in any case
    rng = np.random.default_rng(seed)
    words = walk(rng, 60_000, 16)
    words[rng.integers(0, len(words), 20)] = NO_WORD
    columns = int(rng.integers(5, 60))
    begin = int(rng.integers(0, 50_000))
    template = spoiled(rng, words[begin : begin + columns], 16)
    cuts = np.unique(rng.integers(0, len(words), 20))
    ranges = np.stack([cuts[:-1], cuts[1:]], axis=1)
    (curve,) = distance_curves([template], words, ranges)
    expected = np.concatenate([local_minima(curve[a:b], threshold) + a for a, b in ranges.tolist()])
    for prune in (True, False):
        found = minima_below(template, words, threshold, ranges, prune=prune)
        np.testing.assert_array_equal(found.ends, expected)
        np.testing.assert_array_equal(found.costs, curve[expected])
        np.testing.assert_array_equal(found.starts, start_frames(template, words, expected, ranges))
        assert 0 <= found.skipped <= 1
        assert found.frames == cuts[-1] - cuts[0]
        if not prune:
            assert found.computed >= found.frames
    if threshold == 0.02:
        assert minima_below(template, words, threshold, ranges).skipped > 0.3


def test_a_hit_of_ten_frames_rules_out_what_ends_or_starts_close_to_it():
    template = QuantisedTemplate(np.full(10, 1023, np.uint64), np.arange(1, 11, dtype=np.uint64))
    motion = np.arange(1, 11, dtype=np.uint64)
    far = np.full(30, 1020, np.uint64)
    words = np.concatenate([far, motion, far, motion, far])
    takes = TakeWords(np.array([7, 9]), np.array([0, 60, len(words)]), words)
    hits = rank(template, takes, 0.1)
    assert (hits.takes.tolist(), hits.starts.tolist(), hits.stops.tolist()) == ([0, 1], [30, 10], [40, 20])
    assert hits.costs.tolist() == [0, 0]
    inside = rank(template, takes, 0.01, ranges=np.array([[25, 39], [60, 80]]))
    assert (inside.takes.tolist(), inside.starts.tolist(), inside.stops.tolist()) == ([1], [10], [20])


def test_wrong_wishes_are_refused_in_words():
    template = QuantisedTemplate(np.ones(4, np.uint64), np.ones(4, np.uint64))
    takes = TakeWords(np.array([1, 2]), np.array([0, 4, 8]), np.ones(8, np.uint64))
    with pytest.raises(ParameterError, match="within a take"):
        rank(template, takes, 0.1, ranges=np.array([[2, 6]]))
    with pytest.raises(ParameterError, match="most must be"):
        rank(template, takes, 0.1, most=0)
    with pytest.raises(ParameterError, match="threshold must be"):
        rank(template, takes, 0)
