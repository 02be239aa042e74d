"""Classical weighted DTW written from the textbook: the whole matrix, then the way back."""

from __future__ import annotations

import math


def align(
    cost: list[list[float]], first_weights: list[float], second_weights: list[float]
) -> tuple[float, list[tuple[int, int]]]:
    """Return the cost and the path; ties prefer (1,1), then (1,0), then (0,1)."""
    rows, columns = len(cost), len(cost[0])
    total: dict[tuple[int, int], float] = {}
    for k in range(rows):
        for m in range(columns):
            before = [total.get((k - 1, m - 1)), total.get((k - 1, m)), total.get((k, m - 1))]
            entering = [value for value in before if value is not None]
            least = min(entering) if entering else 0.0
            total[k, m] = least + cost[k][m] * (0.5 * (first_weights[k] + second_weights[m]))
    k, m = rows - 1, columns - 1
    path = [(k, m)]
    while (k, m) != (0, 0):
        choices = [(k - 1, m - 1), (k - 1, m), (k, m - 1)]
        k, m = min(choices, key=lambda cell: total.get(cell, math.inf))  # min keeps the first of equals
        path.append((k, m))
    return total[rows - 1, columns - 1], path[::-1]


def cheapest_by_enumeration(cost: list[list[float]], first_weights: list[float], second_weights: list[float]) -> float:
    """Return the cost of the cheapest of all warping paths, by walking every one of them."""

    def rest(k: int, m: int) -> float:
        here = cost[k][m] * (first_weights[k] + second_weights[m]) / 2
        if (k, m) == (len(cost) - 1, len(cost[0]) - 1):
            return here
        steps = [(k + 1, m + 1), (k + 1, m), (k, m + 1)]
        return here + min(rest(a, b) for a, b in steps if a < len(cost) and b < len(cost[0]))

    return rest(0, 0)
