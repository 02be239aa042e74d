"""This module finds the offset and drift of a sensor's clock: t_sensor = t_take + offset + ppm · 10⁻⁶ · t_take.

The thesis correlates magnitudes of accelerations (Section 7.6.1). This module first correlates angular speeds, which do
not depend on the worlds of take and sensor or on the sensor's position on the limb, and need no second derivative.
After a first calibration with this offset, a fine search nearby finds the offset of the smallest orientation errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64
from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial.lowpass import MIN_PADDING, lowpass
from kinedex.ops.inertial.rotations import LONGEST_GAP_S, angle, angular_speed, inverse_product

RATE_HZ, CUTOFF_HZ = 200.0, 5.0
CLIP_PERCENTILE = 99.0
MIN_OVERLAP_S, OVERLAP_SHARE, VARIANCE_SHARE = 3.0, 0.5, 0.1
MIN_CORRELATION, RIVAL_S, RIVAL_SHARE = 0.3, 0.25, 0.95

CLIP_DEG = 10.0
"""Error in degrees at which errors are clipped in the fine search."""

COARSE_S, COARSE_STEP_S, FINE_S, FINE_STEP_S = 0.1, 0.01, 0.01, 0.001
WINDOW_S, WINDOW_STEP_S = 30.0, 15.0
MAX_FRAMES = 20_000
"""Maximum number of frames of each limb, evenly spread, that the fine search compares."""

_STILL = 1e-12  # a sum of squares in (rad/s)² below which there is no motion


class Speeds(NamedTuple):
    """The angular speeds of one limb in the take and of its sensor.

    Attributes
    ----------
    take_times, take : float64 array (T,)
        Times of the take in seconds, ascending, and angular speeds in rad/s (`rotations.angular_speed`); NaN if
        unknown.
    sensor_times, sensor : float64 array (N,)
        Times of the sensor's clock in seconds, ascending, and angular speeds in rad/s; NaN if unknown.
    """

    take_times: F64
    take: F64
    sensor_times: F64
    sensor: F64


class TimeOffset(NamedTuple):
    """A time offset by correlation, with measures of its reliability.

    Attributes
    ----------
    offset_s : float
        The sensor's time minus the take's time; NaN if no lag is admissible.
    correlation : float
        The correlation at the peak, −1 to 1; NaN if no lag is admissible.
    next_best : float
        The largest correlation at a distance of at least 0.25 s from the peak; NaN if there is none.
    refused : str
        The reason why the offset is not reliable; empty if it is.
    """

    offset_s: float
    correlation: float
    next_best: float
    refused: str


class FineSearch(NamedTuple):
    """Predicted and measured orientations of the sensor on a limb, which the fine search compares at any offset.

    Attributes
    ----------
    take_times : float64 array (T,)
        Times of the take in seconds, ascending.
    predicted : float64 array (T, 4)
        q̄_G ∘ q_T ∘ q_L of valid frames, with the sensor's heading drift included.
    sensor_times : float64 array (N,)
        Times of the sensor's clock in seconds, ascending.
    sensor : float64 array (N, 4)
        The sensor's orientations, all of them known.
    """

    take_times: F64
    predicted: F64
    sensor_times: F64
    sensor: F64


def sensor_speed(times: F64, gyr: F64 | None, orientation: F64 | None) -> tuple[F64, F64]:
    """Return times and angular speeds (rad/s) of a sensor, from its gyroscope, or else from its orientations.

    Parameters
    ----------
    times : float64 array (T,)
        Times in seconds, ascending.
    gyr : float64 array (T, 3) or None
        Angular velocity in rad/s; NaN where unknown.
    orientation : float64 array (T, 4) or None
        Unit quaternions, which are used if there is no gyroscope.

    Raises
    ------
    ParameterError
        The sensor has neither angular velocities nor orientations.
    """
    if gyr is not None:
        return times, np.sqrt(np.einsum("ta,ta->t", gyr, gyr))
    if orientation is None:
        raise ParameterError("the sensor", "with angular velocities or orientations", "neither")
    return angular_speed(times, orientation)


def find_offset(limbs: Sequence[Speeds], longest_s: float | None = None) -> TimeOffset:
    """Find the offset that maximises the joint correlation of the angular speeds of all limbs.

    Parameters
    ----------
    limbs : sequence of Speeds
        The limbs of one take and one recording, whose sensors share a clock.
    longest_s : float, optional
        The largest absolute offset in seconds; larger offsets are excluded, also for `next_best`.

    Returns
    -------
    TimeOffset
        The offset; `refused` is set if it is not reliable.

    Raises
    ------
    ParameterError
        There are no limbs, or `longest_s` is not positive.
    """
    if not limbs:
        raise ParameterError("limbs", "one or more", "none")
    if longest_s is not None and not longest_s > 0.0:
        raise ParameterError("longest_s", "positive", longest_s)
    found = [_limb_curve(limb) for limb in limbs]
    curves = [one for one in found if one is not None]
    if not curves:
        return TimeOffset(math.nan, math.nan, math.nan, "no limb has angular speeds of take and sensor")
    first = min(start for start, _ in curves)
    total = np.zeros(max(start + len(curve) for start, curve in curves) - first)
    total -= len(curves)
    for start, curve in curves:
        total[start - first : start - first + len(curve)] += curve + 1.0
    total /= len(curves)
    lags = (np.arange(len(total)) + first) / RATE_HZ
    if longest_s is not None:
        total = np.where(np.abs(lags) <= longest_s, total, -1.0)
    return _peak(lags, total)


def _limb_curve(limb: Speeds) -> tuple[int, F64] | None:
    """Return the first lag in samples and the correlation at each lag of one limb; None if too few speeds are known."""
    known = np.isfinite(limb.sensor)
    if known.sum() < 2 or np.isfinite(limb.take).sum() < 2:
        return None
    highest = float(np.percentile(limb.sensor[known], CLIP_PERCENTILE))
    take_start, take = _filtered(limb.take_times, limb.take, highest)
    sensor_start, sensor = _filtered(limb.sensor_times, limb.sensor, highest)
    if not len(take) or not len(sensor):
        return None
    curve = correlation(take, sensor)
    return sensor_start - take_start - (len(take) - 1), curve


def _filtered(times: F64, speeds: F64, highest: float) -> tuple[int, F64]:
    """Return speeds, clipped and smoothed, on a grid of 200 Hz through time 0, and the index of the first sample."""
    known = np.isfinite(speeds) & np.isfinite(times)
    times, speeds = times[known], np.minimum(speeds[known], highest)
    start, stop = math.ceil(times[0] * RATE_HZ), math.floor(times[-1] * RATE_HZ)
    grid = np.interp(np.arange(start, stop + 1) / RATE_HZ, times, speeds)
    if len(grid) <= MIN_PADDING:  # shorter than any admissible overlap
        return start, np.empty(0)
    return start, lowpass(grid, RATE_HZ, CUTOFF_HZ)


def correlation(take: F64, sensor: F64) -> F64:
    """Compute the normalised cross-correlation at every lag, with means and variances of each overlap.

    Parameters
    ----------
    take, sensor : float64 array (T,), (N,)
        Values on one grid of 200 Hz.

    Returns
    -------
    float64 array (T + N − 1,)
        The correlations at lags −(T − 1) to N − 1, where lag k compares take[i] with sensor[i + k]. It is −1 if the
        overlap is shorter than 3 s or than half of the shorter array, or if it holds less than 10 % of the variance of
        one of the arrays.
    """
    take, sensor = take - take.mean(), sensor - sensor.mean()
    count, other = len(take), len(sensor)
    size = _fast_length(count + other - 1)
    spectrum = np.fft.rfft(sensor, size) * np.conj(np.fft.rfft(take, size))
    products = np.roll(np.fft.irfft(spectrum, size), count - 1)[: count + other - 1]
    lags = np.arange(-(count - 1), other)
    # at lag k the overlap is take[first:last], sensor[first + k:last + k]
    first, last = np.maximum(0, -lags), np.minimum(count, other - lags)
    overlap = (last - first).astype(np.float64)
    sum_take, square_take = _window_sums(take, first, last)
    sum_sensor, square_sensor = _window_sums(sensor, first + lags, last + lags)
    spread_take = square_take - sum_take**2 / overlap
    spread_sensor = square_sensor - sum_sensor**2 / overlap
    whole_take, whole_sensor = float(take @ take), float(sensor @ sensor)
    least = max(MIN_OVERLAP_S * RATE_HZ, OVERLAP_SHARE * min(count, other))
    counts = (
        (overlap >= least)
        & (spread_take >= max(VARIANCE_SHARE * whole_take, _STILL))
        & (spread_sensor >= max(VARIANCE_SHARE * whole_sensor, _STILL))
    )
    scale = np.sqrt(np.where(counts, spread_take * spread_sensor, 1.0))
    return np.where(counts, (products - sum_take * sum_sensor / overlap) / scale, -1.0)


def _fast_length(least: int) -> int:
    """Return the smallest product of twos, threes and fives that is at least `least`: FFTs of this length are fast."""
    best = 1 << max(0, least - 1).bit_length()
    odd = 1
    while odd < best:
        product = odd
        while product < best:
            best = min(best, product << max(0, -(-least // product) - 1).bit_length())
            product *= 3
        odd *= 5
    return best


def _window_sums(values: F64, first: I64, last: I64) -> tuple[F64, F64]:
    """Return the sums of values, and of their squares, over windows [first, last)."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    squares = np.concatenate([[0.0], np.cumsum(values * values)])
    return sums[last] - sums[first], squares[last] - squares[first]


