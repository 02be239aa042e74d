"""Ctrl-C during a statement of DuckDB."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

_DUCKDBS_MESSAGE = "Query interrupted"


@contextmanager
def ctrl_c_in_statements() -> Iterator[None]:
    """Raise KeyboardInterrupt where Ctrl-C stops a statement of the main thread: DuckDB raises RuntimeError."""
    try:
        yield
    except RuntimeError as fault:
        if str(fault) != _DUCKDBS_MESSAGE:
            raise
        raise KeyboardInterrupt from None
