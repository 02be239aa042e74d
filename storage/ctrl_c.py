"""Handle Ctrl-C while DuckDB runs a statement."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

_DUCKDBS_MESSAGE = "Query interrupted"


@contextmanager
def ctrl_c_in_statements() -> Iterator[None]:
    """Raise KeyboardInterrupt in place of the RuntimeError by which DuckDB reports Ctrl-C in the main thread."""
    try:
        yield
    except RuntimeError as fault:
        if str(fault) != _DUCKDBS_MESSAGE:
            raise
        raise KeyboardInterrupt from None
