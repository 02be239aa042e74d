"""Retargeting and thinning of poses against naive twins, and the counts of the real clips."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import kinedex
from kinedex.ops.body.joint_tree import JOINTS, PARENTS
from kinedex.ops.depth.thinned_poses import (
    PoseThinning,
    bone_directions,
    bone_lengths_of,
    facing_of,
    place_directions,
    thin_poses,
)
from kinedex.ops.errors import ParameterError
from kinedex.ops.words import NO_WORD
from tests.ops.depth.cone_bodies import POSE, bone_lengths, random_pose
from tests.ops.depth.pose_material import BONES, random_directions
from tests.oracles import pose_lookup as naive
from tests.oracles.pose_lookup import pose_distance
from tests.plain_python import slow_as_python

DIRECTIONS = random_directions(120)


def test_a_pose_that_differs_in_one_joint_by_ten_centimetres() -> None:
    other = POSE.copy()
    other[JOINTS.index("lwrist")] += [0.1, 0, 0]
    assert pose_distance(POSE, other) == pytest.approx(0.02236, abs=5e-6)


def test_a_pose_on_its_own_bones_is_the_pose_turned() -> None:
    pose = random_pose(3, 20)
    back = place_directions(bone_directions(pose[None]), bone_lengths(pose))[0]
    between = np.linalg.norm(pose[:, None] - pose[None], axis=2)
    np.testing.assert_allclose(np.linalg.norm(back[:, None] - back[None], axis=2), between, atol=1e-6)
    np.testing.assert_allclose(back[:, 1], pose[:, 1] - pose[0, 1], atol=1e-6)
    facing = np.empty(3)
    facing_of(back, facing)
    np.testing.assert_allclose(facing, [0, 0, 1], atol=1e-12)


def test_retargeting_keeps_directions_and_takes_the_other_lengths() -> None:
    lengths = BONES * np.linspace(0.8, 1.3, len(BONES))
    poses = place_directions(DIRECTIONS, lengths)
    for pose, directions in zip(poses, DIRECTIONS, strict=True):
        np.testing.assert_allclose(pose, naive.placed(directions.astype(float), lengths), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(poses - poses[:, PARENTS], axis=2)[:, 1:], [lengths[1:]] * 120, rtol=1e-6)


def test_bones_without_length_have_no_direction() -> None:
    pose = POSE.copy()
    pose[JOINTS.index("lclavicle")] = pose[JOINTS.index("neck")] + 1e-6
    directions = bone_directions(pose[None])[0]
    assert not directions[JOINTS.index("lclavicle")].any()
    assert not directions[0].any()
    assert bone_lengths_of(np.stack([pose, pose]))[0] == 0


@settings(max_examples=30)
@given(
    seed=st.integers(0, 10_000), distance=st.sampled_from([0.02, 0.06, 0.12, 0.3]), steps=st.sampled_from([2, 8, 64])
)
def test_thinning_keeps_what_a_comparison_with_all_keeps(seed: int, distance: float, steps: int) -> None:
    random = np.random.default_rng(seed)
    directions = DIRECTIONS[random.integers(0, 120, 60)].copy()
    directions = np.round(directions * steps).astype(np.float32) / np.float32(steps)  # equal poses and equal distances
    found = thin_poses(directions, BONES, distance)
    poses = place_directions(directions, BONES)
    kept = naive.thinned(poses.astype(np.float32).astype(float), distance)
    assert found.rows.tolist() == kept
    assert np.isin(found.stands_for, kept).all()
    assert (found.stands_for[kept] == kept).all()
    apart = [pose_distance(poses[row], poses[other]) for row, other in enumerate(found.stands_for.tolist())]
    assert max(apart) <= distance + 1e-6


@slow_as_python
def test_poses_that_come_in_parts_are_thinned_as_one() -> None:
    parts = PoseThinning(BONES, 0.05)
    numbers = [parts.add(DIRECTIONS[:1]), parts.add(DIRECTIONS[1:1]), parts.add(DIRECTIONS[1:])]
    many = np.tile(DIRECTIONS, (30, 1, 1)) + np.random.default_rng(1).normal(0, 0.2, (3600, 24, 3)).astype(np.float32)
    numbers.append(parts.add(many))  # the room grows
    whole = PoseThinning(BONES, 0.05).add(np.concatenate([DIRECTIONS, many]))
    assert np.array_equal(np.concatenate(numbers), whole)
    assert parts.count == whole.max() + 1 > 2000
    assert (parts.near(many) >= 0).all()


@pytest.mark.slow
def test_the_clips_of_three_actors_give_the_poses_of_the_design(shared: Path) -> None:
    takes = {path.stem: kinedex.read(path) for path in (shared / "data/hdm05/clips").glob("*/*.amc")}
    poses: dict[str, list[np.ndarray]] = {}
    for name in sorted(takes):
        order = [takes[name].joints.index(joint) for joint in JOINTS]
        whole = takes[name].words() != NO_WORD
        poses.setdefault(name.split("_")[1], []).append(takes[name].positions[whole][:, order].astype(float))
    bones = np.mean([bone_lengths_of(np.concatenate(own)) for own in poses.values()], axis=0)
    by_name = {actor: iter(own) for actor, own in poses.items()}
    directions = np.concatenate([bone_directions(next(by_name[name.split("_")[1]])) for name in sorted(takes)])
    assert sorted(poses) == ["bd", "bk", "dg"]
    assert len(directions) == 11_269
    assert [len(thin_poses(directions, bones, distance).rows) for distance in (0.05, 0.0805)] == [3506, 1572]


def test_wrong_arguments_are_named() -> None:
    with pytest.raises(ParameterError, match="distance must be a positive number of metres, got 0"):
        thin_poses(DIRECTIONS, BONES, 0)
    with pytest.raises(ParameterError, match="directions must be an array"):
        place_directions(DIRECTIONS[0], BONES)
    with pytest.raises(ParameterError, match="bone_lengths must be 24 lengths"):
        place_directions(DIRECTIONS, BONES[:3])
