"""The display of a run: lines, tables and progress bars, as a terminal shows them or a program collects them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from types import TracebackType
from typing import Literal, Protocol, Self

Tone = Literal["plain", "main", "better", "worse", "doubtful"]
"""The emphasis of a line or row; the display chooses a colour for it."""


@dataclass(frozen=True)
class Line:
    """A line of text, shown between tables."""

    text: str
    tone: Tone = "plain"


@dataclass(frozen=True)
class Row:
    """A row of a table, with numbers already formatted as text; `section` draws a rule above it."""

    cells: tuple[str, ...]
    tone: Tone = "plain"
    section: bool = False


@dataclass
class ResultTable:
    """A table of results for people to read.

    Attributes
    ----------
    columns : sequence of str
        The headings.
    texts : set of int
        The columns with text, which are left-aligned; the others are numbers.
    title, caption : str or None
        The line above the table, and the remark below it.
    layout : {"wide", "close", "tall"}
        The way in which a terminal shows the table. "wide" shortens texts that do not fit; "close" wraps the texts of
        the first column, so that many columns of numbers fit; "tall" does the same for headings of several lines.
    rows : list of Row
        The rows.
    """

    columns: tuple[str, ...]
    texts: frozenset[int] = frozenset({0})
    title: str | None = None
    caption: str | None = None
    layout: Literal["wide", "close", "tall"] = "wide"
    rows: list[Row] = field(default_factory=list)

    def add(self, *cells: str, tone: Tone = "plain", section: bool = False) -> None:
        """Add a row; `section` draws a rule above it."""
        self.rows.append(Row(cells, tone, section))


class ProgressBar(Protocol):
    """A progress bar, used in a `with` statement."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    def advance(self, n: int = 1) -> None:
        """Advance the bar by n steps."""


Progress = Callable[[str, int], ProgressBar]
"""A function that takes a description and a number of steps, and returns a progress bar."""


class _NoBar:
    """A progress bar that is not shown."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def advance(self, n: int = 1) -> None:
        """Do nothing."""


def no_progress(_description: str, _total: int | None = None) -> ProgressBar:
    """Return a progress bar that is not shown."""
    return _NoBar()


class Display(Protocol):
    """The protocol of displays, which show what a run does, such as a terminal."""

    def message(self, text: str) -> None:
        """Show one line below the heading of a stage."""

    def heading(self, text: str) -> None:
        """Show the heading of a stage."""

    def show(self, *parts: ResultTable | Line) -> None:
        """Show tables and lines, one below the other."""

    def progress(self, description: str, total: int | None = None) -> ProgressBar:
        """Return a progress bar."""

    def activity(self, name: str) -> AbstractContextManager[object]:
        """Show regularly that a step is running, as long as a `with` statement lasts."""


class NoDisplay:
    """A display that shows nothing."""

    def message(self, text: str) -> None:
        """Show nothing."""

    def heading(self, text: str) -> None:
        """Show nothing."""

    def show(self, *parts: ResultTable | Line) -> None:
        """Show nothing."""

    def progress(self, description: str, total: int | None = None) -> ProgressBar:
        """Return a progress bar that is not shown."""
        return _NoBar()

    def activity(self, name: str) -> AbstractContextManager[object]:
        """Report nothing."""
        return nullcontext()
