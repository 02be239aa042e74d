"""Run the command line `kinedex COMMAND`."""

from __future__ import annotations

import atexit
import gc
import os
import sys
from contextlib import suppress

from kinedex.commands.app import app
from kinedex.commands.command_list import ASK, COMMANDS, SEARCH
from kinedex.console.streams import escape_streams

__all__ = ["app", "main"]

FIRST = 250_000
"""The number of objects at which Python first collects garbage; a command allocates at most some 160,000."""


def delay_collection() -> None:
    """Delay the first garbage collection until there are `FIRST` objects, and skip the collection at exit.

    After the first collection, the usual thresholds apply. Files are still closed at exit, because this depends on
    reference counts and `atexit`, not on garbage collection.
    """
    usual = gc.get_threshold()
    if usual[0] in (0, FIRST):
        return  # collection is switched off, or already delayed

    def go_on(phase: str, _: dict[str, int]) -> None:
        if phase == "stop":
            gc.callbacks.remove(go_on)
            gc.set_threshold(*usual)

    gc.callbacks.append(go_on)
    gc.set_threshold(FIRST, *usual[1:])
    atexit.register(_leave_out_the_last)


def _leave_out_the_last() -> None:
    """Skip the collection at exit, unless DuckDB is loaded, whose bindings would report objects that are not freed."""
    if "_duckdb" not in sys.modules:
        gc.freeze()


def main() -> None:
    """Run the console command `kinedex`; its output is UTF-8, on Windows too."""
    escape_streams()
    if sys.argv[1:2] and sys.argv[1] in COMMANDS and COMMANDS[sys.argv[1]].panel in (ASK, SEARCH):
        delay_collection()
    try:
        app(prog_name="kinedex")  # use the same name in usage messages, whichever file was started
    except SystemExit as end:
        _leave_a_running_statement(end.code)
        raise


def _leave_a_running_statement(code: object) -> None:
    """End the process at once if a SQL statement still runs.

    A usual exit of Python would unload DuckDB while the statement, or the thread that frees its memory, still runs.
    Nothing is lost: SQL opens a store read-only and holds no lock, the prompt has written its history, and DuckDB
    removes the temporary files of ended processes.
    """
    running = sys.modules.get("kinedex.storage.interruption")
    if running is not None and running.is_running():
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(code if isinstance(code, int) else 0)


if __name__ == "__main__":
    main()
