"""This module estimates sensor orientations from raw readings by the optional filter VQF (Laidig and Seel 2023).

It also estimates the offset of a magnetometer. A magnetised case adds a vector b to the field in the sensor's axes. If
b has a hundredth of the strength of the field, headings are wrong by up to about a degree, depending on the pose. The
readings m satisfy R m = m₀ + R b, where m₀ is the field in the world and R the sensor's rotation, which is computed
without the magnetometer. The equation is linear in m₀ and b. Since rooms distort the field as well, b is a maximum a
posteriori estimate with a normal prior. Errors are correlated over time, which reduces their weight.
"""

from __future__ import annotations

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial.rotations import exp, multiply, rotate
from kinedex.ops.packages import imu_package

BLOCK_S = 0.1
"""Duration in seconds over which readings are averaged."""

PRIOR = 0.01
"""Standard deviation of the offset of a calibrated magnetometer on each axis, as a fraction of the field."""

LIKELY = 4.0
"""Length of an offset, in standard deviations of the prior, from which the magnetometer counts as uncalibrated.
"""

MIN_CORRELATED_S = 1.0
"""Minimum time in seconds over which residuals are taken to be correlated."""

ROUNDS = 6
OUTLIER = 2.0
"""Size in standard deviations at which a residual has a quarter of the full weight."""

_MEDIAN_SQUARE = 2.366
"""The median of the sum of squares of three standard normal variables."""


TO_NORTH_WEST_UP = exp(np.array([0.0, 0.0, -0.5 * np.pi]))
"""The rotation from east-north-up to the inertial world F_GI: X magnetic north, Y west, Z up."""

SETTINGS = {"magNewMinGyr": 0.0}
"""Settings of VQF. By default it learns the field's strength only while the sensor rotates by 20°/s or more. For a
shank that hardly moves the magnetometer is then ignored, and the heading drifts with the gyroscope.
"""


def field_offset(rate_hz: float, orientation: F64, mag: F64) -> F64:
    """Estimate the hard-iron offset of a magnetometer in its own axes.

    Parameters
    ----------
    rate_hz : float
        Samples per second.
    orientation : float64 array (T, 4)
        Orientations of the sensor without its magnetometer, sensor → a world whose heading is arbitrary.
    mag : float64 array (T, 3)
        The readings, in any unit.

    Returns
    -------
    float64 array (3,)
        The offset in the unit of the readings; subtracting it from the readings calibrates them. It is 0 if the sensor
        does not rotate or has no readings of the field.

    Raises
    ------
    ParameterError
        The rate is not positive, or shapes do not agree.
    """
    if not rate_hz > 0.0:
        raise ParameterError("rate_hz", "positive", rate_hz)
    if orientation.shape != (len(mag), 4) or mag.shape != (len(mag), 3):
        raise ParameterError("orientation and mag", "of shapes (T, 4) and (T, 3)", (orientation.shape, mag.shape))
    offset = np.zeros(3)
    each = max(1, round(BLOCK_S * rate_hz))
    if len(mag) < 2 * each:
        return offset
    fields, rotations = _blocks(orientation, mag, each)
    step_s = each / rate_hz
    prior = (PRIOR * float(np.median(np.linalg.norm(fields, axis=1)))) ** 2
    if not prior > 0.0:
        return offset
    offset, residuals = _fit(fields, rotations, np.ones(len(fields)), 1e-6 * len(fields))
    correlated_s = MIN_CORRELATED_S
    for _ in range(ROUNDS):
        squares = np.einsum("ka,ka->k", residuals, residuals)
        variance = max(float(np.median(squares)) / _MEDIAN_SQUARE, 1e-12 * prior)
        weights = (1.0 + squares / (3.0 * OUTLIER**2 * variance)) ** -2
        correlated_s = max(correlated_s, step_s * _correlated(np.sqrt(weights)[:, None] * residuals))
        widened = max(prior, float(offset @ offset) / LIKELY**2)
        offset, residuals = _fit(fields, rotations, weights, variance * correlated_s / (step_s * widened))
    return offset


def _blocks(orientation: F64, mag: F64, each: int) -> tuple[F64, F64]:
    """Return means over blocks of samples: of the readings in the world (K, 3), and of the rotations (K, 3, 3)."""
    count = len(mag) // each
    rows = [rotate(orientation, mag)] + [rotate(orientation, axis) for axis in np.eye(3)]
    fields, *columns = (values[: count * each].reshape(count, each, 3).mean(axis=1) for values in rows)
    return fields, np.stack(columns, axis=2)


def _correlated(residuals: F64) -> float:
    """Return the correlation length of residuals (K, 3) in samples, summed up to the first zero of the correlation."""
    count = len(residuals)
    spectrum = np.fft.rfft(residuals, 2 * count, axis=0)
    products = np.fft.irfft((spectrum * spectrum.conj()).real.sum(axis=1), 2 * count)[:count]
    if not products[0] > 0.0:
        return 1.0
    gone = np.flatnonzero(products <= 0.0)
    stop = int(gone[0]) if len(gone) else count
    return 1.0 + 2.0 * float(products[1:stop].sum()) / float(products[0])


def _fit(fields: F64, rotations: F64, weights: F64, stiffness: float) -> tuple[F64, F64]:
    """Fit field and offset by weighted least squares, and return the offset and the residuals."""
    total = weights.sum()
    mean_field, mean_turn = np.tensordot(weights, fields, 1) / total, np.tensordot(weights, rotations, 1) / total
    y, x = fields - mean_field, rotations - mean_turn
    normal = np.einsum("k,kai,kaj->ij", weights, x, x) + stiffness * np.eye(3)
    offset = np.linalg.solve(normal, np.einsum("k,kai,ka->i", weights, x, y))
    return offset, y - x @ offset


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
        Magnetic field in any unit. If it is None, the heading is arbitrary, and drifts.

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
        "north-west-up" if the horizontal field lies along X (as in F_GI), "east-north-up" if it lies along Y, otherwise
        "unknown".
    """
    known = np.isfinite(quaternions).all(axis=1) & np.isfinite(mag).all(axis=1)
    if not known.any():
        return "unknown"
    x, y, _ = rotate(quaternions[known], mag[known]).mean(axis=0)
    level = np.hypot(x, y)
    if x > 0.9 * level > 0.0:
        return "north-west-up"
    return "east-north-up" if y > 0.9 * level > 0.0 else "unknown"
