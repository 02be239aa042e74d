"""The vertical axis of a file: found for whoever stands in it, however the body is turned; never guessed wrongly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.body.up_axis import AXES, UpAxis, up_axis
from kinedex.storage.formats.motion.reader_table import read_body
from kinedex.storage.formats.motion.single_file import skeleton_beside
from tests.bodies import standing
from tests.oracles import up_axis as naive
from tests.oracles.features import JOINTS

LOWER = ("root", "lhip", "rhip", "lknee", "rknee", "lankle", "rankle", "ltoes", "rtoes")
UPPER = tuple(joint for joint in JOINTS if joint not in LOWER[1:])


def turned(axis: str) -> np.ndarray:
    """The rotation that turns a body of a file with Y up into one of a file with another axis up."""
    up = np.eye(3)["xyz".index(axis[-1])] * (-1.0 if axis[0] == "-" else 1.0)
    side = np.roll(np.abs(up), -1)
    return np.stack([side, up, np.cross(side, up)], axis=1)


def places(body: np.ndarray, joints: tuple[str, ...] = JOINTS, axis: str = "y") -> dict[str, np.ndarray]:
    return {joint: turned(axis) @ body[JOINTS.index(joint)] for joint in joints}


def walking(frames: int = 32) -> np.ndarray:
    """Two metres of straight steps: one foot stands while the other swings."""
    body = standing(frames)
    body[:, 2] += np.linspace(0.0, 2.0, frames)
    for side, phase in (("l", 0.0), ("r", np.pi)):
        lifted = 0.1 * np.maximum(np.sin(np.linspace(0, 6 * np.pi, frames) + phase), 0.0)
        for joint in ("knee", "ankle", "toes"):
            body[JOINTS.index(side + joint), 1] += lifted
    return body


def lying(frames: int = 32) -> np.ndarray:
    """The standing figure on its back: the head towards −Z, the front up."""
    body = standing(frames)
    return np.stack([body[:, 0], body[:, 2] + 0.1, -body[:, 1]], axis=1)


def rest(axis: str = "y") -> dict[str, np.ndarray]:
    return {joint: place[:, 0] for joint, place in places(standing(1), axis=axis).items()}


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("joints", [JOINTS, LOWER, UPPER, ("root", "head"), ("root", "lankle", "rankle")])
def test_whoever_walks_or_stands_has_the_axis_found_in_whatever_way_the_file_is_turned(
    axis: str, joints: tuple[str, ...]
) -> None:
    for body in (walking(), standing(32), standing(1)):
        assert up_axis(places(body, joints, axis)).axis == axis


def test_confidence_grows_with_each_observation_that_agrees() -> None:
    still, moving = up_axis(places(standing(32))), up_axis(places(walking()))
    assert up_axis(places(standing(32), UPPER)).confidence < still.confidence < moving.confidence
    assert still.confidence < up_axis(places(standing(32)), rest()).confidence
    assert "the lowest point varies by 0.0" in moving.reasons[1]


@pytest.mark.parametrize("axis", AXES)
def test_a_body_that_lies_throughout_is_undecided_where_its_skeleton_stands(axis: str) -> None:
    found = up_axis(places(lying(), axis=axis), rest(axis))
    assert (found.axis, found.reasons[-1]) == ("", f"the rest pose stands along {axis}")


def test_getting_up_decides_although_the_body_lies_most_of_the_time() -> None:
    body = np.concatenate([lying(20), standing(10)], axis=2)
    assert up_axis(places(body, axis="z"), rest("z")).axis == "z"


def test_handstands_for_a_third_of_the_time_do_not_turn_the_world_over() -> None:
    upside = standing(10) * np.array([-1.0, -1.0, 1.0])[:, None] + np.array([0.0, 1.75, 0.0])[:, None]
    assert up_axis(places(np.concatenate([walking(20), upside], axis=2))).axis == "y"


def test_who_crawls_throughout_is_undecided_since_sitting_looks_the_same_turned() -> None:
    body = standing(32)
    for side in "lr":
        body[JOINTS.index(side + "knee")] = body[JOINTS.index(side + "hip")] + [[0], [0], [0.45]]
        body[JOINTS.index(side + "ankle")] = body[JOINTS.index(side + "knee")] + [[0], [-0.4], [0]]
        body[JOINTS.index(side + "toes")] = body[JOINTS.index(side + "ankle")] + [[0], [-0.1], [0.15]]
    assert up_axis(places(body)).axis == "y"
    crawling = np.stack([body[:, 0], -body[:, 2], body[:, 1]], axis=1)
    crawling[:, 2] += np.linspace(0, 2, 32)
    assert up_axis(places(crawling)).axis in ("", "y")


def test_a_rest_pose_that_lies_is_overruled_by_who_walks_and_blender_files_are_z_up() -> None:
    assert up_axis(places(walking()), rest("z")).axis == "y"
    assert up_axis(places(walking(), axis="z"), rest("z")).axis == "z"
    assert up_axis(places(walking(), axis="z"), rest("y")).axis == "z"


def test_without_hips_or_ends_or_frames_nothing_is_decided() -> None:
    unseen = places(np.full((24, 3, 5), np.nan))
    for given_places in ({}, places(walking(), ("head", "lankle")), places(walking(), ("root",)), unseen):
        assert up_axis(given_places) == UpAxis("", 0.0, ("no hips with head or feet",))
    assert up_axis(places(np.zeros((24, 3, 5)))).axis == ""


@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.sets(st.sampled_from(JOINTS)), st.booleans())
def test_the_naive_twin_agrees(seed: int, frames: int, joints: set[str], resting: bool) -> None:
    rng = np.random.default_rng(seed)
    start = [walking(frames), lying(frames), np.zeros((24, 3, frames))][rng.integers(3)]
    body = start + rng.choice([0.0, 0.1, 0.5]) * rng.normal(size=start.shape)
    body[rng.random((24, frames))[:, None].repeat(3, axis=1) < rng.choice([0.0, 0.1])] = np.nan
    some = places(body, tuple(sorted(joints)), AXES[rng.integers(6)])
    still = {joint: place for joint, place in rest().items() if joint in joints} if resting else None
    found, (axis, confidence) = up_axis(some, still), naive.up_axis(some, still)
    assert found.confidence == pytest.approx(confidence, abs=1e-9)
    assert found.axis == axis or abs(found.confidence - 0.5) < 1e-9


SAMPLE = ("hdm05/clips/lieDownFloor", "hdm05/clips/hopBothLegs1hops", "hdm05/clips/squat1Reps", "cmu/01")


def test_no_real_take_is_judged_wrongly_in_any_turn(shared: Path) -> None:
    joints = load_feature_set().joints
    mappings = load_mappings("auto", joints)
    files = [file for folder in SAMPLE for file in sorted((shared / "data" / folder).glob("*.amc"))[::3]]
    files += sorted((shared / "data" / "bandai").rglob("*.bvh"))[::40]
    decided = 0
    for file in files:
        body = read_body(file, skeleton_beside(file) if file.suffix == ".amc" else None, mappings, joints)
        sampled = body.positions[:, :, np.linspace(0, body.frames - 1, 32).round().astype(int)]
        for axis in AXES:
            found = up_axis({joint: turned(axis) @ place for joint, place in zip(joints, sampled, strict=True)})
            assert found.axis in ("", axis), f"{file}: {found}"
            decided += found.axis == axis
    assert decided >= 0.8 * 6 * len(files) > 0
