"""Work that may be withdrawn: long computations ask from time to time whether anybody still waits for their result."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from kinedex.ops.errors import KinedexError


class WithdrawnError(KinedexError):
    """Nobody waits for the result any more."""


def _never() -> bool:
    return False


_is_withdrawn: ContextVar[Callable[[], bool]] = ContextVar("is_withdrawn", default=_never)


@contextmanager
def withdrawn_when(test: Callable[[], bool]) -> Iterator[None]:
    """Let the work of this context end once a test is true.

    Parameters
    ----------
    test : callable
        It is called from the threads of the work, often; the context of a thread is that of who has started it.

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
    """Raise a WithdrawnError if nobody waits for the result of this context any more."""
    if _is_withdrawn.get()():
        raise WithdrawnError("the work was withdrawn: nobody waits for its result")
