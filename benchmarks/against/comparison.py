"""Compare the measurements of two commits: the ratio, its spread, and which figures fell."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich import box
from rich.table import Table

FALL = 0.9
"""A figure fell if even the upper end of its ratio's spread is below this."""


@dataclass(frozen=True)
class Compared:
    """A figure at two commits.

    Attributes
    ----------
    figure, unit : str
        What was measured, and its unit.
    other, this : float or None
        The median measurement of each; None where the commit has no such figure.
    ratio : float or None
        How many times as good this is as the other: the median of the rounds.
    low, high : float or None
        The quartiles of the rounds' ratios.
    fell : bool
        True if this is worse by more than 10 % beyond the spread.
    remark : str
        The reason why there is no ratio.
    """

    figure: str
    unit: str
    other: float | None = None
    this: float | None = None
    ratio: float | None = None
    low: float | None = None
    high: float | None = None
    fell: bool = False
    remark: str = ""

    @property
    def spread(self) -> str:
        """Return low and high as text."""
        return f"{self.low:.2f} to {self.high:.2f}" if self.low is not None and self.high is not None else "–"

    @property
    def outcome(self) -> str:
        """Return the ratio with its spread, or why there is none, as text."""
        if self.ratio is None:
            return self.remark
        return f"{self.ratio:.2f} ({self.spread}){' FELL' if self.fell else ''}"


def value_of(measured: dict[str, float], unit: str) -> float:
    """Return a measurement in a figure's unit: MB of memory, seconds, or a rate."""
    if "bytes" in measured:
        return measured["bytes"] / 1e6
    if unit.endswith("/s"):
        return measured["amount"] / measured["seconds"]
    return measured["seconds"] * {"s": 1.0, "ms": 1e3}[unit]


def compare(figure: str, unit: str, other: Iterable[dict[str, float]], this: Iterable[dict[str, float]]) -> Compared:
    """Compare the measurements of two sides, round by round.

    Parameters
    ----------
    figure, unit : str
        The name of the figure, and its unit: a rate ends in "/s" and is better when it is more; all else when less.
    other, this : iterable of dict
        The measurements of the two commits, in the order of the rounds.
    """
    here, there = (np.array([value_of(one, unit) for one in side]) for side in (this, other))
    ratios = here / there if unit.endswith("/s") else there / here
    low, ratio, high = (float(one) for one in np.quantile(ratios, (0.25, 0.5, 0.75)))
    return Compared(figure, unit, float(np.median(there)), float(np.median(here)), ratio, low, high, high < FALL)


def show(rows: Iterable[Compared], other: str) -> Table:
    """Lay out compared figures as a table for the terminal."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in ("figure", "unit", other, "this", "ratio", "low to high", ""):
        table.add_column(column, justify="left" if column in ("figure", "unit", "") else "right", no_wrap=column != "")
    for row in rows:
        ratio = f"{row.ratio:.2f}" if row.ratio is not None else "–"
        table.add_row(
            row.figure, row.unit, _shown(row.other), _shown(row.this), ratio, row.spread,
            "FELL" if row.fell else row.remark,
        )  # fmt: skip
    return table


def _shown(value: float | None) -> str:
    return "–" if value is None else f"{value:,.4g}"


def write(rows: Iterable[Compared], path: Path) -> None:
    """Write compared figures as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n", encoding="utf-8")
