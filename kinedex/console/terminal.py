"""Print results and messages on the terminal: lines, tables, progress bars, and progress lines instead of bars."""

from __future__ import annotations

import logging
import os
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from types import TracebackType
from typing import TYPE_CHECKING, Any, TextIO

from rich.console import Console, ConsoleOptions, ConsoleRenderable, RenderHook, RenderResult
from rich.segment import Segment

from kinedex.console.streams import unescaped
from kinedex.ops.wording import duration, visible, visible_lines, visible_text

if TYPE_CHECKING:
    from kinedex.pipelines.engine.display import Line, ResultTable

_log = logging.getLogger("kinedex.progress")

FIRST_SECONDS = 10.0
"""Seconds without output after which a line reports the current step; also the shortest time between two lines."""

SHARE = 0.2
"""The shortest time between two lines as a fraction of the time since the step began; long steps have few lines."""

LOG_SECONDS = 1.0
LOG_SHARE = 0.02
"""The same fraction for log records with a count, from which programs compute percentages: some 270 in an hour."""


@dataclass
class ProgressStep:
    """A step that may take long, with its name and the amount of work that is done."""

    name: str
    total: int | None = None
    done: int = 0
    begun: float = field(default_factory=time.monotonic)

    def text(self, seconds: float) -> str:
        """Return the line about the step, with name, count, the `seconds` so far, and an estimate of those left."""
        count = "" if self.total is None else f"{self.done:,} of {self.total:,}, "
        left = self.seconds_left(time.monotonic())
        return f"{self.name}: {count}{seconds:.0f} s so far" + (f", about {duration(left)} left" if left else "")

    def seconds_left(self, now: float) -> float | None:
        """Return the seconds left at the mean speed so far; None if nothing or all is done, or the total is unknown."""
        if self.total is None or not 0 < self.done < self.total:
            return None
        return (now - self.begun) * (self.total - self.done) / self.done


class ProgressLines:
    """Prints a line about the innermost running step at intervals.

    Parameters
    ----------
    show : callable
        Prints a line.
    """

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show
        self._steps: list[ProgressStep] = []
        self._spoken = 0.0
        self._end = threading.Event()

    def speak(self) -> None:
        """Record that something was printed just now, which delays the next line."""
        self._spoken = time.monotonic()

    @contextmanager
    def activity(self, name: str, total: int | None = None) -> Iterator[ProgressStep]:
        """Report a step while the block runs; the block counts finished work in `done` of the step."""
        step = ProgressStep(name, total)
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


WIDE = 160
"""Width in characters of a table in a file or a pipe, wide enough that cells are not broken."""

_messages = {"quiet": False, "to_stderr": False}


def configure_messages(*, quiet: bool = False, to_stderr: bool = False) -> None:
    """Choose whether messages and progress are printed, and where; results always go to standard output.

    Parameters
    ----------
    quiet : bool
        Print no messages.
    to_stderr : bool
        Print messages to standard error, so that standard output has only the result.
    """
    _messages.update(quiet=quiet, to_stderr=to_stderr)


def is_quiet() -> bool:
    """Return whether `configure_messages` has chosen to print no messages."""
    return _messages["quiet"]


def make_console() -> Console:
    """Return a console that prints results to standard output."""
    return _console(stderr=False, quiet=False)


def collecting_terminal(file: TextIO) -> Terminal:
    """Return a terminal whose lines and tables are written to a text stream instead of the screen."""
    return Terminal(Console(file=file))


def page_by_page(console: Console) -> AbstractContextManager[object]:
    """Return a context that shows the output of a console in the system's pager; `less` exits after a short text."""
    os.environ.setdefault("LESS", "FRX")
    return console.pager(styles=True)


def message_console() -> Console:
    """Return a console that prints messages as `configure_messages` has chosen."""
    return _console(stderr=_messages["to_stderr"], quiet=_messages["quiet"])


def _console(*, stderr: bool, quiet: bool) -> Console:
    file = unescaped(sys.stderr if stderr else sys.stdout)
    console = EscapingConsole(highlight=False, emoji=False, soft_wrap=True, file=file, quiet=quiet)
    if console.is_terminal:
        return console
    return EscapingConsole(highlight=False, emoji=False, soft_wrap=True, file=file, quiet=quiet, width=WIDE)


class EscapingConsole(Console):
    """A rich console that escapes all texts that it prints; layout and styles are unchanged."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.push_render_hook(_Hook())


class _Hook(RenderHook):
    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        return [_Escaped(one) for one in renderables]


class _Escaped:
    def __init__(self, shown: ConsoleRenderable) -> None:
        self._shown = shown

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render the object, and escape its texts."""
        for text, style, control in console.render(self._shown, options):
            yield Segment(text if control else visible_text(text), style, control)


class Progress:
    """A progress bar, used as a context manager; outside a terminal, it prints a line from time to time."""

    def __init__(self, console: Console, pulse: ProgressLines, description: str, total: int | None) -> None:
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
        from rich.progress import Progress as Bars

        self._bars = Bars(
            TextColumn("    {task.description}"),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            *(() if total is None else (TextColumn("left"), TimeRemainingColumn())),
            console=console,
            transient=True,
            disable=console.quiet or not console.is_terminal,
        )
        self._task = self._bars.add_task(description, total=total)
        self._during = pulse.activity(description, total)

    def __enter__(self) -> Progress:
        self._bars.start()
        self._step = self._during.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._during.__exit__(kind, fault, trace)
        self._bars.stop()

    def advance(self, n: int = 1) -> None:
        """Move the bar by n."""
        self._bars.advance(self._task, n)
        self._step.done += n


class Terminal:
    """Prints messages, tables and progress bars of a pipeline run; stages and runner also log them."""

    def __init__(self, console: Console | None = None) -> None:
        self.console = console or message_console()
        self._pulse = ProgressLines(self._beat)

    def _beat(self, text: str) -> None:
        """Print a line about a long step, unless a terminal shows a bar."""
        if not self.console.is_terminal:
            self.console.print(f"    {visible_lines(text)}", markup=False)

    def activity(self, name: str) -> AbstractContextManager[object]:
        """Report a step from time to time while a `with` statement runs."""
        return self._pulse.activity(name)

    def message(self, text: str) -> None:
        """Print one indented line without markup; a terminal wraps a long line between words."""
        text = visible_lines(text)
        if self.console.is_terminal:
            text = "\n".join(self._wrapped(line) for line in text.splitlines())
        self._pulse.speak()
        self.console.print(f"    {text}", markup=False)

    def _wrapped(self, line: str) -> str:
        # a path longer than a line is not broken, so that it can be copied
        return textwrap.fill(
            line, max(self.console.width, 40) - 4, subsequent_indent=" " * 8, break_long_words=False,
            break_on_hyphens=False,
        )  # fmt: skip

    def heading(self, text: str) -> None:
        """Print one line that begins a step."""
        self.console.print(visible(text), markup=False, style="bold")

    def show(self, *parts: ResultTable | Line) -> None:
        """Print tables of results, and lines between them."""
        from kinedex.console.tables import result_tables

        self.console.print(result_tables(parts))

    def progress(self, description: str, total: int | None = None) -> Progress:
        """Return a progress bar, to be used in a `with` statement."""
        return Progress(self.console, self._pulse, description, total)
