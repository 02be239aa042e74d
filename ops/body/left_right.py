"""The judgement whether a body's left is on its left, from the places of its joints alone.

Toes lie in front of the ankles, and knees bend forwards. Both show the direction that the body faces without the words
left and right; the left hip then has to lie to the left of it. The judgement holds in any right-handed axes, whichever
of them is up. Exchanged names and a mirrored axis look the same, and give the same answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]

CLEAR = 0.15
"""Figures nearer to 0 than this decide nothing; takes of HDM05, CMU and Bandai have 0.37 and more."""

_BENT = 0.15  # leg lengths; a knee so far off the line from hip to ankle counts as fully bent
_TOES, _KNEES = 2.0, 1.0  # weights


@dataclass(frozen=True)
class LeftRight:
    """The agreement of a body's geometry with the names of its sides.

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
        """Return whether the sides are clearly exchanged, of the body or of a pair of joints."""
        return bool(self.legs < -CLEAR or self.lines < -CLEAR)


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
    legs = _legs(places, across)
    lines = {}
    for pair in ("shoulder", "knee"):
        if f"l{pair}" in places and f"r{pair}" in places:
            lines[f"{pair}s"] = _mean(_dot(_unit(places[f"l{pair}"] - places[f"r{pair}"]), across))
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


def _legs(places: Mapping[str, F64], across: F64) -> float:
    """Return the mean agreement of toes and knees with the sides, NaN without a leg."""
    cues: list[tuple[float, float]] = []
    for hip, knee, ankle, toes in (("lhip", "lknee", "lankle", "ltoes"), ("rhip", "rknee", "rankle", "rtoes")):
        if knee not in places or ankle not in places:
            continue
        shank = places[knee] - places[ankle]
        if toes in places:
            foot = _unit(places[toes] - places[ankle])
            cues.append((_TOES, _mean(_dot(foot, _unit(_cross(across, shank))))))
        leg, thigh = places[hip] - places[ankle], places[hip] - places[knee]
        length = np.sqrt(_dot(thigh, thigh)) + np.sqrt(_dot(shank, shank))
        with np.errstate(invalid="ignore", divide="ignore"):
            bend = _dot(shank, _unit(_cross(across, leg))) / (_BENT * length)
        cues.append((_KNEES, _mean(np.minimum(np.maximum(bend, -1.0), 1.0))))
    known = [(weight, cue) for weight, cue in cues if cue == cue]
    return sum(w * cue for w, cue in known) / sum(w for w, _ in known) if known else float("nan")


def _dot(a: F64, b: F64) -> F64:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _cross(a: F64, b: F64) -> F64:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _unit(v: F64) -> F64:
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        return np.asarray(v / np.sqrt(_dot(v, v)))


def _mean(values: F64) -> float:
    """Return the mean of the known values, NaN where there is none."""
    known = values[values == values]
    return float(known.sum()) / known.size if known.size else float("nan")
