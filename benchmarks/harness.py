"""How benchmarks are timed, printed and written: the best of several runs, beside something else in the same run."""

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

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from kinedex.pipelines.console.terminal import Terminal


@dataclass(frozen=True)
class Figure:
    """One benchmark: how much work of what unit was done in how many seconds, and how long the other way took.

    seconds, other_seconds: the best of several runs. other: what it is compared with, done on the same work in the
    same run, or what is asked for; where nothing could be timed, why.

    Memory, a slope, nanoseconds a run have no rate: for these seconds is None, amount is what was found, and
    other_amount what it is compared with. Less is better.
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
        """Units a second."""
        return None if self.seconds is None else self.amount / self.seconds

    @property
    def ratio(self) -> float | None:
        """How many times as fast as the other way; where nothing is timed, how many times as small."""
        if self.seconds is not None:
            return None if self.other_seconds is None else self.other_seconds / self.seconds
        return self.other_amount / self.amount if self.other_amount is not None and self.amount else None

    @property
    def shown(self) -> str:
        """The rate, or where nothing is timed the amount, with its unit."""
        if self.rate is not None:
            return f"{self.rate:,.4g} {self.unit}/s"
        return f"{self.amount:,.4g} {self.unit}".rstrip() if self.amount else "–"


def seconds(work: Callable[[], object], runs: int = 5) -> float:
    """The best time of some runs, after one that does not count (it compiles, and fills the caches).

    Whatever else the machine does can only add to a time, so the least is nearest to what the work itself takes.
    """
    work()
    times = []
    for _ in range(runs):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return min(times)


def silent() -> Terminal:
    """A terminal that nobody sees."""
    return Terminal(Console(file=io.StringIO()))


def calibrate() -> Figure:
    """What the machine is worth this minute: sorting random numbers, which no part of kinedex does."""
    numbers = np.random.default_rng(0).random(2_000_000)
    return Figure("calibration: numpy sort", 2.0, "M numbers", seconds(lambda: np.sort(numbers)))


def show(figures: list[Figure]) -> Table:
    """The figures as a table for the terminal."""
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
    """Write the figures as JSON, named after the moment."""
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
