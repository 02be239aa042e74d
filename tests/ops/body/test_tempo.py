"""Tempo: how fast hands and feet turn round, and the rate that it suggests."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.body.tempo import USUAL_HZ, likely_rate, tempo


def swinging(hz: float, rate_hz: float, seconds: float = 4.0, metres: float = 0.3) -> np.ndarray:
    """Two points that circle at a frequency."""
    angle = 2 * np.pi * hz * np.arange(0, seconds, 1 / rate_hz)
    track = metres * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    return np.stack([track, track + 1.0])


@pytest.mark.parametrize("rate_hz", [30.0, 60.0, 120.0])
@pytest.mark.parametrize("hz", [0.5, 1.0, 2.0])
def test_a_circle_has_its_frequency_and_its_acceleration(hz: float, rate_hz: float) -> None:
    found = tempo(swinging(hz, rate_hz), rate_hz)
    assert found is not None
    assert found.hz == pytest.approx(hz, rel=0.02)
    assert found.acceleration == pytest.approx(0.3 * (2 * np.pi * hz) ** 2, rel=0.02)


@pytest.mark.parametrize("rate_hz", USUAL_HZ)
def test_the_likely_rate_is_that_at_which_points_swing_once_a_second(rate_hz: float) -> None:
    assert likely_rate(swinging(1.0, rate_hz)) == pytest.approx(rate_hz, rel=0.25)
    assert likely_rate(1000 * swinging(1.0, rate_hz)) == likely_rate(swinging(1.0, rate_hz))


def test_what_does_not_move_or_is_too_short_shows_no_rate() -> None:
    for tracks in (
        np.zeros((2, 3, 50)),
        swinging(1.0, 30.0)[:, :, :2],
        np.full((2, 3, 50), np.nan),
        np.zeros((0, 3, 9)),
    ):
        assert tempo(tracks, 30.0) is None
        assert likely_rate(tracks) is None


def test_frames_in_which_a_point_is_not_seen_do_not_count() -> None:
    tracks = swinging(1.0, 60.0)
    tracks[0, :, 10:20] = np.nan
    found = tempo(tracks, 60.0)
    assert found is not None
    assert found.hz == pytest.approx(1.0, rel=0.02)
