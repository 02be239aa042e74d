"""Delay Python's garbage collection in short commands.

Imported modules stay in memory until the end of a command. By default Python searches them for unreachable objects
several times while they are imported, and again at the end of the process, which takes a fifth of the time of a short
command and frees almost nothing.
"""

from __future__ import annotations

import atexit
import gc
import sys

FIRST = 250_000
"""The number of objects at which Python first collects garbage; a command allocates some 160,000 at most."""


def put_off_collection() -> None:
    """Delay the first garbage collection until there are `FIRST` objects, and skip the one at the end of the process.

    After the first collection, the usual thresholds hold. Files are still closed at exit, because that depends on
    reference counts and `atexit` and not on garbage collection.
    """
    usual = gc.get_threshold()
    if usual[0] in (0, FIRST):
        return  # collection is switched off, or delayed already

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
