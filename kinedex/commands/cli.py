"""The command line: `kinedex COMMAND`."""

from __future__ import annotations

import os
import sys
from contextlib import suppress

from kinedex.commands.app import app
from kinedex.commands.command_list import ASK, COMMANDS, SEARCH
from kinedex.console.collection import put_off_collection
from kinedex.console.streams import escape_streams

__all__ = ["app", "main"]


def main() -> None:
    """Run the console command `kinedex`; its output is UTF-8, on Windows too."""
    escape_streams()
    if sys.argv[1:2] and sys.argv[1] in COMMANDS and COMMANDS[sys.argv[1]].panel in (ASK, SEARCH):
        put_off_collection()
    try:
        app(prog_name="kinedex")  # the same name in usage messages, whichever file was started
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
