"""Orientations of sensors by the filter: worlds, headings, and what is refused."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial import rotations as r
from kinedex.ops.inertial.orientation_filter import TO_NORTH_WEST_UP, estimate, field_axis
from kinedex.ops.inertial.sensor_model import sensor_motion
from kinedex.ops.packages import MissingPackageError

TRUE = r.exp(np.array([0.3, -0.4, 0.9]))
ACC = np.tile(r.rotate(r.conjugate(TRUE), np.array([0.0, 0.0, 9.81])), (400, 1))
MAG = np.tile(r.rotate(r.conjugate(TRUE), np.array([20.5, 0.0, -43.7])), (400, 1))
STILL = np.zeros((400, 3))


def test_a_sensor_at_rest_points_north_and_up() -> None:
    assert r.distance_deg(estimate(100.0, ACC, STILL, MAG), TRUE).max() < 0.01
    level = estimate(100.0, ACC, STILL)
    up = r.rotate(level, ACC) / 9.81
    np.testing.assert_allclose(up, np.tile([0.0, 0.0, 1.0], (400, 1)), atol=1e-3)
    assert estimate(100.0, ACC[:0], STILL[:0]).shape == (0, 4)


def test_the_field_tells_the_world_of_a_file() -> None:
    q = estimate(100.0, ACC, STILL, MAG)
    q[:3] = np.nan
    east = r.multiply(r.conjugate(TO_NORTH_WEST_UP), q)
    assert field_axis(q, MAG) == "north-west-up"
    assert field_axis(east, MAG) == "east-north-up"
    assert field_axis(r.multiply(r.exp(np.array([0.0, 0.0, 0.8])), q), MAG) == "unknown"
    assert field_axis(q * np.nan, MAG) == "unknown"


def test_bad_readings_are_refused() -> None:
    for rate, acc, gyr, message in (
        (0.0, ACC, STILL, "rate_hz must be positive"),
        (100.0, ACC, STILL[:3], r"gyr must be of shape \(400, 3\)"),
        (100.0, ACC * np.nan, STILL, "acc must be finite: estimate the parts between gaps apart"),
    ):
        with pytest.raises(ParameterError, match=message):
            estimate(rate, acc, gyr)


def test_a_missing_package_is_named_with_the_way_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "vqf", None)
    monkeypatch.setitem(sys.modules, "scipy.interpolate", None)
    moving = np.zeros((8, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (8, 1)), np.arange(2.0), TRUE, TRUE
    for work, name in (
        (lambda: estimate(100.0, ACC, STILL), "vqf"),
        (lambda: sensor_motion(np.arange(8.0), *moving), "scipy"),
    ):
        with pytest.raises(MissingPackageError, match=rf"the package {name}, .*pip install 'kinedex\[imu\]'"):
            work()
