"""Executors spread the independent tasks of a stage over cores, or over the machines of a Dask cluster."""

from __future__ import annotations

import logging
import multiprocessing
import multiprocessing.connection
import os
import secrets
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from kinedex.ops.cancellation import check_cancelled
from kinedex.ops.errors import KinedexError, ParameterError

if TYPE_CHECKING:
    from distributed import Client

THREADS_OF_LIBRARIES = ("NUMBA_NUM_THREADS", "POLARS_MAX_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")

Item = TypeVar("Item")
Result = TypeVar("Result")
KINDS = ("serial", "processes", "dask")
TRIES = 3
"""The number of workers that may die during one task before the task counts as the cause."""

_CHECKS = 3
ANSWER_SECONDS = 10.0
"""The longest time to wait for the first answer of a Dask scheduler, in seconds."""

PATIENCE_SECONDS = 60.0
"""The longest time to wait for a Dask cluster without workers, or for a finished result, in seconds."""


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


class WorkerDied(KinedexError):
    """The workers of a task died repeatedly; most likely the task needs more memory than there is."""


class Executor(Protocol):
    """The protocol of executors.

    Attributes
    ----------
    workers : int
        The number of tasks that run at a time.
    """

    workers: int

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Yield the results in the order of the items.

        Function, items and results must be picklable, and a task may run twice.
        """
        ...

    def check(self, store: Path) -> None:
        """Raise a KinedexError if a worker cannot see the store; do nothing if all workers are on this machine."""
        return

    def close(self) -> None:
        """End the workers, if there are any, once their tasks are done."""
        return

    def abort(self) -> None:
        """End the workers, if there are any, at once."""
        return


class SerialExecutor(Executor):
    """Runs one task after the other in this process."""

    workers = 1

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Apply a function to every item, lazily."""
        return map(function, items)


class ProcessExecutor(Executor):
    """Runs tasks in worker processes that live as long as the executor, with at most two tasks per worker in flight.

    When a worker dies (killed, out of memory), the tasks in flight are tried again one at a time, so that a task that
    kills its worker is identified. After `TRIES` deaths, an error names the task.
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._pool: ProcessPoolExecutor | None = None

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Yield the results of a function in the order of the items.

        A single item runs in this process if no worker has been started yet. Otherwise it goes to a worker, because
        Ctrl-C ends workers at once, but a kernel in this process only when it has finished.
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
        """Submit a task; if the pool is already broken, return a future that holds that error."""
        try:
            return self._put(function, item)
        except BrokenProcessPool as fault:
            future: Future[Result] = Future()
            future.set_exception(fault)
            return future

    def _put(self, function: Callable[[Item], Result], item: Item) -> Future[Result]:
        """Submit a task to the pool, which may start workers; these ignore Ctrl-C from the start."""
        with ctrl_c_blocked():
            if self._pool is None:
                # Workers are new processes on every system, because a fork with threads of libraries may hang.
                context = multiprocessing.get_context("spawn")
                self._pool = ProcessPoolExecutor(self.workers, mp_context=context, initializer=begin_worker)
            return self._pool.submit(function, item)

    def _next(
        self, function: Callable[[Item], Result], waiting: deque[tuple[Item, Future[Result]]]
    ) -> Iterator[Result]:
        """Yield the first waiting result; after the death of a worker, yield the results of all waiting tasks."""
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

    def close(self) -> None:
        """Wait for the tasks that run, and end the workers."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    def abort(self) -> None:
        """End the workers at once, in the middle of their tasks."""
        if self._pool is not None:
            processes = list((self._pool._processes or {}).values())
            for process in processes:
                process.terminate()
            deadline = time.monotonic() + ANSWER_SECONDS
            for process in processes:
                process.join(max(0.0, deadline - time.monotonic()))
                process.kill()
            self.close()


