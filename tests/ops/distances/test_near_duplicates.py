"""The same motion is found again wherever it takes place, by its joints alone."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.body.facing_direction import placement_of, turn_about_y
from kinedex.ops.distances.near_duplicates import motion_outline, near_duplicates
from kinedex.ops.errors import ParameterError

HIPS = (1, 2)


def dance(seed: int, frames: int = 40, *, yaw: float = 0.0, at: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """A body with wandering joints, of which the first three are its root and its hips."""
    random = np.random.default_rng(seed)
    rest, phase = random.normal(size=(8, 3)), random.uniform(0, 6, (8, 3))
    rest[:3] = [[0, 1, 0], [0.1, 1, 0], [-0.1, 1, 0]]
    time = np.linspace(0, 4, frames)[:, None, None]
    moved = rest + 0.3 * np.sin(phase + time) * (np.arange(8) > 2)[None, :, None]
    return turn_about_y(moved, yaw) + np.array([at[0], 0.0, at[1]])


def outline(positions: np.ndarray) -> np.ndarray:
    root, left, right = positions[0, 0], positions[0, 1:2], positions[0, 2:3]
    return motion_outline(positions, placement_of(root, left, right))


def test_a_motion_elsewhere_or_at_another_rate_is_the_same_and_another_one_is_not() -> None:
    clips = [dance(1), dance(2), dance(1, yaw=2.0, at=(5.0, -3.0)), dance(1, frames=79), dance(1) + 0.001]
    found = near_duplicates([outline(clip) for clip in clips], [4.0, 4.0, 4.0, 4.0, 4.0], 0.02)
    assert found == [-1, -1, 0, 0, 0]
    assert near_duplicates([outline(clip) for clip in clips], [4.0, 4.0, 4.0, 3.0, 4.0], 0.02) == [-1, -1, 0, -1, 0]


@pytest.mark.parametrize("gap", [False, True])
def test_blocks_change_nothing(gap: bool) -> None:
    outlines = [outline(dance(seed % 290)) for seed in range(600)]
    if gap:
        outlines[5] = np.where(np.arange(8)[None, :, None] == 7, np.nan, outlines[5]).astype(np.float32)
    found = near_duplicates(outlines, [4.0] * 600, 0.02)
    assert found == [-1 if i < 290 else i % 290 for i in range(600)]


def test_clips_without_a_joint_in_common_are_different() -> None:
    one, other = outline(dance(1)), outline(dance(1))
    one[:, :4], other[:, 4:] = np.nan, np.nan
    assert near_duplicates([one, other], [4.0, 4.0], 0.02) == [-1, -1]
    assert near_duplicates([], [], 0.02) == []
    with pytest.raises(ParameterError, match="above 0"):
        near_duplicates([one], [4.0], 0.0)
