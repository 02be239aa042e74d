"""Left and right by geometry: toes and knees show where a body faces, however it is turned."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.body.up_axis import CLEAR, left_right
from kinedex.storage.formats.motion.reader_table import read_body
from tests.bodies import standing
from tests.oracles.features import JOINTS


def places(body: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(JOINTS, body, strict=True))


def swapped(named: dict[str, np.ndarray], joints: tuple[str, ...] = JOINTS) -> dict[str, np.ndarray]:
    """The places with left and right names of these joints exchanged."""
    other = {"l" + joint[1:]: joint for joint in joints if joint[0] == "r" and joint != "root"}
    other |= {right: left for left, right in other.items()}
    return {joint: named[other.get(joint, joint)] for joint in named}


def test_left_is_on_the_left_in_any_turn_and_size_and_on_the_right_in_a_mirror() -> None:
    rng = np.random.default_rng(1)
    body = standing(5)
    for _ in range(20):
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        found = left_right(places(rng.uniform(0.01, 100) * np.einsum("ab,jbt->jat", turn, body)))
        assert found.legs * np.linalg.det(turn) > 0.5
        assert found.swapped == (np.linalg.det(turn) < 0)


def test_exchanged_names_are_found_of_all_joints_of_arms_and_of_knees_alone() -> None:
    named = places(standing(5))
    assert left_right(swapped(named)).legs == -left_right(named).legs
    assert "left is on the right" in left_right(swapped(named)).reasons[0]
    arms = left_right(swapped(named, tuple(joint for joint in JOINTS if "hip" not in joint and "toes" not in joint)))
    assert arms.swapped
    assert "the shoulders lie the other way round than the hips" in " ".join(arms.reasons)
    knees = left_right(swapped(named, ("rknee",)))
    assert knees.swapped
    assert "the knees lie the other way round than the hips (-1.00)" in knees.reasons


def test_frames_in_which_joints_are_not_seen_do_not_count_and_unknown_stays_unknown() -> None:
    body = standing(4)
    whole = left_right(places(body))
    body[JOINTS.index("ltoes"), :, 2] = np.nan
    assert left_right(places(body)).legs == pytest.approx(whole.legs)
    named = places(standing(4))
    for absent in ({}, {"lhip": named["lhip"]}, {joint: named[joint] for joint in ("lhip", "rhip", "head")}):
        found = left_right(absent)
        assert np.isnan(found.legs)
        assert not found.swapped
    assert np.isnan(left_right(places(np.full((24, 3, 2), np.nan))).legs)


def test_no_take_of_bandai_is_called_swapped_and_every_mirrored_one_is(shared: Path) -> None:
    joints = load_feature_set().joints
    mappings = load_mappings("auto", joints)
    for file in sorted((shared / "data" / "bandai").rglob("*.bvh"))[::40]:
        body = read_body(file, None, mappings, joints)
        sampled = body.positions[:, :, np.linspace(0, body.frames - 1, 32).round().astype(int)]
        named = dict(zip(joints, sampled, strict=True))
        assert left_right(named).legs > 2 * CLEAR, file
        assert left_right(swapped(named)).swapped, file
