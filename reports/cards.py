"""Cards that show templates on a page: two images, a time axis, and the origin of the template."""

from __future__ import annotations

from dataclasses import dataclass

from kinedex.ops.intervals import in_seconds
from kinedex.ops.wording import counted
from kinedex.reports.axes import Axis, percent, time_axis
from kinedex.reports.data import FeatureNames, Template
from kinedex.reports.pixels import quantised_image, soft_image, wildcard_share
from kinedex.reports.traces import Trace, trace


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
    """Draw a template, as learned and quantised with δ; its columns are frames of the analysis rate."""
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
    """Describe a template's origin: the numbers of clips and rounds of averaging for learned ones, else its source."""
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
