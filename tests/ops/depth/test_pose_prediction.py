"""Predicted poses: they go on as before, on the same bones."""

from __future__ import annotations

import numpy as np

from kinedex.ops.depth.tracker import SHARE, predicted_pose
from tests.ops.depth.cone_bodies import POSE, bone_lengths, random_pose


def test_bones_keep_their_lengths_and_the_root_moves_on() -> None:
    before, pose = random_pose(1, 6) + np.array([0.02, 0, 0]), random_pose(2, 6)
    found = predicted_pose(pose, before)
    np.testing.assert_allclose(bone_lengths(found), bone_lengths(pose), rtol=1e-12)
    np.testing.assert_allclose(found[0] - pose[0], SHARE * (pose[0] - before[0]), atol=1e-12)


def test_a_body_that_stands_or_glides_keeps_its_pose() -> None:
    np.testing.assert_allclose(predicted_pose(POSE, POSE), POSE, atol=1e-12)
    np.testing.assert_allclose(predicted_pose(POSE + 0.1, POSE, 1.0), POSE + 0.2, atol=1e-12)


def test_a_forearm_that_turns_turns_on() -> None:
    elbow, wrist, fingers = 16, 17, 18
    poses = []
    for angle in (0.0, 0.1, 0.2):
        pose = POSE.copy()
        turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
        for joint in (wrist, fingers):
            pose[joint] = pose[elbow] + turn @ (POSE[joint] - POSE[elbow])
        poses.append(pose)
    np.testing.assert_allclose(predicted_pose(poses[1], poses[0], 1.0), poses[2], atol=2e-3)
