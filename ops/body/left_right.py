"""The judgement whether a body's left is on its left, from the places of its joints alone.

Toes lie in front of the ankles, and knees bend forwards. Both show the direction that the body faces without the words
left and right; the left hip then has to lie to the left of it. The judgement holds in any right-handed axes, whichever
of them is up. Swapped names and a mirrored axis look the same, and give the same answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]

CLEAR = 0.15
"""Figures nearer to 0 than this decide nothing; HDM05, CMU and Bandai have 0.37 and more."""

_BENT = 0.15  # leg lengths; a knee so far off the line from hip to ankle counts as fully bent
_TOES, _KNEES = 2.0, 1.0  # weights


@dataclass(frozen=True)
class LeftRight:
    """The agreement of a body's geometry with the names of its sides.

    Attributes
    ----------
    legs : float
        From −1 (left is on the right) to 1 (left is on the left), by toes and knees; NaN without legs.
    arms : float
        Mean cosine between the lines through the shoulders and through the hips: below 0 where either pair is swapped;
        NaN without both.
    reasons : tuple of str
        Phrases with the figures.
    """

    legs: float
    arms: float
    reasons: tuple[str, ...]

    @property
    def swapped(self) -> bool:
        """Return whether the sides are clearly swapped, of the legs, or of the arms against the legs."""
        return bool(self.legs < -CLEAR or self.arms < -CLEAR)


def left_right(places: Mapping[str, F64]) -> LeftRight:
    """Judge whether left and right of a body are where its names claim.

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
    across = _unit(places["lhip"] - places["rhip"])
    cues: list[tuple[float, float]] = []
    for hip, knee, ankle, toes in (("lhip", "lknee", "lankle", "ltoes"), ("rhip", "rknee", "rankle", "rtoes")):
        if knee not in places or ankle not in places:
            continue
        if toes in places:
            foot = _unit(places[toes] - places[ankle])
            shank = places[knee] - places[ankle]
            cues.append((_TOES, _mean(_dot(foot, _unit(_cross(across, shank))))))
        leg, thigh = places[hip] - places[ankle], places[hip] - places[knee]
        with np.errstate(invalid="ignore", divide="ignore"):
            # the triple product is the part of the knee's place in front of the leg, times the leg's length
            bend = _dot(places[knee] - places[ankle], _unit(_cross(across, leg)))
            length = np.sqrt(_dot(thigh, thigh)) + np.sqrt(_dot(leg - thigh, leg - thigh))
            cues.append((_KNEES, _mean(np.clip(bend / (_BENT * length), -1.0, 1.0))))
    known = [(weight, cue) for weight, cue in cues if cue == cue]
    legs = sum(w * cue for w, cue in known) / sum(w for w, _ in known) if known else float("nan")
    arms = float("nan")
    if "lshoulder" in places and "rshoulder" in places:
        arms = _mean(_dot(_unit(places["lshoulder"] - places["rshoulder"]), across))
    return LeftRight(legs, arms, _reasons(legs, arms))


def _reasons(legs: float, arms: float) -> tuple[str, ...]:
    reasons = []
    if legs == legs:
        side = "no side is clear" if abs(legs) < CLEAR else f"left is on the {'left' if legs > 0 else 'right'}"
        reasons.append(f"by toes and knees {side} ({legs:+.2f})")
    if arms == arms and arms < -CLEAR:
        reasons.append(f"the shoulders lie the other way round than the hips ({arms:+.2f})")
    return tuple(reasons)


def _dot(a: F64, b: F64) -> F64:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _cross(a: F64, b: F64) -> F64:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _unit(v: F64) -> F64:
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        return np.asarray(v / np.sqrt(_dot(v, v)))


def _mean(values: F64) -> float:
    """Return the mean of the known values, NaN where there is none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")
