"""Run tasks that each make a take from a recording; each take is committed when done, unchanged ones are kept."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Protocol, TypeVar

import pyarrow as pa

from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.display import Progress
from kinedex.pipelines.engine.executors import Executor
from kinedex.pipelines.recordings.recorded_takes import (
    RecordedTake,
    declare_recorded_columns,
    put_takes,
    refuse_names,
)
from kinedex.pipelines.recordings.stored_results import earlier_rows, put_beside
from kinedex.storage.index.builder import build_index
from kinedex.storage.lock import Wait
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import damaged_frames
from kinedex.storage.store.writer import StoreWriter

COMPILING = "kernels are compiled, once after an installation or update: this takes a minute or two"


@dataclass(frozen=True)
class Place:
    """The stage and run that results belong to, and the workers and display that they use.

    Attributes
    ----------
    stage : str
        The stage, "<pipeline>/<stage>".
    run : str
        Id of the run.
    executor : Executor
        Spreads recordings and takes over workers.
    say : callable
        Shows a line.
    progress : callable
        Function of a description and a number of steps that returns a progress bar.
    code : str
        A hash of the code that runs; results are reused only if it is not empty.
    anew : bool
        True to do everything again.
    """

    stage: str
    run: str
    executor: Executor
    say: Callable[[str], None]
    progress: Progress
    code: str = ""
    anew: bool = False

    @classmethod
    def of(cls, context: StageContext) -> Place:
        """Return the place that corresponds to the context of a stage."""
        return cls(
            context.key(), context.run, context.executor, context.say, context.progress, context.code, context.anew
        )

    def reusable(self, store: Store, kind: str, key: str) -> dict[str, str]:
        """Return the fingerprints of this stage's earlier rows, by the values of a column."""
        if self.anew or not self.code:
            return {}
        return {str(row[key]): str(row["fingerprint"]) for row in earlier_rows(store, kind, self.stage)}


@dataclass
class Outcome:
    """The result of a run.

    Attributes
    ----------
    names : list of str
        The recordings or takes, including unchanged ones.
    unchanged : list of str
        The unchanged ones.
    remarks : list of str
        Sentences about what was excluded.
    """

    names: list[str] = field(default_factory=list)
    unchanged: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Finished:
    """A finished take made from a recording, with its results.

    Attributes
    ----------
    take : RecordedTake
        The take to put into the store.
    tables : dict of str to pyarrow.Table
        Its results by kind.
    lines : tuple of str
        Sentences that report on it.
    """

    take: RecordedTake
    tables: dict[str, pa.Table]
    lines: tuple[str, ...]


class Task(Protocol):
    """A task that makes one take."""

    @property
    def take(self) -> str:
        """The name of the take."""

    @property
    def take_id(self) -> int:
        """The id of the take."""

    @property
    def fingerprint(self) -> str:
        """A hash of everything that determines the take."""


AnyTask = TypeVar("AnyTask", bound=Task)


def take_ids_of(writer: StoreWriter, names: Iterable[str]) -> dict[str, int]:
    """Assign ids to new takes and return them by name; declare the columns of recorded takes, refuse invalid names."""
    takes = list(names)
    declare_recorded_columns(writer)
    refuse_names(writer.store, takes)
    return writer.assign_take_ids(takes)


def run_tasks(
    writer: StoreWriter,
    place: Place,
    kind: str,
    work: Callable[[AnyTask], Finished],
    tasks: Sequence[AnyTask],
    are_kernels_compiled: Callable[[], bool],
) -> Outcome:
    """Run the tasks whose takes are out of date, commit each take with its results, and return the outcome.

    Parameters
    ----------
    writer : StoreWriter
        The writer of the store.
    place : Place
        The stage and run of the results.
    kind : str
        The kind of results that has a row with `fingerprint` for each take.
    work : callable
        Makes the take of a task; must be picklable.
    tasks : sequence of Task
        The tasks.
    are_kernels_compiled : callable
        Returns whether the kernels that `work` needs are compiled on disk.

    Raises
    ------
    KinedexError
        A task has failed; the takes of the other tasks are in the store.
    """
    before = place.reusable(writer.store, kind, "take")
    damaged = {take for part in damaged_frames(writer.store) for take in part.live}
    live = set(writer.manifest.live_takes) - damaged
    unchanged = [one.take for one in tasks if before.get(one.take) == one.fingerprint and one.take_id in live]
    if len(unchanged) < len(tasks) and not are_kernels_compiled():
        place.say(COMPILING)
    faults: list[str] = []
    fresh = [one for one in tasks if one.take not in unchanged]
    with place.progress("takes", len(fresh)) as bar:
        for finished in place.executor.map(partial(_attempt, work), fresh):
            bar.advance()
            if isinstance(finished, str):
                faults.append(finished)
                continue
            ids = put_takes(writer, [finished.take])
            for name, table in finished.tables.items():
                put_beside(
                    writer, name, [table], stage=place.stage, run=place.run, column="take_id", gone=list(ids.values())
                )
            writer.commit()
            for line in finished.lines:
                place.say(line)
    if faults:
        raise KinedexError("\n".join([*faults, *([_rest(len(tasks) - len(faults))] if len(tasks) > 1 else [])]))
    return Outcome([one.take for one in tasks], unchanged)


def _attempt(work: Callable[[AnyTask], Finished], task: AnyTask) -> Finished | str:
    """Return the result of a task, or its error message, so that the other tasks continue."""
    try:
        return work(task)
    except KinedexError as fault:
        return str(fault)


def _rest(count: int) -> str:
    return f"the other {counted(count, 'take')} of this run {'is' if count == 1 else 'are'} in the store"


def is_compiled(kernel: object) -> bool:
    """Return whether a kernel is compiled on disk; True if numba is disabled."""
    statistics = getattr(kernel, "stats", None)
    name = getattr(kernel, "__name__", "")
    return statistics is None or any(Path(statistics.cache_path).glob(f"*{name}-*.nbi"))


def renew_index(path: Path, wait: Wait) -> None:
    """Build the index of the current takes."""
    store = open_store(path, at="newest")
    if store.manifest.live_takes:
        build_index(store, wait=wait)
