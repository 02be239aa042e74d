"""Batches of motion files that worker processes read."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops.errors import SourceError, StoreError
from kinedex.ops.words import NO_WORD
from kinedex.pipelines.ingestion.analysis import analyse, blind, known_features
from kinedex.pipelines.ingestion.failures import Failure, failure
from kinedex.pipelines.ingestion.memory_limit import MemoryShare
from kinedex.storage.formats.motion.reader import Body, MotionFile, ReadSettings, source_bytes
from kinedex.storage.formats.motion.reader_table import read_body, reader_of
from kinedex.storage.formats.motion.sources import SourceFile, checksum
from kinedex.storage.formats.motion.text_blocks import BLOCK
from kinedex.storage.snapshot.manifest import Part
from kinedex.storage.snapshot.parts import FramesWriter

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Task:
    """One motion file to read."""

    name: str
    take_id: int
    motion: SourceFile
    skeleton: SourceFile | None
    groups: dict[str, str]
    recipe: str
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class Batch:
    """The files that one task reads and writes as one frames part."""

    store: Path
    feature_set: FeatureSet
    rate_hz: float
    mappings: Mappings
    given: ReadSettings
    strict: bool
    tasks: tuple[Task, ...]
    memory: MemoryShare | None = None

    @property
    def subject(self) -> str:
        """The files of the batch, for messages."""
        return ", ".join(str(task.motion.absolute) for task in self.tasks)


@dataclass(frozen=True)
class Written:
    """The outcome of a batch: rows of `takes`, the frames part (None where every file failed), and the failures."""

    takes: list[dict[str, Any]]
    part: Part | None
    failures: list[Failure]


def read_batch(batch: Batch) -> Written:
    """Read the files of one batch and write their frames as one part; runs in any process."""
    takes: list[dict[str, Any]] = []
    failures: list[Failure] = []
    writer: FramesWriter | None = None
    try:
        for task in batch.tasks:
            try:
                take, frames = _analysed(batch, task)
            except StoreError:
                raise
            except Exception as fault:
                # whatever one file brings about, even a defect or a lack of memory, must not cost the others
                failures.append(failure(task.motion, fault))
                if batch.strict:
                    break
                continue
            if writer is None:
                writer = FramesWriter(batch.store, batch.feature_set, batch.rate_hz)
            writer.add(task.take_id, *frames)
            takes.append(take)
            del frames  # not to be there while the next file is read
        return Written(takes, writer.close() if writer is not None else None, failures)
    except BaseException:
        if writer is not None:
            writer.__exit__(None, None, None)
        raise


def _analysed(batch: Batch, task: Task) -> tuple[dict[str, Any], tuple[F64, F64, npt.NDArray[np.uint64]]]:
    """Return the row of `takes` of a file, and its frames."""
    content, body = _read(batch, task)
    frames = analyse(body, batch.feature_set, batch.rate_hz)
    return _take_row(batch, task, content, body, frames[2]), frames


def _read(batch: Batch, task: Task) -> tuple[str, Body]:
    """Return the checksum of a file and its body, of the same bytes: read once if it is short, else unchanged since."""
    motion, asf = task.motion.absolute, task.skeleton.absolute if task.skeleton is not None else None
    before = _stamp(motion)
    if batch.memory is not None:
        batch.memory.refuse_large(MotionFile(motion, asf), batch.feature_set, batch.rate_hz, batch.given)
    data = source_bytes(motion) if reader_of(motion).reads_whole and before[0] <= BLOCK else None
    # not before: it reads the whole file, which is work for many processes
    content = checksum(motion) if data is None else hashlib.sha256(data).hexdigest()
    body = read_body(motion, asf, batch.mappings, batch.feature_set.joints, batch.given, data)
    if data is None and _stamp(motion) != before:
        raise SourceError(motion, "was changed while it was read; run again when it is whole")
    return content, body


def _stamp(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except OSError as fault:
        raise SourceError(path, f"cannot be read: {fault.strerror}") from fault
    return found.st_size, found.st_mtime_ns


def _take_row(batch: Batch, task: Task, content: str, body: Body, words: npt.NDArray[np.uint64]) -> dict[str, Any]:
    groups = dict(task.groups)
    known = known_features(batch.feature_set, body)
    return groups | {
        "take_id": task.take_id,
        "name": task.name,
        "source": task.motion.path,
        "source_root": task.motion.root,
        "checksum": content,
        "source_bytes": task.motion.size,
        "source_mtime_ns": task.motion.mtime_ns,
        "format": task.motion.format,
        "skeleton": body.skeleton,
        "skeleton_source": task.skeleton.path if task.skeleton is not None else None,
        "recipe": task.recipe,
        "unit": body.unit,
        "source_rate_hz": body.rate_hz,
        "source_frames": body.frames,
        "rate_hz": batch.rate_hz,
        "frames": len(words),
        "seconds": body.frames / body.rate_hz,
        "invalid_frames": int(np.count_nonzero(words == NO_WORD)),
        "actor": groups.pop("actor", None),
        "class": groups.pop("class", None),
        "clip": groups.pop("clip", None),
        "groups": json.dumps(groups, sort_keys=True),
        "warnings": [*task.warnings, *body.warnings, *blind(batch.feature_set, body)],
        "known": None if known == batch.feature_set.every_bit else known,
    }