class DaskExecutor:
    """Runs tasks on a Dask cluster: one created on this machine, or a running one by the address of its scheduler.

    Dask itself repeats a task whose worker died.
    """

    def __init__(self, workers: int, scheduler: str | None = None) -> None:
        from distributed import Client, LocalCluster

        # kinedex reports lost connections itself
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
        """Yield the results of a function in the order of the items, with two tasks per worker in flight."""
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
                    result = self._result(waiting[0])
                    waiting.popleft()
                except KilledWorker as fault:
                    raise WorkerDied(f"Dask workers died again and again on one task: {fault}") from None
                except CancelledError:
                    raise KinedexError("the Dask scheduler is gone, and with it the tasks that it held") from None
                yield result
        finally:
            for future in waiting:
                future.cancel()

    def _result(self, future: Future[Result]) -> Result:
        """Return the result of a task; if the worker that holds it dies, wait until it is computed again."""
        for _ in range(TRIES):
            self._wait(future)
            try:
                return future.result(timeout=PATIENCE_SECONDS)
            except TimeoutError:
                if str(getattr(future, "status", "")) == "error":
                    raise  # by the task itself
        raise KinedexError(
            f"the Dask cluster {self._scheduler or 'of this machine'} finished a task, but its result did not arrive "
            f"within {TRIES * PATIENCE_SECONDS:.0f} s; look for lost connections in the logs of its workers"
        )

    def _wait(self, future: Future[Any]) -> None:
        """Wait until a task is done; raise an error if the cluster has been without workers for too long."""
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
        """Return the number of tasks that the workers run at a time; 0 without workers or without an answer."""
        try:
            found = self._client.sync(
                self._client.scheduler.identity, n_workers=-1, callback_timeout=min(ANSWER_SECONDS, PATIENCE_SECONDS)
            )
            return sum(worker["nthreads"] for worker in found["workers"].values())
        except (OSError, ValueError, KeyError):
            return 0

    def _without_workers(self) -> KinedexError:
        where = self._scheduler or "of this machine"
        return KinedexError(
            f"the Dask cluster {where} has no workers (any more); start some with `dask worker {where}`, then run the "
            "same command again: it goes on where it was"
        )

    def check(self, store: Path) -> None:
        """Raise a KinedexError if a worker does not answer, or cannot see a file that was just written."""
        store.mkdir(parents=True, exist_ok=True)
        token = store / f".tmp-shared-{secrets.token_hex(4)}"
        try:
            for _ in range(_CHECKS):
                token.touch()
                seen = self._ask_workers(_sees, str(token.resolve()))
                if token.exists():
                    break  # else garbage collection has removed it as left over from a killed run
        finally:
            token.unlink(missing_ok=True)
        blind = [worker for worker, sees in seen.items() if sees is not True]
        broken = [fault for fault in seen.values() if isinstance(fault, BaseException)]
        if broken:
            raise KinedexError(
                f"the Dask workers {', '.join(blind[:3])} cannot do kinedex's work ({broken[0]}); the same kinedex "
                "must be installed where they run"
            )
        if blind:
            raise KinedexError(
                f"the Dask workers {', '.join(blind[:3])} do not see {store.resolve()}: store and source must lie on a "
                "file system that all of them share, under the same path"
            )

    def _ask_workers(self, function: Callable[[str], bool], argument: str) -> dict[str, object]:
        """Call a function in every worker, even in busy ones; return results or exceptions by the worker's address."""
        try:
            found: dict[str, object] = self._client.sync(
                self._client._run, function, argument, on_error="return", callback_timeout=PATIENCE_SECONDS
            )
        except TimeoutError:
            raise KinedexError(
                f"not every Dask worker answered within {PATIENCE_SECONDS:.0f} s; end those that hang, then run again"
            ) from None
        return found

    def close(self) -> None:
        """Disconnect from the cluster, and end it if this executor created it."""
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()

    def abort(self) -> None:
        """Disconnect from the cluster; its tasks for this client are cancelled."""
        self.close()


def _sees(path: str) -> bool:
    return Path(path).is_file()


def _shown(item: object) -> str:
    """Return a short description of a task for messages: the attribute `subject`, or the `repr` if there is none."""
    text = str(getattr(item, "subject", None) or repr(item))
    return text if len(text) <= 300 else f"{text[:300]}…"


def cores() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def batches_of(items: Iterable[Item], sizes: Iterable[int], most: int) -> list[tuple[Item, ...]]:
    """Divide items, in their order, into batches of a total size of at most `most`; a larger item is a whole batch."""
    batches: list[list[Item]] = []
    room = 0
    for item, size in zip(items, sizes, strict=True):
        if not batches or size > room:
            batches.append([])
            room = most
        batches[-1].append(item)
        room -= size
    return [tuple(batch) for batch in batches]


def in_threads(work: Callable[[Item], Result], items: Iterable[Item], workers: int) -> Iterator[Result]:
    """Apply a function to every item in threads, with two items per thread in flight; yield the results in order.

    An item is drawn only after the result of the item 2 × `workers` places before it was consumed, so that the iterable
    can use earlier results, such as a threshold. The kernels release the interpreter's lock, so threads use all cores
    without copying words. After cancellation, only the items in flight are completed.
    """
    source = iter(items)
    with ThreadPoolExecutor(max(1, workers)) as pool:
        waiting: deque[Future[Result]] = deque(pool.submit(work, item) for item in islice(source, 2 * workers))
        try:
            while waiting:
                check_cancelled()
                yield waiting.popleft().result()
                waiting.extend(pool.submit(work, item) for item in islice(source, 1))
        finally:
            for future in waiting:
                future.cancel()


def make_executor(kind: str, workers: int | None = None, scheduler: str | None = None) -> Executor:
    """Make an executor.

    Parameters
    ----------
    kind : {"serial", "processes", "dask"}
        The kind: tasks run in this process, in worker processes, or on a Dask cluster.
    workers : int, optional
        The number of workers; all cores by default.
    scheduler : str, optional
        The address of a running Dask scheduler, for "dask" only.

    Raises
    ------
    ParameterError
        The kind is unknown, there is no worker, or a scheduler is given without Dask.
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
