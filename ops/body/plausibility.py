"""This module measures size, proportions, axes, ground and speed of a take, to reveal a file that was read wrongly.

Geometry is measured in `SAMPLED` valid frames, spread evenly over the take, and speeds in all frames.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.body.motion_faults import MotionFaults, motion_faults
from kinedex.ops.body.tempo import tempo
from kinedex.ops.body.up_axis import (
    AXES,
    FEET,
    GAIN,
    HEADS,
    HIPS,
    SURE,
    least_leads,
    left_right,
    point_spreads,
    posture_shares,
    side_agreement,
    up_axis,
)
from kinedex.ops.copies import copy_table
from kinedex.ops.order_statistics import median, order_statistic

SAMPLED = 32
"""Number of frames in which geometry is measured."""

UNKNOWN = float("nan")

_JOINTS = (
    "root", "lhip", "rhip", "lknee", "rknee", "lankle", "rankle", "ltoes", "rtoes", "belly", "chest", "neck", "head",
    "headtop", "lclavicle", "rclavicle", "lshoulder", "rshoulder", "lelbow", "relbow", "lwrist", "rwrist",
)  # fmt: skip
_ROOT, _NECK, _LSHOULDER, _LELBOW, _FIRST_FOOT = (
    _JOINTS.index(j) for j in ("root", "neck", "lshoulder", "lelbow", "lankle")
)


def _indices(rows: Iterable[Sequence[str]]) -> I64:
    return np.array([[_JOINTS.index(joint) for joint in (row[0], row[-1])] for row in rows])


_LIMBS = (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
_PAIRS = _indices((side + a, side + b) for a, b in _LIMBS for side in "lr")
_HIP_CHOICES, _HEAD_CHOICES, _FOOT_CHOICES = _indices(HIPS), _indices(HEADS), _indices(FEET)
_TRUNK = tuple(_JOINTS.index(joint) for joint in ("root", "belly", "chest", "neck", "head", "headtop"))
_SIDES = tuple(_JOINTS.index("l" + name) for name in ("hip", "knee", "ankle", "toes", "shoulder"))
_SWUNG = tuple(_JOINTS.index(joint) for joint in ("lankle", "rankle", "lwrist", "rwrist"))
_UPRIGHT = 1.1  # factor of the standing height over legs plus trunk, for the feet and the slope of the pelvis
_FIXED_M = 0.01  # a root whose height varies by less is fixed in space, so that the body has no ground
_AT_ORIGIN_M = 0.05  # a fixed root this close to y = 0 has no floor below it
_STILL_M = 0.1  # wrists and ankles that move within a smaller range give no tempo
_BIN_M_S, _BINS = 0.25, 4000  # width in m/s and number of bins of the histogram of speeds


@dataclass(frozen=True)
class Plausibility(MotionFaults):
    """The measures of one take, in addition to those of `MotionFaults`; a measure whose joints are missing is NaN.

    Attributes
    ----------
    height_m : float
        The height of the body along its legs and trunk, in metres.
    thigh_share, shank_share, upper_arm_share, forearm_share : float
        The lengths of limbs, averaged over left and right, as fractions of the height.
    neck_share : float
        The distance of the neck above the middle of the shoulders along the trunk, as a fraction of the height.
    asymmetry : float
        The largest difference between the left and the right limb, as a fraction of their mean.
    bone_variation : float
        The largest standard deviation of the length of a limb over time, as a fraction of its mean.
    up_axis : str
        The axis along which the body stands; "y" for a take that was read correctly, empty if it cannot be determined.
    up_confidence : float
        The confidence of the up axis, from 0 to 1.
    left_right : float
        A number from −1 (left and right are exchanged) to 1 (they are not), judged by toes and knees, or by shoulders
        or knees that contradict the hips.
    floor_m : float
        The median height of the lowest foot in metres; NaN for a body whose root is fixed in space.
    speed_m_s : float
        The mean speed of all joints.
    fast_m_s : float
        The 99th percentile of the speeds of joints.
    fastest_m_s : float
        The largest speed of a joint between two frames.
    tempo_hz, acceleration_m_s2 : float
        The tempo of hands and feet (`ops.body.tempo`), and the 90th percentile of their acceleration.
    repeated_share : float
        The fraction of frames that are equal to the previous frame.
    seconds : float
        The total time over which speeds are measured.
    fastest : (str, int) or None
        The joint of the largest speed, and the first of the two frames between which it occurs.
    """

    height_m: float = UNKNOWN
    thigh_share: float = UNKNOWN
    shank_share: float = UNKNOWN
    upper_arm_share: float = UNKNOWN
    forearm_share: float = UNKNOWN
    neck_share: float = UNKNOWN
    asymmetry: float = UNKNOWN
    bone_variation: float = UNKNOWN
    up_axis: str = ""
    up_confidence: float = 0.0
    left_right: float = UNKNOWN
    floor_m: float = UNKNOWN
    speed_m_s: float = UNKNOWN
    fast_m_s: float = UNKNOWN
    fastest_m_s: float = UNKNOWN
    tempo_hz: float = UNKNOWN
    acceleration_m_s2: float = UNKNOWN
    repeated_share: float = UNKNOWN
    seconds: float = 0.0
    fastest: tuple[str, int] | None = None


def plausibility(positions: F64, joints: tuple[str, ...], rate_hz: float, valid: Bool | None = None) -> Plausibility:
    """Compute the plausibility measures of a take.

    Parameters
    ----------
    positions : float64 array (J, 3, T)
        Joint positions in metres, Y up; NaN for an unknown joint.
    joints : tuple of str
        The names of the J joints.
    rate_hz : float
        Frames per second.
    valid : bool array (T,), optional
        The frames to measure; None for all.

    Returns
    -------
    Plausibility
        The measures.
    """
    counted = np.ones(positions.shape[2], np.bool_) if valid is None else valid
    if not counted.any():
        return Plausibility()
    positions = np.ascontiguousarray(positions, np.float64)
    at = _places_of(tuple(joints))
    limbs, leads, others = _geometry(sampled_frames(positions, counted), at)
    lengths, variations = limbs[:, 0].tolist(), limbs[:, 1].tolist()
    mean, asymmetry = [], []
    for left in range(0, len(lengths), 2):
        sides = [length for length in lengths[left : left + 2] if length == length]
        mean.append(sum(sides) / len(sides) if sides else UNKNOWN)
        if len(sides) == 2 and mean[-1] > 0:
            asymmetry.append(abs(sides[0] - sides[1]) / mean[-1])
    spine, neck, legs, shoulders, knees, floor = others.tolist()
    height = _UPRIGHT * (mean[0] + mean[1] + spine)
    thigh, shank, upper_arm, forearm = (length / height if height > 0 else UNKNOWN for length in mean)
    best = int(np.argmax(leads))
    confidence = 1.0 - math.exp(-GAIN * max(float(leads[best]), 0.0))
    crossed = [line for line in (shoulders, knees) if line < 0]  # not for NaN
    return Plausibility(
        height_m=height,
        thigh_share=thigh,
        shank_share=shank,
        upper_arm_share=upper_arm,
        forearm_share=forearm,
        neck_share=neck / height if height > 0 else UNKNOWN,
        asymmetry=max(asymmetry, default=UNKNOWN),
        bone_variation=max((variation for variation in variations if variation == variation), default=UNKNOWN),
        up_axis=AXES[best] if confidence >= SURE else "",
        up_confidence=confidence,
        left_right=min((line for line in (legs, *crossed) if line == line), default=UNKNOWN),
        floor_m=floor,
        **_motion(positions, joints, rate_hz, counted, at),
        **vars(motion_faults(positions, joints, rate_hz, counted)),
    )


def reasons(positions: F64, joints: tuple[str, ...], valid: Bool | None = None) -> tuple[str, ...]:
    """Return phrases with numbers that explain the judged up axis and sides, from the arguments of `plausibility`."""
    counted = np.ones(positions.shape[2], np.bool_) if valid is None else valid
    if not counted.any():
        return ()
    sampled = sampled_frames(np.ascontiguousarray(positions, np.float64), counted)
    places = {joint: sampled[i] for i, joint in enumerate(joints) if np.isfinite(sampled[i]).all()}
    return (*up_axis(places).reasons, *left_right(places).reasons)


@lru_cache(maxsize=16)
def _places_of(joints: tuple[str, ...]) -> I64:
    """Return the index of each of `_JOINTS`, −1 for a joint that the take lacks."""
    return np.array([joints.index(joint) if joint in joints else -1 for joint in _JOINTS])


@njit(cache=True, nogil=True, error_model="numpy")
def sampled_frames(positions: F64, counted: Bool) -> F64:
    """Return the positions (J, 3, K) in at most `SAMPLED` of the counted frames, spread evenly."""
    frames = np.flatnonzero(counted)
    taken = min(len(frames), SAMPLED)
    sampled = np.empty((positions.shape[0], 3, taken))
    for i in range(taken):
        t = frames[round(i * (len(frames) - 1) / max(taken - 1, 1))]
        for j in range(positions.shape[0]):
            for k in range(3):
                sampled[j, k, i] = positions[j, k, t]
    return sampled


@njit(cache=True, nogil=True, error_model="numpy")
def _geometry(sampled: F64, at: I64) -> tuple[F64, F64, F64]:
    """Return the measures of single poses: limbs (8, 2), leads of the axes (6,), and other measures (6,).

    Limbs have their median length and its relative variation. The other measures are the length of the trunk, the
    height of the neck above the shoulders, the agreement of legs, shoulders and knees with their names (left or right),
    and the height of the lowest foot.
    """
    joints, _, frames = sampled.shape
    seen = np.zeros(joints, np.bool_)
    for j in range(joints):
        seen[j] = np.isfinite(sampled[j]).all()
    there = np.zeros(len(at), np.bool_)
    for i in range(len(at)):
        there[i] = at[i] >= 0 and seen[at[i]]
    limbs = np.full((len(_PAIRS), 2), np.nan)
    for i in range(len(_PAIRS)):
        if there[_PAIRS[i, 0]] and there[_PAIRS[i, 1]]:
            limbs[i, 0], limbs[i, 1] = _length(sampled[at[_PAIRS[i, 0]]], sampled[at[_PAIRS[i, 1]]])
    hips, head, feet = (
        _pair(sampled, at, there, _HIP_CHOICES), _pair(sampled, at, there, _HEAD_CHOICES),
        _pair(sampled, at, there, _FOOT_CHOICES),
    )  # fmt: skip
    leads = np.zeros(6)
    if len(hips) and (len(head) or len(feet)):
        share, _, _ = posture_shares(hips, head, feet)
        lowest, travel, grounded = np.zeros(6), np.zeros(3), False
        if len(feet):
            lowest, travel, grounded = point_spreads(sampled[seen], hips)
        leads = least_leads(share, np.zeros(6), lowest, travel, grounded)
    others = np.full(6, np.nan)
    others[0] = _spine(sampled, at, there)
    if there[_ROOT] and there[_NECK] and there[_LSHOULDER] and there[_LSHOULDER + 1]:
        others[1] = _neck(sampled, at, there)
    sides = np.full((5, 2, 3, frames), np.nan)
    for i in range(5):
        for side in range(2):
            if there[_SIDES[i] + side]:
                copy_table(sides[i, side], sampled[at[_SIDES[i] + side]])
    others[2], others[3], others[4] = side_agreement(sides[0], sides[1], sides[2], sides[3], sides[4])
    others[5] = _floor(sampled, at, there)
    return limbs, leads, others


@njit(cache=True, nogil=True, error_model="numpy")
def _pair(sampled: F64, at: I64, there: Bool, choices: I64) -> F64:
    """Return the positions (2, 3, K) of the first pair of joints that is known, (0, 3, 0) if none is."""
    for i in range(len(choices)):
        if there[choices[i, 0]] and there[choices[i, 1]]:
            pair = np.empty((2, 3, sampled.shape[2]))
            copy_table(pair[0], sampled[at[choices[i, 0]]])
            copy_table(pair[1], sampled[at[choices[i, 1]]])
            return pair
    return np.empty((0, 3, 0))


@njit(cache=True, nogil=True, error_model="numpy")
def _length(a: F64, b: F64) -> tuple[float, float]:
    """Return the median distance of two joints, and the standard deviation of the distance divided by the median."""
    frames = a.shape[1]
    lengths = np.empty(frames)
    for t in range(frames):
        x, y, z = b[0, t] - a[0, t], b[1, t] - a[1, t], b[2, t] - a[2, t]
        lengths[t] = math.sqrt(x * x + y * y + z * z)
    deviation = lengths.std()
    middle = order_statistic(lengths, frames // 2)
    return middle, deviation / middle


@njit(cache=True, nogil=True, error_model="numpy")
def _spine(sampled: F64, at: I64, there: Bool) -> float:
    """Return the length of the trunk from the root to the top of the head, NaN without root or head."""
    if not (there[_TRUNK[0]] and there[_TRUNK[4]]):
        return np.nan
    total, last = 0.0, _TRUNK[0]
    for i in range(1, len(_TRUNK)):
        if there[_TRUNK[i]]:
            total += _length(sampled[at[last]], sampled[at[_TRUNK[i]]])[0]
            last = _TRUNK[i]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _neck(sampled: F64, at: I64, there: Bool) -> float:
    """Return the median height of the neck above the midpoint of the shoulders, measured along the trunk.

    Only frames with hanging arms count, if there are any.
    """
    frames = sampled.shape[2]
    above, hanging = np.empty(frames), np.zeros(frames, np.bool_)
    elbows = there[_LELBOW] and there[_LELBOW + 1]
    for t in range(frames):
        neck = sampled[at[_NECK], :, t]
        trunk = neck - sampled[at[_ROOT], :, t]
        trunk /= math.sqrt((trunk * trunk).sum())
        shoulders = 0.5 * (sampled[at[_LSHOULDER], :, t] + sampled[at[_LSHOULDER + 1], :, t])
        above[t] = ((neck - shoulders) * trunk).sum()
        if elbows:
            arms = shoulders - 0.5 * (sampled[at[_LELBOW], :, t] + sampled[at[_LELBOW + 1], :, t])
            hanging[t] = (arms * trunk).sum() > 0.7 * math.sqrt((arms * arms).sum())
    return median(above[hanging]) if hanging.any() else median(above)


@njit(cache=True, nogil=True, error_model="numpy")
def _floor(sampled: F64, at: I64, there: Bool) -> float:
    """Return the median height of the lowest foot; NaN without feet, and for a root that is fixed at the origin."""
    frames = sampled.shape[2]
    if there[_ROOT] and frames > 1:
        root = sampled[at[_ROOT], 1]
        if root.max() - root.min() < _FIXED_M and abs(root[0]) < _AT_ORIGIN_M:
            return np.nan
    lowest, known = np.full(frames, np.inf), False
    for i in range(_FIRST_FOOT, _FIRST_FOOT + 4):
        if there[i]:
            known = True
            for t in range(frames):
                lowest[t] = min(lowest[t], sampled[at[i], 1, t])
    return order_statistic(lowest, frames // 2) if known else np.nan


def _motion(positions: F64, joints: tuple[str, ...], rate_hz: float, counted: Bool, at: I64) -> dict[str, Any]:
    """Return the measures of speed, repeated frames and tempo."""
    total, number, repeated, steps, fastest, joint, frame, fast = _speeds(positions, counted, float(rate_hz))
    if not number:
        return {}
    found: dict[str, Any] = {
        "speed_m_s": total / number,
        "fast_m_s": _BIN_M_S * fast,
        "fastest_m_s": fastest,
        "repeated_share": repeated / steps,
        "seconds": steps / rate_hz,
        "fastest": (joints[joint], frame),
    }
    swung = tempo(_swung(positions, at), rate_hz)
    if swung is not None:
        found |= {"tempo_hz": swung.hz, "acceleration_m_s2": swung.acceleration}
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _swung(positions: F64, at: I64) -> F64:
    """Return the tracks (N, 3, T) of known wrists and ankles; no track if all of them are still."""
    tracks = np.empty((len(_SWUNG), 3, positions.shape[2]))
    used, most = 0, 0.0
    for joint in _SWUNG:
        if at[joint] < 0:
            continue
        swing = 0.0
        for k in range(3):
            low, high = np.inf, -np.inf
            for place in positions[at[joint], k]:
                low, high = min(low, place), max(high, place)  # a comparison with NaN is false
            swing = max(swing, high - low)
        if swing > 0.0:
            copy_table(tracks[used], positions[at[joint]])
            used += 1
            most = max(most, swing)
    return tracks[: used if most > _STILL_M else 0]


@njit(cache=True, nogil=True, error_model="numpy")
def _speeds(positions: F64, known: Bool, rate_hz: float) -> tuple[float, int, int, int, float, int, int, int]:
    """Return statistics of the speeds of all joints.

    These are the sum and the number of speeds, the number of repeated frames, the number of steps between known frames
    (at least 1), the largest speed with its joint and frame, and the bin of the 99th percentile in the histogram.
    """
    joints, _, frames = positions.shape
    total, counted, fastest, joint, frame = 0.0, 0, 0.0, 0, 0
    bins = np.zeros(_BINS, np.int64)
    moved = np.zeros(frames, np.bool_)
    for j in range(joints):
        x, y, z = positions[j, 0], positions[j, 1], positions[j, 2]
        for t in range(frames - 1):
            dx, dy, dz = x[t + 1] - x[t], y[t + 1] - y[t], z[t + 1] - z[t]
            speed = math.sqrt(dx * dx + dy * dy + dz * dz) * rate_hz
            if not (speed < math.inf and known[t] and known[t + 1]):
                continue
            total += speed
            counted += 1
            bins[min(int(speed / _BIN_M_S), _BINS - 1)] += 1
            if speed > 0.0:
                moved[t] = True
            if speed > fastest:
                fastest, joint, frame = speed, j, t
    steps, repeated = 0, 0
    for t in range(frames - 1):
        if known[t] and known[t + 1]:
            steps += 1
            repeated += not moved[t]
    fast, below = 0, 0
    while fast < _BINS and below < 0.99 * counted:
        below += bins[fast]
        fast += 1
    return total, counted, repeated, max(steps, 1), fastest, joint, frame, fast
