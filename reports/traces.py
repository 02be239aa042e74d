"""The convergence of template learning as a small plot: the largest cost between two clips after each round."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from kinedex.ops.templates.templates import CONVERGED

WIDTH, HEIGHT = 132, 36
_LEAST, _MOST = 1e-3, 1.0  # the ends of the logarithmic scale; lower costs are drawn at the lower end
_LEFT, _RIGHT, _TOP, _BOTTOM = 4, 128, 4, 32


@dataclass(frozen=True)
class Trace:
    """The geometry of one plot: the path, a dot (x, y, text) per round, and the height of the threshold."""

    path: str
    dots: tuple[tuple[float, float, str], ...]
    threshold: float
    description: str


def trace(costs: Sequence[float]) -> Trace | None:
    """Lay out the costs before each round and after the last; None if no clips were averaged."""
    if len(costs) < 2:
        return None
    step = (_RIGHT - _LEFT) / (len(costs) - 1)
    points = [(round(_LEFT + i * step, 1), _height(cost)) for i, cost in enumerate(costs)]
    tips = ["before the first round", *(f"after round {i}" for i in range(1, len(costs)))]
    dots = tuple((x, y, f"{tip}: {cost:.4f}") for (x, y), tip, cost in zip(points, tips, costs, strict=True))
    outcome = "converged" if costs[-1] < CONVERGED else "not converged"
    return Trace(
        "M" + "L".join(f"{x:g} {y:g}" for x, y in points),
        dots,
        _height(CONVERGED),
        f"Largest cost between two clips from {costs[0]:.3f} to {costs[-1]:.4f} in {len(costs) - 1} rounds: {outcome}",
    )


def _height(cost: float) -> float:
    share = math.log(min(max(cost, _LEAST), _MOST) / _LEAST) / math.log(_MOST / _LEAST)
    return round(_BOTTOM - share * (_BOTTOM - _TOP), 1)
