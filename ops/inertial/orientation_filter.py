"""This module estimates sensor orientations from raw readings by the filter VQF (Laidig and Seel 2023), an extra."""

from __future__ import annotations

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial.field_offset import field_offset
from kinedex.ops.inertial.packages import imu_package
from kinedex.ops.inertial.rotations import exp, multiply, rotate

TO_NORTH_WEST_UP = exp(np.array([0.0, 0.0, -0.5 * np.pi]))
"""The rotation from east-north-up to the inertial world F_GI: X magnetic north, Y west, Z up."""

SETTINGS = {"magNewMinGyr": 0.0}
"""Settings of VQF. By default it learns the field's strength only while the sensor rotates by 20°/s or more. For a
shank that hardly moves the magnetometer is then ignored, and the heading drifts with the gyroscope.
"""


def estimate(rate_hz: float, acc: F64, gyr: F64, mag: F64 | None = None) -> F64:
    """Estimate the orientations of a sensor from its readings by a filter that runs forwards and backwards in time.

    Parameters
    ----------
    rate_hz : float
        Samples per second.
    acc : float64 array (T, 3)
        Specific force in m/s², in the sensor's axes.
    gyr : float64 array (T, 3)
        Angular velocity in rad/s.
    mag : float64 array (T, 3) or None
        Magnetic field in any unit; None: the heading is arbitrary, and drifts.

    Returns
    -------
    float64 array (T, 4)
        Sensor → F_GI (X magnetic north, Y west, Z up).

    Raises
    ------
    ParameterError
        The rate is not positive, shapes do not agree, or a reading is not finite.
    MissingPackageError
        The package vqf is not installed.
    """
    if not rate_hz > 0.0:
        raise ParameterError("rate_hz", "positive", rate_hz)
    for name, values in (("acc", acc), ("gyr", gyr), ("mag", mag)):
        if values is not None and values.shape != (len(acc), 3):
            raise ParameterError(name, f"of shape ({len(acc)}, 3)", values.shape)
        if values is not None and not np.isfinite(values).all():
            raise ParameterError(name, "finite: estimate the parts between gaps apart", "NaN or infinity")
    if not len(acc):
        return np.empty((0, 4))
    vqf = imu_package("vqf", "estimated orientations of sensors need")
    rows = [None if values is None else np.ascontiguousarray(values, np.float64) for values in (gyr, acc, mag)]
    found = vqf.offlineVQF(*rows, 1.0 / rate_hz, SETTINGS)
    return multiply(TO_NORTH_WEST_UP, np.asarray(found["quat6D" if mag is None else "quat9D"], np.float64))


def estimate_calibrated(rate_hz: float, acc: F64, gyr: F64, mag: F64) -> tuple[F64, F64]:
    """Estimate the orientations of a sensor after removing a constant offset of its magnetometer.

    Parameters
    ----------
    rate_hz : float
        Samples per second.
    acc, gyr, mag : float64 array (T, 3)
        The readings, as for `estimate`.

    Returns
    -------
    tuple[float64 array (T, 4), float64 array (3,)]
        Sensor → F_GI, and the offset of the magnetometer in its own axes and unit.
    """
    offset = field_offset(rate_hz, estimate(rate_hz, acc, gyr), mag)
    return estimate(rate_hz, acc, gyr, mag - offset), offset


def field_axis(quaternions: F64, mag: F64) -> str:
    """Return the axes of the world of a file's orientations, judged by the mean direction of the magnetic field.

    Parameters
    ----------
    quaternions : float64 array (T, 4)
        Orientations of a file, sensor → its world; NaN where unknown.
    mag : float64 array (T, 3)
        The field in the sensor's axes.

    Returns
    -------
    str
        "north-west-up" where the field lies along X (F_GI), "east-north-up" where it lies along Y, else "unknown".
    """
    known = np.isfinite(quaternions).all(axis=1) & np.isfinite(mag).all(axis=1)
    if not known.any():
        return "unknown"
    x, y, _ = rotate(quaternions[known], mag[known]).mean(axis=0)
    level = np.hypot(x, y)
    if x > 0.9 * level > 0.0:
        return "north-west-up"
    return "east-north-up" if y > 0.9 * level > 0.0 else "unknown"
