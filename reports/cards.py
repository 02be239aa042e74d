"""Draw the cards of templates on a page: two images, a time axis, the origin, and the convergence of learning."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from kinedex.ops.intervals import in_seconds
from kinedex.ops.templates.templates import CONVERGED
from kinedex.ops.wording import counted
from kinedex.reports.pixels import quantised_image, soft_image, wildcard_share
from kinedex.reports.plots import Axis, percent, time_axis
from kinedex.reports.report_data import FeatureNames, Template


@dataclass(frozen=True)
class Card:
    """The images and texts of one template."""

    template: Template
    soft: str
    quantised: str
    axis: Axis
    frames: int
    seconds: float
    wildcards: float
    origin: str
    description: str
    trace: Trace | None


def card(template: Template, delta: float, rate_hz: float) -> Card:
    """Draw a template both as learned and quantised with δ; columns are frames at the analysis rate."""
    frames = int(template.values.shape[0])
    seconds = in_seconds(frames, rate_hz)
    share = wildcard_share(template.values, delta)
    return Card(
        template=template,
        soft=soft_image(template.values),
        quantised=quantised_image(template.values, delta),
        axis=time_axis(max(seconds, 1e-6), most=4, room=0.82),
        frames=frames,
        seconds=seconds,
        wildcards=share,
        origin=origin(template),
        description=f"Motion template of {template.subclass}: {template.values.shape[1]} features "
        f"over {counted(frames, 'frame')}; {share:.0%} of the entries vary between the examples",
        trace=trace(template.costs),
    )


def origin(template: Template) -> str:
    """Describe the origin of a template: its source or, if learned, the numbers of clips and averaging steps."""
    if not template.origin.startswith("learned"):
        return template.origin
    text = f"{counted(len(template.clips), 'clip')}, {counted(template.rounds, 'round')} of averaging"
    if len(template.costs) > 1:
        text += f" (largest pair cost {template.costs[0]:.3f} → {template.costs[-1]:.3f})"
    elif template.costs:
        text += f" (largest pair cost {template.costs[0]:.3f})"
    return text + template.origin.removeprefix("learned").replace(", ", "; ", 1)


def rules(features: FeatureNames) -> tuple[float, ...]:
    """Return the borders between sets of features in percent of the height of an image."""
    return tuple(percent(first - 1, len(features.names)) for _, first, _ in features.sets if first > 1)


def readable(name: str) -> str:
    """Spell a feature's name as words: rhand_forwards becomes "rhand forwards"."""
    return name.replace("_", " ")


WIDTH, HEIGHT = 132, 36
_MIN_COST, _MAX_COST = 1e-3, 1.0  # ends of the logarithmic scale; costs below it are drawn at the lower end
_LEFT, _RIGHT, _TOP, _BOTTOM = 4, 128, 4, 32


@dataclass(frozen=True)
class Trace:
    """The geometry of one plot: the path, a dot (x, y, text) per iteration, and the height of the threshold."""

    path: str
    dots: tuple[tuple[float, float, str], ...]
    threshold: float
    description: str


def trace(costs: Sequence[float]) -> Trace | None:
    """Lay out the costs before each iteration of averaging and after the last; None if no clips were averaged."""
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
    share = math.log(min(max(cost, _MIN_COST), _MAX_COST) / _MIN_COST) / math.log(_MAX_COST / _MIN_COST)
    return round(_BOTTOM - share * (_BOTTOM - _TOP), 1)
