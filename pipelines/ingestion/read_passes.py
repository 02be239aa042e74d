"""Read files in passes: first all files, then the persons of files that turned out to contain several."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np
import pyarrow as pa

from kinedex.catalog.capture_sessions import NO_RATE, decided_recipes, refused_row
from kinedex.catalog.features import FeatureSet
from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops import textnumbers
from kinedex.ops.body import features, kinematics
from kinedex.ops.body.plausibility import plausibility
from kinedex.ops.errors import KinedexError, SourceError
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.executors import Executor, WorkerDied, batches_of
from kinedex.pipelines.ingestion.file_batches import Batch, ReadBatch, Task, read_batch
from kinedex.pipelines.ingestion.file_failures import Failure, fatal_failure, file_failure
from kinedex.pipelines.ingestion.memory_limit import MemoryShare
from kinedex.pipelines.ingestion.parameters import IngestParameters
from kinedex.pipelines.ingestion.source_changes import SourceChanges
from kinedex.storage.formats.motion.sources import Scan
from kinedex.storage.snapshot.file_outcomes import Outcome
from kinedex.storage.snapshot.measured_columns import PERSON_COLUMNS, stored_figures
from kinedex.storage.snapshot.schemas import column_problem
from kinedex.storage.store.writer import StoreWriter

Result = TypeVar("Result")
PIECES = 8
"""The number of pieces into which a batch that fails is divided, to find the task that is the cause."""

MEGABYTE = 1 << 20


class Divisible(Protocol):
    """Protocol of a batch: a dataclass with tasks, and everything that its work needs."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def tasks(self) -> tuple[Any, ...]:
        """The tasks of the batch."""
        ...


Work = TypeVar("Work", bound=Divisible)


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
    batches : iterable of Divisible
        Batches with at least one task each.
    give_up : callable
        Returns the result of a batch of one task that cannot be finished, given the error.

    Yields
    ------
    (Divisible, object)
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


@dataclass
class FilesRead:
    """The result of all passes.

    Attributes
    ----------
    failures : list of Failure
        The files and persons that could not be read.
    frames : int
        The number of frames of all takes.
    takes : dict of str to list of str
        Path → names of the takes that were read from a file.
    persons : dict of str to int
        Path → number of persons, for files with several.
    surplus : list of int
        The ids of takes of persons that their files no longer contain.
    skeletons : set of str
        The names of the mappings that takes were read with.
    """

    failures: list[Failure] = field(default_factory=list)
    frames: int = 0
    takes: dict[str, list[str]] = field(default_factory=dict)
    persons: dict[str, int] = field(default_factory=dict)
    surplus: list[int] = field(default_factory=list)
    skeletons: set[str] = field(default_factory=set)


