"""Run the interactive SQL prompt, which works like the DuckDB shell, and make hints about rows that are not shown."""

from __future__ import annotations

import os
import re
import shlex
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import partial
from pathlib import Path

from rich.console import Console

from kinedex.catalog.sql.views import MACROS, VIEWS, Macro, View
from kinedex.console.tables import PrintedTable
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.wording import counted, name_list
from kinedex.storage.interruption import abandoned_statements
from kinedex.storage.snapshot.manifest import Manifest
from kinedex.storage.snapshot.visible_results import (
    PIPELINE_KINDS,
    all_parts,
    pipeline_of,
    shown_parts,
    shown_pipeline,
)
from kinedex.storage.sql.queries import QueryResult, split_statements
from kinedex.storage.store.store import Store

_QUOTED = re.compile(r"'(?:[^']|'')*'|--[^\n]*|/\*.*?\*/", re.DOTALL)


def hidden_rows_hints(store: Store, statement: str, rows: int) -> list[str]:
    """Return a hint for each view in a statement that is empty only because its rows are of another pipeline.

    Parameters
    ----------
    store : Store
        The store that was queried.
    statement : str
        The SQL statement.
    rows : int
        Number of rows of the result. If it is 0, hints are also given for views that show some rows.
    """
    words = set(re.findall(r"\w+", _QUOTED.sub(" ", statement).lower()))
    hints = []
    for kind in (kind for kind in PIPELINE_KINDS if kind in words):
        shown = sum(part.rows for part in shown_parts(store.manifest, kind))
        others = _hidden(store.manifest, kind)
        if others and (not shown or not rows):
            names = name_list([f"{name} ({counted(count, 'row')})" for name, count in others.items()])
            current = shown_pipeline(store.manifest, kind)
            hints.append(
                f"{kind} shows {counted(shown, 'row')} of pipeline {current}; all_{kind} has those of {names}, too, "
                f"and `kinedex use {shlex.quote(str(store.path))} NAME` shows another pipeline"
            )
    return hints


def _hidden(manifest: Manifest, kind: str) -> dict[str, int]:
    """Return the pipelines whose rows of a kind are not shown, with the number of their rows."""
    shown = {part.path for part in shown_parts(manifest, kind)}
    counts: Counter[str] = Counter()
    for part in all_parts(manifest, kind):
        if part.path not in shown and part.rows:
            counts[pipeline_of(part.stage)] += part.rows
    return dict(sorted(counts.items()))


HELP = """.tables          list the views and macros
.schema [NAME]   show the columns of a view or the arguments of a macro; without a name, the columns of all views
.help [NAME]     show this list, or the purpose of a view or macro with an example
.quit            leave (so does Ctrl-D); Ctrl-C stops a running statement, or clears the input
Anything else is SQL and ends with a semicolon; SELECT * FROM help; lists views and macros with examples."""

COMMANDS = (".tables", ".schema", ".help", ".quit")

_ENTRIES: dict[str, View | Macro] = {entry.name: entry for entry in (*VIEWS, *MACROS)}


def history_file() -> Path:
    """Return the file of the prompt's history, in the folder of the system for such files."""
    local = os.environ.get("LOCALAPPDATA") if os.name == "nt" else None
    base = os.environ.get("XDG_STATE_HOME") or local or Path.home() / ".local" / "state"
    return Path(base) / "kinedex" / "sql_history"


def run_prompt(
    store: Store,
    console: Console,
    read: Callable[[str], str] = input,
    *,
    timeout: float | None = None,
    max_rows: int | None = None,
) -> None:
    """Read statements and dot commands, and print their results, until the input ends.

    Parameters
    ----------
    store : Store
        The store to query.
    console : Console
        The console on which results are printed.
    read : callable
        Function that prompts for one line; it raises EOFError at the end, and KeyboardInterrupt at Ctrl-C.
    timeout : float, optional
        Seconds that a statement may take.
    max_rows : int, optional
        Largest number of rows of a result that are printed and kept in memory; None for all.
    """
    with _history() if read is input else nullcontext():
        console.print(f"{store!r}; .help for help", markup=False)
        typed: str | None = ""
        while typed is not None:
            try:
                line = read("kinedex> " if not typed else "    ...> ")
                typed = _take_line(store, console, f"{typed}\n{line}" if typed else line, timeout, max_rows)
            except EOFError:
                console.print()
                return
            except KeyboardInterrupt:
                console.print()
                typed = ""


def _take_line(store: Store, console: Console, typed: str, timeout: float | None, max_rows: int | None) -> str | None:
    """Run the complete statements typed so far, and return the text after them; None for the command `.quit`."""
    if "\n" not in typed and typed.strip().startswith("."):
        # a semicolon after a command is allowed, as in the DuckDB shell
        words = typed.strip().rstrip(";").split() or ["."]
        if words[0] in (".quit", ".exit"):
            return None
        _answer(console, partial(_dot, store, console, words))
        return ""
    whole, typed = split_statements(typed)
    for statement in whole:
        if not _answer(console, partial(_select, store, console, statement, timeout, max_rows)):
            break
    return typed


