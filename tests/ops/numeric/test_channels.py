"""Channels say how a body moves, wherever it is, wherever it faces, and however large it is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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


def test_what_has_no_channels_is_refused() -> None:
    with pytest.raises(ParameterError, match="two frames"):
        channels(TAKE[:1], JOINTS, RATE_HZ)
    hidden = TAKE.copy()
    hidden[3, 5] = np.nan
    with pytest.raises(ParameterError, match="known joints"):
        channels(hidden, JOINTS, RATE_HZ)
    with pytest.raises(ParameterError, match="apart from above"):
        channels(TAKE * np.array([0.0, 1.0, 0.0]), JOINTS, RATE_HZ)
