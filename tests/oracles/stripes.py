"""Coarse sums written down directly: whole units of local costs, and the least sum of every cell."""

from __future__ import annotations

import math

from tests.oracles.dtw import Column, local_cost

CAP = 255


def coarse_sums(
    template: list[Column], take: list[list[int] | None], threshold: float, weights: list[float] | None = None
) -> list[int]:
    """The least sum of units that a path has which ends at a frame; 255 for all that is no less.

    A path may also leave out the first column and count the second one twice.
    """
    unit = threshold * len(template) / CAP
    total: list[list[float]] = []
    for frame, values in enumerate(take):
        total.append([])
        for n, column in enumerate(template):
            cost = local_cost(column, values, weights)
            units = CAP if math.isinf(cost) else math.floor(cost / unit * (1 - 1e-9))
            ways: list[float] = [0.0] if n == 0 else [units] if n == 1 else []
            if n > 0 and frame > 0:
                ways.append(total[frame - 1][n - 1])
            if n > 0 and frame > 1:
                ways.append(total[frame - 2][n - 1])
            if n > 1 and frame > 0:
                ways.append(total[frame - 1][n - 2] + units)
            total[frame].append(min([units + way for way in ways], default=math.inf))
    return [int(min(CAP, sums[-1])) for sums in total]
