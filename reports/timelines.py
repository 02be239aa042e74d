"""Lay out timelines and distance curves: lanes and panels of classes with their segments (thesis, Fig. 5.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinedex.ops.annotation.segments import local_minima
from kinedex.ops.arrays import F64, I64
from kinedex.ops.intervals import TakeSegment, shown_seconds
from kinedex.ops.wording import counted
from kinedex.reports.plots import Axis, percent, time_axis
from kinedex.reports.report_data import Curve, Score, TakeRow


@dataclass(frozen=True)
class Bar:
    """One segment: its place in percent, its agreement with ground truth, its tooltip, and its frames.

    `agrees` is None if the take has no ground truth. `near` is the index of the nearest example in the page's list.
    """

    left: float
    width: float
    agrees: bool | None
    tip: str
    start: int = 0
    stop: int = 0
    confidence: float | None = None
    near: int | None = None


@dataclass(frozen=True)
class Lane:
    """The segments of one class in one take."""

    label: str
    slot: int
    automatic: tuple[Bar, ...]
    manual: tuple[Bar, ...]
    description: str


@dataclass(frozen=True)
class Timeline:
    """The lanes and the time axis of one take."""

    take: TakeRow
    score: Score | None
    lanes: tuple[Lane, ...]
    axis: Axis
    judged: bool


def timeline(
    take: TakeRow,
    automatic: Sequence[TakeSegment],
    manual: Sequence[TakeSegment],
    slots: Mapping[str, int],
    score: Score | None = None,
    near: Mapping[tuple[str, str, int, int], int] | None = None,
) -> Timeline:
    """Lay out one take.

    Two segments agree as in the measure of segments (thesis, 5.4): they have the same class and a common frame.

    Parameters
    ----------
    take : TakeRow
        The take; all segments must be within it.
    automatic, manual : sequence of TakeSegment
        The segments of the take.
    slots : mapping of str to int
        Colour of each class; its order is the order of the lanes.
    score : Score or None
        Row of the take in the evaluation.
    near : mapping of (take, class, start, stop) to int
        Place of the nearest example of a segment in the page's list.

    Returns
    -------
    Timeline
        The lanes of the classes that occur in the take.
    """
    judged = bool(manual) or score is not None  # ground truth may be empty
    occurring = {segment.label for segment in (*automatic, *manual)}
    lanes = []
    for label in (label for label in slots if label in occurring):
        ours = [segment for segment in automatic if segment.label == label]
        theirs = [segment for segment in manual if segment.label == label]
        lanes.append(
            Lane(
                label=label,
                slot=slots[label],
                automatic=tuple(bar(s, take, "automatic", theirs if judged else None, near) for s in ours),
                manual=tuple(bar(s, take, "manual", ours) for s in theirs),
                description=f"{label}: {counted(len(ours), 'automatic segment')}"
                + (f", {counted(len(theirs), 'manual segment')}" if judged else ""),
            )
        )
    return Timeline(take, score, tuple(lanes), time_axis(max(take.seconds, 1e-6)), judged)


def bar(
    segment: TakeSegment,
    take: TakeRow,
    origin: str,
    others: Sequence[TakeSegment] | None,
    near: Mapping[tuple[str, str, int, int], int] | None = None,
) -> Bar:
    """Place one segment, and describe it in its tooltip."""
    agrees = None if others is None else any(overlap(segment, other) for other in others)
    return Bar(
        left=percent(segment.start, take.frames),
        width=percent(segment.stop - segment.start, take.frames),
        agrees=agrees,
        tip=tooltip(segment, take.rate_hz, origin, agrees),
        start=segment.start,
        stop=segment.stop,
        confidence=segment.confidence,
        near=(near or {}).get(segment.key) if origin == "automatic" else None,
    )


def overlap(one: TakeSegment, other: TakeSegment) -> bool:
    """Return whether two segments of one take have a common frame."""
    return one.start < other.stop and other.start < one.stop


def tooltip(segment: TakeSegment, rate_hz: float, origin: str, agrees: bool | None) -> str:
    """Describe a segment in one line."""
    seconds = f"{shown_seconds(segment.start, rate_hz)}–{shown_seconds(segment.stop, rate_hz)} s"
    text = f"{segment.label}, {origin}: {seconds}, frames [{segment.start}, {segment.stop})"
    if segment.cost is not None:
        text += f", cost {segment.cost:.3f}"
    if segment.confidence is not None:
        text += f", confidence {segment.confidence:.2f}"
    if segment.subclass is not None and segment.subclass != segment.label:
        text += f", as {segment.subclass}"
    if segment.doubted is not None:
        text += f"; another method found {segment.doubted}"
    if agrees is False:
        text += "; no manual segment here" if origin == "automatic" else "; not found"
    return text


HEIGHT = 200  # units of the vertical axis of a panel
POINTS = 1600  # largest number of frames that are all drawn; of longer curves, the extrema of short intervals are drawn


@dataclass(frozen=True)
class Minimum:
    """A mark of a local minimum below τ: a stroke along its plateau, of length 0 for a single frame."""

    path: str
    tip: str


@dataclass(frozen=True)
class Panel:
    """The plot of one class, whose curve is the lowest cost over its subclasses."""

    label: str
    slot: int
    path: str
    minima: tuple[Minimum, ...]
    automatic: tuple[Bar, ...]
    manual: tuple[Bar, ...]
    lowest: float | None
    subclasses: int
    description: str


@dataclass(frozen=True)
class CurveDiagram:
    """The panels of one take; `top` is the cost at the upper edge, `tau_y` the distance of τ from this edge in units.

    `quiet` has the panels without a segment or a minimum below τ. `thinned` is True if not all frames are drawn.
    """

    take: TakeRow
    panels: tuple[Panel, ...]
    quiet: tuple[Panel, ...]
    axis: Axis
    top: float
    tau: float | None
    tau_y: float
    thinned: bool


def curve_diagram(
    take: TakeRow,
    curves: Sequence[Curve],
    automatic: Sequence[TakeSegment],
    manual: Sequence[TakeSegment],
    slots: Mapping[str, int],
    tau: float | None,
) -> CurveDiagram:
    """Lay out the distance curves of one take.

    Parameters
    ----------
    take : TakeRow
        The take; every curve has one cost for each frame of the take.
    curves : sequence of Curve
        The curves of the take, one for each subclass.
    automatic, manual : sequence of TakeSegment
        The segments of the take.
    slots : mapping of str to int
        Colour of each class; its order is the order of the panels.
    tau : float or None
        Threshold of annotation; if None, no minima are marked.

    Returns
    -------
    CurveDiagram
        The panels of classes with a segment or a minimum below τ, and the panels of the other classes, at one scale.
    """
    finite = [curve.costs[np.isfinite(curve.costs)] for curve in curves]
    highest = max((float(costs.max()) for costs in finite if costs.size), default=1.0)
    top = max(min(highest, 0.5), 1.5 * (tau or 0.0), 0.05)
    panels = []
    for label in slots:
        own = [curve for curve in curves if curve.label == label]
        if own:
            theirs = [segment for segment in manual if segment.label == label]
            ours = [segment for segment in automatic if segment.label == label]
            known = theirs if manual else None
            panels.append(
                panel(
                    label,
                    slots[label],
                    own,
                    take,
                    tuple(bar(s, take, "automatic", known) for s in ours),
                    tuple(bar(s, take, "manual", ours) for s in theirs),
                    top,
                    tau,
                )
            )
    telling = tuple(p for p in panels if p.minima or p.automatic or p.manual)
    quiet = tuple(p for p in panels if not (p.minima or p.automatic or p.manual))
    tau_y = HEIGHT * (1 - (tau or 0.0) / top)
    axis = time_axis(max(take.seconds, 1e-6))
    return CurveDiagram(take, telling, quiet, axis, top, tau, tau_y, take.frames > POINTS)


def panel(
    label: str,
    slot: int,
    curves: Sequence[Curve],
    take: TakeRow,
    automatic: tuple[Bar, ...],
    manual: tuple[Bar, ...],
    top: float,
    tau: float | None,
) -> Panel:
    """Lay out one class: the lowest cost over its subclasses as a line, the minima of each subclass as marks."""
    least = np.min(np.stack([curve.costs for curve in curves]), axis=0)
    finite = least[np.isfinite(least)]
    lowest = float(finite.min()) if finite.size else None
    marks = [mark for curve in curves for mark in minima(curve, top, take.rate_hz, tau)] if tau else []
    reached = "never finite" if lowest is None else f"lowest value {lowest:.3f}"
    return Panel(
        label=label,
        slot=slot,
        path=line(least, top),
        minima=tuple(marks),
        automatic=automatic,
        manual=manual,
        lowest=lowest,
        subclasses=len(curves),
        description=f"Distance curve of {label}: {reached}, {len(marks)} minima below the threshold, "
        f"{counted(len(automatic), 'automatic segment')}"
        + (f", {counted(len(manual), 'manual segment')}" if manual else ""),
    )


def line(costs: F64, top: float) -> str:
    """Return the path of a curve, with x in frames and y in units from the top; infinite costs leave a gap."""
    frames, heights = thinned_frames(costs)
    parts: list[str] = []
    last: tuple[int, int] | None = None
    slope: tuple[int, int] | None = None
    for frame, cost in zip(frames.tolist(), heights.tolist(), strict=True):
        if not np.isfinite(cost):
            last = slope = None
            continue
        y = round(HEIGHT * (1 - min(cost, 2 * top) / top))
        if last is None:
            parts.append(f"M{frame} {y}")
        else:
            step = (frame - last[0], y - last[1])
            if step == slope and step[1] == 0:
                parts[-1] = _flat(parts[-1], step[0])
            else:
                parts.append(f"h{step[0]}" if step[1] == 0 else f"l{step[0]} {step[1]}")
            slope = step
        last = (frame, y)
    return "".join(parts)


def _flat(part: str, frames: int) -> str:
    return f"h{int(part[1:]) + frames}"


def thinned_frames(costs: F64) -> tuple[I64, F64]:
    """Return the frames of a curve to draw: all of them, or the lowest and the highest of short intervals."""
    total = costs.size
    if total <= POINTS:
        return np.arange(total, dtype=np.int64), costs
    size = -(-2 * total // POINTS)
    kept: list[int] = []
    for start in range(0, total, size):
        interval = costs[start : start + size]
        low = start + int(np.argmin(interval))
        high = start + int(np.argmax(interval))
        kept.extend(sorted({low, high}))
    frames = np.array(kept, dtype=np.int64)
    return frames, costs[frames]


def minima(curve: Curve, top: float, rate_hz: float, tau: float) -> list[Minimum]:
    """Mark the local minima below τ; a plateau becomes one stroke."""
    costs = curve.costs
    if not costs.size:
        return []
    at = local_minima(costs, tau)
    marks: list[Minimum] = []
    # Adjacent minima have the same cost, since neither is above the other; they form one plateau.
    for plateau in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if at.size else []:
        first, last = int(plateau[0]), int(plateau[-1])
        cost = float(costs[first])
        text = f"{curve.subclass} ends at frame {first}, {shown_seconds(first, rate_hz)} s: cost {cost:.3f}"
        marks.append(Minimum(f"M{first} {round(HEIGHT * (1 - cost / top))}h{last - first}", text))
    return marks


def y_ticks(diagram: CurveDiagram) -> tuple[tuple[float, str], ...]:
    """Return the texts of a panel's vertical axis: the upper edge, τ, 0."""
    ticks = [(0.0, f"{diagram.top:.2f}"), (100.0, "0")]
    if diagram.tau:
        ticks.append((percent(diagram.tau_y, HEIGHT), f"τ {diagram.tau:g}"))
    return tuple(ticks)
