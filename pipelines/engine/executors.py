"""Executors: how the independent tasks of a stage are spread over cores, or over the machines of a Dask cluster."""

from __future__ import annotations

import logging
import multiprocessing
import os
import secrets
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.pipelines.engine.worker_processes import begin_worker, deaf_children, single_thread

if TYPE_CHECKING:
    from distributed import Client

Item = TypeVar("Item")
Result = TypeVar("Result")

KINDS = ("serial", "processes", "dask")

TRIES = 3
"""How often a task is started before its workers' deaths are taken to be its own doing."""

ANSWER_SECONDS = 10.0
"""How long a Dask scheduler may take to answer at first."""

PATIENCE_SECONDS = 60.0
"""How long a Dask cluster may be without any worker, or without its scheduler, before its tasks are given up."""


class WorkerDied(KinedexError):
    """A task's workers died again and again; most likely the task itself needs more memory than there is."""


class Executor(Protocol):
    """Anything with a `map` that yields the results in the order of the items."""

    workers: int

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Apply a function to every item; functions and items must be picklable, and a task may run twice."""
        ...

    def check(self, store: Path) -> None:
        """Refuse, before any work is done, workers that cannot see the store."""
        ...

    def close(self) -> None:
        """Let the workers go."""
        ...

    def abort(self) -> None:
        """Let the workers go at once, whatever they are at."""
        ...


class SerialExecutor:
    """One task after the other in this process."""

    workers = 1

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Apply a function to every item, lazily."""
        return map(function, items)

    def check(self, store: Path) -> None:
        """This process sees the store."""

    def close(self) -> None:
        """Nothing to let go."""

    def abort(self) -> None:
        """Nothing to let go."""


