"""Kernels that several workers of a test run need at the same time are compiled by one of them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from numba.core.caching import NullCache
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

fcntl: Any
try:
    import fcntl
except ImportError:  # on Windows
    fcntl = None

PATIENCE_S = 100.0
"""A worker that has waited this long for another one compiles the kernel itself."""


_held: set[str] = set()


def compile_in_one_worker() -> None:
    """Make this process wait while another one compiles kernels of the same file, and load what that one has cached.

    Without it, all workers of a run with an empty cache would compile the same kernels.
    """
    compile_now = Dispatcher.compile

    def compile_once(self: Any, signature: Any) -> Any:
        if isinstance(self._cache, NullCache):
            return compile_now(self, signature)
        # the lock of this process first, so that no thread waits for a file that another thread holds
        with global_compiler_lock, _locked(self.py_func.__code__.co_filename):
            return compile_now(self, signature)

    Dispatcher.compile = compile_once


@contextmanager
def _locked(path: str) -> Iterator[None]:
    """Lock a file against other processes, but not longer than the patience; not at all where that is impossible."""
    if fcntl is None or path in _held:
        yield
        return
    with open(path, "rb") as file:
        _held.add(path)
        try:
            deadline = time.monotonic() + PATIENCE_S
            while time.monotonic() < deadline:
                with suppress(BlockingIOError):
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                time.sleep(0.02)
            yield
        finally:
            _held.discard(path)
