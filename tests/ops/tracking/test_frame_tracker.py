"""The tracker of frames: rays, places and silhouettes of a moving figure, frames that are lost, and priors."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.body.kinematic_chain import Poses, forward, pose_joints, pose_nodes, rest_cost, rotation_of, take_step
from kinedex.ops.body.pose_fit import fit_poses
from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking import frame_tracker as module
from kinedex.ops.tracking.contours import ContourSums, Observed, Silhouettes
from kinedex.ops.tracking.frame_tracker import FrameTrack, track_frames
from kinedex.ops.tracking.observations import BodyPoints, JointPositions, PriorTerms, Rays, no_priors
from kinedex.ops.tracking.views import render_mask
from tests.ops.tracking.scene import BODY, CAPSULES, CHAIN, JOINTS, cameras
from tests.plain_python import slow_as_python

FRAMES = 5
VIEWS = cameras(4)
LIMBS = [CHAIN.joint(side + name) for side in "lr" for name in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")]
START = fit_poses(BODY, JOINTS)


def motion() -> Poses:
    """Return poses in which the figure walks 3 cm a frame, lifts its left leg and bends its right elbow."""
    rotations = np.repeat(START.rotations, FRAMES, axis=0)
    for t in range(FRAMES):
        for node, vector in {"lhip": (-0.08, 0, 0), "lknee": (0.12, 0, 0), "relbow": (0, 0.1, 0)}.items():
            k = CHAIN.nodes.index(node)
            rotations[t, k] = rotations[t, k] @ rotation_of(t * np.array(vector, float))
    positions = START.positions + np.arange(FRAMES)[:, None] * np.array([0.02, 0.0, 0.02])
    return Poses(positions, rotations)


TRUTH = np.ascontiguousarray(forward(BODY, motion())[0].transpose(2, 0, 1))
MASKS = [
    tuple(render_mask(CAPSULES, joints, view).view(np.uint8) * np.uint8(255) for view in VIEWS) for joints in TRUTH
]
NOTHING = (None,) * len(VIEWS)
POINTS = BodyPoints(BODY.arrays.joint_nodes, BODY.arrays.joint_offsets, np.arange(len(CHAIN.joints)))


def rays() -> Rays:
    """Return rays through all joints, without noise."""
    centres = np.array([view.centre for view in VIEWS])
    directions = TRUTH[:, None] - centres[:, None]
    directions /= np.linalg.norm(directions, axis=3, keepdims=True)
    return Rays(centres, np.full(len(VIEWS), VIEWS[0].matrix[0, 0]), directions, np.ones(directions.shape[:3]))


def apart(track: FrameTrack) -> np.ndarray:
    """Return the mean distance of the limbs' joints from the truth in each frame, in metres."""
    return np.linalg.norm(track.positions - TRUTH, axis=2)[:, LIMBS].mean(axis=1)


def test_rays_without_noise_give_the_joints_back() -> None:
    track = track_frames(Observed(BODY, 30.0, rays(), POINTS), sigma_px=0.05)
    assert apart(track).max() < 1e-4
    assert not track.lost.any()
    assert np.isnan(track.shifts_px).all()
    assert track.costs.max() < 1.0


def test_places_of_joints_are_followed_through_gaps() -> None:
    positions = TRUTH.copy()
    positions[2, CHAIN.joint("lknee")] = np.nan
    positions[3] = np.nan
    track = track_frames(Observed(BODY, 30.0, JointPositions(positions, np.full(positions.shape[:2], 0.002))))
    assert apart(track)[[0, 1, 2, 4]].max() < 2e-3
    assert track.lost.tolist() == [False, False, False, True, False]
    np.testing.assert_array_equal(track.positions[3], track.positions[2])


@slow_as_python
def test_silhouettes_alone_are_followed() -> None:
    track = track_frames(Observed(BODY, 30.0, None, None, Silhouettes(VIEWS, MASKS, CAPSULES)), START)
    assert apart(track).max() < 0.015
    assert not track.lost.any()
    assert track.contours.min() > 200
    assert track.shifts_px.max() < 1.0


@slow_as_python
def test_rays_and_silhouettes_complete_each_other() -> None:
    seen = rays()
    hidden = [CHAIN.joint(name) for name in ("lknee", "lankle", "ltoes")]
    seen.confidence[:, :, hidden] = 0.0
    masks = Silhouettes(VIEWS, MASKS, CAPSULES)
    both = track_frames(Observed(BODY, 30.0, seen, POINTS, masks), START)
    alone = track_frames(Observed(BODY, 30.0, seen, POINTS), START)
    assert apart(both).max() < 0.015
    assert apart(both)[-1] < 0.5 * apart(alone)[-1]


@slow_as_python
def test_a_body_out_of_sight_keeps_its_pose_and_is_found_at_the_centroids() -> None:
    away = Poses(motion().positions + np.array([1.3, 0.0, 0.6]), motion().rotations)
    joints = np.ascontiguousarray(forward(BODY, away)[0].transpose(2, 0, 1))[3:]
    there = tuple(render_mask(CAPSULES, joints[0], view).view(np.uint8) * np.uint8(255) for view in VIEWS)
    masks = [MASKS[0], NOTHING, there, there, there]
    track = track_frames(Observed(BODY, 30.0, None, None, Silhouettes(VIEWS, masks, CAPSULES)), START)
    assert track.lost.tolist() == [False, True, True, False, False]
    np.testing.assert_array_equal(track.positions[1], track.positions[0])
    assert track.contours[1] == 0
    assert np.linalg.norm(track.positions[2] - joints[0], axis=1)[LIMBS].mean() < 0.1
    assert np.linalg.norm(track.positions[4] - joints[0], axis=1)[LIMBS].mean() < 0.03


