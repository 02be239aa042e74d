"""What the user sees while a pipeline runs: lines, progress bars, tables."""

from __future__ import annotations

import textwrap
from types import TracebackType

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars

WIDE = 160  # columns of a table that goes to a file or a pipe: wide enough that cells stay whole


def make_console() -> Console:
    """The console that kinedex prints on."""
    console = Console(highlight=False, soft_wrap=True)
    return console if console.is_terminal else Console(highlight=False, soft_wrap=True, width=WIDE)


class Progress:
    """One progress bar; a context manager. Where the output is no terminal it prints nothing."""

    def __init__(self, console: Console, description: str, total: int | None) -> None:
        self._bars = Bars(
            TextColumn("    {task.description}"),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._bars.add_task(description, total=total)

    def __enter__(self) -> Progress:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()

    def advance(self, n: int = 1) -> None:
        """Move the bar by n."""
        self._bars.advance(self._task, n)


class Terminal:
    """Where stages speak."""

    def __init__(self, console: Console | None = None) -> None:
        self.console = console or make_console()

    def say(self, text: str) -> None:
        """Print one indented line as it is (no markup); in a terminal a long one goes on below, between two words."""
        if self.console.is_terminal:
            text = "\n".join(self._wrapped(line) for line in text.splitlines())
        self.console.print(f"    {text}", markup=False)

    def _wrapped(self, line: str) -> str:
        # a path longer than a line stays one word, so that it can be copied
        return textwrap.fill(
            line, max(self.console.width, 40) - 4, subsequent_indent=" " * 8, break_long_words=False,
            break_on_hyphens=False,
        )  # fmt: skip

    def heading(self, text: str) -> None:
        """Print one line that begins a step."""
        self.console.print(text, markup=False, style="bold")

    def show(self, table: RenderableType) -> None:
        """Print a rich table or anything else that rich can show."""
        self.console.print(table)

    def progress(self, description: str, total: int | None = None) -> Progress:
        """A progress bar, to be used in a `with` statement."""
        return Progress(self.console, description, total)
