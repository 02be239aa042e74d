"""Python's search for unreachable objects waits in a command that answers one question.

What a command imports stays until its end. Python looks through all of it several times while it grows, and again at
the end of the process: a fifth of the time of a short command, to find next to nothing.
"""

from __future__ import annotations

import atexit
import gc
import sys

FIRST = 250_000
"""Objects that are there before Python first looks for unreachable ones; a command needs some 160,000 at most."""


def put_off_collection() -> None:
    """Put off the first collection until there are `FIRST` objects, and leave out those at the end of the process.

    After the first, Python collects as always. Until its end the process closes its files as always: what waits is
    found by counting references, or by `atexit`.
    """
    usual = gc.get_threshold()
    if usual[0] in (0, FIRST):
        return  # switched off, or put off already

    def go_on(phase: str, _: dict[str, int]) -> None:
        if phase == "stop":
            gc.callbacks.remove(go_on)
            gc.set_threshold(*usual)

    gc.callbacks.append(go_on)
    gc.set_threshold(FIRST, *usual[1:])
    atexit.register(_leave_out_the_last)


def _leave_out_the_last() -> None:
    """Keep Python from collecting at its end, except with DuckDB, whose bindings report then what is not freed."""
    if "_duckdb" not in sys.modules:
        gc.freeze()