def test_a_jump_that_no_body_makes_is_lost_until_there_was_time_for_it() -> None:
    positions = TRUTH.copy()
    positions[2:] += np.array([0.5, 0.0, 0.0])
    track = track_frames(Observed(BODY, 30.0, JointPositions(positions, np.full(positions.shape[:2], 0.01))))
    assert track.lost.tolist() == [False, False, True, False, False]


@slow_as_python
def test_priors_pull_unless_silhouettes_contradict_them() -> None:
    priors = no_priors(FRAMES, len(CHAIN.nodes))
    elbow = CHAIN.nodes.index("lelbow")
    priors.turn_targets[:, elbow] = rotation_of(np.array([0.0, -1.0, 0.0]))
    masks = Silhouettes(VIEWS, MASKS, CAPSULES)

    def tracks(of: PriorTerms | None) -> list[Poses]:
        on_rays = track_frames(Observed(BODY, 30.0, rays(), POINTS), START, of)
        return [on_rays.poses, track_frames(Observed(BODY, 30.0, None, None, masks), START, of).poses]

    without = tracks(None)
    for one, other in zip(without, tracks(priors), strict=True):
        np.testing.assert_array_equal(one.rotations, other.rotations)  # they have no weight
    priors.turn_weights[:, elbow] = 1e6
    before = priors.turn_weights.copy()
    pulled, refused = tracks(priors)
    np.testing.assert_allclose(pulled.rotations[-1, elbow], priors.turn_targets[-1, elbow], atol=0.02)
    np.testing.assert_array_equal(refused.rotations, without[1].rotations)
    np.testing.assert_array_equal(priors.turn_weights, before)  # the caller's terms stay as they are
    priors.turn_targets[:, elbow] = without[1].rotations[:, elbow]
    _, agreeing = tracks(priors)
    np.testing.assert_allclose(agreeing.rotations[:, elbow], without[1].rotations[:, elbow], atol=1e-3)


def test_steps_on_silhouettes_end_where_the_squares_of_the_twin_are_least() -> None:
    tracker = module._Frames(Observed(BODY, 30.0, None, None, Silhouettes(VIEWS, MASKS, CAPSULES)), None, 5.0)
    place, rotations = motion().positions[1].copy(), START.rotations[0].copy()
    tracker._find(tracker.silhouettes.seen(1), place, rotations)
    sums = ContourSums(CAPSULES, *(part.copy() for part in tracker.sums[1:]))
    tracker._solve(1, place, rotations, 60, tracker.priors)

    def cost(vector: np.ndarray) -> float:
        """Return the squares of correspondences that move with both ends of their capsule, and the pulls to rest."""
        buffers, joints = tracker.buffers, np.empty((len(CHAIN.joints), 3))
        moved, turned = np.empty(3), np.empty_like(rotations)
        take_step(BODY.arrays, place, rotations, vector, moved, turned)
        pose_nodes(BODY.arrays, moved, turned, buffers.turned, buffers.centres)
        pose_joints(BODY.arrays, buffers.turned, buffers.centres, joints)
        move = joints - sums.joints
        squares = np.einsum("ji,jik,jk->", move, sums.matrices, move) + 2 * (sums.vectors * move).sum()
        squares += 2 * np.einsum("ni,nik,nk->", move[CAPSULES.starts], sums.mixed, move[CAPSULES.ends])
        return float(squares + rest_cost(BODY.arrays, turned))

    for d in range(CHAIN.parameters):
        small = 1e-5 * np.eye(CHAIN.parameters)[d]
        slope, bend = cost(small) - cost(-small), cost(small) + cost(-small) - 2 * cost(0 * small)
        assert abs(slope) < 0.01 * max(bend / 1e-5, 1e-5)  # the minimum is within 0.5 % of a radian or metre


def test_what_cannot_be_tracked_is_refused() -> None:
    masks = Silhouettes(VIEWS, MASKS, CAPSULES)
    with pytest.raises(ParameterError, match="observations must be rays or places, unless there are silhouettes"):
        track_frames(Observed(BODY, 30.0, None), START)
    with pytest.raises(ParameterError, match="first must be a pose, which silhouettes alone do not give"):
        track_frames(Observed(BODY, 30.0, None, None, masks))
    with pytest.raises(ParameterError, match="rate_hz must be positive"):
        track_frames(Observed(BODY, 0.0, rays(), POINTS))
    with pytest.raises(ParameterError, match="masks must be those of 5 frames, got 2"):
        track_frames(Observed(BODY, 30.0, rays(), POINTS, Silhouettes(VIEWS, MASKS[:2], CAPSULES)), START)
    wrong = [*MASKS[:1], (MASKS[1][0][:100], *MASKS[1][1:]), *MASKS[2:]]
    with pytest.raises(ParameterError, match=r"mask of camera 0 in frame 1 must be of shape \(480, 640\)"):
        track_frames(Observed(BODY, 30.0, None, None, Silhouettes(VIEWS, wrong, CAPSULES)), START)
    with pytest.raises(ParameterError, match="masks of frame 0 must be those of 3 cameras, got 4"):
        track_frames(Observed(BODY, 30.0, None, None, Silhouettes(VIEWS[:3], MASKS, CAPSULES)), START)
