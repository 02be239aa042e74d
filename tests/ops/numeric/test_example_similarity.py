"""Similarity to an example is by a distance in which what varies between neighbours counts less."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.arrays import F64, I64
from kinedex.ops.errors import ParameterError
from kinedex.ops.numeric.discriminant import shrunk
from kinedex.ops.numeric.example_similarity import (
    NEIGHBOURS,
    ROUNDS,
    SHRINKAGE,
    compare,
    interval_descriptor,
    learned_whitening,
    mutual_neighbours,
)
from tests.ops.numeric.motions import JOINTS, RATE_HZ, motion


def naive_pairs(points: F64, takes: I64) -> set[tuple[int, int]]:
    """Return the pairs of mutual neighbours of different takes, by sorting all distances of each point."""
    near = []
    for i in range(len(points)):
        others = [(float(np.sum((points[i] - points[j]) ** 2)), j) for j in range(len(points)) if takes[j] != takes[i]]
        near.append({j for _, j in sorted(others)[:NEIGHBOURS]})
    return {(i, j) for i in range(len(points)) for j in near[i] if i < j and i in near[j]}


@given(st.integers(0, 40), st.integers(1, 12), st.integers(0, 1000))
@settings(max_examples=60, deadline=None)
def test_mutual_neighbours_are_those_of_sorted_distances(count: int, takes: int, seed: int) -> None:
    generator = np.random.default_rng(seed)
    points, of = generator.normal(size=(count, 3)), generator.integers(0, takes, count)
    one, other = mutual_neighbours(points, of)
    assert set(zip(one.tolist(), other.tolist(), strict=True)) == naive_pairs(points, of)


def test_the_distance_is_that_of_mahalanobis_by_the_differences_of_neighbours() -> None:
    generator = np.random.default_rng(5)
    points, takes = generator.normal(size=(80, 4)) * [1, 2, 3, 4], np.arange(80) // 2
    expected = np.eye(4)  # the inverse of the covariance
    for _ in range(ROUNDS):
        root = np.linalg.cholesky(expected)
        differences = np.array([points[i] - points[j] for i, j in sorted(naive_pairs(points @ root, takes))])
        covariance = np.mean([np.outer(one, one) for one in differences], axis=0)
        expected = np.linalg.inv(shrunk(covariance, SHRINKAGE))
    whitening = learned_whitening(points, takes)
    np.testing.assert_allclose(whitening @ whitening.T, expected, rtol=1e-8)


def motions(generator: np.random.Generator, each: int = 40) -> tuple[F64, I64]:
    """Return descriptors of three motions, whose styles differ in six numbers that vary together, and the motions."""
    kinds = np.repeat(np.arange(3), each)
    styles = generator.normal(size=(3 * each, 2)) @ generator.normal(size=(2, 6))
    own = np.eye(3)[kinds] + 0.2 * generator.normal(size=(3 * each, 3))
    return np.column_stack([own, styles + 0.1 * generator.normal(size=styles.shape)]), kinds


def test_what_varies_between_neighbours_counts_less() -> None:
    found, kinds = motions(np.random.default_rng(1))
    by_learned, by_scale = [], []
    for query in range(0, len(found), 3):
        rest = np.delete(np.arange(len(found)), query)
        order = np.argsort(-compare(found[[query]], found[rest], rest).similarity)
        by_learned.append(np.mean(kinds[rest[order[:10]]] == kinds[query]))
        far = np.sum(((found[rest] - found[query]) / found.std(axis=0)) ** 2, axis=1)
        by_scale.append(np.mean(kinds[rest[np.argsort(far)[:10]]] == kinds[query]))
    assert np.mean(by_learned) > np.mean(by_scale) + 0.03


def test_more_similar_to_a_rejected_interval_comes_last() -> None:
    generator = np.random.default_rng(3)
    found, kinds = motions(generator)
    takes = np.arange(len(found))
    alone = compare(found[:1], found, takes)
    rejected = found[kinds == 1][:2]
    compared = compare(found[:1], found, takes, rejected)
    lowered = compared.similarity < alone.similarity
    np.testing.assert_allclose(compared.similarity[lowered], alone.similarity[lowered] - 1)
    assert lowered[kinds == 1].mean() > lowered[kinds == 0].mean()
    assert not compared.probable[compared.similarity < 0].any()


def test_an_example_is_most_similar_to_itself_and_probable() -> None:
    found, _ = motions(np.random.default_rng(4))
    compared = compare(found[[7]], found, np.arange(len(found)))
    assert compared.similarity.argmax() == 7
    assert compared.similarity[7] == pytest.approx(1)
    assert compared.probable[7]
    order = np.argsort(-compared.similarity)
    assert np.all(np.diff(compared.probable[order].astype(int)) <= 0)  # a line divides them


def test_few_candidates_are_compared_without_evidence_of_what_varies() -> None:
    few = np.array([[0.0, 1.0], [1.0, 0.0]])
    compared = compare(few[:1], few, np.array([3, 3]))
    assert compared.similarity[0] == pytest.approx(1)
    assert not compared.probable.any()
    assert not len(compare(few[:1], np.empty((0, 2)), np.empty(0, np.int64)).similarity)
    same = compare(few[:1], few[[0, 0]], np.array([1, 2]))
    assert np.isfinite(same.similarity).all()


def test_bad_descriptors_are_refused() -> None:
    few = np.ones((2, 2))
    with pytest.raises(ParameterError, match="examples"):
        compare(np.empty((0, 2)), few, np.arange(2))
    with pytest.raises(ParameterError, match="descriptors"):
        compare(few, np.full((2, 2), np.nan), np.arange(2))


def test_an_interval_without_a_body_has_no_descriptor() -> None:
    walk = motion("walk", 40)
    described = interval_descriptor(walk, JOINTS, RATE_HZ)
    assert described is not None
    assert np.isfinite(described).all()
    without = walk.copy()
    without[:, JOINTS.index("head")] = np.nan
    partial = interval_descriptor(without, JOINTS, RATE_HZ)
    assert partial is not None
    known = np.isfinite(partial)
    assert 0 < np.count_nonzero(~known) < 20
    np.testing.assert_allclose(partial[known], described[known])
    assert interval_descriptor(walk[:1], JOINTS, RATE_HZ) is None
    assert interval_descriptor(np.full_like(walk, np.nan), JOINTS, RATE_HZ) is None
