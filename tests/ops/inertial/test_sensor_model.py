"""Readings of ideal sensors: the worked examples of the appendix, and the way back by a filter."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial.orientation_filter import estimate
from kinedex.ops.inertial.rotations import conjugate, distance_deg, exp, log, multiply, rotate
from kinedex.ops.inertial.sensor_model import (
    GRAVITY,
    centred_acceleration,
    field_in_sensor,
    gyroscope_rates,
    magnetic_field,
    sensor_motion,
    specific_force,
    world_rotation,
)

pytest.importorskip("scipy")
RATE = 100.0


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values).sum(axis=-1))))


def circle(seconds: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, places and accelerations of a circle of radius 0.5 m, once a second."""
    t = np.arange(0.0, seconds, 1 / RATE)
    place = 0.5 * np.stack([np.cos(2 * np.pi * t), np.sin(2 * np.pi * t), 0 * t], axis=1)
    return t, place, -((2 * np.pi) ** 2) * place


def turning(t: np.ndarray) -> np.ndarray:
    return exp(np.stack([1.2 * np.sin(1.3 * t), 0.9 * np.sin(2.1 * t + 1), 1.5 * np.sin(0.7 * t + 2)], axis=1))


def test_centred_differences_are_not_late_as_the_printed_ones() -> None:
    _, place, truth = circle(4.0)
    assert rms(centred_acceleration(place, RATE)[1:-1] - truth[1:-1]) == pytest.approx(0.0065, abs=0.0002)
    printed = (place[2:] - 2 * place[1:-1] + place[:-2]) * RATE**2  # A.22 gives it to the last of the three samples
    assert rms(printed - truth[2:]) == pytest.approx(1.24, abs=0.01)


def test_a_local_turn_about_z_is_read_about_z() -> None:
    start = np.array([0.5, 0.5, 0.5, 0.5])
    q = multiply(start, exp(np.outer(np.arange(50) / RATE, [0.0, 0.0, 1.0])))
    np.testing.assert_allclose(gyroscope_rates(q, RATE)[1:], np.tile([0.0, 0.0, 1.0], (49, 1)), atol=1e-12)
    printed = 2 * RATE * multiply(q[1:], conjugate(q[:-1]))[:, 1:]  # Algorithm 5: in global axes
    np.testing.assert_allclose(printed, np.tile([1.0, 0.0, 0.0], (49, 1)), atol=1e-4)


def test_integrated_rates_give_the_orientations_back() -> None:
    q = turning(np.arange(0, 20, 1 / RATE))
    rates = gyroscope_rates(q, RATE)
    back = [q[0]]
    for rate in rates[1:]:
        back.append(multiply(back[-1], exp(rate / RATE)))
    assert distance_deg(np.array(back), q).max() < 1e-10
    assert (rates[0] == 0).all()


def test_the_field_of_saarbruecken_points_down() -> None:
    np.testing.assert_allclose(magnetic_field(declination_deg=1.133), [20.479, -0.405, -43.692], atol=5e-4)
    assert np.linalg.norm(magnetic_field()) == pytest.approx(48.255)


def test_a_sensor_at_rest_reads_gravity() -> None:
    q = np.tile(exp(np.array([0.0, np.pi / 2, 0.0])), (5, 1))
    np.testing.assert_allclose(specific_force(q, np.zeros((5, 3))), np.tile([-9.81, 0, 0], (5, 1)), atol=1e-12)
    assert GRAVITY[2] == 9.81


def test_the_filter_finds_the_orientations_that_the_readings_came_from() -> None:
    pytest.importorskip("vqf")
    t, _, acceleration = circle(60.0)
    q = turning(t)
    readings = specific_force(q, acceleration), gyroscope_rates(q, RATE), field_in_sensor(q, magnetic_field())
    off = distance_deg(estimate(RATE, *readings), q)[200:-200]
    assert np.sqrt(np.mean(off**2)) == pytest.approx(1.92, abs=0.005)


def limb(rate_hz: float = 120.0, seconds: float = 6.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t = np.arange(0, seconds, 1 / rate_hz)
    return t, 0.4 * np.stack([np.sin(3 * t), np.cos(2 * t), np.sin(t)], axis=1), turning(t)


def test_a_sensor_on_a_limb_moves_with_it() -> None:
    t, place, q = limb()
    at = np.arange(0.0, t[-1], 1 / RATE)
    mount, world, lever = exp(np.array([0.2, -0.4, 0.9])), world_rotation(30.0), np.array([0.03, 0.0, 0.02])
    found = sensor_motion(t, place, q, at, world, mount, lever)
    truth = multiply(conjugate(world), multiply(turning(at), mount))
    inner = slice(50, -50)
    assert distance_deg(found.orientation, truth)[inner].max() < 0.05
    fine = np.arange(0, t[-1], 1e-3)
    moved = 0.4 * np.stack([np.sin(3 * fine), np.cos(2 * fine), np.sin(fine)], axis=1) + rotate(turning(fine), lever)
    exact = rotate(conjugate(world), centred_acceleration(moved, 1000.0)[::10][: len(at)])
    assert rms((found.acceleration - exact)[inner]) < 0.02
    assert found.rate_hz == pytest.approx(RATE)


def test_slow_takes_are_interpolated_without_smoothing() -> None:
    t, place, q = limb(30.0)
    at = np.arange(0.0, t[-1], 1 / RATE)
    found = sensor_motion(t, place, q, at, np.array([1.0, 0, 0, 0]), np.array([1.0, 0, 0, 0]))
    assert distance_deg(found.orientation, turning(at)).max() < 0.1


def test_heading_turns_the_horizon_and_leaves_the_vertical() -> None:
    for heading in (0.0, 90.0, -135.0):
        q = world_rotation(heading)
        np.testing.assert_allclose(rotate(q, np.array([0.0, 0, 1])), [0, 1, 0], atol=1e-12)
        assert np.degrees(np.linalg.norm(log(multiply(conjugate(world_rotation(0)), q)))) == pytest.approx(abs(heading))


def test_wrong_input_is_named() -> None:
    t, place, q = limb(seconds=1.0)
    one = np.array([1.0, 0, 0, 0])
    with pytest.raises(ParameterError, match="8 frames or more"):
        sensor_motion(t[:5], place[:5], q[:5], t[:3], one, one)
    with pytest.raises(ParameterError, match=r"times or more within 0 to 0\.99"):
        sensor_motion(t, place, q, np.array([0.0, 2.0]), one, one)
    with pytest.raises(ParameterError, match="finite"):
        sensor_motion(t, place * np.nan, q, t[:3], one, one)
