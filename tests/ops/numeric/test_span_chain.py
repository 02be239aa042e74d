"""Cuts, scores and chains of spans are those of an enumeration of all possibilities."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.arrays import F64, I64
from kinedex.ops.numeric.span_chain import Spans, aligned_spans, best_chain, candidate_cuts, changes_of_class
from tests.ops.numeric.test_state_rows import every_path

FIRSTS = np.array([0, 2, 5])


def evidence_of(frames: int, seed: int) -> F64:
    """Return random evidence of two classes with two and three states."""
    found: F64 = np.random.default_rng(seed).normal(0, 2, (frames, 5))
    return found


def best_sequence(evidence: F64, readiness: float, cost: float) -> float:
    """Return the greatest evidence of all sequences of motions and background, motion by motion."""
    frames = len(evidence)
    value = np.full((frames + 1, 2), -np.inf)  # before each frame, after a motion, or after background
    whole = np.full((frames, frames + 1, 2), -np.inf)
    for start, stop in combinations(range(frames + 1), 2):
        for k in range(2):
            own = evidence[start:stop, FIRSTS[k] : FIRSTS[k + 1]] + readiness
            paths = every_path(stop - start, own.shape[1])
            whole[start, stop, k] = max((own[range(len(own)), path].sum() for path in paths), default=-np.inf)
            if stop == frames:  # the last motion may end anywhere
                whole[start, stop, k] = max(
                    own[range(len(own)), path].sum()
                    for states in range(1, own.shape[1] + 1)
                    for path in every_path(stop - start, states) or [(0,) * (stop - start)]
                )
    value[0] = 0.0
    for stop in range(1, frames + 1):
        for start in range(stop):
            before = value[start].max() - cost if start else 0.0
            value[stop, 0] = max(value[stop, 0], before + whole[start, stop].max())
            value[stop, 1] = max(value[stop, 1], value[start, 0] - cost if start else 0.0)
    return float(value[-1].max())


@settings(max_examples=15, deadline=None)
@given(frames=st.integers(2, 6), seed=st.integers(0, 50), cost=st.sampled_from([0.5, 3.0]))
def test_changes_of_class_begin_the_most_probable_sequence(frames: int, seed: int, cost: float) -> None:
    evidence = evidence_of(frames, seed)
    begins = np.flatnonzero(changes_of_class(evidence, FIRSTS, 0.3, cost)).tolist()
    assert begins[0] == 0
    value = -cost * (len(begins) - 1)
    for start, stop in zip(begins, [*begins[1:], frames], strict=True):
        own = [evidence[start:stop, FIRSTS[k] : FIRSTS[k + 1]] + 0.3 for k in range(2)]
        options = [0.0]  # background
        for one in own:
            lasts = range(1, one.shape[1] + 1) if stop == frames else [one.shape[1]]
            options += [
                one[range(len(one)), path].sum() for states in lasts for path in every_path(stop - start, states)
            ]
        value += max(options)
    assert value == pytest.approx(best_sequence(evidence, 0.3, cost))


@settings(max_examples=30, deadline=None)
@given(frames=st.integers(2, 9), seed=st.integers(0, 99))
def test_spans_have_the_evidence_of_their_best_path(frames: int, seed: int) -> None:
    evidence, usual = evidence_of(frames, seed), np.array([2.6, 4.0])
    generator = np.random.default_rng(seed)
    inner = generator.choice(np.arange(1, frames), generator.integers(0, frames), replace=False)
    cuts: I64 = np.unique([0, frames, *inner.tolist()])
    found = aligned_spans(evidence, FIRSTS, cuts, usual, 0.5)
    expected = {}
    for start, stop in combinations(cuts.tolist(), 2):
        scores = np.full(2, -np.inf)
        for k in range(2):
            paths = every_path(stop - start, int(FIRSTS[k + 1] - FIRSTS[k]))
            if int(0.4 * usual[k]) <= stop - start <= int(2.2 * usual[k]) and paths:
                own = evidence[start:stop, FIRSTS[k] : FIRSTS[k + 1]] + 0.5
                scores[k] = max(own[range(len(own)), path].sum() for path in paths)
        if np.isfinite(scores).any():
            expected[start, stop] = scores
    assert set(zip(found.starts.tolist(), found.stops.tolist(), strict=True)) == set(expected)
    for start, stop, scores in zip(found.starts.tolist(), found.stops.tolist(), found.scores, strict=True):
        np.testing.assert_allclose(scores, expected[start, stop])
    assert (np.diff(found.stops) >= 0).all()


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 999))
def test_a_chain_is_the_best_set_of_spans_that_do_not_overlap(seed: int) -> None:
    generator = np.random.default_rng(seed)
    pairs = [pair for pair in combinations(range(8), 2) if generator.random() < 0.3][:10]
    pairs.sort(key=lambda pair: pair[1])
    scores = generator.normal(size=(len(pairs), 2))
    spans = np.array(pairs, np.int64).reshape(-1, 2)
    chosen = best_chain(Spans(spans[:, 0].copy(), spans[:, 1].copy(), scores), 7).tolist()
    best = max(
        sum(float(scores[one].max()) for one in some)
        for count in range(len(pairs) + 1)
        for some in combinations(range(len(pairs)), count)
        if all(pairs[a][1] <= pairs[b][0] or pairs[b][1] <= pairs[a][0] for a, b in combinations(some, 2))
    )
    assert sum(float(scores[one].max()) for one in chosen) == pytest.approx(best)
    assert all(pairs[a][1] <= pairs[b][0] for a, b in pairwise(chosen))


def test_a_take_of_one_motion_has_cuts_at_its_ends() -> None:
    assert candidate_cuts(evidence_of(6, 3), FIRSTS)[[0, -1]].tolist() == [0, 6]
