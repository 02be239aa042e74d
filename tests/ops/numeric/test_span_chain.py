"""The best chain of spans is that of an enumeration, whatever is left out on the way to it."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.arrays import F64, I64
from kinedex.ops.numeric.candidate_cuts import Candidates, candidate_cuts
from kinedex.ops.numeric.span_chain import Spans, best_chain, span_evidence, spans_between
from tests.ops.numeric.test_candidate_cuts import COLUMNS, FIRSTS, evidence_of, projected_frames
from tests.oracles.recognition import best_spans, path_evidence

USUAL = np.array([3.6, 6.0])


def with_all_cuts(found: Candidates, frames: int) -> Candidates:
    """Return every frame as a candidate, with gains that are far too great a bound."""
    cuts = np.arange(frames + 1)
    return Candidates(cuts, 1000.0 * cuts, found.background)


@settings(max_examples=40, deadline=None)
@given(
    frames=st.integers(2, 40), seed=st.integers(0, 999), readiness=st.sampled_from([0.0, 2.0, 8.0]),
    scale=st.sampled_from([0.1, 3.0, 30.0]), every=st.booleans(),
)  # fmt: skip
def test_a_chain_is_the_best_of_all(frames: int, seed: int, readiness: float, scale: float, every: bool) -> None:
    projected = projected_frames(frames, seed)
    candidates = candidate_cuts(projected, COLUMNS)
    if every:
        candidates = with_all_cuts(candidates, frames)
    spans = spans_between(candidates.cuts, USUAL)
    worth = -scale * np.random.default_rng(seed).exponential(size=spans.fits.shape)
    found = best_chain(projected, COLUMNS, candidates, spans, worth, readiness)
    allowed = {
        (start, stop, k): worth[span, k]
        for span, (start, stop) in enumerate(zip(spans.starts.tolist(), spans.stops.tolist(), strict=True))
        for k in np.flatnonzero(spans.fits[span]).tolist()
    }
    evidence = evidence_of(projected)
    expected = best_spans(evidence, FIRSTS, candidates.cuts, allowed, readiness)
    chosen = zip(spans.starts[found.spans].tolist(), spans.stops[found.spans].tolist(), found.classes, strict=True)
    assert list(chosen) == expected
    for score, (start, stop, k) in zip(found.scores, expected, strict=True):
        own = evidence[start:stop, FIRSTS[k] : FIRSTS[k + 1]] + readiness
        assert score == pytest.approx(path_evidence(own) + allowed[start, stop, k], abs=1e-3)


@settings(max_examples=30, deadline=None)
@given(cuts=st.sets(st.integers(0, 40), min_size=2), seed=st.integers(0, 999), gaps=st.booleans())
def test_the_evidence_of_spans_is_that_of_the_best_paths(cuts: set[int], seed: int, gaps: bool) -> None:
    projected = projected_frames(40, seed)
    background = candidate_cuts(projected, COLUMNS).background
    edges = np.array(sorted(cuts))
    starts, stops = edges[:-1][:: 1 + gaps], edges[1:][:: 1 + gaps]
    fits = np.random.default_rng(seed).random((len(starts), len(FIRSTS) - 1)) < 0.7
    found = span_evidence(projected, COLUMNS, background, starts, stops, fits)
    evidence = evidence_of(projected)
    for own, allowed, start, stop in zip(found, fits, starts.tolist(), stops.tolist(), strict=True):
        for k, value in enumerate(own.tolist()):
            expected = path_evidence(evidence[start:stop, FIRSTS[k] : FIRSTS[k + 1]]) if allowed[k] else -np.inf
            assert value == pytest.approx(expected, abs=1e-3)


def test_of_classes_with_equal_scores_it_is_the_first() -> None:
    means: F64 = np.zeros((4, 3))
    columns = type(COLUMNS).of_means(np.ones((1, 3)), means, np.array([0, 2, 4]), 0.5)
    projected = projected_frames(9, 0) * np.float32([0, 0, 0, 1])
    candidates = with_all_cuts(candidate_cuts(projected, columns), 9)
    spans = spans_between(candidates.cuts, np.array([9.0, 9.0]))
    found = best_chain(projected, columns, candidates, spans, np.zeros(spans.fits.shape), 1.0)
    assert found.classes.tolist() == [0] * len(found.spans)


@settings(max_examples=30, deadline=None)
@given(st.sets(st.integers(0, 60), min_size=2))
def test_spans_lie_between_all_cuts_at_usual_distances(places: set[int]) -> None:
    cuts: I64 = np.array(sorted(places))
    found = spans_between(cuts, USUAL)
    expected = [
        (start, stop, tuple(int(0.4 * usual) <= stop - start <= int(2.2 * usual) for usual in USUAL))
        for start, stop in combinations(cuts.tolist(), 2)
    ]
    spans = zip(found.starts.tolist(), found.stops.tolist(), map(tuple, found.fits.tolist()), strict=True)
    assert list(spans) == [one for one in expected if any(one[2])]
    np.testing.assert_array_equal(cuts[found.begins], found.starts)
    np.testing.assert_array_equal(cuts[found.ends], found.stops)


def test_a_take_without_spans_has_no_labels() -> None:
    projected = projected_frames(2, 0)
    candidates = candidate_cuts(projected, COLUMNS)
    spans: Spans = spans_between(candidates.cuts, np.array([40.0, 50.0]))
    assert not len(best_chain(projected, COLUMNS, candidates, spans, np.zeros(spans.fits.shape), 8.0).spans)
