"""Candidate cuts are where the most probable sequences of motions change, as an enumeration finds them."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from threadpoolctl import threadpool_limits

from kinedex.ops.arrays import F32, F64
from kinedex.ops.numeric.candidate_cuts import CUTTING_READINESS, SWITCHING, candidate_cuts
from kinedex.ops.numeric.state_columns import PIECE, StateColumns
from tests.oracles.recognition import changes, path_evidence

FIRSTS = np.array([0, 2, 5])
MEANS = np.random.default_rng(5).normal(0, 2, (5, 3))
USUAL = np.random.default_rng(6).normal(0, 2, (2, 3))
COLUMNS = StateColumns.of_means(USUAL, MEANS, FIRSTS, 0.5)


def projected_frames(frames: int, seed: int, spread: float = 2.0) -> F32:
    """Return random frames in the space of the states, with a one behind each."""
    found = np.random.default_rng(seed).normal(0, spread, (frames, 3))
    return np.concatenate([found, np.ones((frames, 1))], axis=1).astype(np.float32)


def evidence_of(projected: F32) -> F64:
    """Return the evidence of the five states by distances."""
    frames = projected[:, :-1].astype(np.float64)
    squares = [((frames[:, None] - means) ** 2).sum(axis=2) for means in (USUAL, MEANS)]
    found: F64 = 0.25 * (squares[0].min(axis=1)[:, None] - squares[1])
    return found


@settings(max_examples=30, deadline=None)
@given(frames=st.integers(2, 60), seed=st.integers(0, 999), spread=st.sampled_from([1.0, 3.0]))
def test_cuts_are_the_changes_of_the_best_sequences(frames: int, seed: int, spread: float) -> None:
    projected = projected_frames(frames, seed, spread)
    evidence = evidence_of(projected)
    expected = {0, frames}.union(*(changes(evidence, FIRSTS, CUTTING_READINESS, cost) for cost in SWITCHING))
    assert candidate_cuts(projected, COLUMNS).cuts.tolist() == sorted(expected)


def best_value(evidence: F64, cost: float) -> float:
    """Return the evidence of the best sequence of motions and background, by enumeration of its motions."""
    frames = len(evidence)
    classes = list(zip(FIRSTS[:-1].tolist(), FIRSTS[1:].tolist(), strict=True))
    best = -np.inf
    for count in range(frames):
        for inner in combinations(range(1, frames), count):
            edges = [0, *inner, frames]
            value = -cost * count
            for start, stop in pairwise(edges):
                # The last motion may stop before its last state.
                options = [
                    path_evidence(evidence[start:stop, first:end])
                    for first, last in classes
                    for end in (range(first + 1, last + 1) if stop == frames else [last])
                ]
                value += max(0.0, *options)
            best = max(best, value)
    return best


@settings(max_examples=20, deadline=None)
@given(frames=st.integers(2, 7), seed=st.integers(0, 99), cost=st.sampled_from([0.5, 3.0]))
def test_the_naive_twin_finds_the_best_of_all_sequences(frames: int, seed: int, cost: float) -> None:
    evidence = evidence_of(projected_frames(frames, seed)) + 0.3
    edges = [*sorted(changes(evidence, FIRSTS, 0.0, cost)), frames]
    value = -cost * (len(edges) - 2)
    for start, stop in pairwise(edges):
        options = [
            path_evidence(evidence[start:stop, first:end])
            for first, last in ((0, 2), (2, 5))
            for end in (range(first + 1, last + 1) if stop == frames else [last])
        ]
        value += max(0.0, *options)
    assert value == pytest.approx(best_value(evidence, cost))


def test_gains_bound_what_any_path_between_two_cuts_has() -> None:
    projected = projected_frames(80, 3)
    evidence = evidence_of(projected) + CUTTING_READINESS
    found = candidate_cuts(projected, COLUMNS)
    for (start, before), (stop, after) in combinations(zip(found.cuts.tolist(), found.gains, strict=True), 2):
        for first, last in ((0, 2), (2, 5)):
            assert path_evidence(evidence[start:stop, first:last]) <= after - before + SWITCHING[0] + 1e-3


def test_cuts_do_not_depend_on_threads_and_on_what_comes_later() -> None:
    projected = projected_frames(3 * PIECE + 17, 1)
    found = []
    for threads in (1, 2, 4):
        with threadpool_limits(threads):
            found.append(candidate_cuts(projected, COLUMNS))
    for one in found[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(one, found[0], strict=True))
    part = candidate_cuts(projected[:PIECE], COLUMNS)
    np.testing.assert_array_equal(part.background, found[0].background[:PIECE])


def test_states_have_the_evidence_of_their_distances() -> None:
    projected = projected_frames(PIECE + 40, 2)
    expected = evidence_of(projected)
    for first, columns, background in COLUMNS.pieces(projected):
        found = columns - background[:, None]
        for k, (low, high) in enumerate(((0, 2), (2, 5))):
            own = found[:, COLUMNS.lasts[k] : COLUMNS.firsts[k] + 1][:, ::-1]
            np.testing.assert_allclose(own, expected[first : first + len(found), low:high], atol=1e-4)