def _peak(lags: F64, curve: F64) -> TimeOffset:
    """Find the peak of a correlation curve, and judge its reliability."""
    best = int(curve.argmax())
    top = float(curve[best])
    if top <= -1.0:
        return TimeOffset(
            math.nan, math.nan, math.nan, "take and recording overlap by less than 3 s of movement at every offset"
        )
    offset = float(lags[best]) + _vertex(curve, best) / RATE_HZ
    far = np.abs(lags - lags[best]) >= RIVAL_S - 1e-9
    rival = float(curve[far].max()) if far.any() else math.nan
    if rival <= -1.0:
        rival = math.nan
    refused = ""
    if top < MIN_CORRELATION:
        refused = (
            f"angular speeds correlate by {top:.2f} only, {MIN_CORRELATION} is needed: "
            "is it the recording of this take, and each sensor on its limb? `offset_s: <seconds>` sets the offset"
        )
    elif rival > RIVAL_SHARE * top:
        other = float(lags[far][int(curve[far].argmax())])
        refused = (
            f"offsets {offset:.3f} s and {other:.3f} s fit alike (correlation {top:.3f}, {rival:.3f}): "
            "`longest_s: <seconds>` excludes far ones, `offset_s: <seconds>` sets the offset"
        )
    return TimeOffset(offset, top, rival, refused)


