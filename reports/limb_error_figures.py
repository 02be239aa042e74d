"""The geometry of the page about limb errors: curves with τ, boxes of runs, P/R/F over τ, drifts of headings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.ops.inertial.disagreement import flagged_ranges
from kinedex.ops.intervals import in_seconds
from kinedex.reports.axes import percent
from kinedex.reports.plots import line_path

F64 = npt.NDArray[np.float64]

BINS = 600
"""Columns of a curve; each shows the smallest and the largest error of its frames."""

CHART_WIDTH, CHART_HEIGHT = 260.0, 130.0
"""Size of a plot of precision, recall and F in SVG units."""

TAU_TOP_DEG = 120.0
"""The end of the axis of τ in these plots, in degrees."""


@dataclass(frozen=True)
class Box:
    """A run of frames as a box of a timeline.

    Attributes
    ----------
    start, stop : int
        Analysis frames of the take.
    left, width : float
        Place in the timeline, in percent.
    text : str
        The text of its tooltip.
    jump : bool
        True if the limb of the take jumps there; such frames are in no measure.
    """

    start: int
    stop: int
    left: float
    width: float
    text: str
    jump: bool = False


def box(start_s: float, stop_s: float, frames: int, rate_hz: float, text: str, *, jump: bool = False) -> Box:
    """Return the box of the interval [start_s, stop_s) of a take with `frames` analysis frames."""
    first = min(max(0, round(start_s * rate_hz)), max(frames - 1, 0))
    last = max(first + 1, min(round(stop_s * rate_hz), frames))
    seconds = in_seconds(max(frames, 1), rate_hz)
    left, right = (min(max(percent(value, seconds), 0.0), 100.0) for value in (start_s, stop_s))
    return Box(first, last, left, round(max(right - left, 0.05), 2), text, jump)


def curve_path(times: F64, degrees: F64, seconds: float, top: float, bins: int = BINS) -> str:
    """Return the SVG path of errors over time as a band from the smallest to the largest error of each column.

    Parameters
    ----------
    times : float64 array (T,)
        Seconds of the take, ascending.
    degrees : float64 array (T,)
        Errors; NaN where a frame does not count, which interrupts the band.
    seconds : float
        Length of the take, which fills `bins` units.
    top : float
        The error at y = 0; the error 0 is at y = top.
    bins : int
        Number of columns.
    """
    known = np.isfinite(degrees)
    if not known.any():
        return ""
    place = np.clip((times[known] / seconds * bins).astype(np.int64), 0, bins - 1)
    low, high = np.full(bins, np.inf), np.full(bins, -np.inf)
    np.minimum.at(low, place, degrees[known])
    np.maximum.at(high, place, degrees[known])
    filled = _without_holes(np.isfinite(low), times, known, seconds)
    texts = []
    for start, stop in flagged_ranges(filled).tolist():
        columns = np.flatnonzero(np.isfinite(low[start:stop])) + start
        middle = columns + 0.5
        upper = list(zip(middle.tolist(), (top - np.minimum(high[columns], top)).tolist(), strict=True))
        lower = list(zip(middle.tolist(), (top - np.minimum(low[columns], top)).tolist(), strict=True))
        texts.append(line_path([*upper, *lower[::-1]]) + "Z")
    return "".join(texts)


def _without_holes(
    filled: npt.NDArray[np.bool_], times: F64, known: npt.NDArray[np.bool_], seconds: float
) -> npt.NDArray[np.bool_]:
    """Return the columns that a band covers; those without any frame, as in short takes, join known neighbours."""
    covered = filled.copy()
    bins = len(filled)
    any_frame = np.zeros(bins, np.bool_)
    any_frame[np.clip((times / seconds * bins).astype(np.int64), 0, bins - 1)] = True
    for start, stop in flagged_ranges(~any_frame).tolist():
        if start > 0 and stop < bins and filled[start - 1] and filled[stop]:
            covered[start:stop] = True
    return covered


def error_top(largest: float, tau: float) -> float:
    """Return the end of an axis of errors in degrees: a multiple of 30 above the errors and τ, 180 at most."""
    return min(180.0, 30.0 * math.ceil(max(largest, 1.25 * tau, 30.0) / 30.0))


@dataclass(frozen=True)
class AgreementChart:
    """Precision, recall and F by frames over τ, of one limb, group or all, against one annotator.

    Attributes
    ----------
    precision, recall, f : str
        SVG paths.
    tau_x : float
        The place of the τ of the run.
    best_tau, best_f : float
        The τ with the largest F.
    """

    precision: str
    recall: str
    f: str
    tau_x: float
    best_tau: float
    best_f: float


def agreement_chart(taus: Sequence[float], values: Sequence[tuple[float, float, float]], tau: float) -> AgreementChart:
    """Lay out precision, recall and F over τ, each value from 0 to 1; NaN where one is not defined."""
    across = [CHART_WIDTH * min(one, TAU_TOP_DEG) / TAU_TOP_DEG for one in taus]
    paths = []
    for column in range(3):
        rows = [value[column] for value in values]
        known = np.isfinite(rows)
        pieces = [
            [(across[i], CHART_HEIGHT * (1.0 - rows[i])) for i in range(start, stop)]
            for start, stop in flagged_ranges(known).tolist()
        ]
        paths.append("".join(line_path(piece) for piece in pieces))
    f = [value[2] if math.isfinite(value[2]) else -1.0 for value in values]
    best = max(range(len(f)), key=f.__getitem__) if f else 0
    return AgreementChart(
        paths[0], paths[1], paths[2], CHART_WIDTH * min(tau, TAU_TOP_DEG) / TAU_TOP_DEG,
        taus[best] if taus else math.nan, f[best] if f else math.nan,
    )  # fmt: skip


@dataclass(frozen=True)
class DriftCurve:
    """The correction of a sensor's heading over a take.

    Attributes
    ----------
    path : str
        Its SVG path in a box of 100 by 30 units.
    span_deg : float
        Degrees from its smallest to its largest value.
    """

    path: str
    span_deg: float


def drift_curve(knots: Sequence[tuple[float, float]], seconds: float) -> DriftCurve | None:
    """Return the curve of a heading's correction through knots (seconds, degrees); None without knots."""
    if not knots:
        return None
    degrees = [value for _, value in knots]
    low, span = min(degrees), max(degrees) - min(degrees)
    points = [(100.0 * t / seconds, 15.0 if not span else 28.0 - 26.0 * (value - low) / span) for t, value in knots]
    return DriftCurve(line_path(points), span)
