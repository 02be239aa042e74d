"""Figures of a take by which a wrong reading shows: size, proportions, up axis, sides, ground, speed and tempo.

Geometry is measured in `SAMPLED` valid frames, spread evenly over the take; speeds in all frames.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.body.left_right import left_right
from kinedex.ops.body.tempo import tempo
from kinedex.ops.body.up_axis import up_axis

F64 = npt.NDArray[np.float64]

SAMPLED = 32
"""Frames in which geometry is measured."""

UNKNOWN = float("nan")

_LIMBS = {
    "thigh": ("hip", "knee"), "shank": ("knee", "ankle"), "upper_arm": ("shoulder", "elbow"),
    "forearm": ("elbow", "wrist"),
}  # fmt: skip
_TRUNK = ("root", "belly", "chest", "neck", "head", "headtop")
_FEET = ("lankle", "rankle", "ltoes", "rtoes")
_SWUNG = ("lankle", "rankle", "lwrist", "rwrist")
_UPRIGHT = 1.1  # the share that feet and the slope of the pelvis add to the length of legs and trunk
_FIXED_M = 0.01  # a root that moves by less up and down is fixed, and its body has no ground
_STILL_M = 0.1  # hands and feet that move within less show no tempo
_BIN_M_S, _BINS = 0.25, 4000  # of the histogram of speeds


@dataclass(frozen=True)
class Plausibility:
    """The figures of one take; a figure that its joints do not show is NaN.

    Attributes
    ----------
    height_m : float
        The height of the body along its legs and trunk, metres.
    thigh_share, shank_share, upper_arm_share, forearm_share : float
        The lengths of limbs, mean of left and right, as shares of the height.
    neck_share : float
        How far the neck lies above the middle of the shoulders along the trunk, as a share of the height.
    asymmetry : float
        The largest difference between the left and the right limb, as a share of their mean.
    bone_variation : float
        The largest standard deviation of the length of a limb over time, as a share of its mean.
    up_axis : str
        The axis along which the body stands: "y" for a take that is read rightly, empty where nothing decides.
    up_confidence : float
        The confidence of the up axis, from 0 to 1.
    left_right : float
        From −1 (left is on the right) to 1, by toes and knees, or by shoulders or knees that contradict the hips.
    floor_m : float
        The median height of the lowest foot, metres; NaN for a body whose root is fixed in space.
    speed_m_s : float
        The mean speed of all joints.
    fast_m_s : float
        The 99th percentile of the speeds of joints.
    fastest_m_s : float
        The largest speed of a joint between two frames.
    tempo_hz, acceleration_m_s2 : float
        The tempo of hands and feet, and the 90th percentile of their acceleration.
    repeated_share : float
        The share of frames that are equal to the one before.
    seconds : float
        The time in which speeds are measured.
    fastest : (str, int) or None
        The fastest joint, and the frame before its fastest step.
    reasons : tuple of str
        Phrases on up axis and sides, with their figures.
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
    reasons: tuple[str, ...] = ()


def plausibility(
    positions: F64, joints: tuple[str, ...], rate_hz: float, valid: npt.NDArray[np.bool_] | None = None
) -> Plausibility:
    """Measure the figures of a take.

    Parameters
    ----------
    positions : float64 array (J, 3, T)
        Joint positions in metres, Y up; NaN for an unknown joint.
    joints : tuple of str
        The names of the J joints.
    rate_hz : float
        Frames per second.
    valid : bool array (T,), optional
        The frames that count; None for all.

    Returns
    -------
    Plausibility
        The figures.
    """
    frames = np.arange(positions.shape[2]) if valid is None else np.flatnonzero(valid)
    if not len(frames):
        return Plausibility()
    sampled = positions[:, :, frames[np.linspace(0, len(frames) - 1, min(SAMPLED, len(frames))).round().astype(int)]]
    known = np.isfinite(sampled).reshape(len(joints), -1).sum(axis=1) == sampled[0].size
    places = {joint: sampled[i] for i, joint in enumerate(joints) if known[i]}
    up, sides = up_axis(places), left_right(places)
    found = _body(places)
    found |= {"up_axis": up.axis, "up_confidence": up.confidence}
    crossed = sides.lines < 0  # false for NaN
    found["left_right"] = float(np.fmin(sides.legs, sides.lines)) if crossed else sides.legs
    found |= _motion(positions, joints, rate_hz, frames if valid is not None else None)
    return Plausibility(**found, reasons=(*up.reasons, *sides.reasons))


