"""This module cancels long computations, which check from time to time whether their result is still needed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from kinedex.ops.errors import KinedexError


class WithdrawnError(KinedexError):
    """The computation was cancelled, since its result is no longer needed."""


def _never() -> bool:
    return False


_is_withdrawn: ContextVar[Callable[[], bool]] = ContextVar("is_withdrawn", default=_never)


@contextmanager
def withdrawn_when(test: Callable[[], bool]) -> Iterator[None]:
    """Cancel the work of this context once a test returns True.

    Parameters
    ----------
    test : callable
        A function that is called often, from the threads of the work; threads inherit the context of their starter.

    Examples
    --------
    >>> from kinedex.ops.withdrawal import WithdrawnError, check_withdrawn, withdrawn_when
    >>> with withdrawn_when(lambda: True):
    ...     try:
    ...         check_withdrawn()
    ...     except WithdrawnError as fault:
    ...         print(fault)
    the work was withdrawn: nobody waits for its result
    """
    token = _is_withdrawn.set(test)
    try:
        yield
    finally:
        _is_withdrawn.reset(token)


def check_withdrawn() -> None:
    """Raise a WithdrawnError if the work of this context was cancelled."""
    if _is_withdrawn.get()():
        raise WithdrawnError("the work was withdrawn: nobody waits for its result")
