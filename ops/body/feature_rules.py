"""Rules describe relational features: sums of geometric primitives, compared with a weak and a strong threshold.

A rule only describes a feature; `ops.body.features` evaluates rules with compiled kernels, which need not be loaded to
read a feature set.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from kinedex.ops.arrays import F64

ABOVE, AT_LEAST, BELOW, AT_MOST, WITHIN = range(5)
"""The comparisons, numbered as kernels expect them."""

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
"""The primitives by name, with the number of joints they take (None: any number, at least one)."""


@dataclass(frozen=True)
class Primitive:
    """A geometric primitive that is not one of `JOINTS_OF`.

    Attributes
    ----------
    joints : int or None
        The number of joints that it takes; None for any number, at least one.
    compute : callable
        Returns the quantity in every frame, float64 (T,), from the trajectories of the joints, float64 (n, 3, T) in
        metres, and the frames per second. A feature is off where it is NaN.
    """

    joints: int | None
    compute: Callable[[F64, float], F64]


@dataclass(frozen=True)
class Term:
    """A geometric primitive over joints (by index), with its factor in a sum."""

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
        Pairs of joints whose distances in frame 0, added up, scale the thresholds; empty for plain numbers.
    weak, strong : tuple[float, float]
        (low, high); one-sided comparisons use the first only.
    stand_ins : tuple of (float, tuple of (int, int))
        Factors and pairs of joints: where a joint of `length` is unknown, the first sum of distances whose joints are
        known, times its factor, stands for it.
    """

    terms: tuple[Term, ...]
    comparison: int
    weak: tuple[float, float]
    strong: tuple[float, float]
    length: tuple[tuple[int, int], ...] = ()
    stand_ins: tuple[tuple[float, tuple[tuple[int, int], ...]], ...] = ()

    @property
    def length_joints(self) -> list[set[int]]:
        """The joints of the length, and those of each stand-in; empty for plain numbers."""
        every = [self.length, *(pairs for _, pairs in self.stand_ins)] if self.length else []
        return [{joint for pair in pairs for joint in pair} for pairs in every]

    def joints(self, body: Iterable[int]) -> tuple[set[int], set[int]]:
        """Return the joints that the terms name, and the joints of `body` over which their extremes are taken."""
        fixed: set[int] = set()
        several: set[int] = set()
        for term in self.terms:
            fixed |= set(term.joints)
            if term.primitive in ("height", "extent_y"):
                several |= set(body) - set(term.without)
        return fixed, several - fixed
