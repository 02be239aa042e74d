"""Worker processes: how they are set up, and that they hear nothing of Ctrl-C, which is their parent's affair."""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

THREADS_OF_LIBRARIES = ("NUMBA_NUM_THREADS", "POLARS_MAX_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")


@contextmanager
def deaf_children() -> Iterator[None]:
    """Let processes that are started meanwhile never hear Ctrl-C, from their first moment; this one hears it later."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def begin_worker() -> None:
    """Set a worker process up: one thread a library, deaf to Ctrl-C (its parent ends it), gone with its parent."""
    single_thread()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_follow, args=(parent.sentinel,), daemon=True).start()


def _follow(sentinel: int) -> None:
    multiprocessing.connection.wait([sentinel])
    os._exit(1)


def single_thread() -> None:
    """One thread a worker, in every library that would take all cores: the processes are the parallelism."""
    for name in THREADS_OF_LIBRARIES:
        os.environ[name] = "1"
