"""The geometry of plots in SVG units: lines, histograms, and the ticks of their axes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class HistogramBar:
    """One bar of a histogram.

    Attributes
    ----------
    low, high : float
        The values that the bar counts are from `low` to `high`.
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
