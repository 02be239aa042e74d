"""Limbs without length, of unequal lengths, and with joints of the other side are doubted."""

from __future__ import annotations

import numpy as np

from kinedex.catalog.skeletons.limb_doubts import limb_doubts
from tests.bodies import standing
from tests.oracles.features import JOINTS as ORDER

JOINTS = tuple(ORDER)


def walking(frames: int = 40) -> np.ndarray:
    """A body (J, 3, T) whose legs swing about the hips, left and right in turn."""
    points = standing(frames).copy()
    angle = 0.5 * np.sin(np.arange(frames) / 5)
    for side, sign in (("l", 1.0), ("r", -1.0)):
        hip = points[JOINTS.index(f"{side}hip")].copy()
        for joint in ("knee", "ankle", "toes"):
            place = points[JOINTS.index(f"{side}{joint}")]
            y, z = place[1] - hip[1], place[2] - hip[2]
            cos, sin = np.cos(sign * angle), np.sin(sign * angle)
            place[1], place[2] = hip[1] + cos * y - sin * z, hip[2] + sin * y + cos * z
    return points


def test_a_walking_body_is_not_doubted() -> None:
    assert limb_doubts(walking(), JOINTS) == []
    assert limb_doubts(1000 * walking(1), JOINTS) == []


def test_a_bone_of_no_length_is_doubted() -> None:
    body = walking()
    body[JOINTS.index("lelbow")] = body[JOINTS.index("lshoulder")]
    (warning,) = limb_doubts(body, JOINTS)
    assert "lshoulder and lelbow are at the same place" in warning


def test_limbs_of_unequal_lengths_are_doubted() -> None:
    body = walking()
    wrist, elbow = JOINTS.index("rwrist"), JOINTS.index("relbow")
    body[wrist] = body[elbow] + 1.5 * (body[wrist] - body[elbow])
    (warning,) = limb_doubts(body, JOINTS)
    assert "lelbow and lwrist are 0.67 times as far apart as relbow and rwrist" in warning


def test_knees_that_are_named_after_the_other_side_are_doubted() -> None:
    body = walking()
    left, right = JOINTS.index("lknee"), JOINTS.index("rknee")
    body[[left, right]] = body[[right, left]]
    (warning,) = limb_doubts(body, JOINTS)
    assert "in all frames, as if exchanged" in warning


def test_unknown_joints_are_not_doubted() -> None:
    body = walking()
    body[JOINTS.index("lwrist")] = np.nan
    assert limb_doubts(body, JOINTS) == []
