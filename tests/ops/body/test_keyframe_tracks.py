"""Tracks and curves between their keys, and the rate that keys were made at."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.body.keyframe_tracks import (
    CONSTANT,
    CUBIC,
    LINEAR,
    NEXT_VALUE,
    OWN_SLOPES,
    Curve,
    likely_rate,
    sample_track,
)
from kinedex.ops.errors import ParameterError

TIMES = np.array([0.5, 1.0, 2.0, 2.5])


def cubic(t: np.ndarray) -> np.ndarray:
    """A cubic, which splines through it must follow."""
    return 2 * t**3 - 5 * t**2 + t - 3


def slope(t: np.ndarray) -> np.ndarray:
    return 6 * t**2 - 10 * t + 1


def test_values_stay_before_the_first_key_and_after_the_last_one() -> None:
    values = np.array([[1.0], [2.0], [4.0], [3.0]])
    at = np.array([-1.0, 0.5, 0.75, 1.999, 2.25, 2.5, 9.0])
    straight = np.interp(at, TIMES, values[:, 0])
    np.testing.assert_allclose(sample_track(TIMES, values, at, "LINEAR", False)[:, 0], straight)
    np.testing.assert_array_equal(sample_track(TIMES, values, at, "STEP", False)[:, 0], [1, 1, 1, 2, 4, 3, 3])
    np.testing.assert_array_equal(sample_track(TIMES, values, at, "STEP", False, 0.01)[:, 0], [1, 1, 1, 4, 4, 3, 3])
    np.testing.assert_array_equal(sample_track(TIMES[:1], values[:1], at, "LINEAR", False)[:, 0], 1.0)


def test_splines_follow_a_cubic_through_their_keys() -> None:
    keys = np.stack([slope(TIMES), cubic(TIMES), slope(TIMES)], axis=1).reshape(-1, 1)
    at = np.linspace(0.5, 2.5, 33)
    np.testing.assert_allclose(sample_track(TIMES, keys, at, "CUBICSPLINE", False)[:, 0], cubic(at), atol=1e-12)
    slopes = np.stack([slope(TIMES), np.roll(slope(TIMES), -1), 0 * TIMES, 0 * TIMES], axis=1)
    curve = Curve(TIMES, cubic(TIMES), np.full(4, CUBIC | OWN_SLOPES), slopes)
    np.testing.assert_allclose(curve.at(at), cubic(at), atol=1e-12)


def test_turns_are_unit_quaternions() -> None:
    values = np.array([[0.0, 0, 0, 2], [0, 1, 0, 1], [0, 0, 0, 0], [0, 0, 0, -1]])
    found = sample_track(TIMES[:2], values[:2], np.array([0.75]), "LINEAR", True)
    np.testing.assert_allclose(found, [[0, np.sin(np.pi / 8), 0, np.cos(np.pi / 8)]], atol=1e-12)
    assert np.isfinite(sample_track(TIMES, values, TIMES, "LINEAR", True)).all()


def test_values_and_keys_must_be_as_many() -> None:
    with pytest.raises(ParameterError, match="3 for each of at least one key"):
        sample_track(TIMES, np.zeros((4, 1)), TIMES, "CUBICSPLINE", False)
    with pytest.raises(ParameterError, match="at least one key"):
        sample_track(TIMES[:0], np.zeros((0, 1)), TIMES, "LINEAR", False)


def test_curves_step_as_their_flags_have_it() -> None:
    values = np.array([1.0, 2.0, 4.0, 3.0])
    at = np.array([0.0, 0.6, 1.0, 1.9, 2.2, 3.0])
    flags = np.array([CONSTANT, CONSTANT | NEXT_VALUE, LINEAR, LINEAR])
    found = Curve(TIMES, values, flags, np.zeros((4, 4))).at(at)
    np.testing.assert_allclose(found, [1, 1, 4, 4, 3.6, 3])
    np.testing.assert_allclose(Curve(TIMES, values).at(at), np.interp(at, TIMES, values))


def test_curves_without_slopes_are_smooth_and_do_not_overshoot() -> None:
    values = np.array([0.0, 1.0, 1.0, 0.0])
    found = Curve(TIMES, values, np.full(4, CUBIC), np.zeros((4, 4))).at(np.linspace(0, 3, 301))
    assert found.max() <= 1.0 + 1e-12
    assert found.min() >= 0.0
    assert np.abs(np.diff(found, 2)).max() < 0.01


@pytest.mark.parametrize("rate_hz", [24.0, 25.0, 30.0, 50.0, 60.0, 90.0, 100.0, 120.0, 240.0])
def test_the_rate_of_keys_is_found(rate_hz: float) -> None:
    random = np.random.default_rng(int(rate_hz))
    frames = np.arange(int(20 * rate_hz))
    for times in (frames / rate_hz, (frames / rate_hz).astype(np.float32), 3.7 + np.round(frames / rate_hz, 4)):
        assert likely_rate(times.astype(float)) == (rate_hz, True)
    some = np.sort(random.choice(frames, 200, replace=False)) / rate_hz  # keys that were thinned out
    assert likely_rate(some) == (rate_hz, True)


def test_keys_on_no_usual_frames_have_the_rate_of_their_steps() -> None:
    rate_hz, usual = likely_rate(np.arange(500) / 31.7)
    assert rate_hz == pytest.approx(31.7)
    assert not usual
    assert likely_rate(np.array([2.0])) == (30.0, True)
