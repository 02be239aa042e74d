"""This module simulates an ideal inertial sensor on a limb: rates, specific force and field (thesis, Appendix A).

The inertial world F_GI has X to magnetic north, Y to the west and Z up; the world of a take has Y up. Rates are those
of the sensor's own axes. Algorithm 5 of the thesis, Im(q_k ∘ q̄_{k−1}), gives rates in global axes; Eq. A.22 is one
sample late. Both are corrected here.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial.lowpass import lowpass
from kinedex.ops.inertial.rotations import Z_TO_Y, conjugate, continuous, exp, log, multiply, rotate
from kinedex.ops.packages import imu_package

GRAVITY = np.array([0.0, 0.0, 9.81])
"""The reading of an accelerometer at rest in F_GI, in m/s²."""

FIELD_UT, INCLINATION_DEG = 48.255, 64.883
"""The magnetic field in Saarbrücken (thesis, A.1): strength in µT, and inclination in degrees below the horizon."""

CUTOFF_HZ = 15.0
"""Frequency in Hz at which positions and rotations of takes are smoothed before they are differentiated."""

LEAST_SAMPLES = 8
"""The smallest number of samples for a quintic spline and a filter."""


@dataclass(frozen=True, eq=False)
class SensorMotion:
    """The true motion of a sensor in F_GI at evenly spaced times.

    Attributes
    ----------
    rate_hz : float
        Samples per second.
    orientation : float64 array (N, 4)
        Unit quaternions w x y z, sensor → F_GI.
    acceleration : float64 array (N, 3)
        Second derivative of the sensor's position, in m/s², in F_GI.
    """

    rate_hz: float
    orientation: F64
    acceleration: F64


def world_turn(heading_deg: float) -> F64:
    """Return q_G, the rotation (4,) from F_GI to a take's world with Y up, for a heading about the vertical."""
    return multiply(Z_TO_Y, exp(np.array([0.0, 0.0, np.radians(heading_deg)])))


def magnetic_field(
    strength_ut: float = FIELD_UT, inclination_deg: float = INCLINATION_DEG, declination_deg: float = 0.0
) -> F64:
    """Return the magnetic field in F_GI (thesis, Eq. A.4 to A.7).

    Parameters
    ----------
    strength_ut : float, optional
        Its strength in µT.
    inclination_deg : float, optional
        Degrees by which it points below the horizon.
    declination_deg : float, optional
        Degrees between X and magnetic north; 0 where X is magnetic north.

    Returns
    -------
    float64 array (3,)
        In µT.
    """
    phi, theta = np.radians(inclination_deg), np.radians(declination_deg)
    return strength_ut * np.array([np.cos(phi) * np.cos(theta), -np.cos(phi) * np.sin(theta), -np.sin(phi)])


