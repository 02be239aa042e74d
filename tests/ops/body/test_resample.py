"""Change of frame rate: positions linearly, orientations by slerp."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.body.resample import feature_rate, resample
from kinedex.ops.errors import ParameterError
from tests.bodies import standing, turned, upright


@pytest.mark.parametrize(
    ("source", "rate"),
    [(120, 120), (100, 90), (24, 30), (30, 30), (60, 60), (59.94, 60), (240, 240), (45, 60), (1, 30)],
)
def test_features_are_computed_at_the_nearest_multiple_of_the_analysis_rate(source: float, rate: float) -> None:
    assert feature_rate(source, 30.0) == rate


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf")])
def test_a_rate_must_be_positive_and_finite(rate: float) -> None:
    with pytest.raises(ParameterError, match="source_rate_hz must be positive"):
        feature_rate(rate, 30.0)


@given(st.integers(2, 50), st.sampled_from([24.0, 25.0, 50.0, 100.0, 59.94]), st.sampled_from([30.0, 60.0, 90.0]))
def test_a_steady_motion_stays_steady(frames: int, source: float, rate: float) -> None:
    positions = standing(frames)
    seconds = np.arange(frames) / source
    positions[0, 2] = 1.5 * seconds
    moved, orientation, _ = resample(positions, turned(90.0 * seconds), source, rate)
    count = moved.shape[2]
    assert count == int(np.floor(round((frames - 1) * rate / source, 9))) + 1
    at = np.arange(count) / rate
    np.testing.assert_allclose(moved[0, 2], 1.5 * at, atol=1e-9)
    np.testing.assert_allclose(orientation, turned(90.0 * at), atol=1e-9)


def test_opposite_signs_of_one_rotation_are_no_turn() -> None:
    orientation = upright(4)
    orientation[:, 1::2] *= -1
    moved = resample(standing(4), orientation, 100.0, 90.0).orientation
    np.testing.assert_allclose(np.abs(moved[0]), 1.0)


def test_the_same_rate_changes_nothing() -> None:
    positions = standing(5)
    assert resample(positions, upright(5), 120.0, 120.0).positions is positions


def test_a_frame_between_a_valid_and_an_invalid_one_is_invalid() -> None:
    positions = standing(5)
    positions[:, :, 2] = np.nan
    valid = np.array([True, True, False, True, True])
    sampled = resample(positions, upright(5), 30.0, 45.0, valid)  # at 0, 2/3, 4/3, 2, 8/3, 10/3, 4
    assert sampled.valid is not None
    assert sampled.valid.tolist() == [True, True, False, False, False, True, True]
    assert np.isfinite(sampled.positions).all(axis=(0, 1)).tolist() == sampled.valid.tolist()


def test_a_frame_that_is_hit_asks_nothing_of_its_neighbours() -> None:
    positions = standing(5)
    positions[:, :, [1, 3]] = np.nan
    valid = np.array([True, False, True, False, True])
    sampled = resample(positions, upright(5), 60.0, 30.0, valid)
    assert sampled.valid is not None
    assert sampled.valid.all()
    assert np.isfinite(sampled.positions).all()
