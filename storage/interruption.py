"""Run statements that Ctrl-C, a time limit or a cancellation can end, even where DuckDB does not stop."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Generic, TypeVar

import duckdb

from kinedex.ops.cancellation import CancelledWorkError, check_cancelled
from kinedex.ops.errors import KinedexError, ParameterError

T = TypeVar("T")

GRACE = 1.2
"""Seconds that a statement has to stop before it is abandoned: DuckDB cannot interrupt a call of one function."""

_abandoned: dict[duckdb.DuckDBPyConnection, threading.Event] = {}
_THREAD = "kinedex-sql"


class TimeLimitError(KinedexError):
    """A query did not end within its time limit."""


def run_bounded(connection: duckdb.DuckDBPyConnection, work: Callable[[], T], timeout: float | None = None) -> T:
    """Run statements on a connection so that Ctrl-C, a time limit or a cancellation ends them.

    Without this function, DuckDB would notice Ctrl-C only at the end of a statement. When interrupted, DuckDB stops
    between two batches of rows, but not within one call of a function over long texts or lists. A statement that has
    not stopped after `GRACE` seconds, or at a second Ctrl-C, is abandoned: it continues in a separate thread until the
    function returns, and `is_abandoned` is True for its connection, which must be neither used again nor closed.

    Parameters
    ----------
    connection : duckdb.DuckDBPyConnection
        The connection on which the statements run.
    work : callable
        Function that runs the statements.
    timeout : float, optional
        Time limit in seconds; None for no limit.

    Raises
    ------
    TimeLimitError
        The statements did not end in time.
    WithdrawnError
        The caller has cancelled the work.
    KeyboardInterrupt
        Ctrl-C ended the statements.
    """
    if timeout is not None and not timeout > 0:
        raise ParameterError("timeout", "a number of seconds above 0", timeout)
    if timeout is None and threading.current_thread() is not threading.main_thread():
        return work()
    run = _Run(work)
    try:
        # Ctrl-C may arrive while the thread starts
        run.thread.start()
        if run.wait(timeout):
            return run.result()
        run.stop(connection)
    except CancelledWorkError:
        run.stop(connection)
        raise
    except KeyboardInterrupt:
        # a second Ctrl-C ends this wait
        with suppress(KeyboardInterrupt):
            run.stop(connection)
        raise KeyboardInterrupt("the statement was stopped") from None
    finally:
        if run.thread.is_alive() and not run.done.is_set():
            _abandoned[connection] = run.done
    raise TimeLimitError(
        f"the statement did not end within {timeout:g} s; give it more time, or fewer rows with WHERE or LIMIT"
    )


class _Run(Generic[T]):
    """A function call in a separate daemon thread, which does not keep the process from exiting."""

    def __init__(self, work: Callable[[], T]) -> None:
        self.done = threading.Event()
        self._work = work
        self._results: list[T] = []
        self._fault: BaseException | None = None
        self.thread = threading.Thread(target=self._run, name=_THREAD, daemon=True)

    def _run(self) -> None:
        try:
            self._results.append(self._work())
        except BaseException as fault:
            self._fault = fault
        finally:
            self.done.set()

    def wait(self, seconds: float | None) -> bool:
        """Wait for the end of the work; return False on a timeout."""
        end = None if seconds is None else time.monotonic() + seconds
        # Windows delivers Ctrl-C only between two waits
        while not self.done.wait(0.5 if end is None else max(0.0, min(0.5, end - time.monotonic()))):
            if end is not None and time.monotonic() >= end:
                return False
            check_cancelled()
        return True

    def stop(self, connection: duckdb.DuckDBPyConnection) -> None:
        """Interrupt the work repeatedly, since an interrupt before its first step has no effect."""
        end = time.monotonic() + GRACE
        while not self.done.is_set() and time.monotonic() < end:
            connection.interrupt()
            self.done.wait(0.05)

    def result(self) -> T:
        """Return what the work returned, or raise its error."""
        if self._fault is not None:
            raise self._fault
        return self._results[0]


def is_abandoned(connection: duckdb.DuckDBPyConnection) -> bool:
    """Return whether a connection was abandoned because its statement did not stop."""
    return connection in _abandoned


def abandoned_statements() -> int:
    """Return the number of abandoned statements that still run."""
    return sum(not done.is_set() for done in _abandoned.values())


def is_running() -> bool:
    """Return whether the thread of any statement is alive, even if the thread only frees memory."""
    return any(thread.name == _THREAD for thread in threading.enumerate())