def _vertex(curve: F64, best: int) -> float:
    """Return the vertex of the parabola through a value and its neighbours, in samples relative to the value."""
    if not 0 < best < len(curve) - 1:
        return 0.0
    before, top, after = curve[best - 1 : best + 2].tolist()
    bend = before - 2.0 * top + after
    return 0.0 if bend == 0.0 else max(-0.5, min(0.5, 0.5 * (before - after) / bend))


def refine_offset(limbs: Sequence[FineSearch], offset_s: float, ppm: float = 0.0) -> float:
    """Find the offset with the smallest orientation errors within 0.1 s of a first offset.

    The result is accurate to fractions of a millisecond.

    Parameters
    ----------
    limbs : sequence of FineSearch
        The limbs of one take and one recording, calibrated with the first offset.
    offset_s : float
        The first offset.
    ppm : float
        The clock's error in parts per million.

    Returns
    -------
    float
        The offset in seconds; the first offset if no frame is known.
    """
    limbs = [limb for limb in limbs if len(limb.predicted)]
    spread = [_spread(limb, MAX_FRAMES) for limb in limbs]

    def cost(offset: float) -> float:
        parts = [_clipped_cost(*limb, offset, ppm, LONGEST_GAP_S) for limb in spread]
        frames = sum(count for _, count in parts)
        # the mean, not the sum: frames that fall outside the recording must not lower the cost
        return sum(total for total, _ in parts) / frames if frames else math.inf

    for reach, step in ((COARSE_S, COARSE_STEP_S), (FINE_S, FINE_STEP_S)):
        offset_s = _least(cost, offset_s, reach, step)
    return offset_s


def _least(cost: Callable[[float], float], middle: float, reach: float, step: float) -> float:
    """Return the offset of lowest cost on a grid about the middle, refined by a parabola through the smallest value."""
    count = round(reach / step)
    offsets = middle + step * np.arange(-count, count + 1)
    costs = np.array([cost(float(offset)) for offset in offsets])
    if not np.isfinite(costs).any():
        return middle
    best = int(costs.argmin())
    return float(offsets[best]) + (step * _vertex(-costs, best) if np.isfinite(costs).all() else 0.0)


