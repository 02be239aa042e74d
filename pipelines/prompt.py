"""The interactive SQL prompt, with the habits of the DuckDB shell: history, several lines, dot commands."""

from __future__ import annotations

import atexit
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

from rich.console import Console

from ops.errors import KinedexError, did_you_mean
from pipelines.tables import rich_table
from storage.store import Store

HELP = """.tables          the views there are
.schema [VIEW]   the columns of a view, or of all of them
.help            this list
.quit            leave (so does Ctrl-D)
Anything else is SQL and ends with a semicolon; SELECT * FROM help; lists views and macros with examples."""

ROWS = 200
"""Most rows that the prompt prints; it says when there are more."""


def history_file() -> Path:
    """Where the prompt remembers what was typed."""
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(base) / "kinedex" / "sql_history"


def run_prompt(store: Store, console: Console, read: Callable[[str], str] = input) -> None:
    """Read statements and dot commands and answer them, until the input ends.

    Parameters
    ----------
    read: asks for one line; raises EOFError at the end.
    """
    if read is input:
        _remember()
    console.print(f"{store!r}; .help for help", markup=False)
    lines: list[str] = []
    while True:
        try:
            line = read("kinedex> " if not lines else "    ...> ")
        except EOFError:
            return
        except KeyboardInterrupt:
            console.print()
            lines = []
            continue
        if not lines and line.strip().startswith("."):
            if line.split()[0] in (".quit", ".exit"):
                return
            _answer(console, partial(_dot, store, console, line.split()))
            continue
        lines.append(line)
        if line.rstrip().endswith(";"):
            statement = "\n".join(lines)
            lines = []
            _answer(console, partial(_select, store, console, statement))
        elif not "".join(lines).strip():
            lines = []


def _answer(console: Console, work: Callable[[], None]) -> None:
    try:
        work()
    except KinedexError as fault:
        console.print(str(fault), markup=False, style="red")


def _select(store: Store, console: Console, statement: str) -> None:
    table = store.sql(statement)
    console.print(rich_table(table.slice(0, ROWS)))
    rows = f"{table.num_rows:,} rows"
    console.print(rows if table.num_rows <= ROWS else f"{rows}, of which the first {ROWS} are shown", markup=False)


def _dot(store: Store, console: Console, words: list[str]) -> None:
    columns = "SELECT table_name AS view, column_name AS column, data_type AS type FROM information_schema.columns"
    match words[0]:
        case ".help":
            console.print(HELP, markup=False)
        case ".tables":
            names = store.sql("SELECT DISTINCT table_name FROM information_schema.columns ORDER BY 1")
            console.print("  ".join(names.column(0).to_pylist()), markup=False)
        case ".schema" if len(words) == 1:
            console.print(rich_table(store.sql(f"{columns} ORDER BY table_name, ordinal_position")))
        case ".schema":
            found = store.sql(f"{columns} WHERE table_name = $1 ORDER BY ordinal_position", [words[1]])
            if not found.num_rows:
                raise KinedexError(f"no view '{words[1]}'; .tables lists them")
            console.print(rich_table(found))
        case other:
            raise KinedexError(f"no command '{other}'{did_you_mean(other, ['.tables', '.schema', '.help', '.quit'])}")


def _remember() -> None:
    """Line editing and history where Python has readline; without it the prompt works all the same."""
    try:
        import readline
    except ImportError:
        return
    path = history_file()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            readline.read_history_file(path)
    except OSError:
        return
    readline.set_history_length(2000)
    atexit.register(readline.write_history_file, path)
