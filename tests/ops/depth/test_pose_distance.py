"""The distance of poses, and the joints that it compares."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.depth.pose_distance import COMPARED, END_EFFECTORS
from tests.oracles.pose_lookup import pose_distance


def test_one_joint_ten_centimetres_away() -> None:
    pose, other = np.zeros((24, 3)), np.zeros((24, 3))
    other[JOINTS.index("lknee"), 1] = 0.1
    assert pose_distance(pose, other) == pytest.approx(0.02236, abs=1e-5)
    assert pose_distance(pose, other) / np.sqrt(len(COMPARED)) == pytest.approx(0.005)  # as the thesis prints it
    np.testing.assert_allclose(pose_distance(pose, np.stack([pose, other])), [0, 0.02236], atol=1e-5)


def test_twenty_joints_are_compared_and_five_are_ends() -> None:
    assert len(COMPARED) == 20
    assert {JOINTS[k] for k in range(24)} - {JOINTS[k] for k in COMPARED} == {"lclavicle", "rclavicle", "belly", "head"}
    assert [JOINTS[k] for k in END_EFFECTORS] == ["lfingers", "rfingers", "ltoes", "rtoes", "headtop"]
