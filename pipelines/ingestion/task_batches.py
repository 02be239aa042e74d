"""Batches of tasks, in which one task that kills its worker does not affect the others."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable
from dataclasses import replace
from typing import Any, ClassVar, Protocol, TypeVar

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.executors import Executor, WorkerDied


class Batch(Protocol):
    """A dataclass with some tasks, and all that its work needs."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def tasks(self) -> tuple[Any, ...]:
        """The tasks, each of which the work is done for."""
        ...


Work = TypeVar("Work", bound=Batch)
Result = TypeVar("Result")

PIECES = 8
"""A batch that cannot be finished is cut into so many pieces, to find the task that is the cause."""


def run_batches(
    executor: Executor,
    work: Callable[[Work], Result],
    batches: Iterable[Work],
    give_up: Callable[[Work, Exception], Result],
) -> Generator[tuple[Work, Result]]:
    """Do the work of every batch, also where workers die.

    A batch whose workers die again and again, or whose work ends in an error that is not the project's own, is done
    again in smaller and smaller pieces, until the task that is the cause is alone; that task is given up. Other work in
    progress may be done twice.

    Parameters
    ----------
    executor : Executor
        The workers.
    work : callable
        Does the work of a batch; picklable, may be called twice, and does nothing for a batch without tasks.
    batches : iterable of Batch
        Each with one task at least.
    give_up : callable
        Returns the result of a batch of one task that cannot be finished, given the error.

    Yields
    ------
    (Batch, object)
        Each batch, or piece of one, with its result, in order.

    Raises
    ------
    KinedexError
        The work raised one; it concerns the store or the set-up, not a task.
    """
    waiting = deque(batches)
    trouble = False
    while waiting:
        todo = list(waiting)
        if trouble and len(todo) == 1:
            # executors do a lone item in this process, which must outlive it
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
