"""Poses on a body of ordinary size: what they keep of a take, and what they leave out."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from kinedex.ops.body.joint_tree import JOINTS, PARENTS
from kinedex.ops.duplicates.poses import TakePoses, bones_of

F32 = npt.NDArray[np.float32]


def take(seed: int, size: float = 1.0) -> F32:
    """Return a body (T, 24, 3) whose bones have constant lengths and turn as they like."""
    random = np.random.default_rng(seed)
    lengths = np.random.default_rng(0).uniform(0.1, 0.4, len(JOINTS)) * size
    directions = np.cumsum(random.normal(0, 0.1, (60, len(JOINTS), 3)), axis=0) + random.normal(0, 1, (len(JOINTS), 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    positions = np.zeros((60, len(JOINTS), 3))
    for joint, parent in enumerate(PARENTS.tolist()):
        if parent >= 0:
            positions[:, joint] = positions[:, parent] + lengths[joint] * directions[:, joint]
    return positions.astype(np.float32)


@pytest.mark.parametrize("mirrored", [False, True])
def test_bodies_of_all_sizes_are_the_same_body_of_ordinary_size(mirrored: bool) -> None:
    one, other = (TakePoses(take(1, size), JOINTS, mirrored) for size in (1.0, 1.3))
    assert not one.is_on_body_of(other)
    assert not np.allclose(one.own, other.own, atol=0.05)
    assert np.allclose(one.on_ordinary_body, other.on_ordinary_body, atol=1e-4)


def test_two_takes_of_one_person_are_on_one_body() -> None:
    one, other = TakePoses(take(1), JOINTS), TakePoses(take(2), JOINTS)
    assert one.is_on_body_of(other)
    assert not np.allclose(one.on_ordinary_body, other.on_ordinary_body, atol=0.05)


def test_noise_makes_no_other_body() -> None:
    noise = np.random.default_rng(3).normal(0, 0.003, (60, 24, 3)).astype(np.float32)
    assert TakePoses(take(1), JOINTS).is_on_body_of(TakePoses(take(1) + noise, JOINTS))


def test_a_child_of_an_unknown_joint_hangs_from_the_next_known_one() -> None:
    parents, lengths = bones_of(JOINTS, [joint not in ("belly", "chest") for joint in JOINTS])
    whole, every = bones_of(JOINTS, [True] * len(JOINTS))
    neck, belly, chest = (JOINTS.index(name) for name in ("neck", "belly", "chest"))
    assert np.array_equal(whole, PARENTS)
    assert JOINTS[parents[neck]] == "root"
    assert lengths[neck] == pytest.approx(every[[neck, belly, chest]].sum())
    lacking = take(1)
    lacking[:, [belly, chest]] = np.nan
    found = TakePoses(lacking, JOINTS).on_ordinary_body
    known = np.isfinite(found).all(axis=(0, 2))
    assert [joint for joint, there in zip(JOINTS, known, strict=True) if not there] == ["belly", "chest"]
    assert np.linalg.norm(found[:, neck] - found[:, 0], axis=1) == pytest.approx(lengths[neck], abs=1e-5)


def test_a_take_without_any_pose_has_no_bones() -> None:
    poses = TakePoses(np.full((5, 24, 3), np.nan, np.float32), JOINTS)
    assert np.isnan(poses.bone_lengths_m).all()
    assert poses.is_on_body_of(TakePoses(take(1), JOINTS))
    assert np.isnan(poses.on_ordinary_body).all()
