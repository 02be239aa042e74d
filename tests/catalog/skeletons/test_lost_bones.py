"""Bones that have lost their length are found, and those that never had one are not."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.catalog.skeletons.lost_bones import lost_bones

NAMES = (
    "Hips", "Spine", "Spine1", "Spine2", "Neck", "Head", "LeftShoulder", "LeftArm", "RightShoulder", "RightArm",
    "LeftUpLeg", "LeftLeg", "LeftFoot", "RightUpLeg", "RightLeg", "RightFoot",
)  # fmt: skip
PARENTS = (-1, 0, 1, 2, 3, 4, 3, 6, 3, 8, 0, 10, 11, 0, 13, 14)
OFFSETS = np.array([
    (0, 0, 0), (0, 10, -1), (0, 11, 0), (0, 12, 0), (0, 14, 1), (0, 10, 1), (5, 12, 1), (13, -1, 0), (-5, 12, 1),
    (-13, -1, 0), (9, -5, 0), (0, -42, 1), (0, -41, 0), (-9, -5, 0), (0, -42, 1), (0, -41, 0),
], dtype=np.float64)  # fmt: skip


def without(*nodes: str) -> np.ndarray:
    offsets = OFFSETS.copy()
    offsets[[NAMES.index(node) for node in nodes]] = 0.0
    return offsets


def test_a_whole_skeleton_has_lost_nothing() -> None:
    assert lost_bones(NAMES, PARENTS, OFFSETS) is None


@pytest.mark.parametrize("node", ["LeftShoulder", "RightArm", "LeftLeg", "RightUpLeg"])
def test_a_bone_of_one_side_is_that_of_the_other_side_mirrored(node: str) -> None:
    found = lost_bones(NAMES, PARENTS, without(node))
    assert found is not None
    i = NAMES.index(node)
    assert found.of_partner == (i,)
    np.testing.assert_array_equal(found.offsets[i], OFFSETS[i])


@pytest.mark.parametrize("node", ["Spine1", "Spine2", "Neck", "Head"])
def test_a_bone_within_the_spine_is_about_as_long_as_those_beside(node: str) -> None:
    found = lost_bones(NAMES, PARENTS, without(node))
    assert found is not None
    i = NAMES.index(node)
    assert found.along == (i,)
    assert np.linalg.norm(found.offsets[i] - OFFSETS[i]) < 5.0
    assert found.warnings(NAMES) == [f"bone {node} has no length in the file; the mean of the bones beside is taken"]


def test_a_first_joint_of_a_long_spine_at_the_hips_is_doubted_and_a_lower_back_is_not() -> None:
    found = lost_bones(NAMES, PARENTS, without("Spine"))
    assert found is not None
    assert (found.offsets, found.doubtful) == ({}, (1,))
    lower = tuple("LowerBack" if name == "Spine" else name for name in NAMES)
    assert lost_bones(lower, PARENTS, without("Spine")) is None


@pytest.mark.parametrize("nodes", [("LeftShoulder", "RightShoulder"), ("Neck", "LeftShoulder", "RightShoulder")])
def test_bones_without_length_on_both_sides_are_meant(nodes: tuple[str, ...]) -> None:
    assert lost_bones(NAMES, PARENTS, without(*nodes)) is None


def test_nothing_is_lost_where_the_spine_is_long_without_it() -> None:
    offsets = without("Spine2")
    offsets[[1, 2]] *= 4.0
    assert lost_bones(NAMES, PARENTS, offsets) is None


def test_ends_and_moved_nodes_are_no_bones() -> None:
    assert lost_bones(NAMES, PARENTS, without("Head"), apart=[NAMES.index("Head")]) is None
