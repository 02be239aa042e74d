"""Set up worker processes: each library uses one thread, Ctrl-C is ignored, and workers end with their parent."""

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
def ctrl_c_blocked() -> Iterator[None]:
    """Block Ctrl-C for processes started inside a `with` statement; this process receives it afterwards.

    Where signals cannot be blocked (Windows), workers ignore Ctrl-C only once `begin_worker` runs.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def begin_worker() -> None:
    """Set up this worker process: one thread per library, Ctrl-C ignored, and exit when the parent process ends."""
    single_thread()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_follow, args=(parent.sentinel,), daemon=True).start()


def _follow(sentinel: int) -> None:
    multiprocessing.connection.wait([sentinel])
    os._exit(1)


def single_thread() -> None:
    """Limit libraries that would use all cores to one thread, because the worker processes already use all cores."""
    for name in THREADS_OF_LIBRARIES:
        os.environ[name] = "1"
