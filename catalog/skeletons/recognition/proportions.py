"""The check of a recognised body against human proportions: lengths of limbs, their symmetry and their constancy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64

_LIMBS = {
    "thigh": ("hip", "knee"), "shank": ("knee", "ankle"),
    "upper arm": ("shoulder", "elbow"), "forearm": ("elbow", "wrist"),
}  # fmt: skip
_RATIOS = {  # shares of the leg, from hip over knee to ankle
    "thigh": (0.32, 0.68), "shank": (0.32, 0.68), "upper arm": (0.2, 0.6), "forearm": (0.17, 0.55),
    "trunk": (0.3, 1.15), "hips": (0.06, 0.55), "shoulders": (0.2, 0.8),
}  # fmt: skip
_UNEQUAL = 1.35  # largest ratio of the lengths of left and right limbs
_LOOSE = 0.15  # largest variation of a limb's length, as a share of it
_ARMS = 1.5  # length of a leg, if it is unknown, as a multiple of an arm's to the wrist
_COST = 0.3  # confidence that each doubt subtracts


@dataclass(frozen=True)
class Proportions:
    """The proportions of a body.

    Attributes
    ----------
    confidence : float
        From 0 to 1.
    doubts : tuple of str
        Phrases on proportions that are not human.
    reasons : tuple of str
        Sentences for `kinedex inspect`.
    """

    confidence: float
    doubts: tuple[str, ...]
    reasons: tuple[str, ...]


def check_proportions(places: Mapping[str, F64]) -> Proportions:
    """Compare the limbs of a body with human ones.

    Parameters
    ----------
    places : Mapping of str to float64 array (3, K)
        Named joints in K sampled frames, in any unit and axes; NaN where a joint is not seen.
    """
    lengths: dict[str, list[float]] = {}
    doubts: list[str] = []
    for limb, (top, end) in _LIMBS.items():
        both = [_lengths(places, f"{side}{top}", f"{side}{end}") for side in "lr"]
        medians = [float(np.median(found)) for found in both if len(found)]
        lengths[limb] = medians
        if len(medians) == 2 and max(medians) > _UNEQUAL * max(min(medians), 1e-12):
            doubts.append(f"left and right {limb} differ by {max(medians) / max(min(medians), 1e-12):.2f}")
        loose = [_spread(found) for found in both if len(found) > 2]
        if loose and max(loose) > _LOOSE:
            doubts.append(f"the {limb} varies by {100 * max(loose):.0f} % of its length")
    for part, ends in {
        "trunk": ("root", "neck"),
        "hips": ("lhip", "rhip"),
        "shoulders": ("lshoulder", "rshoulder"),
    }.items():
        found = _lengths(places, *ends)
        lengths[part] = [float(np.median(found))] if len(found) else []
    legs = sum(float(np.mean(lengths[limb])) for limb in ("thigh", "shank") if lengths[limb])
    arms = sum(float(np.mean(lengths[limb])) for limb in ("upper arm", "forearm") if lengths[limb])
    unit = legs if lengths["thigh"] and lengths["shank"] else 2.0 * float(np.mean(lengths["trunk"] or [0.0]))
    unit = unit or _ARMS * arms
    shares = []
    for part, (least, most) in _RATIOS.items():
        if lengths[part] and unit > 0:
            share = float(np.mean(lengths[part])) / unit
            shares.append(f"{part} {share:.2f}")
            if not least <= share <= most:
                doubts.append(f"{part} {share:.2f} legs")
    if not unit > 0:
        doubts += ["no length"] * 3
    confidence = max(0.0, 1.0 - _COST * len(doubts))
    text = f"in lengths of a leg: {', '.join(shares)}" if shares else "no limb can be measured"
    return Proportions(confidence, tuple(doubts), (text, *doubts))


def _lengths(places: Mapping[str, F64], a: str, b: str) -> F64:
    if a not in places or b not in places:
        return np.empty(0)
    with np.errstate(invalid="ignore", over="ignore"):
        found = np.sqrt(((places[a] - places[b]) ** 2).sum(axis=0))
    return np.asarray(found[np.isfinite(found)])


def _spread(lengths: F64) -> float:
    """Return half the interquartile range of lengths divided by their median."""
    low, middle, high = np.percentile(lengths, [25, 50, 75])
    return float((high - low) / max(middle, 1e-12) / 2)
