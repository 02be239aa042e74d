"""Ranking and its measures written down directly: the whole curve, a sorted list, and a loop over what is taken."""

from __future__ import annotations

import math
from fractions import Fraction

from tests.oracles.dtw import Column, curve_and_starts


def ranked(
    template: list[Column],
    takes: list[list[list[int] | None]],
    threshold: float,
    weights: list[float] | None = None,
) -> list[tuple[int, int, int, float]]:
    """All hits as (take, start, stop, cost), best first, none ruled out by a better one."""
    found = []
    for index, take in enumerate(takes):
        curve, starts = curve_and_starts(template, take, weights)
        for end, cost in enumerate(curve):
            beside = [curve[i] for i in (end - 1, end + 1) if 0 <= i < len(curve)]
            if cost < threshold - 1e-9 and all(cost <= other + 1e-9 for other in beside):
                start = starts[end]
                assert start is not None
                found.append((round(cost * 1e9), index, end, start, cost))
    hits: list[tuple[int, int, int, float]] = []
    for _, index, end, start, cost in sorted(found):
        if not any(index == take and _close(start, end, first, stop - 1) for take, first, stop, _ in hits):
            hits.append((index, start, end + 1, cost))
    return hits


def _close(start: int, end: int, taken_start: int, taken_end: int) -> bool:
    m = taken_end + 1 - taken_start
    by_end = taken_end - Fraction(m, 2) <= end <= taken_end + Fraction(m, 10)
    by_start = taken_start - Fraction(m, 10) <= start <= taken_start + Fraction(m, 2)
    return by_end or by_start


def average_precision(relevant: list[bool], total: int) -> float:
    """The mean, over all that should be found, of the precision at the rank where it is; 0 for what is not found."""
    if not total:
        return math.nan
    return sum(sum(relevant[: i + 1]) / (i + 1) for i in range(len(relevant)) if relevant[i]) / total
