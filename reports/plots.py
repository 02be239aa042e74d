"""Compute the geometry of plots: lines, histograms and axes; time is in percent of a width, the rest in SVG units."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

STEPS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1200.0, 3600.0)


@dataclass(frozen=True)
class Axis:
    """The ticks of an axis as (position in percent, text), and their distance in percent."""

    ticks: tuple[tuple[float, str], ...]
    step_percent: float


def time_axis(seconds: float, most: int = 8, room: float = 0.97) -> Axis:
    """Choose round ticks for a length of time.

    Parameters
    ----------
    seconds : float
        Length of the axis; must be positive.
    most : int
        Largest number of steps, so that texts do not touch on a narrow screen.
    room : float
        Share of the width in which a text may begin, so that the last text fits.

    Returns
    -------
    Axis
        The ticks from 0 on; the text of the last tick has the unit.
    """
    step = next((step for step in STEPS if seconds / step <= most), seconds / most)
    decimals = 1 if step < 1 else 0
    values = [i * step for i in range(int(seconds / step + 1e-9) + 1)]
    kept = [value for value in values if value <= room * seconds] or [0.0]
    texts = [f"{value:.{decimals}f}" for value in kept]
    texts[-1] += " s"
    ticks = tuple((percent(value, seconds), text) for value, text in zip(kept, texts, strict=True))
    return Axis(ticks, percent(step, seconds))


def percent(part: float, whole: float) -> float:
    """Return a position in percent with two digits."""
    return round(100 * part / whole, 2) if whole else 0.0


@dataclass(frozen=True)
class HistogramBar:
    """One bar of a histogram.

    Attributes
    ----------
    low, high : float
        The bar counts the values from `low` to `high`.
    count : int
        Number of values.
    x, y, width, height : float
        Place of the bar in SVG units.
    """

    low: float
    high: float
    count: int
    x: float
    y: float
    width: float
    height: float


def line_path(points: Iterable[tuple[float, float]]) -> str:
    """Return the SVG path of a line through points, to a tenth of a unit; empty without points."""
    texts = [f"{x:.1f} {y:.1f}" for x, y in points]
    return "M" + "L".join(texts) if texts else ""


def histogram(
    values: npt.ArrayLike, low: float, high: float, bins: int, size: tuple[float, float], margin: float
) -> list[HistogramBar]:
    """Lay out a histogram.

    Parameters
    ----------
    values : array_like of float
        The values to count; those outside of [low, high] are not counted.
    low, high : float
        Ends of the axis.
    bins : int
        Number of bars.
    size : tuple of float
        Width and height of the plot in SVG units.
    margin : float
        Space to the left and right of each bar in SVG units.

    Returns
    -------
    list of HistogramBar
        The bars from left to right; the tallest has the height of the plot.
    """
    counts, edges = np.histogram(np.asarray(values, np.float64), bins=bins, range=(low, high))
    width, height = size
    top = max(int(counts.max()), 1)
    step = width / bins
    return [
        HistogramBar(
            float(edges[index]), float(edges[index + 1]), count, step * index + margin, height * (1 - count / top),
            step - 2 * margin, height * count / top,
        )
        for index, count in enumerate(counts.tolist())
    ]  # fmt: skip


def share_ticks(width: float, shares: Sequence[float]) -> list[tuple[float, str]]:
    """Return the ticks of an axis from 0 to 1, as (x in SVG units, text)."""
    return [(width * share, f"{share:g}") for share in shares]