def _spread(limb: FineSearch, most: int) -> FineSearch:
    """Return a limb with at most `most` frames, spread evenly, as contiguous arrays for the kernel."""
    frames = np.linspace(0, len(limb.take_times) - 1, min(len(limb.take_times), most)).astype(np.int64)
    return FineSearch(
        limb.take_times[frames],
        limb.predicted[frames],
        np.array(limb.sensor_times, np.float64),
        np.array(limb.sensor, np.float64, order="C"),
    )


def find_drift(limbs: Sequence[FineSearch], offset_s: float) -> tuple[float, float]:
    """Find the offset and drift of a clock by a robust line through the offsets of the fine search in windows.

    Parameters
    ----------
    limbs : sequence of FineSearch
        The limbs of one take and one recording, calibrated with the first offset.
    offset_s : float
        The first offset.

    Returns
    -------
    tuple[float, float]
        The offset in seconds at the take's time 0, and the drift in parts per million.
    """
    start = min(float(limb.take_times[0]) for limb in limbs if len(limb.take_times))
    stop = max(float(limb.take_times[-1]) for limb in limbs if len(limb.take_times))
    middles, offsets = [], []
    for first in np.arange(start, max(stop - WINDOW_S, start) + 1e-9, WINDOW_STEP_S).tolist():
        window = [_window(limb, first, first + WINDOW_S) for limb in limbs]
        frames = [limb.take_times for limb in window if len(limb.take_times)]
        if frames:
            middles.append(float(np.mean(np.concatenate(frames))))
            offsets.append(refine_offset(window, offset_s))
    if len(middles) < 2:
        return refine_offset(limbs, offset_s), 0.0
    slope, at_zero = _robust_line(np.array(middles), np.array(offsets))
    return at_zero, 1e6 * slope


def _window(limb: FineSearch, start: float, stop: float) -> FineSearch:
    first, last = np.searchsorted(limb.take_times, [start, stop]).tolist()
    return limb._replace(take_times=limb.take_times[first:last], predicted=limb.predicted[first:last])


def _robust_line(x: F64, y: F64) -> tuple[float, float]:
    """Return the slope and intercept of a Theil–Sen line: the median slope of all pairs, and the median intercept."""
    i, j = np.triu_indices(len(x), 1)
    apart = x[j] - x[i]
    slope = float(np.median((y[j] - y[i])[apart > 0.0] / apart[apart > 0.0])) if (apart > 0.0).any() else 0.0
    return slope, float(np.median(y - slope * x))


@njit(cache=True, nogil=True, error_model="numpy")
def _clipped_cost(
    take_times: F64, predicted: F64, times: F64, sensor: F64, offset: float, ppm: float, longest_gap: float
) -> tuple[float, int]:
    """Return the sum of squared clipped errors in degrees, and the number of frames within the recording."""
    total, frames, k = 0.0, 0, 0
    count = len(times)
    for i in range(len(take_times)):
        at = take_times[i] * (1.0 + 1e-6 * ppm) + offset
        while k + 2 < count and times[k + 1] < at:
            k += 1
        if count < 2 or at < times[k] or at > times[k + 1] or times[k + 1] - times[k] > longest_gap:
            continue
        share = (at - times[k]) / (times[k + 1] - times[k]) if times[k + 1] > times[k] else 0.0
        a, b, c, d = sensor[k, 0], sensor[k, 1], sensor[k, 2], sensor[k, 3]
        w, x, y, z = sensor[k + 1, 0], sensor[k + 1, 1], sensor[k + 1, 2], sensor[k + 1, 3]
        cosine = a * w + b * x + c * y + d * z
        sign = -1.0 if cosine < 0.0 else 1.0
        arc = math.acos(min(abs(cosine), 1.0))
        if arc < 1e-6:
            first, second = 1.0 - share, share
        else:
            first, second = math.sin((1.0 - share) * arc) / math.sin(arc), math.sin(share * arc) / math.sin(arc)
        second *= sign
        there = (first * a + second * w, first * b + second * x, first * c + second * y, first * d + second * z)
        wanted = (predicted[i, 0], predicted[i, 1], predicted[i, 2], predicted[i, 3])
        error = min(angle(inverse_product(wanted, there)) * 180.0 / math.pi, CLIP_DEG)
        total += error * error
        frames += 1
    return total, frames
