"""Smoothed poses keep their bones, their gaps and slow motion, and lose fast motion."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.depth.low_pass import low_pass
from kinedex.ops.depth.thinned_poses import bone_lengths_of
from kinedex.ops.errors import ParameterError
from tests.bodies import STANDING

STILL = np.array([STANDING[joint] for joint in JOINTS], float)
RATE_HZ, FRAMES = 30.0, 240


def swaying(hz: float) -> np.ndarray:
    """A standing body that sways to the side as a whole by 0.1 m."""
    moved = np.repeat(STILL[None], FRAMES, axis=0)
    moved[:, :, 0] += 0.1 * np.sin(2 * np.pi * hz * np.arange(FRAMES) / RATE_HZ)[:, None]
    return moved


@pytest.mark.parametrize(("hz", "share"), [(0.25, 0.995), (4.0, 0.7071), (12.0, 0.0442)])
def test_the_amplitude_falls_with_the_frequency(hz: float, share: float) -> None:
    way = low_pass(swaying(hz), RATE_HZ, 4.0)[60:180, 0, 0] - STILL[0, 0]
    assert np.abs(way).max() == pytest.approx(0.1 * share, rel=0.05)


def test_bones_and_gaps_stay_and_nothing_is_carried_over_a_gap() -> None:
    poses = np.repeat(STILL[None], 20, axis=0) + np.random.default_rng(1).normal(0, 0.02, (20, len(JOINTS), 3))
    poses[8:10] = np.nan
    smooth = low_pass(poses, RATE_HZ, 5.0)
    assert np.array_equal(np.isnan(smooth), np.isnan(poses))
    for t in (0, 7, 12):
        assert bone_lengths_of(smooth[t : t + 1]) == pytest.approx(bone_lengths_of(poses[t : t + 1]), abs=1e-12)
    changed = poses.copy()
    changed[10:] += 1.0
    assert np.array_equal(low_pass(changed, RATE_HZ, 5.0)[:8], smooth[:8])


def test_a_frequency_must_be_positive() -> None:
    with pytest.raises(ParameterError, match="cutoff_hz"):
        low_pass(swaying(1.0), RATE_HZ, 0.0)