def _answer(console: Console, work: Callable[[], None]) -> bool:
    """Run a statement or command, print its error if it fails, and return whether it succeeded."""
    before = abandoned_statements()
    try:
        work()
    except KinedexError as fault:
        console.print(str(fault), markup=False, style="red")
    except KeyboardInterrupt:
        console.print("stopped", style="red")
    else:
        return True
    if abandoned_statements() > before:
        console.print("its last function still computes, until it returns or you leave the prompt", style="red")
    return False


def _select(store: Store, console: Console, statement: str, timeout: float | None, max_rows: int | None) -> None:
    found = store.answer(statement, timeout=timeout, max_rows=max_rows)
    console.print(PrintedTable(found.table))
    console.print(rows_line(found), markup=False)
    for hint in hidden_rows_hints(store, statement, found.rows):
        console.print(hint, markup=False)


def rows_line(found: QueryResult) -> str:
    """Return the line with the number of rows, and of shown rows if these are fewer."""
    rows = f"{'' if found.counted else 'more than '}{found.rows:,} row{'' if found.rows == 1 else 's'}"
    shown = found.table.num_rows
    return rows if found.counted and shown == found.rows else f"{rows}; the first {shown:,} are shown"


def _dot(store: Store, console: Console, words: list[str]) -> None:
    match words:
        case [".help"]:
            console.print(HELP, markup=False)
        case [".tables"]:
            console.print("  ".join(sorted(_views(store))), markup=False)
            console.print(f"macros: {'  '.join(sorted(macro.name for macro in MACROS))}", markup=False)
        case [".schema"]:
            query = (
                "SELECT table_name AS view, column_name AS column, data_type AS type FROM information_schema.columns"
            )
            console.print(PrintedTable(store.sql(f"{query} ORDER BY table_name, ordinal_position")))
        case [".schema" | ".help", name]:
            known = _views(store) | {macro.name for macro in MACROS}
            if name not in known:
                # a view is listed even if the index that it needs is missing
                without = f"; {name} needs an index, see `SELECT * FROM {name}`" if name in _ENTRIES else ""
                near = without or did_you_mean(name, known | set(_ENTRIES))
                raise KinedexError(f"no view or macro '{name}'; .tables lists them{near}")
            _describe(store, console, words[0], name)
        case [(".tables" | ".schema" | ".help") as command, *_]:
            raise KinedexError(f"{command}: expected {'no name' if command == '.tables' else 'at most one name'}")
        case [other, *_]:
            raise KinedexError(f"no command '{other}'{did_you_mean(other, COMMANDS)}")


def _views(store: Store) -> set[str]:
    """Return the names of the views of the store, without the tables on which they are based."""
    found = store.sql("SELECT DISTINCT table_name FROM information_schema.columns").column(0).to_pylist()
    return {name for name in found if not name.startswith("stored_")}


def _describe(store: Store, console: Console, command: str, name: str) -> None:
    entry = _ENTRIES.get(name)
    if command == ".help" and entry is not None:
        call = entry.signature if isinstance(entry, Macro) else entry.name
        console.print(f"{call}\n  {entry.summary}\n  {entry.example};", markup=False)
    elif isinstance(entry, Macro):
        console.print(entry.signature, markup=False)
        for argument, default, meaning in entry.arguments:
            text = meaning if default is None else f"{meaning} (default {default})"
            console.print(f"  {argument}: {text}", markup=False)
    else:
        query = "SELECT column_name AS column, data_type AS type FROM information_schema.columns WHERE table_name = $1"
        console.print(PrintedTable(store.sql(f"{query} ORDER BY ordinal_position", [name])))


@contextmanager
def _history() -> Iterator[None]:
    """Enable line editing, history and completion if Python has readline, which is missing on Windows."""
    try:
        import readline
    except ImportError:
        yield
        return
    readline.set_completer(completer([*COMMANDS, *_ENTRIES, *(c.name for view in VIEWS for c in view.columns)]))
    readline.set_completer_delims(" \t\n,;()='\"")
    readline.parse_and_bind("tab: complete")
    readline.set_history_length(2000)
    path = history_file()
    # the prompt works without a history file
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            readline.read_history_file(path)
    try:
        yield
    finally:
        with suppress(OSError):
            readline.write_history_file(path)


def completer(names: Iterable[str]) -> Callable[[str, int], str | None]:
    """Return the function that readline calls for the n-th name with a prefix."""
    known = sorted(set(names))

    def complete(text: str, n: int) -> str | None:
        fitting = [name for name in known if name.startswith(text)]
        return fitting[n] if n < len(fitting) else None

    return complete
