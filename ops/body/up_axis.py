"""This module judges which axis of a file is vertical, from the positions of a body's joints.

    up = up_axis(places, rest)          # places: {"root": (3, K), "head": (3, K), "lankle": …}, rest: {"root": (3,), …}
    if up.axis:                         # "x", "y", "z", "-x", "-y" or "-z"; "" where nothing decides
        print(up.axis, up.confidence, *up.reasons, sep="; ")

The judgement combines three observations. None of them prefers an axis, so rotating the body rotates the result:

- *posture*: in most frames the head is above the hips, and the hips are above the feet;
- *ground*: over time the lowest point of the body stays at one height, whereas the hips travel across the ground;
- *rest pose*: a skeleton that stands in its rest pose stands along the vertical axis.

A body that lies still looks like a standing body that was rotated. Therefore posture alone decides only if neither
ground nor rest pose contradicts it. For a body that lies or hangs throughout, the result is undecided, and the caller
should use the axis of the file format. (A body that lies still, in a file without a rest pose, is taken for a standing
body, with a confidence of 0.8.)

The module also judges from joint positions alone whether the left and right of a body are exchanged. Toes lie in front
of the ankles, and knees bend forwards. Both determine the direction that the body faces without using the names left
and right, and the left hip must lie to the left of this direction. The judgement holds in any right-handed axes,
whichever of them is up. Exchanged names and a mirrored axis cannot be distinguished, and give the same result.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64
from kinedex.ops.order_statistics import median, order_statistic

SURE = 0.5
"""Minimum confidence of an axis that is returned."""

AXES = ("x", "y", "z", "-x", "-y", "-z")

HEADS = (("head",), ("headtop",), ("neck",), ("lshoulder", "rshoulder"), ("lclavicle", "rclavicle"), ("chest",))
HIPS = (("lhip", "rhip"), ("root",), ("belly",))
FEET = (("lankle", "rankle"), ("ltoes", "rtoes"), ("lknee", "rknee"))
_STRAIGHT, _LEANING, _BENT = 0.75, 0.85, 0.4
"""Cosines with the vertical axis: of trunk and legs of a standing body, and of the trunk and the legs of a sitting one.
"""

_HALF_BODY = 0.75  # weight of the posture of a trunk without legs, or of legs without a trunk
# weight of a frame in which only the trunk is upright, since a crawling body looks like that when rotated
_SITTING = 0.5
_GROUND, _REST = 0.5, 0.7  # weights of ground and rest pose relative to posture
_ONCE = 0.05  # share of frames with the body upright along an axis from which ground has twice its weight for that axis
_LEVEL = 0.15  # body sizes; if the lowest point varies by more, there is no level ground
# body sizes; the excess of the hips' travel over the lowest point's variation at which ground has its full weight
_TRAVEL = 0.08
_ENDS = 2.0  # factor of the lead of an axis over its opposite axis
_NO_BODY = ("no hips with head or feet",)
GAIN = 1.6  # confidence is 1 − exp(−GAIN · lead)

CLEAR = 0.15
"""Values nearer to 0 than this are inconclusive; takes of HDM05, CMU and Bandai have values of 0.37 and more."""

_KNEE_BENT = 0.15  # leg lengths; a knee so far off the line from hip to ankle counts as fully bent
_TOES, _KNEES = 2.0, 1.0  # weights of the evidence of toes and of knees


@dataclass(frozen=True)
class UpAxis:
    """The axis that points up, with its confidence.

    Attributes
    ----------
    axis : str
        One of `AXES`; empty if the confidence is below `SURE`.
    confidence : float
        A number from 0 to 1, which grows with the lead of the best axis over the second.
    reasons : tuple of str
        Phrases on posture, ground and rest pose, with numbers.
    """

    axis: str
    confidence: float
    reasons: tuple[str, ...]


def up_axis(positions: Mapping[str, F64], rest: Mapping[str, F64] | None = None) -> UpAxis:
    """Judge which of the axes ±x, ±y and ±z points up.

    Parameters
    ----------
    positions : mapping of str to float64 array (3, K)
        Any of the 24 named joints, in K sampled frames, in any unit and axes; NaN if a joint is not seen. Head, hips
        and feet are used for posture, and all joints for the ground. About 32 frames, spread over the take, suffice.
    rest : mapping of str to float64 array (3,), optional
        The same joints in the rest pose of the skeleton, if the file has one.

    Returns
    -------
    UpAxis
        Axis, confidence and reasons. The result is undecided for a body without hips, or without both head and feet.
    """
    hips, head, feet = (_pair(positions, choices) for choices in (HIPS, HEADS, FEET))
    if not len(hips) or not (len(head) or len(feet)):
        return UpAxis("", 0.0, _NO_BODY)
    share, stood, frames = posture_shares(hips, head, feet)
    if not frames:
        return UpAxis("", 0.0, _NO_BODY)
    standing = _standing({joint: np.reshape(place, (3, 1)) for joint, place in rest.items()}) if rest else np.zeros(6)
    lowest, travel, grounded = np.zeros(6), np.zeros(3), False
    if len(feet):
        lowest, travel, grounded = point_spreads(np.array(list(positions.values()), np.float64), hips)
    leads = least_leads(share, standing, lowest, travel, grounded)
    best = int(np.argmax(leads))
    confidence = 1.0 - math.exp(-GAIN * max(float(leads[best]), 0.0))
    parts = " and ".join(", ".join(["head"] * bool(len(head)) + ["hips"] + ["feet"] * bool(len(feet))).rsplit(", ", 1))
    reasons = [f"{parts} stand along {AXES[best]} in {100 * stood[best] / frames:.0f} % of {frames} frames"]
    other = max((axis for axis in range(6) if axis != best), key=lambda axis: stood[axis])
    if stood[other] > 0:
        reasons[0] += f", along {AXES[other]} in {100 * stood[other] / frames:.0f} %"
    if grounded:
        across = ", ".join(f"{AXES[a]} {travel[a]:.2f}" for a in range(3) if a != best % 3)
        level = f"the lowest point varies by {lowest[best]:.2f} body sizes along {AXES[best]}"
        reasons.append(f"{level}, the hips across it by {across}")
    if standing.any():
        reasons.append(f"the rest pose stands along {AXES[int(np.argmax(standing))]}")
    return UpAxis(AXES[best] if confidence >= SURE else "", confidence, tuple(reasons))


def _pair(positions: Mapping[str, F64], choices: tuple[tuple[str, ...], ...]) -> F64:
    """Return the positions (2, 3, K) of the first pair of joints that is known, (0, 3, 0) if none is."""
    for names in choices:
        if all(name in positions for name in names):
            return np.array([positions[names[0]], positions[names[-1]]], np.float64)
    return np.zeros((0, 3, 0))


def _standing(rest: Mapping[str, F64]) -> F64:
    """Return a score (6,) of how upright the rest pose is along each axis."""
    hips, head, feet = (_pair(rest, choices) for choices in (HIPS, HEADS, FEET))
    return posture_shares(hips, head, feet)[0] if len(hips) and (len(head) or len(feet)) else np.zeros(6)


@njit(cache=True, nogil=True, error_model="numpy")
def _middle(pair: F64, k: int, t: int) -> float:
    """Return a coordinate of the midpoint of two joints, or of the known joint if the other is not known."""
    a, b = pair[0, k, t], pair[1, k, t]
    return b if np.isnan(a) else a if np.isnan(b) else 0.5 * (a + b)


@njit(cache=True, nogil=True, error_model="numpy")
def posture_shares(hips: F64, head: F64, feet: F64) -> tuple[F64, F64, int]:
    """Return for each axis the weighted share and the number of frames in which the body is upright along it.

    A frame has a lower weight if the body sits, or if only one half of the body is known. The last value is the number
    of frames in which the joints are known.
    """
    share, stood = np.zeros(6), np.zeros(6)
    seen = 0
    for t in range(hips.shape[2]):
        trunk, legs = np.empty(3), np.empty(3)
        for k in range(3):
            middle = _middle(hips, k, t)
            trunk[k] = _middle(head, k, t) - middle if len(head) else 0.0
            legs[k] = middle - _middle(feet, k, t) if len(feet) else 0.0
        trunk /= math.sqrt(trunk[0] * trunk[0] + trunk[1] * trunk[1] + trunk[2] * trunk[2]) if len(head) else 1.0
        legs /= math.sqrt(legs[0] * legs[0] + legs[1] * legs[1] + legs[2] * legs[2]) if len(feet) else 1.0
        if not (np.isfinite(trunk[0]) and np.isfinite(legs[0])):
            continue
        seen += 1
        for axis in range(6):
            sign = 1.0 if axis < 3 else -1.0
            up, down = sign * trunk[axis % 3], sign * legs[axis % 3]
            vote = 0.0
            if not len(head) or not len(feet):
                vote = _HALF_BODY if up + down > _STRAIGHT else 0.0
            elif up > _STRAIGHT and down > _STRAIGHT:
                vote = 1.0
            elif up > _LEANING and down > _BENT:
                vote = _SITTING
            share[axis] += vote
            stood[axis] += vote > 0.0
    return share / max(seen, 1), stood, seen


@njit(cache=True, nogil=True, error_model="numpy")
def point_spreads(positions: F64, hips: F64) -> tuple[F64, F64, bool]:
    """Return the ranges of the lowest point along each axis (6,) and of the hips (3,), in body sizes.

    The last value is False if too few frames are known; the ranges are 0 then.
    """
    joints, _, frames = positions.shape
    tracks = np.empty((9, frames))
    sizes = np.empty(frames)
    whole = 0
    for t in range(frames):
        size, known = 0.0, True
        for k in range(3):
            low, high = np.inf, -np.inf
            for j in range(joints):
                place = positions[j, k, t]
                known = known and np.isfinite(place)
                low, high = min(low, place), max(high, place)
            middle = _middle(hips, k, t)
            known = known and np.isfinite(middle)
            tracks[k, whole], tracks[3 + k, whole], tracks[6 + k, whole] = low, -high, middle
            size += (high - low) * (high - low)
        if known:
            sizes[whole] = math.sqrt(size)
            whole += 1
    lowest, travel = np.zeros(6), np.zeros(3)
    if whole < 3:
        return lowest, travel, False
    size = median(sizes[:whole])
    if not 0.0 < size < np.inf:
        return lowest, travel, False
    cut = whole // 8
    for i in range(9):
        track = tracks[i, :whole]
        spread = (order_statistic(track, whole - 1 - cut) - order_statistic(track, cut)) / size
        if i < 6:
            lowest[i] = spread
        else:
            travel[i - 6] = spread
    return lowest, travel, True


@njit(cache=True, nogil=True, error_model="numpy")
def least_leads(share: F64, standing: F64, lowest: F64, travel: F64, grounded: bool) -> F64:
    """Return the lead of each axis (6,), which is the least amount by which it exceeds any other axis.

    The lead over axes of other directions is a difference of scores, and the lead over the opposite axis is a
    difference of posture relative to the sum of both.
    """
    stance = share + _REST * standing
    score = stance.copy()
    for axis in range(6) if grounded else range(0):
        far = max(travel[(axis + 1) % 3], travel[(axis + 2) % 3])
        clear = min(max((far - lowest[axis]) / _TRAVEL, 0.0), 1.0) * max(1.0 - lowest[axis] / _LEVEL, 0.0)
        score[axis] += _GROUND * (2.0 if share[axis] > _ONCE else 1.0) * clear
    leads = np.empty(6)
    for axis in range(6):
        other_end = stance[(axis + 3) % 6]
        both = stance[axis] + other_end
        leads[axis] = _ENDS * (stance[axis] - other_end) / both if both > 0.0 else 0.0
        for other in range(6):
            if other % 3 != axis % 3:
                leads[axis] = min(leads[axis], score[axis] - score[other])
    return leads


@dataclass(frozen=True)
class LeftRight:
    """The agreement between the names of a body's left and right joints and its geometry.

    Attributes
    ----------
    legs : float
        A number from −1 (the legs are exchanged) to 1 (they are not), judged by toes and knees; NaN without legs.
    lines : float
        The smaller of two mean cosines: between the lines through the shoulders and the hips, and between the lines
        through the knees and the hips. It is below 0 if one of the pairs is exchanged, and NaN without shoulders and
        knees.
    reasons : tuple of str
        Phrases with the numbers.
    """

    legs: float
    lines: float
    reasons: tuple[str, ...]

    @property
    def swapped(self) -> bool:
        """Return whether the sides are clearly exchanged, for the whole body or for a pair of joints."""
        return bool(self.legs < -CLEAR or self.lines < -CLEAR)


def left_right(positions: Mapping[str, F64]) -> LeftRight:
    """Judge whether the joints named left lie on the body's left.

    Parameters
    ----------
    positions : mapping of str to float64 array (3, K)
        Any of the 24 named joints in K sampled frames, in any unit and any right-handed axes; NaN if a joint is not
        seen. The judgement of the legs needs both hips, knees and ankles; toes are used if they are given.

    Returns
    -------
    LeftRight
        The measures; NaN where joints are missing.
    """
    if "lhip" not in positions or "rhip" not in positions:
        return LeftRight(float("nan"), float("nan"), ("no hips",))
    absent = np.full(positions["lhip"].shape, np.nan)
    pairs = (
        np.array([positions.get(f"l{name}", absent), positions.get(f"r{name}", absent)], np.float64)
        for name in ("hip", "knee", "ankle", "toes", "shoulder")
    )
    legs, shoulders, knees = side_agreement(*pairs)
    lines = {"shoulders": shoulders, "knees": knees}
    reasons = []
    if legs == legs:
        side = "no side is clear" if abs(legs) < CLEAR else f"left is on the {'left' if legs > 0 else 'right'}"
        reasons.append(f"by toes and knees {side} ({legs:+.2f})")
    reasons += [
        f"the {pair} lie the other way round than the hips ({line:+.2f})"
        for pair, line in lines.items()
        if line < -CLEAR
    ]
    known = [line for line in lines.values() if line == line]
    return LeftRight(legs, min(known, default=float("nan")), tuple(reasons))


@njit(cache=True, nogil=True, error_model="numpy")
def side_agreement(hips: F64, knees: F64, ankles: F64, toes: F64, shoulders: F64) -> tuple[float, float, float]:
    """Return the agreement of the legs with their names, and the mean cosines of shoulders and knees with the hips."""
    across = hips[0] - hips[1]
    total, weights = 0.0, 0.0
    for s in range(2):
        toe, toe_frames, knee, knee_frames = 0.0, 0, 0.0, 0
        for t in range(hips.shape[2]):
            shank = knees[s, :, t] - ankles[s, :, t]
            cue = _cosine(toes[s, :, t] - ankles[s, :, t], _cross(across[:, t], shank))
            if cue == cue:
                toe += cue
                toe_frames += 1
            front = _cross(across[:, t], hips[s, :, t] - ankles[s, :, t])
            thigh = hips[s, :, t] - knees[s, :, t]
            length = math.sqrt(_dot(thigh, thigh)) + math.sqrt(_dot(shank, shank))
            bend = _dot(shank, front) / math.sqrt(_dot(front, front)) / (_KNEE_BENT * length)
            if bend == bend:
                knee += min(max(bend, -1.0), 1.0)
                knee_frames += 1
        if toe_frames:
            total += _TOES * toe / toe_frames
            weights += _TOES
        if knee_frames:
            total += _KNEES * knee / knee_frames
            weights += _KNEES
    legs = total / weights if weights > 0.0 else np.nan
    return legs, _parallel(shoulders, across), _parallel(knees, across)


@njit(cache=True, nogil=True, error_model="numpy")
def _parallel(pair: F64, across: F64) -> float:
    """Return the mean cosine of a line through two joints and the line through the hips; NaN if not known."""
    total, frames = 0.0, 0
    for t in range(across.shape[1]):
        cosine = _cosine(pair[0, :, t] - pair[1, :, t], across[:, t])
        if cosine == cosine:
            total += cosine
            frames += 1
    return total / frames if frames else np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def _cosine(a: F64, b: F64) -> float:
    return _dot(a, b) / math.sqrt(_dot(a, a) * _dot(b, b))


@njit(cache=True, nogil=True, error_model="numpy")
def _dot(a: F64, b: F64) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@njit(cache=True, nogil=True, error_model="numpy")
def _cross(a: F64, b: F64) -> F64:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
