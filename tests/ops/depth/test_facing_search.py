"""Poses that face any direction are proposed with the maps that they were found by."""

from __future__ import annotations

import numpy as np

from kinedex.ops.depth.lookup import (
    ALL_MAPS_DEG,
    TURNS_DEG,
    Lookup,
    add_rotated,
    best_of_rows,
    propose_start,
    turned_direction,
)
from kinedex.ops.depth.pose_distance import END_EFFECTORS
from kinedex.ops.depth.pose_index import PoseIndex, pose_centres
from kinedex.ops.depth.thinned_poses import facing_of, place_directions, turn_poses
from tests.ops.depth.pose_material import BONES, random_directions
from tests.oracles.pose_lookup import pose_distance

POSES = place_directions(random_directions(200), BONES)
LOOKUP = Lookup(PoseIndex(POSES))
CENTRE, TOWARDS = np.array([0.2, -0.1, -3.0]), np.array([0.0, 0.0, 1.0])


def filmed(row: int, degrees: float) -> np.ndarray:
    """A pose of the database that faces so many degrees from Z towards X."""
    pose = POSES[row] - pose_centres(POSES[[row]])[0]
    turn_poses(pose, np.sin(np.deg2rad(degrees)), np.cos(np.deg2rad(degrees)))
    return pose + CENTRE


def test_a_direction_is_turned_from_z_towards_x() -> None:
    facing = np.empty(3)
    facing_of(filmed(3, 90.0), facing)
    np.testing.assert_allclose(facing, turned_direction(TOWARDS, 90.0), atol=1e-6)
    assert turned_direction(TOWARDS, 0.0) is TOWARDS


def test_a_start_finds_a_pose_that_faces_any_direction() -> None:
    feet_down = [
        row
        for row in range(200)
        if POSES[row, END_EFFECTORS[2:4], 1].max() < POSES[row, END_EFFECTORS, 1][[0, 1, 4]].min()
    ]
    for degrees in (0.0, 180.0, -45.0):
        row = 11 if degrees in ALL_MAPS_DEG else feet_down[0]
        pose = filmed(row, degrees)
        extrema = pose[END_EFFECTORS][[2, 4, 0, 3, 1]]
        found = propose_start(LOOKUP, extrema, CENTRE, TOWARDS)
        assert len(found.maps) == 2 * 120 + 6 * 12
        best = int(np.argmin(found.costs))
        assert (found.rows[best], found.rotations[best]) == (row, degrees)
        assert pose_distance(pose, found.poses[[best]])[0] < 1e-6
        np.testing.assert_array_equal(extrema[found.maps[found.origins[best]]], pose[END_EFFECTORS])


def test_a_frame_adds_one_pose_of_the_direction_whose_turn_it_is() -> None:
    pose = filmed(5, 0.0)
    extrema = pose[END_EFFECTORS]
    own = LOOKUP.propose(extrema, CENTRE, TOWARDS, pose)
    for number in (0, 2, 8):
        found = add_rotated(own, LOOKUP, extrema, CENTRE, TOWARDS, number)
        assert len(found.rows) == len(own.rows) + 1 == len(set(found.rows.tolist()))
        assert found.rotations.tolist() == [*[0.0] * len(own.rows), TURNS_DEG[number % 7]]
        assert found.origins[-1] >= len(own.maps)
        np.testing.assert_array_equal(found.maps[: len(own.maps)], own.maps)
    assert len(add_rotated(own, LOOKUP, extrema[:4], CENTRE, TOWARDS, 0).rows) == len(own.rows)


def test_the_best_candidate_of_each_row_stays() -> None:
    found = propose_start(LOOKUP, filmed(5, 0.0)[END_EFFECTORS], CENTRE, TOWARDS)
    rows = np.arange(len(found.rows)) // 2
    costs = np.linspace(2.0, 1.0, len(rows))  # the later one of each row costs less
    best = best_of_rows(found._replace(rows=rows), costs.tolist(), 4)
    assert sorted(best) == [len(rows) - 7 + 2 * k for k in range(4)]
    assert (np.diff(found.costs[best]) >= 0).all()
    assert best_of_rows(found._replace(rows=rows[:0]), [], 4) == []
