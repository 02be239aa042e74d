"""Pivots turn what hangs below them, and bones keep their lengths."""

from __future__ import annotations

import numpy as np

from kinedex.ops.depth.cones import moved_joints
from tests.ops.depth.cone_bodies import BODY, POSE, bone_lengths, turned_pose
from tests.oracles import cone_body as oracle


def test_a_pivot_moves_the_joints_below_it() -> None:
    moved = moved_joints(BODY.pivots)
    assert moved.tolist() == [[oracle.below(j, pivot) for j in range(24)] for pivot in BODY.pivots]


def test_turns_are_those_of_rotations_with_the_deepest_pivot_first() -> None:
    rng = np.random.default_rng(3)
    rotations, shift = rng.normal(0, 0.5, (len(BODY.pivots), 3)), rng.normal(size=3)
    rotations[4] = 0
    found = turned_pose(BODY.pivots, POSE, rotations, shift)
    np.testing.assert_allclose(found, oracle.turned(BODY.pivots, POSE, rotations, shift), atol=1e-12)


def test_bones_keep_their_lengths() -> None:
    rng, pose = np.random.default_rng(4), POSE
    for _ in range(100):
        pose = turned_pose(BODY.pivots, pose, rng.normal(0, 0.3, (len(BODY.pivots), 3)), rng.normal(size=3))
    np.testing.assert_allclose(bone_lengths(pose), bone_lengths(POSE), rtol=0, atol=1e-12)
