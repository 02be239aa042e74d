"""Subsequence DTW written from the thesis (Eq. 5.1 to 5.3): the whole N × L matrix, then the way back."""

from __future__ import annotations

import math

Column = list[int | None]  # 0, 1 or None for a wildcard

Matrix = list[list[float]]


def local_cost(column: Column, frame: list[int] | None, weights: list[float] | None = None) -> float:
    if frame is None:
        return math.inf
    counted = [i for i, value in enumerate(column) if value is not None]
    if not counted:
        return 0.0
    if weights is None:
        return sum(abs(column[i] - frame[i]) for i in counted) / len(counted)
    return sum(weights[i] * abs(column[i] - frame[i]) for i in counted) / sum(weights[i] for i in counted)


def accumulated(
    template: list[Column], take: list[list[int]], weights: list[float] | None = None
) -> tuple[Matrix, Matrix]:
    """Return the local costs and D[n][l]: the cost of the best path that ends in column n and frame l."""
    cost = [[local_cost(column, frame, weights) for frame in take] for column in template]
    total = [[math.inf] * len(take) for _ in template]
    for n in range(len(template)):
        for frame in range(len(take)):
            if n == 0:
                total[n][frame] = cost[n][frame]
                continue
            ways = [total[k][m] + c for k, m, c in _ways(n, frame, cost[n][frame])]
            total[n][frame] = min(ways, default=math.inf)
    return cost, total


def _ways(n: int, frame: int, cost: float) -> list[tuple[int, int, float]]:
    """Return the cells before this one in order of preference, and what the step from there costs."""
    steps = [(n - 1, frame - 1, cost), (n - 1, frame - 2, cost), (n - 2, frame - 1, 2 * cost)]
    return [(k, m, c) for k, m, c in steps if k >= 0 and m >= 0]


def curve_and_starts(
    template: list[Column], take: list[list[int]], weights: list[float] | None = None
) -> tuple[list[float], list[int | None]]:
    """Return the distance curve and, for each frame, where its best path starts (None where there is none)."""
    cost, total = accumulated(template, take, weights)
    last = len(template) - 1
    starts: list[int | None] = []
    for end in range(len(take)):
        n, frame = last, end
        if math.isinf(total[n][frame]):
            starts.append(None)
            continue
        while n > 0:
            ways = _ways(n, frame, cost[n][frame])
            n, frame, _ = min(ways, key=lambda way: total[way[0]][way[1]] + way[2])  # the first of equals
        starts.append(frame)
    return [value / len(template) for value in total[last]], starts


def curve_by_enumeration(template: list[Column], take: list[list[int]]) -> list[float]:
    """Return the distance curve by walking every path there is."""

    def best(n: int, frame: int) -> float:
        if frame < 0 or n < 0:
            return math.inf
        cost = local_cost(template[n], take[frame])
        if n == 0:
            return cost
        return min(best(n - 1, frame - 1) + cost, best(n - 1, frame - 2) + cost, best(n - 2, frame - 1) + 2 * cost)

    return [best(len(template) - 1, frame) / len(template) for frame in range(len(take))]
