"""Legs that cameras confuse are exchanged, and nothing else."""

from __future__ import annotations

import numpy as np

from kinedex.ops.body.kinematic_chain import forward
from kinedex.ops.tracking.observations import BodyPoints, JointPositions, Rays
from kinedex.ops.tracking.trust import exchanged_sides
from tests.ops.body.test_kinematic_chain import BODY, CHAIN, random_poses

NAMES = [s + n for s in "lr" for n in ("hip", "knee", "ankle", "toes", "wrist")]
JOINTS = np.array([CHAIN.joint(name) for name in NAMES])
POINTS = BodyPoints(np.array([CHAIN.rest[j].node for j in JOINTS]), BODY.offsets[JOINTS], JOINTS)
POSES = random_poses(4, 3)
CENTRES = np.array([[4.0, 1.0, 0.0], [0.0, 1.0, 4.0], [-4.0, 1.0, 1.0]])


def seen() -> Rays:
    """Return what three cameras see of the poses, without noise."""
    positions = np.moveaxis(forward(BODY, POSES)[0][JOINTS], 2, 0)
    directions = positions[:, None] - CENTRES[None, :, None]
    directions /= np.linalg.norm(directions, axis=3, keepdims=True)
    confidence = np.random.default_rng(0).uniform(0.5, 1.0, directions.shape[:3])
    return Rays(CENTRES, np.full(3, 1000.0), directions, confidence)


def test_confused_legs_are_exchanged_in_their_frames_and_cameras_only():
    true = seen()
    legs = [NAMES.index(s + n) for s in "lr" for n in ("hip", "knee", "ankle", "toes")]
    other = legs[4:] + legs[:4]
    directions, confidence = true.directions.copy(), true.confidence.copy()
    for t, v in ((0, 1), (2, 0), (2, 1), (2, 2)):
        directions[t, v, legs], confidence[t, v, legs] = true.directions[t, v, other], true.confidence[t, v, other]
    found = exchanged_sides(BODY, Rays(CENTRES, true.focal_px, directions, confidence), POINTS, POSES)
    assert isinstance(found, Rays)
    np.testing.assert_array_equal(found.directions, true.directions)
    np.testing.assert_array_equal(found.confidence, true.confidence)


def test_what_is_not_seen_and_places_stay_as_they_are():
    true = seen()
    unseen = Rays(CENTRES, true.focal_px, np.full_like(true.directions, np.nan), np.zeros_like(true.confidence))
    found = exchanged_sides(BODY, unseen, POINTS, POSES)
    assert isinstance(found, Rays)
    np.testing.assert_array_equal(found.confidence, unseen.confidence)
    positions = JointPositions(np.zeros((3, 24, 3)), np.ones((3, 24)))
    assert exchanged_sides(BODY, positions, None, POSES) is positions
    arms = BodyPoints(POINTS.nodes[4:5], POINTS.offsets[4:5], POINTS.joints[4:5])
    assert exchanged_sides(BODY, unseen, arms, POSES) is unseen
