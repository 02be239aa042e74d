"""Reading batches of motion files: the part of an ingest that runs in worker processes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pyarrow as pa

from catalog.features import FeatureSet
from catalog.skeletons import Mappings
from ops.errors import StoreError
from pipelines.analysis import analyse, blind
from pipelines.failures import Failure, failure
from storage.bodies import Body, Given, read_body
from storage.manifest import Part
from storage.parts import FramesWriter, frames_table
from storage.schemas import frames_schema
from storage.sources import SourceFile, checksum


@dataclass(frozen=True)
class Task:
    """One motion file to bring in."""

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
    given: Given
    strict: bool
    tasks: tuple[Task, ...]

    @cached_property
    def schema(self) -> pa.Schema:
        """The schema of the frames part."""
        return frames_schema(self.feature_set, self.rate_hz)

    @property
    def subject(self) -> str:
        """What the batch is about, for messages."""
        return ", ".join(str(task.motion.absolute) for task in self.tasks)


@dataclass(frozen=True)
class Written:
    """What a batch left: rows of `takes`, the frames part (None where every file failed), and the failures."""

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
                # not before: it reads the whole file, which is work for many processes
                content = checksum(task.motion.absolute)
                asf = task.skeleton.absolute if task.skeleton is not None else None
                joints = batch.feature_set.joints
                body = read_body(task.motion.absolute, asf, batch.mappings, joints, batch.given)
                rows = _frames(batch, task, body)
                take = _take_row(batch, task, content, body, rows)
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
            writer.add_table(task.take_id, rows)
            takes.append(take)
        return Written(takes, writer.close() if writer is not None else None, failures)
    except BaseException:
        if writer is not None:
            writer.__exit__(None, None, None)
        raise


def _frames(batch: Batch, task: Task, body: Body) -> pa.Table:
    """The rows of one take, at the analysis rate."""
    positions, orientation, words = analyse(body, batch.feature_set, batch.rate_hz)
    return frames_table(task.take_id, positions, orientation, words, batch.schema)


def _take_row(batch: Batch, task: Task, content: str, body: Body, rows: pa.Table) -> dict[str, Any]:
    groups = dict(task.groups)
    return {
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
        "frames": rows.num_rows,
        "seconds": body.frames / body.rate_hz,
        "invalid_frames": rows.column("word").null_count,
        "actor": groups.pop("actor", None),
        "class": groups.pop("class", None),
        "clip": groups.pop("clip", None),
        "groups": json.dumps(groups, sort_keys=True),
        "warnings": [*task.warnings, *body.warnings, *blind(batch.feature_set, body)],
    }
