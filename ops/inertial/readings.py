"""This module compares a sensor's readings with each other, finds rest, and interpolates missing samples."""

from __future__ import annotations

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.inertial.rotations import conjugate, interpolate, log, multiply

_SMOOTH_S = 0.1
_REST_RAD_S = 0.1
_REST_SPREAD = 0.02


def typical_length(vectors: F64) -> float:
    """Return the median length of vectors (T, 3), ignoring NaN; NaN if all are NaN."""
    lengths = np.linalg.norm(vectors, axis=1)
    known = np.isfinite(lengths)
    return float(np.median(lengths[known])) if known.any() else float("nan")


def compare_with_orientation(times: F64, gyr: F64, quaternions: F64) -> tuple[float, float, float]:
    """Compare measured angular velocities with angular velocities computed from the orientations.

    Parameters
    ----------
    times : float64 array (T,)
        Times of the samples in seconds, ascending.
    gyr : float64 array (T, 3)
        Angular velocity in the sensor's axes.
    quaternions : float64 array (T, 4)
        Orientations, sensor → world; NaN where unknown.

    Returns
    -------
    tuple[float, float, float]
        The correlation of both; the ratio of the first to the second, 1 for radians per second; and the root mean
        square of the second in radians per second. NaN where fewer than 10 samples are known.
    """
    return _compared(_between(gyr), _rates(times, quaternions))


def compare_with_gravity(times: F64, acc: F64, gyr: F64) -> tuple[float, float, float]:
    """Compare the rotation of gravity in the sensor's axes with the one predicted from angular velocities.

    Parameters
    ----------
    times : float64 array (T,)
        Times of the samples in seconds, ascending.
    acc, gyr : float64 array (T, 3)
        Specific force in any unit, and angular velocity.

    Returns
    -------
    tuple[float, float, float]
        The correlation of both; the ratio, which is about 1 for radians per second and 57 for degrees; and the root
        mean square of gravity's rotation in radians per second. NaN where fewer than 10 samples are known.
    """
    width = max(1, round(_SMOOTH_S / max(float(np.median(np.diff(times))), 1e-6))) if len(times) > 1 else 1
    if len(times) < 2 * width + 10:
        return float("nan"), float("nan"), float("nan")
    kernel = np.full(width, 1.0 / width)
    rows = np.concatenate([acc, gyr], axis=1)
    smooth = np.stack([np.convolve(row, kernel, "valid") for row in rows.T], axis=1)
    at = np.convolve(times, kernel, "valid")
    size = typical_length(smooth[:, :3])
    gravity = smooth[:, :3] / size if size > 0 else smooth[:, :3]
    steps = np.diff(at)[:, None]
    turning = np.diff(gravity, axis=0) / steps
    middle = 0.5 * (gravity[1:] + gravity[:-1])
    return _compared(-np.cross(_between(smooth[:, 3:]), middle), turning)


def _between(gyr: F64) -> F64:
    """Return the angular velocities (T − 1, 3) at the midpoints between samples (T, 3)."""
    return 0.5 * (gyr[1:] + gyr[:-1])


def _rates(times: F64, quaternions: F64) -> F64:
    rotations = log(multiply(conjugate(quaternions[:-1]), quaternions[1:]))
    rates: F64 = rotations / np.diff(times)[:, None]
    return rates


def _compared(first: F64, second: F64) -> tuple[float, float, float]:
    known = np.isfinite(first).all(axis=1) & np.isfinite(second).all(axis=1)
    if known.sum() < 10:
        return float("nan"), float("nan"), float("nan")
    x, y = first[known], second[known]
    # a few samples of a disturbed stream can outweigh all others together
    lengths = np.linalg.norm(y, axis=1)
    most = float(np.quantile(lengths, 0.99))
    y = y * np.divide(most, lengths, out=np.ones_like(lengths), where=lengths > most)[:, None]
    xx, yy, xy = float((x * x).sum()), float((y * y).sum()), float((x * y).sum())
    correlation = xy / np.sqrt(xx * yy) if xx > 0 and yy > 0 else float("nan")
    ratio = float(np.sqrt(xx / yy)) if yy > 0 else float("nan")
    return float(correlation), ratio, float(np.sqrt(yy / len(y)))


def rests(
    times: F64, rate_hz: float, acc: F64 | None, gyr: F64 | None, shortest_s: float = 1.0
) -> list[tuple[float, float]]:
    """Return the intervals in which a sensor is at rest.

    At rest, the angular velocity is below 0.1 rad/s, and the specific force differs by less than 2 % of gravity from
    its mean over half a second around the sample.

    Parameters
    ----------
    times : float64 array (T,)
        Times of the samples in seconds.
    rate_hz : float
        Samples per second.
    acc, gyr : float64 array (T, 3) or None
        Specific force in m/s², angular velocity in rad/s.
    shortest_s : float
        The duration in seconds below which intervals are ignored.

    Returns
    -------
    list of (float, float)
        The first and the last time of each, in seconds.
    """
    still = np.ones(len(times), bool)
    if acc is None and gyr is None:
        return []
    if gyr is not None:
        still &= np.linalg.norm(gyr, axis=1) < _REST_RAD_S
    if acc is not None:
        width = max(3, round(0.5 * rate_hz) | 1)
        padded = np.pad(acc, ((width // 2, width // 2), (0, 0)), mode="edge")
        sums = np.cumsum(np.vstack([np.zeros((1, 3)), np.nan_to_num(padded, nan=1e9)]), axis=0)
        mean = (sums[width:] - sums[:-width]) / width
        still &= np.linalg.norm(acc - mean, axis=1) < _REST_SPREAD * 9.81
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    found = [(float(times[start]), float(times[stop - 1])) for start, stop in edges.reshape(-1, 2)]
    return [(start, stop) for start, stop in found if stop - start >= shortest_s]


def bridge(times: F64, values: F64, longest_gap_s: float) -> F64:
    """Interpolate missing samples between known samples that are close in time.

    Parameters
    ----------
    times : float64 array (T,)
        Times of the samples in seconds, ascending.
    values : float64 array (T, 3) or (T, 4)
        Vectors, or unit quaternions; a row with a NaN is missing.
    longest_gap_s : float
        The longest time in seconds between two known samples that is bridged by interpolation.

    Returns
    -------
    float64 array
        The values, of the same shape; rows that remain unknown are NaN.
    """
    missing = ~np.isfinite(values).all(axis=1)
    if not missing.any():
        return values
    found = np.array(values, np.float64)
    found[missing] = np.nan
    if missing.all():
        return found
    if values.shape[1] == 4:
        found[missing], _ = interpolate(times, found, times[missing], longest_gap_s)
        return found
    known = np.flatnonzero(~missing)
    after = np.searchsorted(known, np.flatnonzero(missing))
    inside = (after > 0) & (after < len(known))
    before, after = known[np.maximum(after - 1, 0)], known[np.minimum(after, len(known) - 1)]
    near = inside & (times[after] - times[before] <= longest_gap_s * (1.0 + 1e-9))
    rows = np.flatnonzero(missing)[near]
    for axis in range(values.shape[1]):
        found[rows, axis] = np.interp(times[rows], times[known], values[known, axis])
    return found
