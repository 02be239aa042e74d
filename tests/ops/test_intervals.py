"""Test intervals of takes, and the conversion between frames and seconds."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.intervals import Interval, in_seconds, nearest_frame, shown_seconds


def test_intervals_overlap_where_they_share_a_frame_of_the_take() -> None:
    walk = Interval("walk", 10, 20)
    assert walk.frames == 10
    assert walk.overlaps(Interval("walk", 19, 30))
    assert not walk.overlaps(Interval("walk", 20, 30))
    assert not walk.overlaps(Interval("run", 10, 20))


@pytest.mark.parametrize(
    ("frames", "rate_hz", "shown"),
    [(680, 30.0, "22.67"), (0, 30.0, "0.00"), (15, 120.0, "0.13"), (3, 120.0, "0.03"), (45, 30.0, "1.50")],
)
def test_shown_seconds_round_halves_upwards(frames: int, rate_hz: float, shown: str) -> None:
    assert shown_seconds(frames, rate_hz) == shown


def test_a_frame_is_the_nearest_to_its_own_seconds() -> None:
    frames = np.arange(10_000)
    for rate_hz in (30.0, 29.97, 119.88):
        assert [nearest_frame(one, rate_hz) for one in in_seconds(frames, rate_hz)] == frames.tolist()
    assert nearest_frame(0.05, 30.0) == 2  # halfway between 1 and 2