def _body(places: Mapping[str, F64]) -> dict[str, Any]:
    """Return height, proportions, symmetry, bone lengths and ground."""
    pairs = [(side + upper, side + lower) for upper, lower in _LIMBS.values() for side in "lr"]
    pairs = [pair for pair in pairs if pair[0] in places and pair[1] in places]
    trunk = list(pairwise(joint for joint in _TRUNK if joint in places))
    lengths = {pair: _length(places[pair[0]], places[pair[1]]) for pair in (*pairs, *trunk)}
    mean, asymmetry = {}, []
    for limb, (upper, lower) in _LIMBS.items():
        both = [(side + upper, side + lower) for side in "lr"]
        sides = [lengths[pair][0] for pair in both if pair in lengths]
        mean[limb] = sum(sides) / len(sides) if sides else UNKNOWN
        if len(sides) == 2 and mean[limb] > 0:
            asymmetry.append(abs(sides[0] - sides[1]) / mean[limb])
    height = UNKNOWN
    if {"root", "head"} <= places.keys():
        height = _UPRIGHT * (mean["thigh"] + mean["shank"] + sum(lengths[pair][0] for pair in trunk))
    found: dict[str, Any] = {f"{limb}_share": length / height for limb, length in mean.items() if height > 0}
    neck = UNKNOWN
    if height > 0 and {"neck", "lshoulder", "rshoulder"} <= places.keys():
        ends = [places.get(joint, np.zeros((3, 0))) for joint in ("lelbow", "relbow")]
        neck = _neck(places["neck"], places["root"], places["lshoulder"], places["rshoulder"], *ends) / height
    return found | {
        "height_m": height,
        "neck_share": neck,
        "asymmetry": max(asymmetry, default=UNKNOWN),
        "bone_variation": max((lengths[pair][1] for pair in pairs), default=UNKNOWN),
        "floor_m": _floor(places),
    }


@njit(cache=True, nogil=True, error_model="numpy")
def _length(a: F64, b: F64) -> tuple[float, float]:
    """Return the median distance of two joints, and its standard deviation as a share of it."""
    frames = a.shape[1]
    lengths = np.empty(frames)
    for t in range(frames):
        x, y, z = b[0, t] - a[0, t], b[1, t] - a[1, t], b[2, t] - a[2, t]
        lengths[t] = math.sqrt(x * x + y * y + z * z)
    median = np.sort(lengths)[frames // 2]
    return median, lengths.std() / median


@njit(cache=True, nogil=True, error_model="numpy")
def _neck(neck: F64, root: F64, lshoulder: F64, rshoulder: F64, lelbow: F64, relbow: F64) -> float:
    """Return how far the neck lies above the middle of the shoulders along the trunk, with hanging arms if they do."""
    frames = neck.shape[1]
    above, hanging = np.empty(frames), np.zeros(frames, np.bool_)
    for t in range(frames):
        trunk = neck[:, t] - root[:, t]
        trunk /= math.sqrt((trunk * trunk).sum())
        shoulders = 0.5 * (lshoulder[:, t] + rshoulder[:, t])
        above[t] = ((neck[:, t] - shoulders) * trunk).sum()
        if lelbow.shape[1] == frames and relbow.shape[1] == frames:
            arms = shoulders - 0.5 * (lelbow[:, t] + relbow[:, t])
            hanging[t] = (arms * trunk).sum() > 0.7 * math.sqrt((arms * arms).sum())
    return np.median(above[hanging]) if hanging.any() else np.median(above)


def _floor(places: Mapping[str, F64]) -> float:
    feet = [places[joint][1] for joint in _FEET if joint in places]
    root = places.get("root")
    if not feet or (root is not None and root.shape[1] > 1 and np.ptp(root[1]) < _FIXED_M and abs(root[1, 0]) < 0.05):
        return UNKNOWN
    lowest = np.sort(np.minimum.reduce(feet))
    return float(lowest[len(lowest) // 2])


def _motion(
    positions: F64, joints: tuple[str, ...], rate_hz: float, frames: npt.NDArray[np.intp] | None
) -> dict[str, Any]:
    """Return speeds, repeated frames and tempo."""
    known = np.ones(positions.shape[2], np.bool_)
    if frames is not None:
        known[:] = False
        known[frames] = True
    total, counted, repeated, steps, fastest, joint, frame, bins = _speeds(
        np.ascontiguousarray(positions), known, rate_hz
    )
    if not counted:
        return {}
    found: dict[str, Any] = {
        "speed_m_s": total / counted,
        "fast_m_s": _BIN_M_S * float(np.searchsorted(np.cumsum(bins), 0.99 * counted) + 1),
        "fastest_m_s": fastest,
        "repeated_share": repeated / steps,
        "seconds": steps / rate_hz,
        "fastest": (joints[joint], frame),
    }
    tracks = positions[[i for i, name in enumerate(joints) if name in _SWUNG]]
    swing = _swing(tracks)
    swung = tempo(tracks[swing > 0], rate_hz) if (swing > _STILL_M).any() else None
    if swung is not None:
        found |= {"tempo_hz": swung.hz, "acceleration_m_s2": swung.acceleration}
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _swing(tracks: F64) -> F64:
    """Return the largest range (N,) of the coordinates of each point; 0 for one that is never known."""
    swing = np.zeros(len(tracks))
    for j in range(len(tracks)):
        for k in range(3):
            low, high = np.inf, -np.inf
            for place in tracks[j, k]:
                low, high = min(low, place), max(high, place)  # a comparison with NaN is false
            swing[j] = max(swing[j], high - low)
    return swing


@njit(cache=True, nogil=True, error_model="numpy")
def _speeds(
    positions: F64, known: npt.NDArray[np.bool_], rate_hz: float
) -> tuple[float, int, int, int, float, int, int, npt.NDArray[np.int64]]:
    """Return sum and number of speeds, repeated frames, steps, the largest speed, its joint and frame, a histogram."""
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
    return total, counted, repeated, max(steps, 1), fastest, joint, frame, bins
