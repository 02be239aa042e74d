"""BVH files of the 24 joints: turns of a kinematic chain, places at the root only."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import kinedex
from kinedex.ops.body.euler import euler_angles, matrices_of
from kinedex.ops.body.kinematic_chain import forward
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.storage.formats.motion.bvh_parser import parse_bvh
from kinedex.storage.formats.motion.bvh_writer import write_chain_bvh
from kinedex.storage.formats.motion.joint_motion import JointMotion
from tests.ops.body.test_kinematic_chain import BODY, CHAIN, random_poses


@pytest.fixture(scope="module")
def motion() -> JointMotion:
    positions, _ = forward(BODY, random_poses(2, 12, 0.3))
    return JointMotion("a", CHAIN.joints, positions.transpose(2, 0, 1).astype(np.float32), 30.0)


def test_joints_come_back_within_the_error_of_the_fit(tmp_path: Path, motion: JointMotion) -> None:
    path = tmp_path / "a.bvh"
    write_chain_bvh(path, motion)
    again = kinedex.read(path)
    assert (again.info["skeleton"], again.rate_hz) == ("named", 30.0)
    order = [motion.joints.index(joint) for joint in again.joints]
    apart = np.linalg.norm(again.positions - motion.positions[:, order], axis=2)
    assert apart.mean() < 0.005
    assert apart.max() < 0.03
    first = path.read_bytes()
    write_chain_bvh(path, motion)
    assert path.read_bytes() == first


def test_only_the_root_has_places_and_the_bones_are_those_of_the_body(tmp_path: Path, motion: JointMotion) -> None:
    write_chain_bvh(tmp_path / "a.bvh", motion)
    bvh = parse_bvh(tmp_path / "a.bvh")
    assert [len(node.steps) for node in bvh.nodes if not node.name.endswith("_end")] == [6] + [3] * 24
    assert not bvh.warnings
    offsets = {node.name: node.before for node in bvh.nodes}
    for joint in ("belly", "lshoulder", "lhip", "rknee", "lfingers", "rtoes"):
        np.testing.assert_allclose(offsets[joint], BODY.offsets[CHAIN.joint(joint)], atol=1e-3)
    np.testing.assert_allclose(bvh.channels[:, :3], motion.positions[:, CHAIN.joint("root")], atol=0.01)
    assert np.ptp(bvh.channels[:, 3:6], axis=0).max() > 1  # the root turns


def test_clavicles_beside_the_neck_stay_there(tmp_path: Path, motion: JointMotion) -> None:
    poses = random_poses(2, 12, 0.3)
    positions, turned = forward(BODY, poses)
    chest = turned[:, CHAIN.nodes.index("spine2")]
    for joint, x in (("lclavicle", 0.06), ("rclavicle", -0.06)):
        positions[CHAIN.joint(joint)] += np.einsum("tab,b->at", chest, [x, -0.03, 0.02])
    beside = replace(motion, positions=positions.transpose(2, 0, 1).astype(np.float32))
    write_chain_bvh(tmp_path / "a.bvh", beside)
    again = kinedex.read(tmp_path / "a.bvh")
    order = [CHAIN.joints.index(joint) for joint in again.joints]
    assert np.linalg.norm(again.positions - beside.positions[:, order], axis=2).max() < 0.03


def test_missing_joints_and_invalid_frames_are_refused(tmp_path: Path, motion: JointMotion) -> None:
    lost = motion.positions.copy()
    lost[3:5, CHAIN.joint("lknee")] = np.nan
    with pytest.raises(KinedexError, match=r"invalid in 2 of its 12 frames, where lknee have no place.* fill_gap"):
        write_chain_bvh(tmp_path / "a.bvh", replace(motion, positions=lost))
    lost[:, CHAIN.joint("lknee")] = np.nan
    with pytest.raises(KinedexError, match="take 'a' has no lknee; a BVH needs every joint"):
        write_chain_bvh(tmp_path / "a.bvh", replace(motion, positions=lost))
    fewer = replace(motion, joints=motion.joints[1:], positions=motion.positions[:, 1:])
    with pytest.raises(KinedexError, match=f"take 'a' has no {motion.joints[0]}"):
        write_chain_bvh(tmp_path / "a.bvh", fewer)


@pytest.mark.parametrize("order", ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"])
def test_euler_angles_of_any_order_go_on_without_jumps(order: str) -> None:
    t = np.linspace(0, 4 * np.pi, 200)
    angles = np.stack([t, 1.5 * np.sin(t), -0.7 * t], axis=1)
    found = euler_angles(matrices_of(angles, order), order)
    np.testing.assert_allclose(found, angles, atol=1e-9)
    for sine in (1.0, -1.0):  # two axes in one place
        locked = np.tile([0.4, sine * np.pi / 2, 0.9], (2, 1))
        again = euler_angles(matrices_of(locked, order), order)
        np.testing.assert_allclose(matrices_of(again, order), matrices_of(locked, order), atol=1e-7)
    with pytest.raises(ParameterError, match="order must be a permutation of XYZ"):
        euler_angles(np.eye(3)[None], "XYX")
