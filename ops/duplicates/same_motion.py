"""This module decides whether two takes hold the same motion, by the distances of their joints after an alignment.

One noise model decides: what an export, a filter or another rate can change in a copy is a number of millimetres, and a
number of milliseconds times the speed of the joints. Two performances differ by more, and their difference persists for
tenths of a second, whereas that of a noisy copy changes from frame to frame.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F32, F64

NEAR_M = 0.03
"""Distance of joints in metres below which two poses can be the same pose, sampled at another rate."""

PROBED_M = 0.02
"""Distance of joints in metres below which most poses around the support of an alignment must be."""

AROUND = 4
"""Number of frames before and after the support of an alignment that are looked at, too."""

GAP_FRAMES = 3
"""Longest interruption of an interval of near poses in frames, as by a fast hand sampled at another rate."""

NOISE_M, NOISE_S = 0.007, 0.006
"""The largest root mean square distance of copies: metres, and seconds that are multiplied by the speed of joints."""

PERSISTING_M, PERSISTING_S = 0.003, 0.004
"""The largest distance of copies that persists for `LAG_S`: metres, and seconds that are multiplied by the speed."""

SPREAD = 0.35
"""The largest persisting distance of copies, relative to the spread of poses: they share movement, not posture."""

FLOOR_M = 0.0003
"""Distance in metres below which the spread does not count, as files are rounded to whole millimetres."""

LAG_S = 0.1
"""Time in seconds for which a difference of poses must last in order to persist."""

SPEED_S = 0.2
"""Time in seconds over which the speed of joints is measured, so that noise hardly adds to it."""

MAX_PACE = 0.06
"""Largest relative difference of the clocks of two copies; films at 24 and at 25 frames a second differ by 0.04."""

SEED_S = 0.4
"""Minimum duration in seconds of an interval of near poses that is extended while the clocks are compared."""

MIN_DURATION_S = 1.0
"""Minimum duration in seconds of a common interval, unless it is nearly all of the shorter take."""

NEARLY_ALL = 0.9
"""Share of the shorter take from which a common interval counts as nearly all of it."""

MAX_SAMPLED_FRAMES = 256
"""Maximum number of frames in which the shift between two frames is estimated."""

_SHIFT_FRAMES = 0.1  # from which the moments of two takes differ
_DRIFT_FRAMES = 0.5  # from which the clocks of two takes differ
_OUTSIDE = 0.02  # share of a frame by which a moment may lie outside of a take, as alignments are not exact
_PROBED = 8  # frames that are looked at before takes are compared
_ROUNDS = 12  # rounds of extending an interval, each at most to its double
_STEADY_FRAMES = 0.001  # change of the alignment from which a fit goes on
_TRIES = 6  # steps of the fit of shift and pace in each round


class Warp(NamedTuple):
    """An alignment in time: frame t of the second take is at t + shift + pace · (t − centre) of the first."""

    shift: float
    pace: float
    centre: float

    def at(self, frame: float) -> float:
        """Return the shift at a frame of the second take."""
        return self.shift + self.pace * (frame - self.centre)


class SameMotion(NamedTuple):
    """An interval that two takes have in common.

    Parameters
    ----------
    start, stop : int
        Frames of the second take.
    shift : float
        Frame `start` of the second take corresponds to frame start + shift of the first.
    pace : float
        Frames of the first take in a frame of the second; 1 if their clocks agree.
    distance_m : float
        Root mean square distance of the joints in metres.
    persisting_m : float
        The part of it that persists for `LAG_S`, in metres.
    speed_m_s : float
        Root mean square speed of the joints relative to the root, in metres a second.
    spread_m : float
        Root mean square distance of the joints from their mean place around the root, in metres.
    """

    start: int
    stop: int
    shift: float
    pace: float
    distance_m: float
    persisting_m: float
    speed_m_s: float
    spread_m: float

    @property
    def within_noise(self) -> bool:
        """True if the poses differ by no more than noise and resampling explain at this speed."""
        return (
            self.distance_m <= NOISE_M + NOISE_S * self.speed_m_s
            and self.persisting_m <= PERSISTING_M + PERSISTING_S * self.speed_m_s
            and self.persisting_m <= FLOOR_M + SPREAD * self.spread_m
        )


def same_motion(
    first: F32, second: F32, shift: int, rate_hz: float, support: tuple[int, int] | None = None
) -> SameMotion | None:
    """Return the longest interval around an alignment in which two takes show the same motion.

    Parameters
    ----------
    first, second : float32 array (T, J, 3)
        Poses of the two takes from `local_poses`, over the same joints.
    shift : int
        Frame i of the second take is near frame i + shift of the first, up to one frame.
    rate_hz : float
        Frames per second of both takes.
    support : tuple of int, optional
        The frames [start, stop) of the second take for which the words support the alignment. If the poses are not
        near there, the takes are not compared further.

    Returns
    -------
    SameMotion or None
        None if the interval is shorter than `MIN_DURATION_S` (and than `NEARLY_ALL` of the shorter take), or if its
        poses differ by more than noise explains.
    """
    if support is not None and not is_supported(first, second, shift, *support):
        return None
    found = nearest_interval(first, second, shift, rate_hz)
    return found if found is not None and found.within_noise else None


def changes_of(match: SameMotion, frames: int, others: int) -> list[str]:
    """Return what was done to a copy in time, in words of the view `duplicates`; an empty list for the same frames.

    Parameters
    ----------
    match : SameMotion
        What two takes have in common.
    frames, others : int
        The number of frames of the second take, which is the copy, and of the first one.
    """
    length = match.stop - match.start
    changes = []
    if length < NEARLY_ALL * frames:
        changes.append("part")
    elif length < NEARLY_ALL * others:
        changes.append("trimmed")
    if abs(match.pace - 1.0) * length > _DRIFT_FRAMES:
        changes.append("another clock")
    elif abs(match.shift - round(match.shift)) > _SHIFT_FRAMES:
        changes.append("shifted")
    return changes


def nearest_interval(first: F32, second: F32, shift: int, rate_hz: float) -> SameMotion | None:
    """Return the longest interval around an alignment in which the poses of two takes are near one another.

    Parameters and return value are those of `same_motion`, apart from the decision by noise.
    """
    low, high = max(0, -shift), min(len(second), len(first) - shift)
    if high - low < 2:
        return None
    warp = Warp(_moment(first, second, low, high, shift), 0.0, 0.0)
    shorter = min(len(first), len(second))
    begin, end = _near(first, second, low, high, warp)
    if end - begin < max(2.0, min(SEED_S * rate_hz, NEARLY_ALL * shorter)):
        return None
    for _ in range(_ROUNDS):
        warp = _fitted(first, second, begin, end, warp)
        length = end - begin
        low, high = max(0, begin - length), min(len(second), end + length)
        before, (begin, end) = (begin, end), _near(first, second, low, high, warp)
        if end - begin <= length or (begin, end) == before:
            break
    if end - begin < max(2.0, min(MIN_DURATION_S * rate_hz, NEARLY_ALL * shorter)):
        return None
    errors = _errors(first, second, begin, end, *warp)
    lag = max(1, min(round(LAG_S * rate_hz), (end - begin) // 2))
    step = max(1, min(round(SPEED_S * rate_hz), end - begin - 1))
    part = second[begin:end]
    moved, around = part[step:] - part[:-step], part - _means(part)
    return SameMotion(
        begin, end, warp.at(begin), 1.0 + warp.pace, math.sqrt(_mean_product(errors, errors)),
        math.sqrt(max(0.0, _mean_product(errors[lag:], errors[:-lag]))),
        math.sqrt(_mean_product(moved, moved)) * rate_hz / step, math.sqrt(_mean_product(around, around)),
    )  # fmt: skip


def _means(poses: F32) -> F32:
    """Return the mean pose (J, 3) over the frames in which each joint is known; NaN if it never is."""
    known = np.isfinite(poses)
    with np.errstate(invalid="ignore"):
        mean: F32 = np.where(known, poses, 0).sum(axis=0) / known.sum(axis=0)
    return mean


def _mean_product(one: F32, other: F32) -> float:
    """Return the mean scalar product of the vectors of joints that are known in both; 0 if there are none."""
    products = (one.astype(np.float64) * other).sum(axis=2)
    known = np.isfinite(products)
    return float(products[known].mean()) if known.any() else 0.0


def _near(first: F32, second: F32, low: int, high: int, warp: Warp) -> tuple[int, int]:
    """Return the longest interval of near poses in [low, high)."""
    begin, end = _longest(_distances(first, second, low, high, *warp), NEAR_M, GAP_FRAMES)
    return low + begin, low + end


def _fitted(first: F32, second: F32, begin: int, end: int, warp: Warp) -> Warp:
    """Return the shift and the pace at which poses in an interval differ least, by Gauss and Newton."""
    centre = 0.5 * (begin + end - 1)
    warp = Warp(warp.at(centre), warp.pace, centre)
    for _ in range(_TRIES):
        square, along, across, right, left = _normal_equations(first, second, begin, end, *warp)
        determinant = square * across - along * along
        if not determinant > 1e-9 * square * across:
            break
        shift = (right * across - left * along) / determinant
        pace = (left * square - right * along) / determinant
        before = warp
        warp = Warp(
            warp.shift - min(max(shift, -1.0), 1.0), min(max(warp.pace - pace, -MAX_PACE), MAX_PACE), centre
        )  # fmt: skip
        if max(abs(warp.at(edge) - before.at(edge)) for edge in (begin, end)) < _STEADY_FRAMES:
            break
    return warp


@njit(cache=True, nogil=True)
def _moment(first: F32, second: F32, low: int, high: int, shift: int) -> float:
    """Return the shift, to half a frame, at which poses differ least, up to a frame from a given one."""
    best, least = float(shift), np.inf
    for step in range(-2, 3):
        cost = _cost(first, second, low, high, shift + 0.5 * step)
        if cost < least:
            best, least = shift + 0.5 * step, cost
    return best


@njit(cache=True, nogil=True)
def _cost(first: F32, second: F32, low: int, high: int, shift: float) -> float:
    """Return the mean distance of poses, each clipped at `NEAR_M`, in `MAX_SAMPLED_FRAMES` frames spread over the
    interval."""
    stride = max(1, (high - low) // MAX_SAMPLED_FRAMES)
    total, count = 0.0, 0
    for t in range(low, high, stride):
        distance = _distance(first, second, t, t + shift)
        total += distance if distance < NEAR_M else NEAR_M
        count += 1
    return total / count


@njit(cache=True, nogil=True)
def _distances(first: F32, second: F32, low: int, high: int, shift: float, pace: float, centre: float) -> F64:
    """Return the distance of poses in frames [low, high) of the second take; NaN outside of the first."""
    result = np.empty(high - low)
    for t in range(low, high):
        result[t - low] = _distance(first, second, t, t + shift + pace * (t - centre))
    return result


@njit(cache=True, nogil=True)
def _place(first: F32, j: int, x: int, at: int, f: float) -> float:
    """Return a coordinate at a share of the way between frames `at` and at + 1, by a Catmull–Rom spline."""
    if f == 0.0:
        return np.float64(first[at, j, x])
    last, g = len(first) - 1, 1.0 - f
    place = (1.0 - f * f * (2.5 - 1.5 * f)) * first[at, j, x] + (1.0 - g * g * (2.5 - 1.5 * g)) * first[at + 1, j, x]
    place -= 0.5 * f * g * g * first[max(at - 1, 0), j, x] + 0.5 * g * f * f * first[min(at + 2, last), j, x]
    return place


@njit(cache=True, nogil=True)
def _within(moment: float, last: int) -> tuple[int, float]:
    """Return the frame before a moment and the share of a frame after it; frame −1 outside of the take."""
    if -_OUTSIDE <= moment <= 0.0:
        return 0, 0.0
    if last <= moment <= last + _OUTSIDE:
        return last, 0.0
    at = math.floor(moment)
    return (at, moment - at) if 0 <= at < last else (-1, 0.0)


@njit(cache=True, nogil=True)
def _distance(first: F32, second: F32, t: int, moment: float) -> float:
    """Return the root mean square distance of the joints in frame t of the second take and at a moment of the first.

    The first pose is moved, and turned about the vertical, to where it is nearest. The result is NaN outside of the
    first take.
    """
    at, f = _within(moment, len(first) - 1)
    if at < 0:
        return np.nan
    count, squares, dot, cross, upright = 0, 0.0, 0.0, 0.0, 0.0
    px, py, pz, qx, qy, qz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(first.shape[1]):
        x, y, z = _place(first, j, 0, at, f), _place(first, j, 1, at, f), _place(first, j, 2, at, f)
        u, v, w = np.float64(second[t, j, 0]), np.float64(second[t, j, 1]), np.float64(second[t, j, 2])
        if x + y + z + u + v + w == x + y + z + u + v + w:
            count += 1
            px, py, pz, qx, qy, qz = px + x, py + y, pz + z, qx + u, qy + v, qz + w
            squares += x * x + y * y + z * z + u * u + v * v + w * w
            dot += x * u + z * w
            cross += x * w - z * u
            upright += y * v
    if count == 0:
        return np.nan
    squares -= (px * px + py * py + pz * pz + qx * qx + qy * qy + qz * qz) / count
    dot -= (px * qx + pz * qz) / count
    cross -= (px * qz - pz * qx) / count
    upright -= py * qy / count
    return math.sqrt(max(0.0, squares - 2.0 * (upright + math.hypot(dot, cross))) / count)


@njit(cache=True, nogil=True)
def _turned(first: F32, second: F32, t: int, moment: float, errors: F64, slopes: F64) -> bool:
    """Write the differences of joints at a moment, and how they change with it; return whether the moment is known.

    The first pose is moved and turned as in `_distance`.
    """
    last = len(first) - 1
    at, f = _within(moment, last)
    if at < 0:
        return False
    count, joints = 0, first.shape[1]
    means = np.zeros(9)
    for j in range(joints):
        total = 0.0
        for x in range(3):
            errors[j, x] = _place(first, j, x, at, f)
            slopes[j, x] = first[min(at + 1, last), j, x] - first[at if at < last else at - 1, j, x]
            total += errors[j, x] + slopes[j, x] + second[t, j, x]
        if total == total:
            count += 1
            for x in range(3):
                means[x] += errors[j, x]
                means[3 + x] += second[t, j, x]
                means[6 + x] += slopes[j, x]
        else:
            errors[j, 0] = np.nan
    if count == 0:
        return False
    means /= count
    dot, cross = 0.0, 0.0
    for j in range(joints):
        if errors[j, 0] == errors[j, 0]:
            x, z = errors[j, 0] - means[0], errors[j, 2] - means[2]
            u, w = second[t, j, 0] - means[3], second[t, j, 2] - means[5]
            dot += x * u + z * w
            cross += x * w - z * u
    length = math.hypot(dot, cross)
    cosine, sine = (dot / length, cross / length) if length > 0.0 else (1.0, 0.0)
    for j in range(joints):
        if errors[j, 0] == errors[j, 0]:
            x, z = errors[j, 0] - means[0], errors[j, 2] - means[2]
            errors[j, 1] += means[4] - means[1] - second[t, j, 1]
            errors[j, 0] = cosine * x - sine * z + means[3] - second[t, j, 0]
            errors[j, 2] = sine * x + cosine * z + means[5] - second[t, j, 2]
            x, z = slopes[j, 0] - means[6], slopes[j, 2] - means[8]
            slopes[j, 0], slopes[j, 1], slopes[j, 2] = (
                cosine * x - sine * z,
                slopes[j, 1] - means[7],
                sine * x + cosine * z,
            )
        else:
            errors[j] = np.nan
    return True


@njit(cache=True, nogil=True)
def _errors(first: F32, second: F32, begin: int, end: int, shift: float, pace: float, centre: float) -> F32:
    """Return the differences of joints (T, J, 3) in frames [begin, end) of the second take.

    They are NaN where unknown, and in the frames whose poses are not near, which interrupt the interval.
    """
    joints = first.shape[1]
    result = np.full((end - begin, joints, 3), np.nan, np.float32)
    errors, slopes = np.empty((joints, 3)), np.empty((joints, 3))
    for t in range(begin, end):
        moment = t + shift + pace * (t - centre)
        if _distance(first, second, t, moment) <= NEAR_M and _turned(first, second, t, moment, errors, slopes):
            result[t - begin] = errors
    return result


@njit(cache=True, nogil=True)
def is_supported(first: F32, second: F32, shift: int, start: int, stop: int) -> bool:
    """Return whether most of some frames around [start, stop) have near poses, up to a frame from a shift.

    Parameters
    ----------
    first, second : float32 array (T, J, 3)
        Poses of two takes, as for `same_motion`.
    shift : int
        Frame i of the second take is near frame i + shift of the first.
    start, stop : int
        Frames of the second take; `AROUND` frames before and after count as well.
    """
    low, high = max(0, -shift, start - AROUND), min(len(second), len(first) - shift, stop + AROUND)
    stride = max(1, (high - low) // _PROBED)
    for step in range(-4, 5):
        near, count = 0, 0
        for t in range(low, high, stride):
            count += 1
            near += _distance(first, second, t, t + shift + 0.25 * step) <= PROBED_M
        if count and 3 * near >= 2 * count:
            return True
    return False


@njit(cache=True, nogil=True)
def _normal_equations(
    first: F32, second: F32, begin: int, end: int, shift: float, pace: float, centre: float
) -> tuple[float, float, float, float, float]:
    """Return the sums of squared slopes times 1, τ and τ², and of slopes times errors times 1 and τ; τ = t − centre.

    Frames whose poses are not near do not count.
    """
    joints = first.shape[1]
    errors, slopes = np.empty((joints, 3)), np.empty((joints, 3))
    square, along, across, right, left = 0.0, 0.0, 0.0, 0.0, 0.0
    stride = max(1, (end - begin) // (2 * MAX_SAMPLED_FRAMES))
    for t in range(begin, end, stride):
        if not _turned(first, second, t, t + shift + pace * (t - centre), errors, slopes):
            continue
        count, far, own, product = 0, 0.0, 0.0, 0.0
        for j in range(joints):
            if errors[j, 0] == errors[j, 0]:
                count += 1
                for x in range(3):
                    far += errors[j, x] ** 2
                    own += slopes[j, x] ** 2
                    product += slopes[j, x] * errors[j, x]
        if count == 0 or far > count * NEAR_M**2:
            continue
        tau = t - centre
        square, along, across = square + own, along + own * tau, across + own * tau * tau
        right, left = right + product, left + product * tau
    return square, along, across, right, left


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
