"""Triangulation, trust, restart, and the track without priors that they make."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from kinedex.ops.body.kinematic_chain import ChainBody, Poses
from kinedex.ops.body.pose_fit import measured_body
from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking.contours import Observed
from kinedex.ops.tracking.first_track import find_start, first_track
from kinedex.ops.tracking.observations import BodyPoints, JointPositions, Rays
from kinedex.ops.tracking.triangulation import filled, start_from_positions, start_from_triangulation, triangulate
from kinedex.ops.tracking.trust import interpolated, restart, trust
from tests.ops.tracking.filmed_bodies import BODY, CHAIN, LIMBS, filmed, joint_places, keypoints, moving_poses
from tests.oracles.kinematic_chain import exp, log
from tests.plain_python import slow_as_python

POINTS = keypoints()
HIPS, ELBOW = [CHAIN.nodes.index(name) for name in ("lhip", "rhip")], CHAIN.nodes.index("lelbow")


def keypoint(name: str) -> int:
    return POINTS.joints.tolist().index(CHAIN.joint(name))


def test_exact_rays_meet_in_their_points() -> None:
    poses = moving_poses(2)
    points, cameras = triangulate(filmed(poses, POINTS))
    np.testing.assert_allclose(points[:, :14], joint_places(poses)[:, POINTS.joints[:14]], atol=1e-9)
    assert (cameras == 4).all()


@pytest.mark.parametrize("count", [4, 12])
def test_a_camera_that_is_wrong_is_left_out(count: int) -> None:
    poses = moving_poses(1)
    rays = filmed(poses, POINTS, cameras=count)
    rays.directions[0, 1] += [0, 0.5, 0]
    rays.directions[0, 1] /= np.sqrt((rays.directions[0, 1] ** 2).sum(axis=1, keepdims=True))
    rays.confidence[0, 3, 2] = 0.2
    points, cameras = triangulate(rays)
    np.testing.assert_allclose(points[0, :14], joint_places(poses)[0, POINTS.joints[:14]], atol=1e-9)
    assert cameras[0, 0] == count - 1
    assert cameras[0, 2] == count - 2


def test_no_point_where_cameras_do_not_meet_or_stand_in_one_place() -> None:
    poses = moving_poses(1)
    rays = filmed(poses, POINTS)
    rays.confidence[0, 1:, 0] = 0.0  # one camera alone
    rays.directions[0, :, 1] *= -1.0  # behind the cameras
    points, cameras = triangulate(rays)
    assert np.isnan(points[0, :2]).all()
    assert not cameras[0, :2].any()
    one_place = dataclasses.replace(rays, centres=np.tile(rays.centres[:1], (4, 1)))
    one_place.directions[:] = rays.directions[:, :1]
    assert np.isnan(triangulate(one_place)[0]).all()


def test_gaps_are_filled_linearly_and_ends_held() -> None:
    positions = np.full((6, 3), np.nan)
    positions[1], positions[4] = [0, 1, 2], [3, 4, 5]
    np.testing.assert_allclose(filled(positions), np.array([0, 0, 1, 2, 3, 3])[:, None] + [0, 1, 2])
    assert np.isnan(filled(np.full((2, 3), np.nan))).all()


def test_the_start_is_near_the_body() -> None:
    poses = moving_poses(4)
    points, _ = triangulate(filmed(poses, POINTS))
    start = joint_places(start_from_triangulation(BODY, points, POINTS))
    assert np.sqrt(((start - joint_places(poses)) ** 2).sum(axis=2))[:, LIMBS].mean() < 0.03
    observed = JointPositions(joint_places(poses), np.full((4, 24), 0.02))
    observed.positions[1, 3], observed.positions[:, CHAIN.joint("headtop")] = np.nan, np.nan
    again = joint_places(start_from_positions(BODY, observed))
    assert np.sqrt(((again - joint_places(poses)) ** 2).sum(axis=2))[:, LIMBS].mean() < 0.03


def test_a_body_without_hips_is_refused() -> None:
    poses = moving_poses(2)
    points, _ = triangulate(filmed(poses, POINTS))
    points[:, keypoint("lhip")] = np.nan
    with pytest.raises(ParameterError, match="points of lhip must be seen by two cameras that agree"):
        start_from_triangulation(BODY, points, POINTS)
    with pytest.raises(ParameterError, match="points must be the points that the rays observe"):
        find_start(BODY, filmed(poses, POINTS), None)


def disagreeing(poses: Poses) -> Rays:
    """Rays of a left arm that two of four cameras see elsewhere, and of a left leg that one camera sees."""
    rays = filmed(poses, POINTS)
    rays.confidence[:] = 0.8
    for name in ("lelbow", "lwrist"):
        rays.directions[:, :2, keypoint(name)] = rays.directions[:, :2, keypoint("rankle")]
    for name in ("lhip", "lknee", "lankle"):
        rays.confidence[:, 1:, keypoint(name)] = 0.0
    return rays


def test_trust_finds_what_cameras_contest_and_what_they_do_not_see() -> None:
    poses = moving_poses(2)
    found = trust(BODY, disagreeing(poses), POINTS, poses)
    assert found.contested[:, [keypoint("lelbow"), keypoint("lwrist")]].all()
    assert found.contested.sum() == 4
    np.testing.assert_allclose(found.keypoints[:, keypoint("rknee")], 3.2)
    np.testing.assert_allclose(found.keypoints[:, keypoint("lknee")], 0.8)
    unseen = [CHAIN.nodes[k] for k in np.flatnonzero(~found.nodes_seen[0])]
    assert unseen == ["lshoulder", "lelbow", "lwrist", "lhip", "lknee", "lankle"]


def test_toes_that_no_keypoint_shows_do_not_count() -> None:
    poses = moving_poses(1)
    points = keypoints(tuple(CHAIN.joints[joint] for joint in LIMBS))
    assert trust(BODY, filmed(poses, points), points, poses).nodes_seen.all()
    rays = filmed(poses, POINTS)
    rays.confidence[:, :, keypoint("ltoes")] = 0.0
    seen = trust(BODY, rays, POINTS, poses).nodes_seen
    assert CHAIN.nodes[int(np.flatnonzero(~seen[0])[0])] == "lankle"
    track = JointPositions(joint_places(poses), np.full((1, 24), 0.02))
    track.positions[0, CHAIN.joint("rwrist")] += 1.0
    seen = trust(BODY, track, None, poses).nodes_seen
    assert [CHAIN.nodes[k] for k in np.flatnonzero(~seen[0])] == ["rshoulder", "relbow", "rwrist"]


def test_a_restart_interpolates_what_is_not_seen() -> None:
    poses = moving_poses(5)
    seen = np.ones((5, 20), np.bool_)
    seen[1:4, ELBOW] = False
    seen[0, HIPS[0]] = False  # the other hip is seen: the pelvis stays
    seen[3:, HIPS] = False
    found = restart(BODY, poses, seen)
    first, last = poses.rotations[0, ELBOW], poses.rotations[4, ELBOW]
    np.testing.assert_allclose(found.rotations[2, ELBOW], first @ exp(0.5 * log(first.T @ last)), atol=1e-12)
    np.testing.assert_array_equal(found.rotations[:3, 0], poses.rotations[:3, 0])
    np.testing.assert_array_equal(found.rotations[4, 0], poses.rotations[2, 0])
    np.testing.assert_array_equal(found.positions[3:], poses.positions[[2, 2]])
    np.testing.assert_array_equal(found.rotations[0, HIPS[0]], poses.rotations[1, HIPS[0]])
    nowhere = interpolated(poses, np.zeros((5, 20), np.bool_))
    np.testing.assert_array_equal(nowhere.rotations, poses.rotations)


@slow_as_python
def test_legs_that_two_of_four_cameras_confuse_are_tracked_on() -> None:
    poses = moving_poses(40)
    rays = filmed(poses, POINTS, 0.003)
    swaps = [(keypoint(f"l{name}"), keypoint(f"r{name}")) for name in ("hip", "knee", "ankle", "toes")]
    for left, right in swaps:
        rays.directions[15:27, :2, [left, right]] = rays.directions[15:27, :2, [right, left]]
    found = first_track(Observed(BODY, 30.0, rays, POINTS))
    gaps = np.sqrt(((found.track.positions - joint_places(poses)) ** 2).sum(axis=2))[:, LIMBS]
    assert gaps.mean() < 0.02
    assert gaps.max() < 0.2
    assert found.trust.contested[16:26, keypoint("lknee")].mean() > 0.5


def recorded(folder: Path, name: str) -> tuple[ChainBody, Rays, BodyPoints, np.ndarray]:
    """The body, rays, points and joints (T, J, 3) of a simulated recording."""
    about = json.loads((folder / "cameras.json").read_text(encoding="utf-8"))
    names = [key.replace("left_", "l").replace("right_", "r").replace("toe", "toes") for key in about["keypoints"]]
    limbs = [p for p, key in enumerate(names) if key in CHAIN.joints]
    truth = pl.read_parquet(folder / "truth.parquet").filter(pl.col("take").cast(pl.String) == name.split("_seed")[0])
    truth = truth.sort("frame")
    positions = np.stack([truth[key].struct.unnest().to_numpy() for key in CHAIN.joints], axis=1).astype(float)
    rows = pl.read_parquet(folder / "keypoints.parquet").filter(pl.col("recording").cast(pl.String) == name)
    rows = rows.sort("frame", "camera", "keypoint")
    shape = (len(positions), 4, len(names))
    pixels = rows.select("x", "y").to_numpy().reshape(*shape, 2).astype(float)
    confidence = rows["confidence"].to_numpy().reshape(shape).astype(float)
    cameras = about["recordings"][name]
    ways = np.empty((*shape, 3))
    for v, camera in enumerate(cameras):
        plane = (pixels[:, v] - [640, 480]) / 1000.0
        ways[:, v] = np.concatenate([plane, np.ones((*plane.shape[:2], 1))], axis=2) @ np.array(camera["rotation"])
    ways /= np.sqrt((ways**2).sum(axis=3, keepdims=True))
    centres = np.array([camera["centre"] for camera in cameras])
    body = measured_body(CHAIN, np.moveaxis(positions, 0, 2))
    joints = np.array([CHAIN.joint(names[p]) for p in limbs])
    points = BodyPoints(np.array([CHAIN.rest[j].node for j in joints]), body.offsets[joints], joints)
    return body, Rays(centres, np.full(4, 1000.0), ways[:, :, limbs], confidence[:, :, limbs]), points, positions


@slow_as_python
@pytest.mark.shared
def test_a_recording_with_confused_legs_is_tracked(shared: Path) -> None:
    body, rays, points, truth = recorded(shared / "data" / "cameras" / "simulated", "squat1Reps_seed1")
    found = first_track(Observed(body, 30.0, rays, points))
    gaps = np.sqrt(((found.track.positions - truth) ** 2).sum(axis=2))[:, LIMBS]
    assert gaps.mean() < 0.026
    assert np.median(gaps) < 0.023
