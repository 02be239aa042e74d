"""Run tasks that each make a take from a recording, and store their results beside those of other takes."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Protocol, TypeVar

import pyarrow as pa
import pyarrow.compute as pc

from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.display import Progress
from kinedex.pipelines.engine.executors import Executor
from kinedex.pipelines.tracking.recorded_takes import RecordedTake, declare_recorded_columns, put_takes, refuse_names
from kinedex.storage.index.builder import build_index
from kinedex.storage.lock import Wait
from kinedex.storage.store.reused_results import reused_parts, values_in
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import damaged_frames
from kinedex.storage.store.writer import StoreWriter

MADE_KINDS = ("tracks", "reconstructions")
"""The kinds of results that have a row for each take made from a recording."""

COMPILING = "kernels are compiled, once after an installation or update: this takes a minute or two"


def put_for_takes(
    writer: StoreWriter,
    kind: str,
    tables: Iterable[pa.Table],
    *,
    stage: str,
    run: str,
    column: str,
    gone: Collection[int | str],
) -> None:
    """Store results of some takes or recordings, and keep the stage's results of all others.

    Parameters
    ----------
    writer : StoreWriter
        The writer of the store.
    kind : str
        One of `RESULT_KINDS`.
    tables : iterable of pyarrow.Table
        The new rows.
    stage : str
        The stage, "<pipeline>/<stage>".
    run : str
        Id of the pipeline run.
    column : str
        The column that names the take or the recording of a row: take_id or recording.
    gone : collection
        The values in this column whose earlier rows are removed.
    """
    store = writer.store
    before = store.stage_parts(kind, stage)
    stay = set().union(*(values_in(store, part, column) for part in before)) - set(gone)
    reused = reused_parts(store, kind, stage, stay, column)

    def pieces() -> Iterator[pa.Table]:
        for rows in store.result_pieces(kind, reused.again):
            left = rows.filter(pc.is_in(rows.column(column), pa.array(sorted(stay), rows.schema.field(column).type)))
            place = left.schema.get_field_index("run")
            yield left.set_column(place, left.schema.field("run"), pa.repeat(pa.scalar(run), left.num_rows))
        yield from tables

    writer.put_results(kind, chain(reused.stay, pieces()), stage=stage, run=run)


def earlier_rows(store: Store, kind: str, stage: str) -> list[dict[str, object]]:
    """Return all rows of results of `kind` that a stage has stored; an empty list if they cannot be read.

    All rows are in memory at once, so this is for results with few rows.
    """
    parts = store.stage_parts(kind, stage)
    try:
        return [row for rows in store.result_pieces(kind, parts) for row in rows.to_pylist()]
    except KinedexError:
        return []  # repair removes unreadable rows, and the stage makes all of them again


def stages_of_takes(store: Store, take_ids: Collection[int]) -> set[str]:
    """Return the stages, as "<pipeline>/<stage>", that have made any of the given takes from recordings."""
    return {
        part.stage
        for kind in MADE_KINDS
        for part in store.manifest.results.get(kind, ())
        if any(row["take_id"] in take_ids for row in earlier_rows(store, kind, part.stage))
    }


def command_of_take(store: Store, take_id: int) -> str:
    """Return the command that makes a take again from its recording."""
    path = shlex.quote(str(store.path))
    for kind in MADE_KINDS:
        for rows in store.result_pieces(kind, store.manifest.results.get(kind, ())):
            for row in (row for row in rows.to_pylist() if row["take_id"] == take_id):
                if kind == "reconstructions":
                    return f"kinedex reconstruct {path} RECORDINGS"
                if row["track_of"] is not None:
                    return f"kinedex stabilise {path} {shlex.quote(row['track_of'])}"
    return f"kinedex track {path} RECORDINGS"


def has_all_takes(store: Store, kind: str, uses: str) -> bool:
    """Return whether all takes that stages of a kind have made are in the store, according to their results."""
    live = set(store.manifest.live_takes)
    records = store.manifest.stages
    stages = {
        part.stage
        for part in store.manifest.results.get(kind, ())
        if part.stage in records and records[part.stage].summary.get("uses") == uses
    }
    return all(row["take_id"] in live for stage in stages for row in earlier_rows(store, kind, stage))


@dataclass(frozen=True)
class RunContext:
    """The stage and run that results belong to, and the workers and display that they use.

    Attributes
    ----------
    stage : str
        The stage, "<pipeline>/<stage>".
    run : str
        Id of the run.
    executor : Executor
        Spreads recordings and takes over workers.
    message : callable
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
    message: Callable[[str], None]
    progress: Progress
    code: str = ""
    anew: bool = False

    @classmethod
    def of(cls, context: StageContext) -> RunContext:
        """Return the run context that corresponds to the context of a stage."""
        return cls(
            context.key(), context.run, context.executor, context.message, context.progress, context.code, context.anew
        )

    def reusable(self, store: Store, kind: str, key: str) -> dict[str, str]:
        """Return the fingerprints of this stage's earlier rows by the values of a column; empty if none is reusable."""
        if self.anew or not self.code:
            return {}
        return {str(row[key]): str(row["fingerprint"]) for row in earlier_rows(store, kind, self.stage)}


@dataclass
class RecordingOutcome:
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
class FinishedTake:
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
    place: RunContext,
    kind: str,
    work: Callable[[AnyTask], FinishedTake],
    tasks: Sequence[AnyTask],
    are_kernels_compiled: Callable[[], bool],
) -> RecordingOutcome:
    """Run the tasks whose takes are out of date, commit each take with its results, and return the outcome.

    Parameters
    ----------
    writer : StoreWriter
        The writer of the store.
    place : RunContext
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
        place.message(COMPILING)
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
                put_for_takes(
                    writer, name, [table], stage=place.stage, run=place.run, column="take_id", gone=list(ids.values())
                )
            writer.commit()
            for line in finished.lines:
                place.message(line)
    if faults:
        if len(tasks) > 1:
            rest = len(tasks) - len(faults)
            verb = "is" if rest == 1 else "are"
            faults.append(f"the other {counted(rest, 'take')} of this run {verb} in the store")
        raise KinedexError("\n".join(faults))
    return RecordingOutcome([one.take for one in tasks], unchanged)


def _attempt(work: Callable[[AnyTask], FinishedTake], task: AnyTask) -> FinishedTake | str:
    """Return the result of a task, or its error message, so that the other tasks continue."""
    try:
        return work(task)
    except KinedexError as fault:
        return str(fault)


def is_compiled(kernel: object) -> bool:
    """Return whether a kernel is compiled on disk; True if numba is disabled."""
    statistics = getattr(kernel, "stats", None)
    name = getattr(kernel, "__name__", "")
    return statistics is None or any(Path(statistics.cache_path).glob(f"*{name}-*.nbi"))


def rebuild_index(path: Path, wait: Wait) -> None:
    """Build the index of the current takes."""
    store = open_store(path, at="newest")
    if store.manifest.live_takes:
        build_index(store, wait=wait)
