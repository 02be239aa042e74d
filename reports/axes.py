"""Compute time axes with round steps in seconds; positions are in percent of the width of a figure."""

from __future__ import annotations

from dataclasses import dataclass

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
        Share of the width in which a text may begin, so that the last one fits.

    Returns
    -------
    Axis
        The ticks from 0 on; the last one has the unit.
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
