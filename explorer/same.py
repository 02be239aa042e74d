"""Command lines and Python lines that do the same as a request of the page."""

from __future__ import annotations

import shlex
from pathlib import Path

from kinedex.explorer.archive import Archive


def command_line(*words: str | Path) -> str:
    """Return a command of the shell, its words quoted where they need it.

    Examples
    --------
    >>> command_line("kinedex", "sql", Path("my store"), "SELECT 1")
    "kinedex sql 'my store' 'SELECT 1'"
    """
    return shlex.join(str(word) for word in words)


def python_lines(store: Path, *lines: str) -> str:
    """Return a Python program that opens the store as `store` and then runs some lines.

    Examples
    --------
    >>> print(python_lines(Path("my store"), "store.takes()"))
    import kinedex
    store = kinedex.open_store('my store')
    store.takes()
    """
    return "\n".join(["import kinedex", f"store = kinedex.open_store({str(store)!r})", *lines])


def same_query(archive: Archive, text: str) -> dict[str, str]:
    """Return the command and the Python lines that run a SQL query on the store."""
    return {
        "command": command_line("kinedex", "sql", archive.path, text),
        "python": python_lines(archive.path, f"store.sql({text!r})"),
    }
