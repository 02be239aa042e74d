"""Time axes: round steps in seconds, positions in percent of a figure's width."""

from __future__ import annotations

from dataclasses import dataclass

STEPS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1200.0, 3600.0)


@dataclass(frozen=True)
class Axis:
    """Ticks as (position in percent, text), and the distance of two of them in percent."""

    ticks: tuple[tuple[float, str], ...]
    step_percent: float


def time_axis(seconds: float, most: int = 8, room: float = 0.97) -> Axis:
    """Lay round ticks on a span of time.

    Parameters
    ----------
    seconds: the length of the figure; must be positive.
    most: how many steps at most, so that the texts of a narrow screen do not touch.
    room: the share of the width in which a text may begin, so that the last one stays inside.

    Returns
    -------
    The ticks from 0 on; the last one carries the unit.
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
    """Return a position in percent, with the digits that a screen can show."""
    return round(100 * part / whole, 2) if whole else 0.0
