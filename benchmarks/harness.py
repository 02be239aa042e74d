"""Time benchmarks, print and write them: the best of several runs, beside a comparison in the same run."""

from __future__ import annotations

import io
import json
import os
import platform
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from kinedex.console.terminal import Terminal

SMALL_VARIABLE = "KINEDEX_BENCH_SMALL"
"""The variable that asks for sizes at which every part takes seconds; processes that a part starts inherit it."""

SMALL = os.environ.get(SMALL_VARIABLE) == "1"

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build" / "bench" / ("small" if SMALL else "")
"""Folder of what benchmarks make, apart for the small size."""

LEFT_OUT = "left out: "
"""The begin of a reason why nothing was measured."""

T = TypeVar("T")


def sized(whole: T, small: T) -> T:
    """Return a size, or the one at which a part takes seconds if that is asked for."""
    return small if SMALL else whole


@dataclass(frozen=True)
class Figure:
    """One benchmark: an amount of work, the seconds it took, and the same for what it is compared with.

    Memory, slopes and nanoseconds a run have no rate: their `seconds` is None, and less is better.

    Attributes
    ----------
    name : str
        The work.
    amount : float
        The amount of work in `unit`; where nothing is timed, the measured value.
    unit : str
        The unit of `amount`.
    seconds : float or None
        The best time of several runs.
    other : str
        The comparison, on the same work in the same run, or the required value; the reason where nothing was timed.
    other_seconds : float or None
        The best time of the comparison.
    other_amount : float or None
        The value of the comparison where nothing is timed.
    """

    name: str
    amount: float
    unit: str
    seconds: float | None
    other: str = ""
    other_seconds: float | None = None
    other_amount: float | None = None

    @property
    def rate(self) -> float | None:
        """Return the units done in a second; None where nothing is timed."""
        return None if self.seconds is None else self.amount / self.seconds

    @property
    def ratio(self) -> float | None:
        """Return how many times as fast as the comparison this is; where nothing is timed, as small."""
        if self.seconds is not None:
            return None if self.other_seconds is None else self.other_seconds / self.seconds
        return self.other_amount / self.amount if self.other_amount is not None and self.amount else None

    @property
    def left_out(self) -> bool:
        """Return True where nothing was measured as something is missing; `other` says what."""
        return self.other.startswith(LEFT_OUT)

    @property
    def shown(self) -> str:
        """Return the rate with its unit, or the amount where nothing is timed."""
        if self.rate is not None:
            return f"{self.rate:,.4g} {self.unit}/s"
        return f"{self.amount:,.4g} {self.unit}".rstrip() if self.amount else "–"


def seconds(work: Callable[[], object], runs: int = 5) -> float:
    """Return the best time of several runs, after one that compiles and fills the caches.

    Other work of the machine only adds to a time, so the smallest is nearest to the cost of the work itself.
    """
    work()
    times = []
    for _ in range(sized(runs, 1)):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return min(times)


def silent() -> Terminal:
    """Return a terminal whose output is dropped."""
    return Terminal(Console(file=io.StringIO()))


def calibrate() -> Figure:
    """Measure the speed of the machine by sorting random numbers, which no part of kinedex does."""
    numbers = np.random.default_rng(0).random(2_000_000)
    return Figure("calibration: numpy sort", 2.0, "M numbers", seconds(lambda: np.sort(numbers)))


def show(figures: list[Figure]) -> Table:
    """Lay the figures out as a table for the terminal."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in ("benchmark", "rate or amount", "seconds", "beside it, in the same run", "times as good"):
        table.add_column(column, justify="left" if column[:2] == "be" else "right", no_wrap=True)
    for figure in figures:
        table.add_row(
            figure.name,
            figure.shown,
            f"{figure.seconds:.{4 if figure.seconds >= 0.1 else 6}f}" if figure.seconds is not None else "–",
            figure.other or "–",
            f"{figure.ratio:,.1f}" if figure.ratio is not None else "–",
        )
    return table


def write(figures: list[Figure], folder: Path) -> Path:
    """Write the figures as JSON into a file named after the time, and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    moment = datetime.now(UTC)
    path = folder / f"{moment:%Y%m%d-%H%M%S}.json"
    content = {
        "moment": moment.isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "figures": [asdict(figure) | {"rate": figure.rate, "ratio": figure.ratio} for figure in figures],
    }
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return path