def sensor_motion(
    times: F64,
    position: F64,
    orientation: F64,
    at: F64,
    q_global: F64,
    q_mount: F64,
    lever: F64 | None = None,
    cutoff_hz: float = CUTOFF_HZ,
) -> SensorMotion:
    """Return the motion of a sensor that is mounted on a limb.

    Positions are smoothed and interpolated by a quintic spline, orientations by a spline of rotations.

    Parameters
    ----------
    times : float64 array (T,)
        Seconds of the limb's frames, evenly spaced.
    position : float64 array (T, 3)
        A point of the limb in metres, in the take's world.
    orientation : float64 array (T, 4)
        Unit quaternions of the limb, segment → the take's world.
    at : float64 array (N,)
        Evenly spaced times within these, at which the sensor samples.
    q_global : float64 array (4,)
        F_GI → the take's world.
    q_mount : float64 array (4,)
        Sensor → segment.
    lever : float64 array (3,), optional
        From the point to the sensor, in metres and in the segment's axes.
    cutoff_hz : float, optional
        Frequency in Hz at which positions and orientations are smoothed; no smoothing if the rate is not above twice
        the frequency.

    Raises
    ------
    ParameterError
        There are fewer than 8 frames, a frame is not known, or a time lies outside.
    MissingPackageError
        The package scipy is not installed.
    """
    if len(times) < LEAST_SAMPLES or position.shape != (len(times), 3) or orientation.shape != (len(times), 4):
        raise ParameterError(
            "times, position, orientation", f"of {LEAST_SAMPLES} frames or more, (T,), (T, 3) and (T, 4)",
            (times.shape, position.shape, orientation.shape),
        )  # fmt: skip
    if not (np.isfinite(position).all() and np.isfinite(orientation).all()):
        raise ParameterError("position and orientation", "finite in all frames", "NaN or infinity")
    if len(at) < 2 or at[0] < times[0] - 1e-9 or at[-1] > times[-1] + 1e-9:
        raise ParameterError("at", f"two times or more within {times[0]:g} to {times[-1]:g} s", f"{len(at)} times")
    rate_hz = (len(times) - 1) / (times[-1] - times[0])
    place = position if lever is None else position + rotate(orientation, lever)
    place, turned = smooth(place, rate_hz, cutoff_hz), smooth(continuous(orientation), rate_hz, cutoff_hz)
    turned = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    inside = np.clip(at, times[0], times[-1])
    spline = _scipy("interpolate").make_interp_spline(times, place, k=5)
    acceleration = np.asarray(spline.derivative(2)(inside), np.float64)
    back = conjugate(q_global)
    whole = multiply(back, multiply(_interpolated_turns(times, turned, inside), q_mount))
    return SensorMotion((len(at) - 1) / (at[-1] - at[0]), continuous(whole), rotate(back, acceleration))


def _interpolated_turns(times: F64, turned: F64, at: F64) -> F64:
    """Return rotations (N, 4) w x y z, interpolated by a spline with continuous angular accelerations."""
    transform = _scipy("spatial.transform")
    spline = transform.RotationSpline(times, transform.Rotation.from_quat(turned[:, [1, 2, 3, 0]]))
    return np.asarray(spline(at).as_quat(), np.float64)[:, [3, 0, 1, 2]]


def smooth(values: F64, rate_hz: float, cutoff_hz: float) -> F64:
    """Return values (T, K), smoothed by a zero-phase Butterworth filter of order 2.

    Values are returned unchanged if the rate is not above twice the frequency, or if there are fewer than 8.
    """
    if cutoff_hz >= 0.5 * rate_hz or len(values) < LEAST_SAMPLES:
        return values
    padding = min(len(values) - 1, int(np.ceil(3 * rate_hz / cutoff_hz)))
    return lowpass(values, rate_hz, cutoff_hz, padding)


def turn_rates(orientation: F64, rate_hz: float) -> F64:
    """Return a gyroscope's readings: the rotation since the previous sample over the time step, in sensor axes.

    Integrating the rates reproduces the orientations; with central differences, a filter would be half a sample ahead.

    Parameters
    ----------
    orientation : float64 array (N, 4)
        Unit quaternions w x y z, sensor → world.
    rate_hz : float
        Samples per second.

    Returns
    -------
    float64 array (N, 3)
        Radians per second; 0 in the first sample.
    """
    rates = np.zeros((len(orientation), 3))
    rates[1:] = log(multiply(conjugate(orientation[:-1]), orientation[1:])) * rate_hz
    return rates


def specific_force(orientation: F64, acceleration: F64) -> F64:
    """Return an accelerometer's readings (N, 3) in m/s²: acceleration plus gravity's reaction, in sensor axes."""
    return rotate(conjugate(orientation), acceleration + GRAVITY)


def field_in_sensor(orientation: F64, field: F64) -> F64:
    """Return a field (3,) or (N, 3), given in F_GI, in the axes of a sensor, (N, 3)."""
    return rotate(conjugate(orientation), np.broadcast_to(field, (len(orientation), 3)))


def centred_acceleration(position: F64, rate_hz: float) -> F64:
    """Return central second differences (N, 3) of positions (N, 3); both ends repeat their neighbour."""
    found = np.empty_like(position)
    found[1:-1] = (position[2:] - 2.0 * position[1:-1] + position[:-2]) * rate_hz**2
    found[0], found[-1] = found[1], found[-2]
    return found


def _scipy(part: str) -> ModuleType:
    return imu_package(f"scipy.{part}", "simulated sensors need")
