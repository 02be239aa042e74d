"""This module cancels long computations, which call `check_cancelled` from time to time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from kinedex.ops.errors import KinedexError


class CancelledWorkError(KinedexError):
    """The computation was cancelled, since its result is no longer needed."""


def _never() -> bool:
    return False


_is_cancelled: ContextVar[Callable[[], bool]] = ContextVar("is_withdrawn", default=_never)


@contextmanager
def cancelled_when(test: Callable[[], bool]) -> Iterator[None]:
    """Cancel the work of this context once a test returns True.

    Parameters
    ----------
    test : callable
        A function that is called often, in the thread that enters this context; other threads do not call it.

    Examples
    --------
    >>> from kinedex.ops.cancellation import CancelledWorkError, check_cancelled, cancelled_when
    >>> with cancelled_when(lambda: True):
    ...     try:
    ...         check_cancelled()
    ...     except CancelledWorkError as fault:
    ...         print(fault)
    the work was withdrawn: nobody waits for its result
    """
    token = _is_cancelled.set(test)
    try:
        yield
    finally:
        _is_cancelled.reset(token)


def check_cancelled() -> None:
    """Raise a CancelledWorkError if the work of this context was cancelled."""
    if _is_cancelled.get()():
        raise CancelledWorkError("the work was withdrawn: nobody waits for its result")
