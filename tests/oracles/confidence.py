"""Confidence with plain loops: Bayesian logistic regression by coordinate search."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence


def loss(
    point: Sequence[float],
    rows: Sequence[Sequence[float]],
    right: Sequence[bool],
    mean: Sequence[float],
    spread: Sequence[float],
) -> float:
    """Return minus the logarithm of likelihood times prior, without constants."""
    total = sum(((a - b) / s) ** 2 / 2 for a, b, s in zip(point, mean, spread, strict=True))
    for row, true in zip(rows, right, strict=True):
        odds = sum(a * b for a, b in zip(point, row, strict=True))
        total += math.log1p(math.exp(-odds if true else odds))
    return total


def least(function: Callable[[list[float]], float], start: Sequence[float]) -> list[float]:
    """Return the place of the least value of a convex function, by steps along each coordinate that get smaller."""
    point, step = list(start), 1.0
    best = function(point)
    while step > 1e-6:
        moved = False
        for place in range(len(point)):
            for change in (step, -step):
                other = [*point[:place], point[place] + change, *point[place + 1 :]]
                if (value := function(other)) < best:
                    point, best, moved = other, value, True
        step = step if moved else step / 2
    return point


def curvature(function: Callable[[list[float]], float], point: Sequence[float]) -> list[list[float]]:
    """Return the second derivatives of a function, by differences."""
    step = 1e-3

    def at(i: int, a: float, j: int, b: float) -> float:
        other = list(point)
        other[i] += a
        other[j] += b
        return function(other)

    size = range(len(point))
    return [
        [
            (at(i, step, j, step) - at(i, step, j, -step) - at(i, -step, j, step) + at(i, -step, j, -step))
            / (4 * step * step)
            for j in size
        ]
        for i in size
    ]
