"""The geometry of distance curves: a panel for each class, with τ, the minima below it, and the segments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.ops.annotation.segments import local_minima
from kinedex.ops.intervals import TakeSegment, shown_seconds
from kinedex.ops.wording import counted
from kinedex.reports.axes import Axis, percent, time_axis
from kinedex.reports.data import Curve, TakeRow
from kinedex.reports.timelines import Bar, bar

HEIGHT = 200  # units of the vertical axis of a panel
POINTS = 1600  # of curves with more frames, only the lowest and highest values of short intervals are drawn


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
class CurveFigure:
    """All panels of one take; `top` is the cost at the upper edge, `tau_y` the height of τ in units."""

    take: TakeRow
    panels: tuple[Panel, ...]
    quiet: tuple[Panel, ...]
    axis: Axis
    top: float
    tau: float | None
    tau_y: float
    thinned: bool


def curve_figure(
    take: TakeRow,
    curves: Sequence[Curve],
    automatic: Sequence[TakeSegment],
    manual: Sequence[TakeSegment],
    slots: Mapping[str, int],
    tau: float | None,
) -> CurveFigure:
    """Lay out the distance curves of one take.

    Parameters
    ----------
    take : TakeRow
        The take; every curve has one cost for each of its frames.
    curves : sequence of Curve
        Its curves, one for each subclass.
    automatic, manual : sequence of TakeSegment
        Its segments.
    slots : mapping of str to int
        Colour of each class; its order is the order of the panels.
    tau : float or None
        Threshold of annotation; without it no minima are marked.

    Returns
    -------
    CurveFigure
        The panels of classes with a segment or a minimum below τ, and those of the other classes; all have one scale.
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
    return CurveFigure(take, telling, quiet, axis, top, tau, tau_y, take.frames > POINTS)


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


def line(costs: npt.NDArray[np.float64], top: float) -> str:
    """Return the path of a curve: x in frames, y in units from the top, a gap where the cost is infinite."""
    frames, heights = thin(costs)
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


def thin(costs: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Return the frames of a curve to draw: all, or the lowest and the highest of short intervals."""
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
    """Mark the local minima below τ, a plateau as one stroke."""
    costs = curve.costs
    if not costs.size:
        return []
    at = local_minima(costs, tau)
    marks: list[Minimum] = []
    # Neighbouring minima have the same cost, as neither is above the other: they are one plateau.
    for plateau in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if at.size else []:
        first, last = int(plateau[0]), int(plateau[-1])
        cost = float(costs[first])
        text = f"{curve.subclass} ends at frame {first}, {shown_seconds(first, rate_hz)} s: cost {cost:.3f}"
        marks.append(Minimum(f"M{first} {round(HEIGHT * (1 - cost / top))}h{last - first}", text))
    return marks


def y_ticks(figure: CurveFigure) -> tuple[tuple[float, str], ...]:
    """Return the texts of a panel's vertical axis: the upper edge, τ, 0."""
    ticks = [(0.0, f"{figure.top:.2f}"), (100.0, "0")]
    if figure.tau:
        ticks.append((percent(figure.tau_y, HEIGHT), f"τ {figure.tau:g}"))
    return tuple(ticks)
