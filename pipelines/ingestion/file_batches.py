"""Read batches of motion files in worker processes."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from kinedex.catalog.capture_sessions import decisions_in
from kinedex.catalog.features import FeatureSet
from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops.arrays import F64, U64
from kinedex.ops.errors import SourceError, StoreError
from kinedex.pipelines.ingestion.analysis import analyse, body_row
from kinedex.pipelines.ingestion.file_failures import Failure, file_failure
from kinedex.pipelines.ingestion.memory_limit import MemoryShare
from kinedex.pipelines.ingestion.metadata import group_values
from kinedex.storage.formats.motion.reader import Body, MotionFile, ReadSettings
from kinedex.storage.formats.motion.reader_table import persons_of, read_body, reader_of
from kinedex.storage.formats.motion.scanned_files import SourceFile
from kinedex.storage.formats.motion.sources import checksum
from kinedex.storage.formats.motion.text_blocks import BLOCK
from kinedex.storage.formats.motion.unpacked_files import unpacked
from kinedex.storage.formats.source_files import source_bytes
from kinedex.storage.snapshot.manifest import Part
from kinedex.storage.snapshot.parts import FramesWriter


@dataclass(frozen=True)
class Task:
    """One motion file to read, or one person of it.

    Attributes
    ----------
    name : str
        The name of the take; for a file with several persons, the name of the file.
    take_id : int
        The id of the take.
    motion : SourceFile
        The file.
    skeleton : SourceFile, optional
        Its skeleton file.
    groups : dict of str to str
        The named groups of its path.
    recipe : str
        A hash of everything except the file that the take depends on, and what other files decide for it
        (`catalog.capture_sessions.decisions_in`).
    warnings : tuple of str
        Warnings about the file.
    person : str or None
        The person to read; empty for a file with one person; None if it is not yet known how many there are.
    persons : int
        The number of persons in the file.
    """

    name: str
    take_id: int
    motion: SourceFile
    skeleton: SourceFile | None
    groups: dict[str, str]
    recipe: str
    warnings: tuple[str, ...]
    person: str | None = None
    persons: int = 1

    @property
    def described(self) -> dict[str, Any]:
        """The columns by which tables of metadata identify the take."""
        return {"take_id": self.take_id, "name": self.name, "source": self.motion.path}


@dataclass(frozen=True)
class Batch:
    """Motion files that a worker reads and writes as one part of frames; `figures` are the quality columns to fill."""

    store: Path
    feature_set: FeatureSet
    rate_hz: float
    mappings: Mappings
    given: ReadSettings
    strict: bool
    tasks: tuple[Task, ...]
    memory: MemoryShare | None = None
    figures: frozenset[str] = frozenset()

    @property
    def subject(self) -> str:
        """The paths of the files of the batch, separated by commas, for messages."""
        return ", ".join(str(task.motion.absolute) for task in self.tasks)


@dataclass(frozen=True)
class ReadBatch:
    """The result of reading a batch.

    Attributes
    ----------
    takes : list of dict
        Rows of `takes`.
    part : Part or None
        The part with the frames; None if no file was read.
    failures : list of Failure
        The files and persons that could not be read.
    persons : dict of str to tuple of str
        Path → persons in files with several; such a file is read only after an id is assigned to each person.
    """

    takes: list[dict[str, Any]]
    part: Part | None
    failures: list[Failure]
    persons: dict[str, tuple[str, ...]] = field(default_factory=dict)


def read_batch(batch: Batch) -> ReadBatch:
    """Read the files of one batch and write their frames as one part; runs in any process."""
    done = ReadBatch([], None, [])
    writer: FramesWriter | None = None
    try:
        for task in batch.tasks:
            try:
                found = _analysed(batch, task)
            except StoreError:
                raise
            except Exception as fault:
                # an error in one file, even a defect or a lack of memory, must not affect the others
                done.failures.append(file_failure(task.motion, fault, person=task.person))
                if batch.strict:
                    break
                continue
            if isinstance(found, tuple):
                done.persons[task.motion.path] = found
                continue
            if writer is None:
                writer = FramesWriter(batch.store, batch.feature_set, batch.rate_hz)
            writer.add(task.take_id, *found.frames)
            done.takes.append(found.row)
            del found  # free the memory before the next file is read
        return replace(done, part=writer.close()) if writer is not None else done
    except BaseException:
        if writer is not None:
            writer.__exit__(None, None, None)
        raise


@dataclass(frozen=True)
class _Take:
    """A take that was read: its row of `takes`, and its positions, orientation and words."""

    row: dict[str, Any]
    frames: tuple[F64, F64, U64]


def _analysed(batch: Batch, task: Task) -> _Take | tuple[str, ...]:
    """Return the take in a file, or the names of the persons if the file has several."""
    found = _read(batch, task)
    if not isinstance(found[1], Body):
        return found[1]
    content, body = found[0], found[1]
    frames = analyse(body, batch.feature_set, batch.rate_hz)
    return _Take(_take_row(batch, task, content, body, frames[2]), frames)


def _read(batch: Batch, task: Task) -> tuple[str, Body | tuple[str, ...]]:
    """Return the checksum of a file and its body, computed from the same bytes.

    A short file is read once. A longer file is read twice, and must not change in between. If the file has several
    persons and the task names none, their names are returned instead of a body.
    """
    with unpacked(task.motion.absolute, task.skeleton.absolute if task.skeleton is not None else None) as file:
        motion, asf = file.path, file.skeleton
        before = _stamp(motion)
        if batch.memory is not None:
            batch.memory.refuse_large(MotionFile(motion, asf), batch.feature_set, batch.rate_hz, batch.given)
        data = source_bytes(motion) if reader_of(motion).reads_whole and before[0] <= BLOCK else None
        if task.person is None and (persons := persons_of(MotionFile(motion, asf, data), batch.mappings)):
            return "", persons
        # computed last: it reads the whole file, which would delay the division of work among processes
        content = file.checksum or (checksum(motion) if data is None else hashlib.sha256(data).hexdigest())
        given = replace(batch.given, **decisions_in(task.recipe))
        body = read_body(motion, asf, batch.mappings, batch.feature_set.joints, given, data, task.person or "")
        if data is None and _stamp(motion) != before:
            raise SourceError(motion, "was changed while it was read; run again when it is whole")
    return content, file.restated_body(body)


def _stamp(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except OSError as fault:
        raise SourceError(path, f"cannot be read: {fault.strerror}") from fault
    return found.st_size, found.st_mtime_ns


def _take_row(batch: Batch, task: Task, content: str, body: Body, words: U64) -> dict[str, Any]:
    judged = body_row(body, words, batch.feature_set, batch.rate_hz, batch.figures)
    return (
        task.groups
        | judged
        | {
            "take_id": task.take_id,
            "name": task.name,
            "source": task.motion.path,
            "source_root": task.motion.root,
            "checksum": content,
            "source_bytes": task.motion.size,
            "source_mtime_ns": task.motion.mtime_ns,
            "format": task.motion.format,
            "skeleton_source": task.skeleton.path if task.skeleton is not None else None,
            "recipe": task.recipe,
            **group_values(task.groups),
            "warnings": [*task.warnings, *judged["warnings"]],
            **({"person": task.person, "persons": task.persons} if task.persons > 1 else {}),
        }
    )