class ReadPasses:
    """Reads the files of one ingest in passes, and commits their takes in batches.

    Parameters
    ----------
    context : StageContext
        The place of the stage in its pipeline.
    params : IngestParameters
        The parameters of the stage.
    mappings : Mappings
        The skeleton mappings.
    writer : StoreWriter
        The writer of the store.
    plan : SourceChanges
        The changes of the source.
    """

    def __init__(
        self,
        context: StageContext,
        params: IngestParameters,
        mappings: Mappings,
        writer: StoreWriter,
        plan: SourceChanges,
    ) -> None:
        self.context = context
        self.params = params
        self.mappings = mappings
        self.writer = writer
        self.plan = plan
        self.done = FilesRead()
        self._tasks = {task.take_id: task for task in plan.undecided}
        self._rows = {row["take_id"]: row for file in plan.unchanged.values() for row in file.rows}

    def run(self) -> FilesRead:
        """Read all files, commit them batch by batch, and return the outcome."""
        tasks: Sequence[Task] = self.plan.tasks
        if tasks and self.context.executor.workers > 1:
            with self.context.progress("compiling kernels"):
                _compile_kernels(self.context.feature_set)
        while tasks:
            several = self._read(tasks)
            tasks = [] if self._is_stopped else self._persons(several)
        if not self._is_stopped and (again := self._decided()):
            self._read(again)
        return self.done

    def _decided(self) -> list[Task]:
        """Return tasks for the files whose axis, rate or unit only the other files of their folders decide."""
        refused = {one.source for one in self.done.failures if NO_RATE.removeprefix("it ") in one.message}
        rows = dict(self._rows)
        for take, task in self._tasks.items():
            if task.motion.path in refused:
                rows[take] = refused_row(take, (task.motion.root, task.motion.path, task.motion.format), task.recipe)
        recipes = decided_recipes(rows.values())
        again = [replace(self._tasks[take], recipe=recipes[take]) for take in sorted(recipes) if take in self._tasks]
        paths = {task.motion.path for task in again}
        self.done.failures = [one for one in self.done.failures if one.source not in paths]
        return again

    @property
    def _is_stopped(self) -> bool:
        return self.params.strict and bool(self.done.failures)

    def _read(self, tasks: Sequence[Task]) -> list[tuple[Task, tuple[str, ...]]]:
        """Read the files of one pass, and return those that contain several persons."""
        workers = self.context.executor.workers
        memory = MemoryShare.of(self.params.max_memory, workers) if self.params.max_memory is not None else None
        several: list[tuple[Task, tuple[str, ...]]] = []
        what = "reading takes" if tasks[0].person is None else "reading persons"
        with self.context.progress(what, len(tasks)) as progress:
            batches = [
                Batch(
                    self.context.store_path, self.context.feature_set, self.writer.manifest.rate_hz, self.mappings,
                    self.params.given, self.params.strict, part, memory, stored_figures(self.writer.columns),
                )
                for part in _batches(tasks, self.params.batch_mb * MEGABYTE, workers)
            ]  # fmt: skip
            with closing(run_batches(self.context.executor, read_batch, batches, _give_up)) as results:
                for batch, written in results:
                    self._add(batch, written)
                    persons = ((task, written.persons.get(task.motion.path)) for task in batch.tasks)
                    several += [(task, names) for task, names in persons if names is not None]
                    progress.advance(len(batch.tasks))
                    if self._is_stopped:
                        break
        return several

    def _add(self, batch: Batch, written: ReadBatch) -> None:
        """Commit the takes of a batch."""
        self.done.failures += written.failures
        for row in written.takes:
            names = self.done.takes.setdefault(row["source"], [])
            names += [] if row["name"] in names else [row["name"]]
            self._rows[row["take_id"]] = row
            self.done.skeletons.add(row["skeleton"])
        self._tasks.update((task.take_id, task) for task in batch.tasks)
        for task in batch.tasks:
            file = self.plan.known.get(task.motion.path)
            if task.person is None and file is not None and any(row["name"] == task.name for row in written.takes):
                # a file that contained several persons now contains one
                self.done.surplus += [row["take_id"] for row in file.rows if row["name"] != task.name]
        if written.part is not None:
            rows = pa.Table.from_pylist(written.takes, schema=self.writer.takes_schema)
            self.writer.add_takes(rows, written.part)
            self.writer.commit()
            self.done.frames += written.part.rows

    def _persons(self, several: Sequence[tuple[Task, tuple[str, ...]]]) -> list[Task]:
        """Return a task for each person, whose take is named after the file and the person."""
        if not several:
            return []
        problems = [
            column_problem(name, column, self.writer.manifest.columns) for name, column in PERSON_COLUMNS.items()
        ]
        if not any(problems):
            self.writer.declare_columns(PERSON_COLUMNS)
        tasks: list[Task] = []
        for task, persons in several:
            if any(problems):
                self.done.failures.append(file_failure(task.motion, _no_column(task, persons)))
            else:
                self.done.persons[task.motion.path] = len(persons)
                tasks += self._named(task, persons)
        ids = self.writer.assign_take_ids(task.name for task in tasks)
        return sorted((replace(task, take_id=ids[task.name]) for task in tasks), key=lambda task: task.take_id)

    def _named(self, task: Task, persons: tuple[str, ...]) -> Iterator[Task]:
        """Yield the tasks for the persons in a file; persons known to the store keep the names of their takes."""
        path = task.motion.path
        rows = self.plan.known[path].rows if path in self.plan.known else ()
        names = {row.get("person"): row["name"] for row in rows}
        self.done.surplus += [row["take_id"] for row in rows if row.get("person") not in persons]
        for person in persons:
            name = names.get(person) or self.plan.names.add_person(path, task.name, person)
            if name is None:
                fault = SourceError(task.motion.absolute, "other takes have every name that the take could have")
                self.done.failures.append(file_failure(task.motion, fault, person))
            else:
                yield replace(task, name=name, person=person, persons=len(persons))


