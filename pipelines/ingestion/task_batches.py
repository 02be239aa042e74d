"""Run batches of tasks such that one task that kills its worker does not affect the others."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable
from dataclasses import replace
from typing import Any, ClassVar, Protocol, TypeVar

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.executors import Executor, WorkerDied


class Batch(Protocol):
    """Protocol of a batch: a dataclass with tasks, and everything that its work needs."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def tasks(self) -> tuple[Any, ...]:
        """The tasks of the batch."""
        ...


Work = TypeVar("Work", bound=Batch)
Result = TypeVar("Result")

PIECES = 8
"""The number of pieces into which a batch that fails is divided, to find the task that is the cause."""


def run_batches(
    executor: Executor,
    work: Callable[[Work], Result],
    batches: Iterable[Work],
    give_up: Callable[[Work, Exception], Result],
) -> Generator[tuple[Work, Result]]:
    """Do the work of every batch, even if workers die.

    A batch whose workers die repeatedly, or whose work raises an error other than a KinedexError, is repeated in
    smaller and smaller pieces, until the task that is the cause is alone; that task is given up. Other work in progress
    may be done twice.

    Parameters
    ----------
    executor : Executor
        The workers.
    work : callable
        Does the work of a batch; picklable, may be called twice, and does nothing for a batch without tasks.
    batches : iterable of Batch
        Batches with at least one task each.
    give_up : callable
        Returns the result of a batch of one task that cannot be finished, given the error.

    Yields
    ------
    (Batch, object)
        Each batch, or piece of one, with its result, in order.

    Raises
    ------
    KinedexError
        The work raised it, because of the store or the set-up, not because of a task.
    """
    waiting = deque(batches)
    trouble = False
    while waiting:
        todo = list(waiting)
        if trouble and len(todo) == 1:
            # executors run a single item in this process, which must survive
            todo.append(replace(todo[0], tasks=()))
        results = executor.map(work, todo)
        for batch in todo:
            try:
                result = next(results)
            except Exception as fault:
                if isinstance(fault, KinedexError) and not isinstance(fault, WorkerDied):
                    raise
                trouble = True
                waiting.popleft()
                if len(batch.tasks) > 1:
                    waiting.extendleft(reversed(_pieces(batch)))
                else:
                    yield batch, give_up(batch, fault)
                break
            if batch.tasks:
                waiting.popleft()
                yield batch, result


def _pieces(batch: Work) -> list[Work]:
    size = -(-len(batch.tasks) // PIECES)
    return [replace(batch, tasks=batch.tasks[start : start + size]) for start in range(0, len(batch.tasks), size)]
