"""This module measures the frequency at which hands and feet swing, and estimates a take's frame rate from it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64
from kinedex.ops.order_statistics import median, percentile

USUAL_HZ = tuple(map(float, (10, 15, 20, 25, 30, 50, 60, 75, 90, 100, 120, 150, 200, 240, 300, 400, 500)))
"""Rates of motion capture and cameras that a likely rate is rounded to."""

TYPICAL_HZ = 1.0
"""The median tempo in Hz of the takes of HDM05, CMU and Bandai."""

LAG_S = 1.0 / 30.0  # seconds; differences over this time are free of the noise between frames of fast cameras
_TURNED = 0.4  # radians; the least turn of the motion over the lag from which a likely rate is computed
_MAX_DIFFERENCES = 512  # most frames in which differences are taken, spread over the take


@dataclass(frozen=True)
class Tempo:
    """The tempo of a motion.

    Attributes
    ----------
    hz : float
        The frequency in Hz of a harmonic motion with the same ratio of acceleration to speed, as a median over frames.
    acceleration : float
        The 90th percentile of acceleration over points and frames, in units of length per second squared.
    """

    hz: float
    acceleration: float


def tempo(tracks: F64, rate_hz: float) -> Tempo | None:
    """Measure the tempo of a set of points, for instance wrists and ankles.

    Parameters
    ----------
    tracks : float64 array (N, 3, T)
        Positions of N points over time; NaN if a point is not known.
    rate_hz : float
        Frames per second.

    Returns
    -------
    Tempo or None
        None where there are too few frames, or nothing moves.
    """
    lag = max(1, round(rate_hz * LAG_S))
    turned, second = turn_and_acceleration(np.ascontiguousarray(tracks, np.float64), lag)
    return Tempo(turned * rate_hz / lag / (2 * np.pi), second * (rate_hz / lag) ** 2) if turned == turned else None


def likely_rate(tracks: F64) -> float | None:
    """Estimate the frame rate from the motion alone: the rate at which hands and feet move at the typical tempo.

    On HDM05, CMU and Bandai, with all frames and with every second frame, the estimate is within a factor of 2 of the
    true rate for 96 % of takes, and within a factor of 3 for 98 %.

    Parameters
    ----------
    tracks : float64 array (N, 3, T)
        Wrists and ankles, in any unit; NaN where a point is not known.

    Returns
    -------
    float or None
        One of `USUAL_HZ`; None where there are too few frames, or nothing moves.
    """
    tracks = np.ascontiguousarray(tracks, np.float64)
    lag, rate = 1, None
    while (turned := turn_and_acceleration(tracks, lag)[0]) == turned:  # not for NaN, where frames or motion end
        rate = lag * TYPICAL_HZ * 2 * np.pi / max(turned, 1e-9)
        if turned >= _TURNED:
            break
        lag *= 2
    return None if rate is None else usual_rate(rate)


def usual_rate(rate_hz: float) -> float:
    """Return the rate of `USUAL_HZ` that is nearest to a rate on a logarithmic scale."""
    return min(USUAL_HZ, key=lambda usual: abs(np.log(usual / rate_hz)))


@njit(cache=True, nogil=True, error_model="numpy")
def turn_and_acceleration(tracks: F64, lag: int) -> tuple[float, float]:
    """Return the median angle of motion over a lag in radians, and the 90th percentile of second differences.

    Both are NaN if nothing moves.
    """
    points, _, length = tracks.shape
    frames = max(length - 2 * lag, 0)
    taken = min(frames, _MAX_DIFFERENCES)
    ratios, rotations = np.empty(taken), np.empty(taken * points)
    moving, known = 0, 0
    for i in range(taken):
        t = i if frames <= _MAX_DIFFERENCES else i * (frames - 1) // (taken - 1)
        speed, turn = 0.0, 0.0
        for j in range(points):
            first, second = 0.0, 0.0
            for k in range(3):
                before, now, after = tracks[j, k, t], tracks[j, k, t + lag], tracks[j, k, t + 2 * lag]
                first += 0.25 * (after - before) * (after - before)
                second += (after - 2.0 * now + before) * (after - 2.0 * now + before)
            second = math.sqrt(second)
            speed += math.sqrt(first)
            turn += second
            if second < np.inf:  # false for NaN
                rotations[known] = second
                known += 1
        if 0.0 < speed < np.inf:
            ratios[moving] = turn / speed
            moving += 1
    if moving == 0:
        return np.nan, np.nan
    return median(ratios[:moving]), percentile(rotations[:known], 90.0)
