"""Naive twin of keyframe fitting: every placement of the keyframes, one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise, product


def best_placement(
    template: Sequence[Sequence[float]], keyframes: Sequence[str], gaps: Sequence[tuple[int, int]]
) -> tuple[tuple[int, ...], Fraction] | None:
    """The leftmost of the cheapest placements of keyframe patterns over "01*", or None where the gaps admit none."""
    best: tuple[Fraction, tuple[int, ...]] | None = None
    for placement in product(range(len(template)), repeat=len(keyframes)):
        if not all(low <= b - a <= high for (a, b), (low, high) in zip(pairwise(placement), gaps, strict=True)):
            continue
        cost = placement_cost(template, keyframes, placement)
        if best is None or (cost, placement) < best:
            best = (cost, placement)
    return None if best is None else (best[1], best[0])


def placement_cost(template: Sequence[Sequence[float]], keyframes: Sequence[str], placement: Sequence[int]) -> Fraction:
    """Return the mean of the costs of keyframe patterns in columns."""
    cost = Fraction(0)
    for column, pattern in zip(placement, keyframes, strict=True):
        fixed = [(x, int(c)) for x, c in zip(template[column], pattern, strict=True) if c != "*"]
        cost += sum((abs(Fraction(x) - c) for x, c in fixed), Fraction(0)) / max(len(fixed), 1)
    return cost / len(keyframes)
