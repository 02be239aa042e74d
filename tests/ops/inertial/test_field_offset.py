"""The offset of a magnetometer is found from the sensor's turns, and believed as far as the readings support it."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial.orientation_filter import field_offset
from kinedex.ops.inertial.rotations import conjugate, exp, multiply, rotate

FIELD = np.array([20.5, 0.0, -43.7])
TIMES = np.arange(3000) / 100.0
SINES = np.sin(TIMES[:, None] * np.array([1.3, 2.1, 0.7]) + np.array([0.0, 1.0, 2.0]))
TURNING = exp(SINES * np.array([1.2, 0.9, 1.5]))
OFFSET = np.array([9.0, -14.0, 4.0])


def readings(orientation: np.ndarray, offset: np.ndarray, noise: float = 0.35) -> np.ndarray:
    """Return what a magnetometer with an offset and white noise reads."""
    random = np.random.default_rng(7).normal(size=(len(orientation), 3))
    return rotate(conjugate(orientation), FIELD) + offset + noise * random


def test_a_large_offset_is_found() -> None:
    found = field_offset(100.0, TURNING, readings(TURNING, OFFSET))
    np.testing.assert_allclose(found, OFFSET, atol=0.3)
    assert np.linalg.norm(field_offset(100.0, TURNING, readings(TURNING, np.zeros(3)))) < 0.05


def test_neither_the_heading_nor_the_unit_matters() -> None:
    mag = readings(TURNING, 0.02 * OFFSET)
    found = field_offset(100.0, TURNING, mag)
    turned = multiply(exp(np.array([0.0, 0.0, 2.0])), TURNING)
    np.testing.assert_allclose(field_offset(100.0, turned, mag), found, atol=1e-9)
    np.testing.assert_allclose(field_offset(100.0, TURNING, mag / 48.0), found / 48.0, atol=1e-9)


def test_passing_magnets_do_not_decide() -> None:
    mag = readings(TURNING, 0.02 * OFFSET)
    mag[500:800] += np.array([30.0, 10.0, -20.0])
    np.testing.assert_allclose(field_offset(100.0, TURNING, mag), 0.02 * OFFSET, atol=0.1)


def test_a_field_that_follows_the_sensor_slowly_is_no_offset() -> None:
    """Residuals that stay alike for seconds are few independent ones, so that a small offset is not believed."""
    slow = np.cumsum(np.random.default_rng(1).normal(size=(3000, 3)), axis=0)
    bent = readings(TURNING, np.zeros(3)) + 2.0 * (slow - slow.mean(axis=0)) / slow.std()
    assert np.linalg.norm(field_offset(100.0, TURNING, bent)) < 0.5


def test_a_sensor_at_rest_has_no_offset() -> None:
    still = np.tile(exp(np.array([0.3, -0.4, 0.9])), (3000, 1))
    np.testing.assert_allclose(field_offset(100.0, still, readings(still, OFFSET)), 0.0, atol=1e-9)
    assert not field_offset(100.0, still[:5], readings(still[:5], OFFSET)).any()
    assert not field_offset(100.0, still, np.zeros((3000, 3))).any()


def test_bad_input_is_refused() -> None:
    with pytest.raises(ParameterError, match="rate_hz must be positive"):
        field_offset(0.0, TURNING, SINES)
    with pytest.raises(ParameterError, match="orientation and mag must be of shapes"):
        field_offset(100.0, TURNING[:5], SINES)
