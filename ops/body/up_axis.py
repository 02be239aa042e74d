"""The judgement which axis of a file is vertical, from the places of a body's joints.

    up = up_axis(places, rest)          # places: {"root": (3, K), "head": (3, K), "lankle": …}, rest: {"root": (3,), …}
    if up.axis:                         # "x", "y", "z", "-x", "-y" or "-z"; "" where nothing decides
        print(up.axis, up.confidence, *up.reasons, sep="; ")

Three observations vote, and none of them uses the name of an axis, so that a turned body gets the turned axis:

- *posture*: the head is above the hips, and the hips are above the feet, in most frames;
- *ground*: over time the lowest point of the body stays at one height, whereas the hips travel across the ground;
- *rest pose*: a skeleton that stands in its rest pose stands along the vertical axis.

A body that lies still looks like one that stands, turned. Therefore posture alone decides only where neither ground nor
rest pose contradict it, and a body that lies or hangs throughout is left undecided: the caller keeps the format's axis.
(One that lies still, in a file without a rest pose, passes for one that stands, with a confidence of 0.8.)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]

SURE = 0.5
"""An axis with less confidence is not returned."""

AXES = ("x", "y", "z", "-x", "-y", "-z")

_HEADS = (("head",), ("headtop",), ("neck",), ("lshoulder", "rshoulder"), ("lclavicle", "rclavicle"), ("chest",))
_HIPS = (("lhip", "rhip"), ("root",), ("belly",))
_FEET = (("lankle", "rankle"), ("ltoes", "rtoes"), ("lknee", "rknee"))
_STRAIGHT, _LEANING, _BENT = 0.75, 0.85, 0.4
"""Cosines with the axis: trunk and legs of a standing body, trunk of a sitting body, and its legs."""

_HALF_BODY = 0.75  # weight of the posture of a trunk without legs, or of legs without a trunk
_SITTING = 0.5  # weight of a frame in which only the trunk is upright: a crawling body looks like it, turned
_GROUND, _REST = 0.5, 0.7  # weights of ground and rest pose, where posture has 1
_ONCE = 0.05  # an axis along which the body stands in this share of frames has twice the weight of ground
_LEVEL = 0.15  # body sizes; a lowest point that varies by more does not rest on a ground
_TRAVEL = 0.08  # body sizes; by so much more the hips travel where the ground is clear
_ENDS = 2.0  # lead over the opposite axis of a body that never stands on its head
_GAIN = 1.6  # confidence is 1 − exp(−_GAIN · lead)


@dataclass(frozen=True)
class UpAxis:
    """The axis that points up.

    Attributes
    ----------
    axis : str
        One of `AXES`; empty where the confidence is below `SURE`.
    confidence : float
        From 0 to 1, by the lead of the best axis over the second.
    reasons : tuple of str
        Phrases on posture, ground and rest pose, with their figures.
    """

    axis: str
    confidence: float
    reasons: tuple[str, ...]


def up_axis(places: Mapping[str, F64], rest: Mapping[str, F64] | None = None) -> UpAxis:
    """Judge which of ±x, ±y and ±z points up.

    Parameters
    ----------
    places : mapping of str to float64 array (3, K)
        Any of the 24 named joints, in K sampled frames, in any unit and axes; NaN where a joint is not seen. Head, hips
        and feet count for posture, all joints for the ground. About 32 frames, spread over the take, are enough.
    rest : mapping of str to float64 array (3,), optional
        The same joints in the rest pose of the skeleton, if the file has one.

    Returns
    -------
    UpAxis
        Axis, confidence and reasons. A body without hips and one end (head or feet) is undecided.
    """
    votes, parts = _posture(places)
    if votes is None:
        return UpAxis("", 0.0, ("no hips with head or feet",))
    share = votes.mean(axis=1)
    rested = _posture({joint: np.reshape(place, (3, 1)) for joint, place in (rest or {}).items()})[0]
    standing = np.zeros(6) if rested is None else rested[:, 0]
    spreads = _spreads(places) if parts.endswith("feet") else None
    leads = _leads(share, standing, np.zeros(6) if spreads is None else _ground(*spreads))
    best = int(np.argmax(leads))
    confidence = 1.0 - float(np.exp(-_GAIN * max(leads[best], 0.0)))
    percent = 100 * (votes > 0).mean(axis=1)
    reasons = [f"{parts} stand along {AXES[best]} in {percent[best]:.0f} % of {votes.shape[1]} frames"]
    other = int(np.argmax(np.where(np.arange(6) == best, -1.0, percent)))
    if percent[other] > 0:
        reasons[0] += f", along {AXES[other]} in {percent[other]:.0f} %"
    if spreads is not None:
        lowest, travel = spreads
        across = ", ".join(f"{AXES[a]} {travel[a]:.2f}" for a in range(3) if a != best % 3)
        level = f"the lowest point varies by {lowest[best]:.2f} body sizes along {AXES[best]}"
        reasons.append(f"{level}, the hips across it by {across}")
    if standing.any():
        reasons.append(f"the rest pose stands along {AXES[int(np.argmax(standing))]}")
    return UpAxis(AXES[best] if confidence >= SURE else "", confidence, tuple(reasons))


def _leads(share: F64, standing: F64, ground: F64) -> F64:
    """Return the least lead (6,) that each axis has over the axes of the other lines, and over its own other end."""
    stance = share + _REST * standing
    score = stance + _GROUND * np.where(share > _ONCE, 2.0, 1.0) * ground
    lines = np.maximum(score[:3], score[3:])
    rivals = np.array([max(lines[1], lines[2]), max(lines[0], lines[2]), max(lines[0], lines[1])])
    other_end = np.roll(stance, 3)
    both = np.where(stance + other_end > 0, stance + other_end, 1.0)
    return np.asarray(np.minimum(score - np.tile(rivals, 2), _ENDS * (stance - other_end) / both))


def _posture(places: Mapping[str, F64]) -> tuple[F64 | None, str]:
    """Return how upright the body is along each axis, (6, K), and its parts in words; None without hips and one end."""
    hips, head, feet = (_middle(places, names) for names in (_HIPS, _HEADS, _FEET))
    if hips is None or (head is None and feet is None):
        return None, ""
    trunk, legs = (None if head is None else _cosines(head - hips)), (None if feet is None else _cosines(hips - feet))
    if trunk is not None and legs is not None:
        known, parts = trunk + legs, "head, hips and feet"
        sitting = _SITTING * ((trunk > _LEANING) & (legs > _BENT))
        votes = np.where((trunk > _STRAIGHT) & (legs > _STRAIGHT), 1.0, sitting)
    else:
        known = np.asarray(legs if trunk is None else trunk)
        parts = "hips and feet" if trunk is None else "head and hips"
        votes = np.where(known > _STRAIGHT, _HALF_BODY, 0.0)
    seen = np.isfinite(known[0])
    return (votes[:, seen], parts) if seen.any() else (None, "")


def _middle(places: Mapping[str, F64], choices: tuple[tuple[str, ...], ...]) -> F64 | None:
    """Return the mean place of the first choice of joints that are there, those not seen in a frame excluded."""
    for names in choices:
        if all(name in places for name in names):
            if len(names) == 1:
                return places[names[0]]
            a, b = (places[name] for name in names)
            return np.where(np.isnan(a), b, np.where(np.isnan(b), a, 0.5 * (a + b)))
    return None


def _cosines(vectors: F64) -> F64:
    """Return the cosines (6, K) of vectors (3, K) with the axes; NaN for a vector without length."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        unit = vectors / np.sqrt((vectors * vectors).sum(axis=0))
    return np.concatenate([unit, -unit])


