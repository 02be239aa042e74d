"""Define the manifest of a version of a store: its parts, and the records of its sources and pipelines."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import chain
from typing import Any

import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.storage.snapshot.part_records import AnyPart, LabelPart, Part, ResultPart, ranges
from kinedex.storage.snapshot.schemas import TakeColumn, takes_schema


@dataclass(frozen=True)
class Source:
    """The settings with which a source folder was last ingested.

    Attributes
    ----------
    stage : str
        The stage that ingested it, "<pipeline>/<stage>".
    settings : dict
        The parameters of the stage, as JSON values; paths are absolute.
    recorded : str
        Time of the ingest, ISO 8601 in UTC.
    """

    stage: str
    settings: dict[str, Any]
    recorded: str


@dataclass(frozen=True)
class PipelineRecord:
    """Everything needed to run a pipeline again.

    Attributes
    ----------
    yaml : str
        The text of the pipeline's file.
    path : str
        The path of that file.
    settings : dict
        The settings of the run that replaced those of the file, as JSON values.
    sources : tuple of str
        The absolute paths of the folders from which its stages read motion files.
    command : str
        The command line of the process that ran it.
    kinedex : str
        Version of kinedex.
    run : str
        Id of the pipeline run.
    recorded : str
        Time when the last stage of the run was recorded, ISO 8601 in UTC.
    """

    yaml: str
    path: str
    settings: dict[str, Any]
    sources: tuple[str, ...]
    command: str
    kinedex: str
    run: str
    recorded: str


@dataclass(frozen=True)
class StageRecord:
    """The record of a finished stage.

    Attributes
    ----------
    stage : str
        The stage, "<pipeline>/<stage>".
    fingerprint : str
        Hash of everything on which its results depend.
    run : str
        Id of this run of the stage, which is the `run` of its results.
    finished : str
        Time of its end, ISO 8601 in UTC.
    seconds : float
        Its duration.
    summary : dict
        Facts about its results, as JSON values.
    pipeline_run : str
        Id of the pipeline run that included it (`PipelineRecord.run`); empty, like `command` and `kinedex`, in records
        of an older kinedex.
    command : str
        The command line of the process that ran it.
    kinedex : str
        Version of kinedex.
    """

    stage: str
    fingerprint: str
    run: str
    finished: str
    seconds: float
    summary: dict[str, Any] = field(default_factory=dict)
    pipeline_run: str = ""
    command: str = ""
    kinedex: str = ""


@dataclass(frozen=True)
class Manifest:
    """One version of a store.

    Attributes
    ----------
    format_version : int
        Version of the store's layout.
    version : int
        Number of this version.
    created : str
        Time of the commit, ISO 8601 in UTC.
    feature_set : FeatureSet
        The feature set of the words.
    rate_hz : float
        Analysis frames per second.
    next_take_id : int
        The id of the next new take.
    content : str
        Hash of the takes of this version: every change of takes (not of layout or results) hashes the previous value
        and the change.
    frames : tuple of Part
        The parts with frames.
    takes : tuple of Part
        The parts with rows of takes.
    results : dict of str to tuple of ResultPart
        Kind of result → its parts.
    stages : dict of str to StageRecord
        "<pipeline>/<stage>" → its record.
    kinedex : str
        Version of the kinedex that made this version; empty, like `command` and `changes`, in a store of format 3.
    command : str
        Command line of the process that made it.
    changes : dict of str to object
        Its differences from the version before (`storage.store.version_changes`), as JSON values.
    columns : dict of str to TakeColumn
        The declared columns of takes, by name.
    labels : tuple of LabelPart
        The parts with labels, whose rows are in every later version, too.
    sources : dict of str to Source
        Absolute path of a source folder → the settings with which it was last ingested.
    pipelines : dict of str to PipelineRecord
        Name of a pipeline that has results → its last run.
    mappings : dict of str to str
        Name → YAML text of the user's skeleton mappings and vocabularies, which every ingest adds to the built-in ones.
    recent_pipelines : tuple of str
        The pipelines with results that were run to their end, the latest first.
    chosen_pipeline : str
        The pipeline chosen as current by `kinedex use`; empty for the last one that was run.
    removed_files : dict of str to tuple of str
        Absolute path of a source folder → paths in it whose takes a user removed; an ingest skips them.
    """

    format_version: int
    version: int
    created: str
    feature_set: FeatureSet
    rate_hz: float
    next_take_id: int
    content: str = ""
    frames: tuple[Part, ...] = ()
    takes: tuple[Part, ...] = ()
    results: dict[str, tuple[ResultPart, ...]] = field(default_factory=dict)
    stages: dict[str, StageRecord] = field(default_factory=dict)
    kinedex: str = ""
    command: str = ""
    changes: dict[str, Any] = field(default_factory=dict)
    columns: dict[str, TakeColumn] = field(default_factory=dict)
    labels: tuple[LabelPart, ...] = ()
    sources: dict[str, Source] = field(default_factory=dict)
    pipelines: dict[str, PipelineRecord] = field(default_factory=dict)
    mappings: dict[str, str] = field(default_factory=dict)
    recent_pipelines: tuple[str, ...] = ()
    chosen_pipeline: str = ""
    removed_files: dict[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def parts(self) -> tuple[AnyPart, ...]:
        """Every part that this version names."""
        return (*self.frames, *self.takes, *self.labels, *chain.from_iterable(self.results.values()))

    @property
    def takes_schema(self) -> pa.Schema:
        """The columns of takes, including declared ones."""
        return takes_schema(self.columns)

    @property
    def live_takes(self) -> tuple[int, ...]:
        """The ids of the live takes, ascending."""
        return tuple(sorted(take for part in self.frames for take in part.live))

    def content_digest(self) -> str:
        """Return a hash of everything that the index depends on: feature set, rate, takes and their frames.

        It depends neither on results nor on the layout of takes in parts, so that compaction keeps an index valid.
        """
        text = json.dumps([self.feature_set.digest, self.rate_hz, self.content], separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()

    def takes_digest(self) -> str:
        """Return a hash of the rows of takes, including the columns on which `content_digest` does not depend."""
        parts = [[part.sha256, ranges(part.dropped)] for part in self.takes]
        text = json.dumps([self.takes_schema.to_string(show_schema_metadata=False), parts], separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


def changed_content(content: str, changes: list[Any]) -> str:
    """Return the new `Manifest.content` after changes of takes, given as JSON values."""
    return hashlib.sha256(json.dumps([content, changes], separators=(",", ":")).encode()).hexdigest()


def now() -> str:
    """Return the current time in the format of manifests: ISO 8601, UTC, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
