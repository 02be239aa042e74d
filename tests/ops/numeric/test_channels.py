"""Channels say how a body moves, wherever it is, wherever it faces, and however large it is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.arrays import F64
from kinedex.ops.body.facing_direction import mirrored_positions, turn_about_y
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.errors import ParameterError
from kinedex.ops.numeric.channels import channels, running_mean
from tests.ops.numeric.motions import RATE_HZ, in_a_row, motion
from tests.oracles.recognition import channels as naive_channels

TAKE = in_a_row(["raise left", "walk", "bow"], [30, 25, 35])


@settings(max_examples=20, deadline=None)
@given(
    yaw=st.floats(-3.1, 3.1), x=st.floats(-50, 50), z=st.floats(-50, 50), size=st.floats(0.3, 3.0),
)  # fmt: skip
def test_place_heading_and_size_do_not_matter(yaw: float, x: float, z: float, size: float) -> None:
    found = channels((turn_about_y(TAKE, yaw) + np.array([x, 0, z])) * size, JOINTS, RATE_HZ)
    expected = channels(TAKE, JOINTS, RATE_HZ)
    np.testing.assert_allclose(found.frames, expected.frames, atol=2e-6)
    np.testing.assert_allclose(np.diff(found.yaw), np.diff(expected.yaw), atol=1e-9)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 99), names=st.lists(st.sampled_from(["raise left", "walk", "bow"]), min_size=1, max_size=3))
def test_channels_are_those_of_plain_numpy(dtype: type[np.floating], seed: int, names: list[str]) -> None:
    take = in_a_row(names, [25] * len(names), seed).astype(dtype)
    found = channels(take, JOINTS, RATE_HZ)
    frames, yaw = naive_channels(take.astype(np.float64), JOINTS, RATE_HZ)
    np.testing.assert_allclose(found.frames, frames, atol=1e-5)
    np.testing.assert_allclose(found.yaw, yaw, atol=1e-9)
    parts = [found.pose, found.velocities, found.speeds, found.root]
    np.testing.assert_array_equal(np.concatenate(parts, axis=1), found.frames)


def test_a_mirror_image_goes_to_the_other_side() -> None:
    found, image = (channels(one, JOINTS, RATE_HZ) for one in (TAKE, mirrored_positions(TAKE, JOINTS)))
    np.testing.assert_array_equal(image.root[:, [0, 3]], -found.root[:, [0, 3]])
    np.testing.assert_array_equal(image.root[:, [1, 2, 4, 5]], found.root[:, [1, 2, 4, 5]])
    lwrist, rwrist = JOINTS.index("lwrist") - 1, JOINTS.index("rwrist") - 1
    left, right = found.pose.reshape(-1, 23, 3)[:, lwrist], image.pose.reshape(-1, 23, 3)[:, rwrist]
    np.testing.assert_array_equal(right * np.array([-1, 1, 1], np.float32), left)


def test_who_walks_ahead_and_turns_left_has_positive_channels() -> None:
    walk = channels(motion("walk", 40), JOINTS, RATE_HZ)
    assert np.median(walk.root[:, 2]) > 1.0
    turning = np.stack(
        [turn_about_y(pose, angle) for pose, angle in zip(motion("stand", 40), np.arange(40) / 30, strict=True)]
    )
    found = channels(turning, JOINTS, RATE_HZ)
    np.testing.assert_allclose(found.root[5:-5, 3], 1.0, atol=0.1)
    assert found.yaw[-1] - found.yaw[0] == pytest.approx(39 / 30, abs=0.1)


def test_a_jump_reaches_velocities_only_and_these_are_limited() -> None:
    far = np.concatenate([TAKE, TAKE + np.array([100.0, 0, 0])])
    found = channels(far, JOINTS, RATE_HZ)
    assert found.speeds.max() == 8.0
    np.testing.assert_allclose(found.pose[len(TAKE) + 5 :], channels(TAKE, JOINTS, RATE_HZ).pose[5:], atol=1e-6)


@pytest.mark.parametrize("frames", [1, 2, 5, 6.9, 40])
def test_a_running_mean_is_the_mean_of_those_around(frames: float) -> None:
    values = np.random.default_rng(0).normal(size=(12, 2))
    half = round((frames - 1) / 2)
    expected = [values[np.clip(np.arange(t - half, t + half + 1), 0, 11)].mean(axis=0) for t in range(12)]
    np.testing.assert_allclose(running_mean(values, frames), expected, atol=1e-12)


def hidden(take: F64, names: Sequence[str]) -> F64:
    """Return a take without some joints."""
    found = take.copy()
    found[:, [JOINTS.index(name) for name in names]] = np.nan
    return found


@pytest.mark.parametrize("names", [["lhip"], ["lshoulder"], ["rknee", "rankle"], ["lwrist", "head", "rtoes"]])
def test_one_pair_gives_the_heading_and_one_leg_the_size(names: list[str]) -> None:
    found, whole = channels(hidden(TAKE, names), JOINTS, RATE_HZ), channels(TAKE, JOINTS, RATE_HZ)
    assert [JOINTS[k] for k in np.flatnonzero(~found.known)] == [name for name in JOINTS if name in names]
    np.testing.assert_allclose(found.yaw, whole.yaw, atol=0.2)
    np.testing.assert_allclose(found.root[:, 5], whole.root[:, 5], atol=0.05)
    nowhere = JOINTS.index(names[0]) - 1
    assert not found.pose[:, 3 * nowhere : 3 * nowhere + 3].any()
    assert np.isfinite(found.frames).all()


def test_a_gap_is_bridged_beside_the_root() -> None:
    walk = motion("walk", 60)
    seen = np.ones(60, bool)
    seen[20:32] = False
    part = walk.copy()
    part[~seen, JOINTS.index("rwrist")] = np.nan
    part[40:42] = np.inf
    found, whole = channels(part, JOINTS, RATE_HZ), channels(walk, JOINTS, RATE_HZ)
    assert found.known.all()
    np.testing.assert_allclose(found.frames, whole.frames, atol=0.5)
    np.testing.assert_allclose(found.pose, whole.pose, atol=0.03)
    np.testing.assert_allclose(found.frames[:19], whole.frames[:19], atol=1e-3)


def test_a_joint_that_most_frames_lack_is_not_known() -> None:
    part = TAKE.copy()
    part[: len(TAKE) // 2 + 1, JOINTS.index("head")] = np.nan
    found = channels(part, JOINTS, RATE_HZ)
    assert JOINTS[int(np.flatnonzero(~found.known)[0])] == "head"
    assert not found.speeds[:, JOINTS.index("head")].any()


def test_what_has_no_channels_is_refused() -> None:
    with pytest.raises(ParameterError, match="two frames"):
        channels(TAKE[:1], JOINTS, RATE_HZ)
    for names, said in (
        (["root"], "the joint root"),
        (["lhip", "rshoulder"], "both hips or both shoulders"),
        (["lhip", "rankle"], "ankle of one side"),
    ):
        with pytest.raises(ParameterError, match=said):
            channels(hidden(TAKE, names), JOINTS, RATE_HZ)
    with pytest.raises(ParameterError, match="apart from above"):
        channels(TAKE * np.array([0.0, 1.0, 0.0]), JOINTS, RATE_HZ)
