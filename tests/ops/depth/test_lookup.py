"""The lookup of poses by their ends against naive twins."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.depth.lookup import APART_M, MAX_MAPS, NEAR_M, Lookup, feet_maps, near_maps
from kinedex.ops.depth.pose_distance import END_EFFECTORS
from kinedex.ops.depth.pose_index import PoseIndex, pose_centres
from kinedex.ops.depth.thinned_poses import facing_of, place_directions, turn_poses
from kinedex.ops.errors import ParameterError
from tests.ops.depth.pose_material import BONES, random_directions
from tests.oracles import pose_lookup as naive
from tests.oracles.pose_lookup import pose_distance

POSES = place_directions(random_directions(300), BONES)
INDEX = PoseIndex(POSES)


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000), count=st.sampled_from([1, 5, 40, 300]), steps=st.sampled_from([2, 10, 1000]))
def test_the_tree_finds_what_a_comparison_with_all_finds(seed: int, count: int, steps: int) -> None:
    random = np.random.default_rng(seed)
    poses = np.round(POSES[random.integers(0, 300, count)] * steps) / steps  # many ties
    index = PoseIndex(poses)
    noise = random.choice([0, 0.1]) * random.normal(size=(7, 15))
    queries = (index.features[random.integers(0, count, 7)] + noise).astype(np.float32)
    rows, distances = index.nearest(queries, 10)
    _, expected = naive.nearest(queries, index.features, 10)
    np.testing.assert_allclose(distances, expected, rtol=1e-5, atol=1e-6)
    for query, own, far in zip(queries, rows, distances, strict=True):
        np.testing.assert_allclose(np.linalg.norm(index.features[own] - query, axis=1), far, rtol=1e-5, atol=1e-6)
        assert [*zip(far, own, strict=True)] == sorted(set(zip(far, own, strict=True)))


def test_equal_poses_come_by_their_rows() -> None:
    index = PoseIndex(np.repeat(POSES[:3], 50, axis=0))
    rows, distances = index.nearest(index.features[[70]], 12)
    assert rows[0].tolist() == list(range(50, 62))
    assert not distances.any()


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000), count=st.integers(5, 6), spread=st.sampled_from([0.1, 0.3, 0.5]))
def test_maps_are_those_of_least_sum_among_all(seed: int, count: int, spread: float) -> None:
    random = np.random.default_rng(seed)
    extrema, ends = random.normal(0, spread, (count, 3)), random.normal(0, spread, (5, 3))
    maps, sums = np.empty((24, 5), np.int64), np.empty(24)
    found = near_maps(extrema, ends, maps, sums)
    assert [tuple(one) for one in maps[:found].tolist()] == naive.near_maps(extrema, ends, NEAR_M, MAX_MAPS)
    assert (np.diff(sums[:found]) >= 0).all()


def test_at_a_start_the_two_lowest_are_the_feet() -> None:
    extrema = np.array([[0, 1.0, 0], [0, -0.9, 0], [0, 0.2, 0], [0, -1.0, 0], [0, 0.3, 0]])
    maps, sums = np.empty((24, 5), np.int64), np.empty(24)
    assert feet_maps(extrema, maps, sums, 0) == 12
    assert len({tuple(one) for one in maps[:12].tolist()}) == 12
    assert {frozenset(one) for one in maps[:12, 2:4].tolist()} == {frozenset([1, 3])}
    assert (np.sort(maps[:12], axis=1) == np.arange(5)).all()


def filmed(row: int, yaw: float, place: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A pose of the database, turned and moved, with its centre and facing direction."""
    pose = POSES[row] - pose_centres(POSES[[row]])[0]
    turn_poses(pose, np.sin(yaw), np.cos(yaw))
    pose += place
    facing = np.empty(3)
    facing_of(pose, facing)
    return pose, np.array(place, float), facing


@pytest.mark.parametrize("known", [True, False])
def test_candidates_are_the_cheapest_that_are_apart(known: bool) -> None:
    pose, centre, facing = filmed(17, 0.4, (0.3, -0.1, -3.0))
    before = filmed(17, 0.3, (0.25, -0.1, -3.0))[0]
    extrema = np.concatenate([pose[END_EFFECTORS][[2, 0, 4, 3, 1]], pose[[2, 6]]])
    found = Lookup(INDEX).propose(extrema, centre, facing, before if known else None)
    yaw = float(np.arctan2(facing[0], facing[2]))
    expected = naive.proposals(POSES, extrema, centre, yaw, found.maps, before if known else None)
    for cost, row, placed in zip(found.costs, found.rows, found.poses, strict=True):
        assert any(abs(one - cost) < 1e-6 and other == row for one, other in expected)
        np.testing.assert_allclose(placed, filmed(int(row), yaw, tuple(centre))[0], atol=1e-9)
    assert found.costs[0] == pytest.approx(expected[0][0], abs=1e-6)
    assert (np.diff(found.costs) >= 0).all()
    assert all(pose_distance(one, found.poses[k + 1 :]).min() > APART_M for k, one in enumerate(found.poses[:-1]))
    assert np.isnan(found.sums).all() != known
    if not known:
        assert found.rows[0] == 17
        np.testing.assert_allclose(found.poses[0], pose, atol=1e-9)


def test_fewer_than_five_extrema_propose_nothing() -> None:
    pose, centre, facing = filmed(17, 0.0, (0, 0, -3))
    found = Lookup(INDEX).propose(pose[:4], centre, facing, None)
    assert len(found.rows) == len(found.maps) == 0


def test_jumps_add_the_lowest_as_feet() -> None:
    pose, centre, facing = filmed(17, 0.0, (0, 0, -3))
    lookup, extrema = Lookup(INDEX, among=5), pose[END_EFFECTORS]
    calm, jumped = (lookup.propose(extrema, centre, facing, pose, jumped=jumped) for jumped in (False, True))
    assert len(jumped.maps) == len(calm.maps) + 12
    assert calm.costs[0] == pytest.approx(0.0, abs=1e-9)


def test_wrong_arguments_are_named() -> None:
    with pytest.raises(ParameterError, match="poses must be at least one pose"):
        PoseIndex(POSES[:0])
    with pytest.raises(ParameterError, match="features must be an array"):
        INDEX.nearest(np.zeros((1, 3), np.float32), 1)
    with pytest.raises(ParameterError, match="candidates must be at least 1, got 0"):
        Lookup(INDEX, 0)
