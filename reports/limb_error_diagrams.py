"""Compute the geometry of the page about limb errors: curves with τ, boxes of runs, agreement, drifts, an example."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64, Bool
from kinedex.ops.inertial.disagreement import flagged_ranges
from kinedex.ops.inertial.rotations import distance_deg, exp, multiply
from kinedex.ops.intervals import in_seconds
from kinedex.reports.plots import line_path, percent

BINS = 600
"""Number of columns of a curve; each column shows the smallest and the largest error of its frames."""

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
        True if the tracked limb jumps in the run; the frames of such runs are not counted in any measure.
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


def _without_holes(filled: Bool, times: F64, known: Bool, seconds: float) -> Bool:
    """Return the columns that a band covers; in short takes, columns without a frame are filled between known ones."""
    covered = filled.copy()
    bins = len(filled)
    any_frame = np.zeros(bins, np.bool_)
    any_frame[np.clip((times / seconds * bins).astype(np.int64), 0, bins - 1)] = True
    for start, stop in flagged_ranges(~any_frame).tolist():
        if start > 0 and stop < bins and filled[start - 1] and filled[stop]:
            covered[start:stop] = True
    return covered


def error_top(largest: float, tau: float) -> float:
    """Return the end of an axis of errors: a multiple of 30 degrees above the errors and τ, at most 180."""
    return min(180.0, 30.0 * math.ceil(max(largest, 1.25 * tau, 30.0) / 30.0))


@dataclass(frozen=True)
class AgreementChart:
    """Precision, recall and F of frames over τ, for a limb, a group or all limbs, against one annotator.

    Attributes
    ----------
    precision, recall, f : str
        SVG paths.
    tau_x : float
        The x of the threshold τ that was used.
    best_tau, best_f : float
        The τ with the largest F, and that F.
    """

    precision: str
    recall: str
    f: str
    tau_x: float
    best_tau: float
    best_f: float


def agreement_chart(taus: Sequence[float], values: Sequence[tuple[float, float, float]], tau: float) -> AgreementChart:
    """Lay out precision, recall and F over τ; values are from 0 to 1, or NaN if not defined."""
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
        The SVG path of the curve in a box of 100 by 30 units.
    span_deg : float
        The difference between the largest and the smallest correction in degrees.
    """

    path: str
    span_deg: float


def drift_curve(knots: Sequence[tuple[float, float]], seconds: float) -> DriftCurve | None:
    """Return the curve of a correction of heading through knots (seconds, degrees); None without knots."""
    if not knots:
        return None
    degrees = [value for _, value in knots]
    low, span = min(degrees), max(degrees) - min(degrees)
    points = [(100.0 * t / seconds, 15.0 if not span else 28.0 - 26.0 * (value - low) / span) for t, value in knots]
    return DriftCurve(line_path(points), span)


FRAMES, HIDDEN = 640, 485
"""The number of frames of the example, and the frame whose error a wrong mapping hides."""

ERRORS = (((1.0, 2.0, 0.0), 50, 200, 70.0), ((0.0, -1.0, 1.0), 400, 600, 100.0))
"""Two errors of the track: axis, first and last frame, and degrees at the last frame."""

MOUNT = np.radians(100.0 / math.hypot(0.69, 1.0, 0.69)) * np.array([-0.69, 1.0, 0.69])
"""A wrong mount, 100 degrees off, as a rotation vector; the thesis does not give the values that it used."""

WORLD = np.radians([0.0, 50.0, 70.0])
"""A wrong rotation between the world frames of sensor and track, as a rotation vector."""

TOP_DEG = 180.0
"""The end of the axis of errors; y is 0 there."""


@dataclass(frozen=True)
class MappingCurve:
    """The errors of the frames that one mapping between sensor and limb gives.

    Attributes
    ----------
    name : str
        The mapping.
    path : str
        SVG path over frames and degrees.
    correct : tuple of (float, float)
        The smallest and the largest error of correctly tracked frames.
    peak : float
        The error of frame 200, in which the track is off by 70 degrees.
    hidden : float
        The error of frame 485, in which the track is off by 42.5 degrees.
    """

    name: str
    path: str
    correct: tuple[float, float]
    peak: float
    hidden: float


def streams() -> tuple[F64, F64]:
    """Return orientations of a sensor and of a track with two errors, quaternions (640, 4)."""
    t = np.arange(float(FRAMES))
    sensor = exp(np.stack([0.9 * np.sin(t / 60), 0.7 * np.sin(t / 43 + 1), 1.1 * np.sin(t / 77 + 2)], axis=1))
    track = sensor.copy()
    for axis, start, last, degrees in ERRORS:
        frames = np.arange(start, last + 1)
        angle = math.radians(degrees) * (frames - start) / (last - start)
        track[frames] = multiply(sensor[frames], exp(angle[:, None] * np.array(axis) / np.linalg.norm(axis)))
    return sensor, track


def mapping_curves() -> list[MappingCurve]:
    """Return the errors for the right mapping, and with one or both rotations wrong (thesis, Figure 7.14 a to c)."""
    sensor, track = streams()
    correct = np.ones(FRAMES, np.bool_)
    for _, start, last, _ in ERRORS:
        correct[start : last + 1] = False
    found = []
    for name, world, mount in (
        ("right mapping", 0.0 * WORLD, 0.0 * MOUNT),
        ("wrong mount", 0.0 * WORLD, MOUNT),
        ("wrong mount and world", WORLD, MOUNT),
    ):
        error = distance_deg(sensor, multiply(multiply(exp(world), track), exp(mount)))
        path = line_path([(float(frame), TOP_DEG - float(value)) for frame, value in enumerate(error)])
        own = error[correct]
        found.append(
            MappingCurve(name, path, (float(own.min()), float(own.max())), float(error[200]), float(error[HIDDEN]))
        )
    return found
