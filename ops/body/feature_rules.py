"""This module defines the rules of relational features, which compare sums of geometric primitives with thresholds.

`ops.body.features` evaluates the rules. It is a separate module, so that a feature set can be read without loading
compiled kernels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from kinedex.ops.arrays import F64

ABOVE, AT_LEAST, BELOW, AT_MOST, WITHIN = range(5)
"""The comparisons of a value with a threshold, by the numbers that kernels use for them."""

COMPARISONS = {">": ABOVE, ">=": AT_LEAST, "<": BELOW, "<=": AT_MOST, "within": WITHIN}

JOINTS_OF = {
    "plane": 4,
    "nplane": 4,
    "vplane": 4,
    "vnplane": 4,
    "speed": None,
    "angle": 3,
    "segments": 4,
    "tilt": 2,
    "height": 1,
    "extent_y": 0,
    "extent_xz": None,
    "turn_rate": 1,
}
"""A dict from primitive to the number of its joints; None for any number from 1."""


@dataclass(frozen=True)
class Primitive:
    """A geometric primitive that is not one of `JOINTS_OF`.

    Attributes
    ----------
    joints : int or None
        The number of joints of the primitive; None for any number from 1.
    compute : callable
        A function of the trajectories of the joints, float64 (n, 3, T) in metres, and the frames per second, which
        returns the quantity in every frame, float64 (T,). A feature is off in frames in which the quantity is NaN.
    """

    joints: int | None
    compute: Callable[[F64, float], F64]


@dataclass(frozen=True)
class Term:
    """A summand of a rule: a geometric primitive of some joints, given by index, with a factor."""

    primitive: str
    joints: tuple[int, ...]
    factor: float = 1.0
    window_ms: float = 0.0
    without: tuple[int, ...] = ()
    absolute: bool = False


@dataclass(frozen=True)
class Rule:
    """The rule of a feature: a sum of terms is compared with a weak and a strong threshold.

    Attributes
    ----------
    length : tuple[tuple[int, int], ...]
        Pairs of joints. The sum of their distances in the first valid frame scales the thresholds; empty for unscaled
        thresholds.
    weak, strong : tuple[float, float]
        The thresholds (low, high); one-sided comparisons use only the first.
    stand_ins : tuple of (float, tuple of (int, int))
        Replacements for `length` if one of its joints is unknown, each a factor and pairs of joints. The first
        replacement whose joints are all known is used: the sum of the distances times the factor.
    """

    terms: tuple[Term, ...]
    comparison: int
    weak: tuple[float, float]
    strong: tuple[float, float]
    length: tuple[tuple[int, int], ...] = ()
    stand_ins: tuple[tuple[float, tuple[tuple[int, int], ...]], ...] = ()

    @property
    def length_joints(self) -> list[set[int]]:
        """Return the sets of joints of the length and of each stand-in; an empty list for unscaled thresholds."""
        every = [self.length, *(pairs for _, pairs in self.stand_ins)] if self.length else []
        return [{joint for pair in pairs for joint in pair} for pairs in every]

    def joints(self, body: Iterable[int]) -> tuple[set[int], set[int]]:
        """Return the joints that the terms name, and the joints of `body` over which they take a minimum or maximum."""
        fixed: set[int] = set()
        several: set[int] = set()
        for term in self.terms:
            fixed |= set(term.joints)
            if term.primitive in ("height", "extent_y"):
                several |= set(body) - set(term.without)
        return fixed, several - fixed