class ProcessExecutor:
    """Tasks in worker processes that live as long as the executor; at most two tasks a worker are in flight.

    A worker that dies (killed, out of memory) costs the tasks in flight another try, one at a time, so that a task that
    kills its worker is found out; after `TRIES` it is refused by name.
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._pool: ProcessPoolExecutor | None = None

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Apply a function to every item; results come in the items' order.

        For a single item no workers are started. Where there are some it goes to them: Ctrl-C ends them at once, and a
        kernel in this process only when it is through.
        """
        source = iter(items)
        first = list(islice(source, 2))
        if len(first) < 2 and self._pool is None:
            yield from map(function, first)
            return
        waiting: deque[tuple[Item, Future[Result]]] = deque()
        try:
            for item in chain(first, source):
                waiting.append((item, self._submit(function, item)))
                if len(waiting) >= 2 * self.workers:
                    yield from self._next(function, waiting)
            while waiting:
                yield from self._next(function, waiting)
        finally:
            for _, future in waiting:
                future.cancel()

    def _submit(self, function: Callable[[Item], Result], item: Item) -> Future[Result]:
        """A task in the pool; in one that is broken already, a task that fails like those that broke it."""
        try:
            return self._put(function, item)
        except BrokenProcessPool as fault:
            future: Future[Result] = Future()
            future.set_exception(fault)
            return future

    def _put(self, function: Callable[[Item], Result], item: Item) -> Future[Result]:
        """Give a task to the pool, which may start workers: they hear nothing of Ctrl-C, from their first moment on."""
        with deaf_children():
            return self._start().submit(function, item)

    def _next(
        self, function: Callable[[Item], Result], waiting: deque[tuple[Item, Future[Result]]]
    ) -> Iterator[Result]:
        """The first waiting result; after a worker's death, all that were waiting."""
        try:
            result = waiting[0][1].result()
        except BrokenProcessPool:
            self.close()
            while waiting:
                item, future = waiting[0]
                done = future.done() and not future.cancelled() and future.exception() is None
                result = future.result() if done else self._alone(function, item)
                waiting.popleft()
                yield result
            return
        waiting.popleft()
        yield result

    def _alone(self, function: Callable[[Item], Result], item: Item) -> Result:
        for _ in range(TRIES - 1):
            try:
                return self._put(function, item).result()
            except BrokenProcessPool:
                self.close()
        raise WorkerDied(
            f"a worker process died {TRIES} times on the same task ({_shown(item)}); is there enough memory for it? "
            "--executor serial shows what happens"
        )

    def check(self, store: Path) -> None:
        """Workers of this machine see the store."""

    def close(self) -> None:
        """Wait for what is running and let the workers go."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    def abort(self) -> None:
        """End the workers at once, whatever they are at."""
        if self._pool is not None:
            for process in list((self._pool._processes or {}).values()):
                process.terminate()
            self.close()

    def _start(self) -> ProcessPoolExecutor:
        if self._pool is None:
            # Workers start afresh: a fork of a process with numba, polars or DuckDB threads may hang.
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self.workers, mp_context=context, initializer=begin_worker)
        return self._pool


class DaskExecutor:
    """Tasks on a Dask cluster: one made on this machine, or a running one by its scheduler's address.

    Dask itself tries a task again whose worker died.
    """

    def __init__(self, workers: int, scheduler: str | None = None) -> None:
        from distributed import Client, LocalCluster

        # what it logs of lost connections is said in our own words
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        self._cluster: LocalCluster | None = None
        if scheduler is None:
            # Workers of the cluster inherit this process's environment.
            single_thread()
            self._cluster = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
        try:
            self._client: Client = Client(self._cluster or scheduler, timeout=ANSWER_SECONDS)
        except (OSError, ValueError) as fault:
            raise KinedexError(f"--scheduler {scheduler}: no Dask scheduler answers there ({fault})") from None
        self._scheduler = scheduler
        self.workers = self._slots()
        deadline = time.monotonic() + min(ANSWER_SECONDS, PATIENCE_SECONDS)
        while not self.workers:
            if time.monotonic() > deadline:
                self.close()
                raise self._without_workers()
            time.sleep(0.2)
            self.workers = self._slots()

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Apply a function to every item; results come in the items' order, two tasks a worker in flight."""
        from distributed import KilledWorker

        waiting: deque[Future[Result]] = deque()
        source = iter(items)
        try:
            while True:
                for item in islice(source, 2 * self.workers - len(waiting)):
                    waiting.append(self._client.submit(function, item, pure=False, retries=0))
                if not waiting:
                    return
                try:
                    self._wait(waiting[0])
                    result = waiting.popleft().result()
                except KilledWorker as fault:
                    raise WorkerDied(f"Dask workers died again and again on one task: {fault}") from None
                except CancelledError:
                    raise KinedexError("the Dask scheduler is gone, and with it the tasks that it held") from None
                yield result
        finally:
            for future in waiting:
                future.cancel()

    def _wait(self, future: Future[Any]) -> None:
        """Wait for a task, however long it takes, as long as there is anyone to do it."""
        from distributed import wait

        seen = time.monotonic()
        while True:
            with suppress(TimeoutError):
                wait([future], timeout=min(2.0, PATIENCE_SECONDS))
                return
            if self._slots():
                seen = time.monotonic()
            elif time.monotonic() - seen > PATIENCE_SECONDS:
                raise self._without_workers()

    def _slots(self) -> int:
        """How many tasks the cluster's workers do at a time; 0 where there is none, or no scheduler to ask."""
        try:
            return sum(worker["nthreads"] for worker in self._client.scheduler_info(n_workers=-1)["workers"].values())
        except (OSError, ValueError, KeyError):
            return 0

    def _without_workers(self) -> KinedexError:
        where = self._scheduler or "of this machine"
        return KinedexError(
            f"the Dask cluster {where} has no workers (any more); start some with `dask worker {where}`, then run the "
            "same command again: it goes on where it was"
        )

    def check(self, store: Path) -> None:
        """Let every worker look for a file that was just written into the store."""
        store.mkdir(parents=True, exist_ok=True)
        token = store / f".tmp-shared-{secrets.token_hex(4)}"
        token.touch()
        try:
            seen = self._client.run(_sees, str(token.resolve()), on_error="return")
            blind = [worker for worker, sees in seen.items() if sees is not True]
            broken = [fault for fault in seen.values() if isinstance(fault, BaseException)]
            if broken:
                raise KinedexError(
                    f"the Dask workers {', '.join(blind[:3])} cannot do kinedex's work ({broken[0]}); the same kinedex "
                    "must be installed where they run"
                )
        finally:
            token.unlink()
        if blind:
            raise KinedexError(
                f"the Dask workers {', '.join(blind[:3])} do not see {store.resolve()}: store and source must lie on a "
                "file system that all of them share, under the same path"
            )

    def close(self) -> None:
        """Leave the cluster, and end it where it is our own."""
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()

    def abort(self) -> None:
        """Leave the cluster; what it was doing for us is cancelled."""
        self.close()


def _sees(path: str) -> bool:
    return Path(path).is_file()


def _shown(item: object) -> str:
    """What a task is about: its own `subject` where it has one."""
    text = str(getattr(item, "subject", None) or repr(item))
    return text if len(text) <= 300 else f"{text[:300]}…"


def cores() -> int:
    """The processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def make_executor(kind: str, workers: int | None = None, scheduler: str | None = None) -> Executor:
    """An executor by name.

    Parameters
    ----------
    kind: "serial", "processes", or "dask". workers: all cores unless told.
    scheduler: address of a running Dask scheduler, for "dask" only.

    Raises
    ------
    ParameterError: an unknown kind, fewer than one worker, or a scheduler without Dask.
    """
    if kind not in KINDS:
        raise ParameterError("executor", f"one of {', '.join(KINDS)}", kind)
    count = cores() if workers is None else workers
    if count < 1:
        raise ParameterError("workers", "at least 1", count)
    if scheduler is not None and kind != "dask":
        raise ParameterError("executor", "dask where a scheduler is given", kind)
    if kind == "dask":
        return DaskExecutor(count, scheduler)
    return SerialExecutor() if kind == "serial" or count == 1 else ProcessExecutor(count)
