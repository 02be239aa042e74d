"""Pruned minima and ranked hits against the whole curve and a sorted list."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.annotation.segments import local_minima
from kinedex.ops.distances import pruning
from kinedex.ops.distances.costs import encode
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.distances.pruning import FineBound, coarse_bound, coarse_bounds, fine_bound, possible_minima
from kinedex.ops.distances.sweep import BLOCK, CAP
from kinedex.ops.errors import ParameterError
from kinedex.ops.ranking import best_hits
from kinedex.ops.ranking.best_hits import Hits, rank, rank_together
from kinedex.ops.templates.templates import QuantisedTemplate, learn_soft, quantise
from kinedex.ops.words import NO_WORD, TakeWords
from tests.ops.distances.test_dtw import as_words_with_gaps, feature_weights, quantised, takes_with_gaps, templates
from tests.oracles import ranking as naive
from tests.plain_python import slow_as_python

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


@given(
    st.lists(st.tuples(templates, st.none() | feature_weights, thresholds), min_size=1, max_size=4),
    st.lists(takes_with_gaps, max_size=3),
    st.sampled_from([None, 1, 2]),
)
def test_templates_ranked_together_have_the_hits_that_each_has_alone(
    several: list[tuple[list[list[int | None]], list[float] | None, float]],
    takes: list[list[list[int] | None]],
    most: int | None,
):
    chosen = [quantised(template, weights) for template, weights, _ in several]
    words = laid_out(takes)
    together = rank_together(chosen, words, np.array([threshold for _, _, threshold in several]), most)
    for one, hits, (template, weights, threshold) in zip(chosen, together, several, strict=True):
        assert_same_hits(hits, rank(one, words, threshold, most))
        costs = [cost for *_, cost in naive.ranked(template, takes, threshold, weights)[:most]]
        if weights is None:
            np.testing.assert_allclose(hits.costs, costs, rtol=0, atol=1e-12)
        elif len(costs):
            assert abs(hits.costs[0] - costs[0]) < 1e-9  # beyond, equal costs may be ordered by rounding


def assert_same_hits(one: Hits, other: Hits) -> None:
    for name in ("takes", "starts", "stops", "costs"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.frames == other.frames


@given(
    st.lists(st.tuples(templates, st.none() | feature_weights, thresholds), min_size=1, max_size=4),
    takes_with_gaps,
    st.data(),
)
def test_a_coarse_bound_is_never_above_the_curve(
    several: list[tuple[list[list[int | None]], list[float] | None, float]],
    take: list[list[int] | None],
    data: st.DataObject,
):
    words = as_words_with_gaps(take)
    chosen = [quantised(template, weights) for template, weights, _ in several]
    cuts = sorted(data.draw(st.lists(st.integers(0, len(take)), min_size=4, max_size=4)))
    ranges = np.array(cuts, np.int64).reshape(2, 2)
    curves = distance_curves(chosen, words, ranges)
    kept = ranges[ranges[:, 0] < ranges[:, 1]]
    taus = np.array([threshold for *_, threshold in several])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pruning, "_TABLE_CELLS", data.draw(st.sampled_from([1, 60 * len(words) + 1, 1 << 20])))
        coarse = coarse_bounds(chosen, encode(words), taus, kept)
    for one, curve, tau, template in zip(coarse, curves, taus.tolist(), chosen, strict=True):
        assert (np.repeat(one.sums, BLOCK)[: len(curve)] * one.unit <= curve + 1e-12).all()
        for lower in (tau, tau / 2, tau / 10):
            assert not (~np.repeat(one.blocks_below(lower), BLOCK)[: len(curve)] & (curve < lower)).any()
            for bound in (one, None):
                assert_no_minimum_is_lost(fine_bound(template, encode(words), lower, kept, bound), curve, lower, kept)


def assert_no_minimum_is_lost(bound: FineBound, curve: np.ndarray, tau: float, ranges: np.ndarray) -> None:
    assert bound.frames == (ranges[:, 1] - ranges[:, 0]).sum()
    left = bound.units < CAP
    assert (bound.units[left] * bound.unit <= curve[left] + 1e-12).all()
    assert (curve[~left] >= tau - 1e-12).all()
    candidates, possible = possible_minima(bound.units, bound.ranges, bound.slack)
    minima = np.concatenate([np.empty(0, np.int64), *(local_minima(curve[a:b], tau) + a for a, b in ranges.tolist())])
    assert np.isin(minima, candidates[possible]).all()
    # what decides about a minimum is there, too
    beside = np.concatenate([minima - 1, minima + 1])
    beside = beside[(beside >= 0) & (beside < len(curve))]
    assert np.isin(beside[left[beside] & (curve[beside] < tau)], candidates).all()


def walk(rng: np.random.Generator, frames: int, bits: int) -> np.ndarray:
    """Words that change one bit at a time, now and then, as those of motions do."""
    flips = np.where(rng.random(frames) < 0.3, 1 << rng.integers(0, bits, frames), 0)
    return np.bitwise_xor.accumulate(flips.astype(np.uint64))


def spoiled(rng: np.random.Generator, words: np.ndarray, bits: int) -> QuantisedTemplate:
    masks = rng.integers(0, 1 << bits, len(words)).astype(np.uint64)
    noise = (rng.random(len(words)) < 0.1) * (1 << rng.integers(0, bits, len(words)))
    return QuantisedTemplate(masks, (words ^ noise.astype(np.uint64)) & masks)


@slow_as_python
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("threshold", [0.02, 0.1, 0.25])
def test_pruning_loses_no_minimum_and_reports_what_it_skipped(
    seed: int, threshold: float, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(pruning, "_MIN_COLUMNS", 1)  # coarse sums are computed in any case
    rng = np.random.default_rng(seed)
    words = walk(rng, 60_000, 16)
    words[rng.integers(0, len(words), 20)] = NO_WORD
    columns = int(rng.integers(5, 60))
    begin = int(rng.integers(0, 50_000))
    template = spoiled(rng, words[begin : begin + columns], 16)
    cuts = np.unique(rng.integers(0, len(words), 20))
    ranges = np.stack([cuts[:-1], cuts[1:]], axis=1)
    (curve,) = distance_curves([template], words, ranges)
    coded = encode(words)
    whole = fine_bound(template, coded, threshold, ranges)
    pruned = fine_bound(template, coded, threshold, ranges, coarse_bound(template, coded, threshold, ranges))
    for bound in (whole, pruned):
        assert_no_minimum_is_lost(bound, curve, threshold, ranges)
    assert whole.computed >= whole.frames
    if threshold == 0.02:
        assert pruned.computed < 0.7 * pruned.frames


@slow_as_python
@pytest.mark.parametrize("seed", range(3))
def test_the_best_hits_are_the_first_of_all_hits(seed: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(pruning, "_MIN_COLUMNS", 1)
    rng = np.random.default_rng(seed)
    words = walk(rng, 20_000, 12)
    columns = int(rng.integers(20, 60))
    template = spoiled(rng, words[5000 : 5000 + columns], 12)
    for _ in range(40):  # good places and worse ones, more of them than are asked for
        at, noise = int(rng.integers(0, len(words) - columns)), rng.random(columns) < rng.random() * 0.4
        words[at : at + columns] = template.value ^ np.where(noise, 1 << rng.integers(0, 12, columns), 0).astype(
            np.uint64
        )
    takes = TakeWords(np.arange(3), np.array([0, 7000, 15_000, len(words)]), words)
    every = rank(template, takes, 0.15)
    assert len(every) > 30
    thresholds = []
    below = best_hits._best_below
    monkeypatch.setattr(best_hits, "_best_below", lambda *given: thresholds.append(given[2]) or below(*given))
    for most in (1, 2, 7, 20, 30):
        hits = rank(template, takes, 0.15, most)
        for name in ("takes", "starts", "stops", "costs"):
            np.testing.assert_array_equal(getattr(hits, name), getattr(every, name)[:most])
    assert len(thresholds) >= 5  # lower ones were tried
    assert max(thresholds) < 0.15


@pytest.mark.shared
def test_real_classes_ranked_together_have_the_minima_of_their_whole_curves(shared: Path):
    rows = (
        pl.read_parquet(shared / "reference" / "feature_words.parquet")
        .filter(pl.col("source_frame") % 4 == 0)
        .with_columns(pl.col("take").cast(pl.String))
        .filter(pl.col("take").str.starts_with("HDM_"))
        .sort("take", "source_frame")
    )
    takes = {str(take): frames["word"].to_numpy() for (take,), frames in rows.group_by("take", maintain_order=True)}
    offsets = np.cumsum([0, *map(len, takes.values())]).astype(np.int64)
    words = TakeWords(np.arange(len(takes)), offsets, np.concatenate(list(takes.values())))
    classes: dict[str, list[np.ndarray]] = {}
    for name, own in takes.items():
        if found := re.fullmatch(r"HDM_(?:bd|bk|dg)_(\w+)_\d+_120", name):
            classes.setdefault(found[1], []).append(own)
    chosen = [quantise(learn_soft(clips[:6], 40).template, 0.1) for clips in classes.values()]
    assert len(chosen) == 11
    ranges = np.stack([offsets[:-1], offsets[1:]], axis=1)
    curves = distance_curves(chosen, words.words, ranges)
    together = rank_together(chosen, words, np.full(11, 0.1), 40)
    coarse = coarse_bounds(chosen, encode(words.words), np.full(11, 0.1), ranges)
    for template, curve, hits, bound in zip(chosen, curves, together, coarse, strict=True):
        assert_no_minimum_is_lost(fine_bound(template, encode(words.words), 0.1, ranges, bound), curve, 0.1, ranges)
        assert hits.costs[0] == curve.min()
        assert_same_hits(hits, rank(template, words, 0.1, 40))
        assert (np.repeat(bound.sums, BLOCK)[: len(curve)] * bound.unit <= curve + 1e-12).all()


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


def test_equal_hits_come_in_the_order_that_takes_are_given():
    template = QuantisedTemplate(np.full(6, 1023, np.uint64), np.arange(1, 7, dtype=np.uint64))
    take = np.concatenate([np.full(12, 1020, np.uint64), np.arange(1, 7, dtype=np.uint64)])
    words = TakeWords(np.arange(5), np.arange(0, 91, 18), np.tile(take, 5))
    order = np.array([3, 0, 4, 1, 2])
    for most in (None, 1, 2, 3, 5):
        assert rank(template, words, 0.1, most).takes.tolist() == [0, 1, 2, 3, 4][:most]
        assert rank(template, words, 0.1, most, order=order).takes.tolist() == [1, 3, 4, 0, 2][:most]
        for hits in rank_together([template, template], words, np.array([0.1, 0.1]), most, order=order):
            assert hits.takes.tolist() == [1, 3, 4, 0, 2][:most]
    with pytest.raises(ParameterError, match="order must be"):
        rank(template, words, 0.1, order=order[:2])


@pytest.mark.parametrize("block", [1, 2, 3, 7, 1000])
def test_a_motionless_interval_is_divided_without_a_trace(block: int, monkeypatch: pytest.MonkeyPatch):
    rng = np.random.default_rng(block)
    still = np.full(90, 0b1011, np.uint64)
    for at in rng.integers(0, len(still), 9):
        still[at] ^= np.uint64(1 << int(rng.integers(0, 4)))
    words = TakeWords(np.arange(2), np.array([0, 50, 180]), np.concatenate([still, still]))
    template = QuantisedTemplate(np.full(5, 0b1111, np.uint64), np.array([11, 11, 11, 3, 11], np.uint64))
    ranges = np.array([[3, 20], [20, 50], [60, 61], [62, 175]])
    monkeypatch.setattr(best_hits, "_BLOCK", 1 << 40)
    whole = [
        rank(template, words, tau, most, own) for tau in (0.1, 0.5) for most in (None, 3) for own in (None, ranges)
    ]
    monkeypatch.setattr(best_hits, "_BLOCK", block)
    parts = [
        rank(template, words, tau, most, own) for tau in (0.1, 0.5) for most in (None, 3) for own in (None, ranges)
    ]
    for one, other in zip(parts, whole, strict=True):
        assert_same_hits(one, other)
    assert len(whole[4]) > 5


def test_the_window_does_not_grow_with_a_motionless_interval():
    for frames in (10_000, 100_000):
        still = np.arange(frames, dtype=np.int64)
        groups = best_hits.grouped(still, np.zeros(frames, np.int64), 150)
        assert groups[0] == 0
        assert groups[-1] == frames
        assert np.diff(groups).max() <= best_hits._BLOCK


def test_wrong_wishes_are_refused_in_words():
    template = QuantisedTemplate(np.ones(4, np.uint64), np.ones(4, np.uint64))
    takes = TakeWords(np.array([1, 2]), np.array([0, 4, 8]), np.ones(8, np.uint64))
    with pytest.raises(ParameterError, match="within a take"):
        rank(template, takes, 0.1, ranges=np.array([[2, 6]]))
    with pytest.raises(ParameterError, match="most must be"):
        rank(template, takes, 0.1, most=0)
    with pytest.raises(ParameterError, match="threshold must be"):
        rank(template, takes, 0)
