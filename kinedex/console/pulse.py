"""Print and log lines about long steps, for outputs that show no progress bar."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from kinedex.ops.wording import duration

_log = logging.getLogger("kinedex.progress")

FIRST_SECONDS = 10.0
"""Seconds without a message after which a line reports the step; also the shortest time between two lines."""

SHARE = 0.2
"""The shortest time between two lines as a fraction of the time since the step began, so that a long step has few."""

LOG_SECONDS = 1.0
LOG_SHARE = 0.02
"""The same for log records with a count, from which programs compute percentages: some 270 in an hour."""


@dataclass
class PulseStep:
    """A step that may take long: its name, and how much of it is done."""

    name: str
    total: int | None = None
    done: int = 0
    begun: float = field(default_factory=time.monotonic)

    def text(self, seconds: float) -> str:
        """Return the line about the step: its name, its count, the `seconds` so far, and an estimate of the rest."""
        count = "" if self.total is None else f"{self.done:,} of {self.total:,}, "
        left = self.seconds_left(time.monotonic())
        return f"{self.name}: {count}{seconds:.0f} s so far" + (f", about {duration(left)} left" if left else "")

    def seconds_left(self, now: float) -> float | None:
        """Return the seconds that the rest will take at the mean speed so far; None if nothing is done yet."""
        if self.total is None or not 0 < self.done < self.total:
            return None
        return (now - self.begun) * (self.total - self.done) / self.done


class Pulse:
    """Prints a line about the innermost running step at intervals.

    Parameters
    ----------
    show : callable
        Prints a line.
    """

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show
        self._steps: list[PulseStep] = []
        self._spoken = 0.0
        self._end = threading.Event()

    def speak(self) -> None:
        """Record that something was printed now, which delays the next line."""
        self._spoken = time.monotonic()

    @contextmanager
    def during(self, name: str, total: int | None = None) -> Iterator[PulseStep]:
        """Report a step while the block runs; the step's `done` counts what is finished."""
        step = PulseStep(name, total)
        self._steps.append(step)
        thread = None
        if len(self._steps) == 1:
            self.speak()
            self._end = threading.Event()
            thread = threading.Thread(target=self._beat, args=(self._end,), name="progress", daemon=True)
            thread.start()
        try:
            yield step
        finally:
            self._steps.remove(step)
            if thread is not None:
                self._end.set()
                thread.join()

    def _beat(self, end: threading.Event) -> None:
        begin = logged = time.monotonic()
        while not end.wait(min(self._due(begin), _log_due(begin, logged))):
            steps = list(self._steps)
            if not steps:
                continue
            text = steps[-1].text(time.monotonic() - begin)
            is_due, is_counted = self._due(begin) <= 0, steps[-1].total is not None
            if is_due:
                self.speak()
                self._show(text)
            if _log_due(begin, logged) <= 0:
                logged = time.monotonic()
                is_due = is_due or is_counted
            if is_due:
                count = {"done": steps[-1].done, "total": steps[-1].total} if is_counted else {}
                _log.info("%s", text, extra={"event": "progress", **count})

    def _due(self, begin: float) -> float:
        """Return the seconds until the next line should be printed."""
        now = time.monotonic()
        return max(0.0, self._spoken + max(FIRST_SECONDS, SHARE * (now - begin)) - now)


def _log_due(begin: float, logged: float) -> float:
    """Return the seconds until the next record with a count should be logged."""
    now = time.monotonic()
    return max(0.0, logged + max(LOG_SECONDS, LOG_SHARE * (now - begin)) - now)