def _spreads(places: Mapping[str, F64]) -> tuple[F64, F64] | None:
    """Return by how much the lowest point (6,) and the hips (3,) vary, in body sizes; None without enough frames."""
    hips = _middle(places, _HIPS)
    stacked = np.stack([*places.values(), *([] if hips is None else [hips])])
    stacked = stacked[:, :, np.isfinite(stacked).all(axis=(0, 1))]
    if stacked.shape[2] < 3:
        return None
    low, high = stacked.min(axis=0), stacked.max(axis=0)
    size = float(np.median(np.sqrt(((high - low) ** 2).sum(axis=0))))
    if not 0 < size < np.inf:
        return None
    ordered = np.sort(np.concatenate([low, -high, stacked[-1]]), axis=1)
    cut = ordered.shape[1] // 8
    spread = (ordered[:, -1 - cut] - ordered[:, cut]) / size
    return spread[:6], spread[6:]


def _ground(lowest: F64, hips: F64) -> F64:
    """Return how clearly the lowest point rests on a ground across each axis, (6,), from 0 to 1."""
    travel = np.array([max(hips[1], hips[2]), max(hips[0], hips[2]), max(hips[0], hips[1])])
    clear = np.clip((np.tile(travel, 2) - lowest) / _TRAVEL, 0.0, 1.0)
    return np.asarray(clear * np.clip(1.0 - lowest / _LEVEL, 0.0, 1.0))
