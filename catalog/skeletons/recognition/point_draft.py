"""The draft of a body among points: the joints found so far, as combinations of points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from kinedex.catalog.skeletons.skeleton_fit import Mix
from kinedex.ops.arrays import F64

_TINY = 1e-9  # in any unit; joints this near to each other coincide, which the check of proportions reports

SIDES = ("l", "r")
"""The first letters of the joints of each side."""


@dataclass
class BodyDraft:
    """The joints found so far: the alternatives of each, best first, and how some of them are estimated."""

    places: dict[str, F64]
    joints: dict[str, list[Mix]] = field(default_factory=dict)
    estimated: dict[str, str] = field(default_factory=dict)
    made: dict[Mix, F64] = field(default_factory=dict)

    def at(self, mix: Mix) -> F64:
        """Return where a combination of points is in the sampled frames, (3, K)."""
        if mix not in self.made:
            self.made[mix] = mix.apply(self.places, 1.0)
        return self.made[mix]

    def set(self, joint: str, *mixes: Mix | None, how: str = "") -> None:
        """Give a joint its alternatives if it has none, and record how it is estimated."""
        found = [mix for mix in mixes if mix is not None]
        if found and joint not in self.joints:
            self.joints[joint] = found
            if how:
                self.estimated[joint] = how

    def place(self, joint: str) -> F64 | None:
        """Return where a joint is in the sampled frames, (3, K); None if it is unknown."""
        if joint not in self.joints:
            return None
        mix = self.joints[joint][0]
        if mix.of_joints:
            parts = {name: self.place(name) for name in mix.names}
            if any(part is None for part in parts.values()):
                return None
            return mix.apply({name: part for name, part in parts.items() if part is not None}, 1.0)
        return self.at(mix)


def one_point(label: str) -> Mix:
    """Return the mix that consists of one point with weight 1."""
    return Mix(((label, 1.0),))


def mean_of(labels: Sequence[str]) -> Mix | None:
    """Return the mean of points; None without any."""
    return Mix(tuple((label, 1.0 / len(labels)) for label in labels)) if labels else None


def blend(a: Mix, b: Mix, share: float) -> Mix:
    """Return the combination at a fraction of the line from one combination of points to another."""
    weights: dict[str, float] = {}
    for mix, part in ((a, 1.0 - share), (b, share)):
        for name, weight in mix.weights:
            weights[name] = weights.get(name, 0.0) + part * weight
    return Mix(tuple((name, round(weight, 6)) for name, weight in weights.items()))


def median_of(values: F64) -> float:
    """Return the median of the finite values; NaN without any."""
    ordered = np.sort(values[np.isfinite(values)])
    count = len(ordered)
    return float(ordered[(count - 1) // 2] + ordered[count // 2]) / 2 if count else float("nan")


def median_length(vectors: F64) -> float:
    """Return the median length of vectors (3, K), at least a small positive number, so that it can be a divisor."""
    return max(median_of(np.sqrt((vectors * vectors).sum(axis=0))), _TINY)
