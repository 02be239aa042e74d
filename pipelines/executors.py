"""Executors: how the independent tasks of a stage are spread over cores."""

from __future__ import annotations

import multiprocessing
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from itertools import chain, islice
from typing import Protocol, TypeVar

from ops.errors import ParameterError

Item = TypeVar("Item")
Result = TypeVar("Result")

KINDS = ("serial", "processes")


class Executor(Protocol):
    """Anything with a `map` that yields the results in the order of the items."""

    workers: int

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Apply a function to every item; functions and items must be picklable."""
        ...

    def close(self) -> None:
        """Let the workers go."""
        ...


class SerialExecutor:
    """One task after the other in this process."""

    workers = 1

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Apply a function to every item, lazily."""
        return map(function, items)

    def close(self) -> None:
        """Nothing to let go."""


class ProcessExecutor:
    """Tasks in worker processes that live as long as the executor; at most two tasks a worker are in flight."""

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._pool: ProcessPoolExecutor | None = None

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Apply a function to every item; results come in the items' order. A single item stays in this process."""
        source = iter(items)
        first = list(islice(source, 2))
        if len(first) < 2:
            yield from map(function, first)
            return
        pool = self._start()
        waiting: deque[Future[Result]] = deque()
        try:
            for item in chain(first, source):
                waiting.append(pool.submit(function, item))
                if len(waiting) >= 2 * self.workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()

    def close(self) -> None:
        """Wait for what is running and let the workers go."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    def _start(self) -> ProcessPoolExecutor:
        if self._pool is None:
            # Workers start afresh: a fork of a process with numba, polars or DuckDB threads may hang.
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self.workers, mp_context=context, initializer=_single_thread)
        return self._pool


def _single_thread() -> None:
    """One thread a worker, in every library that would take all cores: the processes are the parallelism."""
    for name in ("NUMBA_NUM_THREADS", "POLARS_MAX_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"


def cores() -> int:
    """The processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def make_executor(kind: str, workers: int | None = None) -> Executor:
    """An executor by name: "serial", or "processes" with as many workers as there are cores unless told.

    Raises
    ------
    ParameterError: an unknown kind, or fewer than one worker.
    """
    if kind not in KINDS:
        raise ParameterError("executor", f"one of {', '.join(KINDS)}", kind)
    count = cores() if workers is None else workers
    if count < 1:
        raise ParameterError("workers", "at least 1", count)
    return SerialExecutor() if kind == "serial" or count == 1 else ProcessExecutor(count)
