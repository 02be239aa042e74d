"""Batches: many tasks in few pieces of work, and none of them lost to the one that kills its worker."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable
from dataclasses import replace
from typing import Any, ClassVar, Protocol, TypeVar

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.executors import Executor, WorkerDied


class Batch(Protocol):
    """A dataclass of whatever its work needs, with the tasks that it is about."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def tasks(self) -> tuple[Any, ...]:
        """What the work is done for, one by one."""
        ...


Work = TypeVar("Work", bound=Batch)
Result = TypeVar("Result")

PIECES = 8
"""Into how many pieces a batch is cut that cannot be finished, to find the task that is to blame."""


def run_batches(
    executor: Executor,
    work: Callable[[Work], Result],
    batches: Iterable[Work],
    give_up: Callable[[Work, Exception], Result],
) -> Generator[tuple[Work, Result]]:
    """Do the work of every batch, whatever happens to the workers.

    A batch whose workers die again and again, or whose work ends in an error that is not of the project's own, is done
    again in smaller and smaller pieces, until the task is alone that is to blame; that one is given up. What was in
    flight meanwhile may be done twice.

    Parameters
    ----------
    executor: where the work is done.
    work: what to do with a batch; picklable, may be done twice, and costs nothing for a batch without tasks.
    batches: each with one task at least.
    give_up: the result that stands for a batch of one task that cannot be finished, and the error it ended in.

    Returns
    -------
    Each batch, or piece of one, with its result, in order.

    Raises
    ------
    KinedexError: the work raised one; it concerns the store or the set-up, not a task.
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
