"""Batches whose work kills its worker or ends in a defect: only the task that is to blame is given up."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import pytest

from kinedex.ops.errors import KinedexError, StoreError
from kinedex.pipelines.engine.executors import ProcessExecutor, SerialExecutor, WorkerDied
from kinedex.pipelines.ingestion.read_passes import run_batches


@dataclass(frozen=True)
class Batch:
    """Numbers to square: some kill the process that does, some are not numbers."""

    tasks: tuple[int | str, ...]


def square(batch: Batch) -> list[int]:
    for task in batch.tasks:
        if task == 13:
            os.kill(os.getpid(), signal.SIGKILL)
    return [task * task for task in batch.tasks]  # type: ignore[operator,misc]


class DyingExecutor(SerialExecutor):
    """Workers that die of 13, without the processes."""

    def __init__(self) -> None:
        self.lone = 0

    def map(self, function: Callable[[Batch], list[int]], items: Iterable[Batch]) -> Iterator[list[int]]:
        items = list(items)
        self.lone += len(items) == 1
        for item in items:
            if 13 in item.tasks:
                raise WorkerDied("a worker process died 3 times")
            yield function(item)


def results(executor: SerialExecutor | ProcessExecutor, *batches: tuple[int | str, ...]) -> tuple[list[int], list[str]]:
    given_up: list[str] = []

    def give_up(batch: Batch, fault: Exception) -> list[int]:
        given_up.append(f"{batch.tasks[0]}: {type(fault).__name__}")
        return []

    found: list[int] = []
    for _, result in run_batches(executor, square, [Batch(tasks) for tasks in batches], give_up):
        found += result
    return found, given_up


def test_work_that_goes_well_comes_in_order() -> None:
    assert results(SerialExecutor(), (1, 2), (3,), (4, 5)) == ([1, 4, 9, 16, 25], [])
    assert results(SerialExecutor()) == ([], [])


@pytest.mark.parametrize("place", [0, 1, 39, 40, 44, 45])
def test_only_the_task_that_kills_its_worker_is_given_up_and_the_rest_comes_once_and_in_order(place: int) -> None:
    numbers = list(range(100, 145))
    numbers.insert(place, 13)
    executor = DyingExecutor()
    batches = (tuple(numbers[:40]), tuple(numbers[40:45]), tuple(numbers[45:]))
    assert results(executor, *batches) == ([n * n for n in range(100, 145)], ["13: WorkerDied"])
    # a lone item would be done in this very process
    assert executor.lone == 0


def test_a_defect_costs_its_task_only() -> None:
    found, given_up = results(SerialExecutor(), (1, 2), (3, "x", 4), ("y",), (5,))
    assert found == [1, 4, 9, 16, 25]
    assert given_up == ["x: TypeError", "y: TypeError"]


def test_an_error_of_the_store_ends_the_run() -> None:
    def full(_: Batch) -> list[int]:
        raise StoreError("the disk is full")

    with pytest.raises(StoreError, match="the disk is full"):
        list(run_batches(SerialExecutor(), full, [Batch((1,))], lambda *_: []))


@pytest.mark.slow
def test_a_real_worker_that_is_killed_costs_one_task() -> None:
    executor = ProcessExecutor(2)
    try:
        assert results(executor, (1, 2), (3, 13), (4,)) == ([1, 4, 9, 16], ["13: WorkerDied"])
    finally:
        executor.close()


def test_the_error_of_dead_workers_is_one_of_the_project() -> None:
    assert issubclass(WorkerDied, KinedexError)
