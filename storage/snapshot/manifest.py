"""Define the manifest of a version of a store: its parts, and the records of its sources, pipelines and provenance."""

from __future__ import annotations

import hashlib
import json
import shlex
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache, cached_property
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.storage.snapshot.schemas import TakeColumn, takes_schema

MAX_TAKES = 100_000_000
"""The largest number of takes in a part; the limit keeps a wrong manifest from filling the memory."""


def ranges(take_ids: Iterable[int]) -> list[list[int]]:
    """Return ascending ids as half-open ranges, [[first, last + 1], …], the form of manifests."""
    found: list[list[int]] = []
    for take in take_ids:
        if found and found[-1][1] == take:
            found[-1][1] = take + 1
        else:
            found.append([take, take + 1])
    return found


def _from_ranges(value: object) -> tuple[int, ...]:
    if not isinstance(value, list) or not all(
        isinstance(pair, list) and len(pair) == 2 and all(type(end) is int for end in pair) for pair in value
    ):
        raise ValueError("must be a list of ranges [first, last + 1] of take ids")
    if sum(max(0, stop - start) for start, stop in value) > MAX_TAKES:
        raise ValueError(f"must be at most {MAX_TAKES} takes")
    return tuple(chain.from_iterable(range(start, stop) for start, stop in value))


class _Ranges:
    """The pydantic type of take ids that a manifest stores as ranges."""

    read = staticmethod(_from_ranges)

    @staticmethod
    def __get_pydantic_core_schema__(source: Any, handler: Any) -> Any:
        """Return the pydantic schema, which is needed only to explain what is wrong with a faulty manifest."""
        from pydantic_core import core_schema

        return core_schema.no_info_before_validator_function(_from_ranges, handler(source))


TakeIds = Annotated[tuple[int, ...], _Ranges()]


@dataclass(frozen=True)
class Part:
    """A Parquet file of frames or takes.

    Attributes
    ----------
    path : str
        Path relative to the store, with /.
    rows : int
        Number of its rows.
    bytes : int
        Size of the file.
    sha256 : str
        Checksum of the file.
    take_ids : tuple of int
        Ids of the takes written into it, ascending.
    dropped : tuple of int
        Tombstones: ids of takes in it that were replaced or removed later.
    dropped_rows : int
        Number of rows of dropped takes, which stay until compaction.
    xxh3 : str
        XXH3 checksum of the file, 128 bits in hexadecimal digits; empty in a store of format 3.
    """

    path: str
    rows: int
    bytes: int
    sha256: str
    take_ids: TakeIds
    dropped: TakeIds = ()
    dropped_rows: int = 0
    xxh3: str = ""

    @cached_property
    def live(self) -> tuple[int, ...]:
        """The ids of the takes of this part that are not dropped, ascending."""
        if not self.dropped:
            return self.take_ids
        gone = set(self.dropped)
        return tuple(take for take in self.take_ids if take not in gone)

    @property
    def live_rows(self) -> int:
        """The number of rows of live takes."""
        return self.rows - self.dropped_rows

    @cached_property
    def encoded(self) -> dict[str, Any]:
        """The part as JSON values for a manifest; cached, since every later version writes them again."""
        values = {name: getattr(self, name) for name in ("path", "rows", "bytes", "sha256", "xxh3", "dropped_rows")}
        return values | {"take_ids": ranges(self.take_ids), "dropped": ranges(self.dropped)}


@dataclass(frozen=True)
class ResultPart:
    """A Parquet file of results of one kind, written by one run of one stage.

    Attributes
    ----------
    path : str
        Path relative to the store, with /.
    rows : int
        Number of its rows.
    bytes : int
        Size of the file.
    sha256 : str
        Checksum of the file.
    stage : str
        The stage, "<pipeline>/<stage>".
    run : str
        Id of the run of the stage.
    xxh3 : str
        XXH3 checksum of the file, 128 bits in hexadecimal digits; empty in a store of format 3.
    columns : int
        Number of its columns, the first ones of the schema of its kind; 0 (unknown) in a store of format 3.
    """

    path: str
    rows: int
    bytes: int
    sha256: str
    stage: str
    run: str
    xxh3: str = ""
    columns: int = 0

    @property
    def live_rows(self) -> int:
        """The number of rows, all of which are live."""
        return self.rows

    @property
    def dropped_rows(self) -> int:
        """Always 0, since results have no tombstones."""
        return 0


@dataclass(frozen=True)
class LabelPart:
    """A Parquet file of labels: statements of people, which cannot be recomputed.

    Attributes
    ----------
    path : str
        Path relative to the store, with /.
    rows : int
        Number of its rows, all of which are kept forever.
    bytes : int
        Size of the file.
    sha256 : str
        Checksum of the file.
    xxh3 : str
        XXH3 checksum of the file, 128 bits in hexadecimal digits.
    """

    path: str
    rows: int
    bytes: int
    sha256: str
    xxh3: str


AnyPart = Part | ResultPart | LabelPart
"""A Parquet file that a version names."""


LONGEST = 1000
"""The largest number of characters of a recorded command."""


def running_command() -> str:
    """Return the command line of this process as it would be typed, such as "kinedex ingest STORE DIR".

    The option --log-file is omitted: it does not affect results, and the explorer adds it to its commands.
    """
    program, *arguments = sys.argv or [""]
    if "--log-file" in arguments:
        place = arguments.index("--log-file")
        del arguments[place : place + 2]
    path = Path(program)
    name = path.parent.name if path.name == "__main__.py" else path.name
    # a program passed to Python as text has no name
    program_words = [name] if name and not name.startswith("-") else ["python", *filter(None, [name])]
    text = shlex.join([*program_words, *arguments])
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…"


@cache
def kinedex_version() -> str:
    """Return the version of the installed kinedex; "unknown" for a source tree that is not installed."""
    from importlib.metadata import PackageNotFoundError, version  # imported here: it is slow, and readers need none

    try:
        return version("kinedex")
    except PackageNotFoundError:
        return "unknown"


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
        Hash of the takes of this version. Every change of takes gives a new hash, of the previous value and the change;
        changes of layout or results do not.
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
        The parts with labels; every later version has their rows as well.
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

    def parts_by_stage(self, *kinds: str) -> Iterator[tuple[list[ResultPart], ...]]:
        """Yield, for each stage in the order of names, the parts of each of the given kinds of results."""
        of_kinds = [self.results.get(kind, ()) for kind in kinds]
        for stage in sorted({part.stage for parts in of_kinds for part in parts}):
            yield tuple([part for part in parts if part.stage == stage] for parts in of_kinds)

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
