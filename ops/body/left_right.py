"""This module judges from joint positions alone whether the left and right of a body are exchanged.

Toes lie in front of the ankles, and knees bend forwards. Both show the direction that the body faces without the words
left and right; the left hip then has to lie to the left of it. The judgement holds in any right-handed axes, whichever
of them is up. Exchanged names and a mirrored axis look the same, and give the same answer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64

CLEAR = 0.15
"""Values nearer to 0 than this decide nothing; takes of HDM05, CMU and Bandai have 0.37 and more."""

_BENT = 0.15  # leg lengths; a knee so far off the line from hip to ankle counts as fully bent
_TOES, _KNEES = 2.0, 1.0  # weights of the evidence of toes and of knees


@dataclass(frozen=True)
class LeftRight:
    """The result of the judgement whether the names of a body's sides agree with its geometry.

    Attributes
    ----------
    legs : float
        From −1 (left is on the right) to 1 (left is on the left), by toes and knees; NaN without legs.
    lines : float
        The lesser of the mean cosines of the lines through shoulders and through knees with that through the hips:
        below 0 where one of the pairs is exchanged; NaN without both.
    reasons : tuple of str
        Phrases with the figures.
    """

    legs: float
    lines: float
    reasons: tuple[str, ...]

    @property
    def swapped(self) -> bool:
        """Return True where the sides are clearly exchanged, of the whole body or of a pair of joints."""
        return bool(self.legs < -CLEAR or self.lines < -CLEAR)


def left_right(places: Mapping[str, F64]) -> LeftRight:
    """Judge whether the joints named left lie on the body's left.

    Parameters
    ----------
    places : mapping of str to float64 array (3, K)
        Any of the 24 named joints in K sampled frames, in any unit and any right-handed axes; NaN where a joint is not
        seen. Both hips, and knees and ankles, or ankles and toes with knees, are needed for the legs.

    Returns
    -------
    LeftRight
        The figures; NaN where joints are missing.
    """
    if "lhip" not in places or "rhip" not in places:
        return LeftRight(float("nan"), float("nan"), ("no hips",))
    absent = np.full(places["lhip"].shape, np.nan)
    pairs = (
        np.array([places.get(f"l{name}", absent), places.get(f"r{name}", absent)], np.float64)
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
            bend = _dot(shank, front) / math.sqrt(_dot(front, front)) / (_BENT * length)
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
