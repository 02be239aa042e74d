"""This module decides whether two takes hold the same motion, by joint positions relative to the root."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F32, F64

NEAR_M = 0.03
"""Mean distance of joints in metres below which two poses can be the same pose, sampled at another rate."""

GAP_FRAMES = 3
"""Longest interruption of an interval of near poses in frames, as by a fast hand sampled at another rate."""

LAG_S = 0.2
"""Time in seconds between the poses of a take that measure how much it moves."""

RATIO = 0.15
"""Largest distance of two copies, relative to the distance of poses `LAG_S` apart in the interval."""

FLOOR_M = 0.0001
"""Distance in metres below which poses count as equal, due to rounding in files, however still the body is."""

MIN_DURATION_S = 1.0
"""Minimum duration in seconds of a common interval, unless it is nearly all of the shorter take."""

NEARLY_ALL = 0.9
"""Share of the shorter take from which a common interval counts as nearly all of it."""

MAX_SAMPLED_FRAMES = 256
"""Number of frames in which a shift is estimated; fewer than twice as many, as the step between them is whole."""

_STEPS = 8  # steps per frame of the first search for the shift between two frames


class SameMotion(NamedTuple):
    """An interval that two takes have in common.

    Parameters
    ----------
    start, stop : int
        Frames of the second take.
    shift : float
        Time t of the second take corresponds to time t + shift of the first, in frames.
    distance_m : float
        Mean distance of the joints in metres.
    """

    start: int
    stop: int
    shift: float
    distance_m: float


def local_poses(positions: F32, root: int, left: int, right: int, *, mirrored: bool = False) -> F32:
    """Return joint positions relative to the root, rotated so that the hips lie along the X axis.

    Parameters
    ----------
    positions : float32 array (T, J, 3)
        Positions in metres, Y up.
    root, left, right : int
        The joints of the root and of the left and right hip.
    mirrored : bool, optional
        True to mirror the poses; `left`, `right` and the order of the joints must then be those of the other side.

    Returns
    -------
    float32 array (T, J, 3)
        Positions that depend neither on the body's position nor on its facing direction; NaN if a joint is not known.
    """
    return _local(positions, root, left, right, -1.0 if mirrored else 1.0)


@njit(cache=True, nogil=True)
def _local(positions: F32, root: int, left: int, right: int, side: float) -> F32:
    turned = np.empty(positions.shape, np.float32)
    for t in range(len(positions)):
        x0, y0, z0 = (
            np.float64(positions[t, root, 0]),
            np.float64(positions[t, root, 1]),
            np.float64(positions[t, root, 2]),
        )
        across = side * (np.float64(positions[t, left, 0]) - positions[t, right, 0])
        along = np.float64(positions[t, left, 2]) - positions[t, right, 2]
        length = math.hypot(across, along)
        cosine, sine = (across / length, along / length) if length > 0 else (across, along)
        for j in range(positions.shape[1]):
            x, z = side * (np.float64(positions[t, j, 0]) - x0), np.float64(positions[t, j, 2]) - z0
            turned[t, j, 0] = cosine * x + sine * z
            turned[t, j, 1] = np.float64(positions[t, j, 1]) - y0
            turned[t, j, 2] = cosine * z - sine * x
    return turned


def same_motion(first: F32, second: F32, shift: int, rate_hz: float) -> SameMotion | None:
    """Return the longest interval around an alignment in which two takes show the same motion.

    Parameters
    ----------
    first, second : float32 array (T, J, 3)
        Poses of the two takes from `local_poses`, over the same joints.
    shift : int
        Frame i of the second take is near frame i + shift of the first, up to one frame.
    rate_hz : float
        Frames per second of both takes.

    Returns
    -------
    SameMotion or None
        None if the interval is shorter than `MIN_DURATION_S` (and than `NEARLY_ALL` of the shorter take), or if its
        poses differ by more than `RATIO` times the movement in `LAG_S`.
    """
    low, high = max(0, -shift), min(len(second), len(first) - shift)
    if high - low < 2:
        return None
    moment = _moment(first, second, low, high, float(shift))
    distances = _distances(first, second, low, high, moment)
    begin, end = _longest(distances, NEAR_M, GAP_FRAMES)
    shorter = min(len(first), len(second))
    if end - begin < min(MIN_DURATION_S * rate_hz, NEARLY_ALL * shorter) or end - begin < 2:
        return None
    start, stop = low + begin, low + end
    lag = max(1, round(LAG_S * rate_hz))
    moved = _distances(second, second, start, stop, float(lag))
    inside = distances[begin:end]
    distance = float(np.nanmean(inside))
    span = float(np.nanmean(moved)) if np.isfinite(moved).any() else 0.0
    if not distance <= max(RATIO * span, FLOOR_M):
        return None
    return SameMotion(start, stop, moment, distance)


@njit(cache=True, nogil=True)
def _moment(first: F32, second: F32, low: int, high: int, shift: float) -> float:
    """Return the shift, to a thousandth of a frame, at which poses differ least; distances are clipped at `NEAR_M`."""
    best, least = shift, _cost(first, second, low, high, shift)
    for step in range(-_STEPS, _STEPS + 1):
        cost = _cost(first, second, low, high, shift + step / _STEPS)
        if cost < least:
            best, least = shift + step / _STEPS, cost
    width = 0.5 / _STEPS
    while width > 0.0005:
        middle = best
        for tried in (middle - width, middle + width):
            cost = _cost(first, second, low, high, tried)
            if cost < least:
                best, least = tried, cost
        width /= 2.0
    return best


@njit(cache=True, nogil=True)
def _cost(first: F32, second: F32, low: int, high: int, shift: float) -> float:
    """Return the mean distance of poses, clipped at `NEAR_M`, in frames that are evenly spread over an interval."""
    stride = max(1, (high - low) // MAX_SAMPLED_FRAMES)
    weights = _weights(shift)
    total, count = 0.0, 0
    for t in range(low, high, stride):
        distance = _distance(first, second, t, shift, weights)
        total += distance if distance < NEAR_M else NEAR_M
        count += 1
    return total / count


@njit(cache=True, nogil=True)
def _distances(first: F32, second: F32, low: int, high: int, shift: float) -> F64:
    """Return the mean distance of the joints in frames [low, high) of the second take; NaN outside of the first."""
    weights = _weights(shift)
    result = np.empty(high - low)
    for t in range(low, high):
        result[t - low] = _distance(first, second, t, shift, weights)
    return result


@njit(cache=True, nogil=True)
def _weights(shift: float) -> tuple[float, float, float, float]:
    """Return the weights of four frames in a Catmull–Rom spline between the middle two."""
    f = shift - math.floor(shift)
    g = 1.0 - f
    return -0.5 * f * g * g, 1.0 - f * f * (2.5 - 1.5 * f), 1.0 - g * g * (2.5 - 1.5 * g), -0.5 * g * f * f


@njit(cache=True, nogil=True)
def _distance(first: F32, second: F32, t: int, shift: float, weights: tuple[float, float, float, float]) -> float:
    """Return the mean distance of the joints in frame t of the second take; NaN outside of the first."""
    last = len(first) - 1
    whole = math.floor(shift)
    at = t + whole
    if at < 0 or at > last or (at == last and shift > whole):
        return np.nan
    before, after, later = max(at - 1, 0), min(at + 1, last), min(at + 2, last)
    total, count = 0.0, 0
    for j in range(first.shape[1]):
        square = 0.0
        for x in range(3):
            place = weights[1] * first[at, j, x]
            if shift > whole:
                place += weights[0] * first[before, j, x] + weights[2] * first[after, j, x]
                place += weights[3] * first[later, j, x]
            square += (place - second[t, j, x]) ** 2
        if square == square:
            total += math.sqrt(square)
            count += 1
    return total / count if count else np.nan


@njit(cache=True, nogil=True)
def _longest(distances: F64, near: float, gap: int) -> tuple[int, int]:
    """Return the longest interval of near poses, with interruptions of at most `gap` frames."""
    best_start, best_stop, start, end = 0, 0, -1, -1
    for t in range(len(distances)):
        if not distances[t] <= near:
            continue
        if start < 0 or t - end > gap:
            start = t
        end = t + 1
        if end - start > best_stop - best_start:
            best_start, best_stop = start, end
    return best_start, best_stop