def _no_column(task: Task, persons: Sequence[str]) -> SourceError:
    """Return the error of a file with several persons in a store whose columns `person` or `persons` are the user's."""
    return SourceError(
        task.motion.absolute,
        f"holds {len(persons)} persons ({', '.join(persons)}), and the columns `person` and `persons` of takes, which "
        "would name them, are named groups of `patterns`; give the groups other names, and use a new store",
    )


def _give_up(batch: Batch, fault: Exception) -> ReadBatch:
    task = batch.tasks[0]
    return ReadBatch(
        [], None, [(fatal_failure if isinstance(fault, WorkerDied) else file_failure)(task.motion, fault, task.person)]
    )


def _batches(tasks: Sequence[Task], limit: int, workers: int) -> list[tuple[Task, ...]]:
    """Divide tasks by bytes: at most `limit` per batch, and two batches per worker if there is enough work."""
    sizes = [task.motion.size for task in tasks]
    return batches_of(tasks, sizes, min(limit, max(4 * MEGABYTE, sum(sizes) // (2 * workers) + 1)))


def _compile_kernels(feature_set: FeatureSet) -> None:
    """Compile kernels into the cache, so that worker processes need not all compile them."""
    node = kinematics.Node("root", -1, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3), ())
    kinematics.forward((node,), np.zeros((2, 1)))
    textnumbers.parse_frames(b"1\nroot 0\n", 0, 1, ["root"], [1])
    textnumbers.parse_rows(b"0\n", 0, 1, 1)
    body, upright = np.zeros((len(feature_set.joints), 3, 2)), np.zeros((4, 2))
    features.words(body, upright, 30.0, feature_set.rules, None, feature_set.plugin_primitives)
    plausibility(np.random.default_rng(0).normal(size=(len(feature_set.joints), 3, 9)), feature_set.joints, 30.0)


def motion_outcomes(
    found: Scan, plan: SourceChanges, done: FilesRead, failures: Sequence[Failure]
) -> Iterator[Outcome]:
    """Yield path, outcome, number of takes and reason of every motion file.

    Parameters
    ----------
    found : Scan
        The files.
    plan : SourceChanges
        The changes of the source, with its unchanged files.
    done : FilesRead
        The files that were read.
    failures : sequence of Failure
        The files and persons that could not be read.
    """
    reasons: dict[str, list[str]] = {}
    for one in failures:
        reasons.setdefault(one.source, []).append(one.message)
    for motion in found.motions:
        reason = "\n".join(reasons.get(motion.path, ())) or None
        if motion.path in done.takes:
            yield motion.path, "in", len(done.takes[motion.path]), reason
        elif (file := plan.unchanged.get(motion.path)) is not None:
            copy = f"has the content of {file.root}/{file.path}" if file.is_elsewhere(motion) else None
            yield motion.path, "in", len(file.rows), copy
        else:
            yield motion.path, "refused" if reason else "not read", 0, reason or "strict stopped before this file"
