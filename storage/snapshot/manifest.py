"""The manifest: the JSON file of each version of a store that names every part; the truth, published whole."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import uuid
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import UTC, datetime
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import pyarrow as pa
from pydantic import BeforeValidator, TypeAdapter, ValidationError

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import StoreError
from kinedex.storage.disk import TEMPORARY, sync_folder, write_errors
from kinedex.storage.remedies import repair, upgrade
from kinedex.storage.snapshot.schemas import FORMAT_VERSION, READ_VERSIONS, TakeColumn, takes_schema

FOLDER = "manifest"
MOST_TAKES = 100_000_000
"""More takes than a part may name: a wrong manifest must not fill the memory."""

_NAME = re.compile(r"^(\d{6,})\.json$")


def ranges(take_ids: Iterable[int]) -> list[list[int]]:
    """Return ascending ids as half-open ranges, [[first, last + 1], …], as manifests write them."""
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
    if sum(max(0, stop - start) for start, stop in value) > MOST_TAKES:
        raise ValueError(f"must be at most {MOST_TAKES} takes")
    return tuple(chain.from_iterable(range(start, stop) for start, stop in value))


TakeIds = Annotated[tuple[int, ...], BeforeValidator(_from_ranges)]


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
        Ids of the takes that were written into it, ascending.
    dropped : tuple of int
        Tombstones: ids of takes that were replaced or removed since.
    dropped_rows : int
        Number of their rows, which stay until compaction.
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
        """The takes of this part that count, ascending."""
        if not self.dropped:
            return self.take_ids
        gone = set(self.dropped)
        return tuple(take for take in self.take_ids if take not in gone)

    @property
    def live_rows(self) -> int:
        """The rows of the takes that count."""
        return self.rows - self.dropped_rows

    @cached_property
    def encoded(self) -> dict[str, Any]:
        """The part as its manifests write it; kept, since every later version writes it again."""
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
        Number of its columns, which are the first ones of the schema of its kind; 0 (not known) in a store of format 3.
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
        """All of its rows count."""
        return self.rows

    @property
    def dropped_rows(self) -> int:
        """It has no tombstones."""
        return 0


@dataclass(frozen=True)
class LabelPart:
    """A Parquet file of labels: statements of people, which no run makes again.

    Attributes
    ----------
    path : str
        Path relative to the store, with /.
    rows : int
        Number of its rows, all of which count for good.
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


@dataclass(frozen=True)
class Source:
    """The settings with which a source folder was ingested last.

    Attributes
    ----------
    stage : str
        The stage that ingested it, "<pipeline>/<stage>".
    settings : dict
        The parameters of the stage, as JSON values; paths are absolute.
    recorded : str
        Time of that, ISO 8601 in UTC.
    """

    stage: str
    settings: dict[str, Any]
    recorded: str


@dataclass(frozen=True)
class PipelineRecord:
    """All that it takes to run a pipeline again.

    Attributes
    ----------
    yaml : str
        The text of the pipeline's file.
    path : str
        The path of that file.
    settings : dict
        The settings that the run was given in place of those of the file, as JSON values.
    sources : tuple of str
        The folders that its stages read motion files from, absolute.
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
        Hash of all that its results follow from.
    run : str
        Id of this run of the stage, which its results have as `run`.
    finished : str
        Time of its end, ISO 8601 in UTC.
    seconds : float
        Its duration.
    summary : dict
        Facts about its results, as JSON values.
    pipeline_run : str
        Id of the pipeline run that it ran in (`PipelineRecord.run`); empty if an older kinedex recorded it, as are
        `command` and `kinedex`.
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
        The id that the next new take gets.
    content : str
        Hash of the takes of this version: every change of takes (not of layout, nor of results) makes a new one out of
        the one before and of the change.
    frames : tuple of Part
        The parts with frames.
    takes : tuple of Part
        The parts with rows of takes.
    results : dict of str to tuple of ResultPart
        Kind of result → its parts.
    stages : dict of str to StageRecord
        "<pipeline>/<stage>" → its record.
    kinedex : str
        Version of the kinedex that made this version; empty in a store of format 3, as are `command` and `changes`.
    command : str
        Command line of the process that made it.
    changes : dict of str to object
        Its differences from the version before (`storage.store.version_changes`), as JSON values.
    columns : dict of str to TakeColumn
        The declared columns of takes, by name.
    labels : tuple of LabelPart
        The parts with labels; every later version names all of their rows.
    sources : dict of str to Source
        Source folder, absolute → the settings with which it was ingested last.
    pipelines : dict of str to PipelineRecord
        Name of a pipeline that has results → its last run.
    mappings : dict of str to str
        Name → YAML text of skeleton mappings and vocabularies of the user's own, which every ingest adds to the others.
    recent_pipelines : tuple of str
        The pipelines that make results and were run to their end, the last one first.
    chosen_pipeline : str
        The pipeline that was made the current one by `kinedex use`; empty: the last one that was run.
    removed_files : dict of str to tuple of str
        Source folder, absolute → paths in it whose takes a person removed; an ingest passes them over.
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
        """The columns of takes, the declared ones among them."""
        return takes_schema(self.columns)

    @property
    def live_takes(self) -> tuple[int, ...]:
        """The ids of the takes that count, ascending."""
        return tuple(sorted(take for part in self.frames for take in part.live))

    def content_digest(self) -> str:
        """Return a hash of everything that the index depends on: feature set, rate, takes and their frames.

        Neither results count, nor the layout of takes in parts: compaction keeps an index valid.
        """
        text = json.dumps([self.feature_set.digest, self.rate_hz, self.content], separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()

    def takes_digest(self) -> str:
        """Return a hash of the rows of takes, the columns that `content_digest` leaves aside among them."""
        parts = [[part.sha256, ranges(part.dropped)] for part in self.takes]
        text = json.dumps([self.takes_schema.to_string(show_schema_metadata=False), parts], separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


def changed_content(content: str, changes: list[Any]) -> str:
    """Return the `Manifest.content` that follows another one after changes of takes, given as JSON values."""
    return hashlib.sha256(json.dumps([content, changes], separators=(",", ":")).encode()).hexdigest()


_ADAPTER: TypeAdapter[Manifest] = TypeAdapter(Manifest)


def now() -> str:
    """Return the present time as manifests write it: ISO 8601, UTC, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def manifest_path(store: Path, version: int) -> Path:
    """Return the path of the manifest of a version."""
    return store / FOLDER / f"{version:06d}.json"


def versions(store: Path) -> list[int]:
    """Return the versions that a store holds, ascending; empty if there is no store."""
    folder = store / FOLDER
    if not folder.is_dir():
        return []
    return sorted(int(match[1]) for name in os.listdir(folder) if (match := _NAME.match(name)))


def read_newest(store: Path) -> Manifest:
    """Read the newest version of a store.

    Parameters
    ----------
    store : Path
        The store's directory.

    Raises
    ------
    StoreError
        There is no store, its manifest is damaged, or it has a format that is not read.
    """
    found = versions(store)
    if not found:
        there = "is no kinedex store (it has no manifest)" if store.exists() else "does not exist"
        raise StoreError(f"{store} {there}; make one with `kinedex run` or `kinedex ingest`")
    return read_version(store, found[-1])


def read_version(store: Path, version: int) -> Manifest:
    """Read one version of a store.

    Parameters
    ----------
    store : Path
        The store's directory.
    version : int
        Number of the version.

    Raises
    ------
    StoreError
        The manifest is missing or damaged, or has a format that is not read.
    """
    path = manifest_path(store, version)
    content = _content(path)
    try:
        manifest = _ADAPTER.validate_python(content)
    except ValidationError as fault:
        first = fault.errors(include_url=False)[0]
        raise _damaged(path, f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from None
    if manifest.version != version:
        raise _damaged(path, f"it names version {manifest.version}")
    return manifest


def require_current_format(store: Path, manifest: Manifest) -> None:
    """Raise a StoreError if a version of a store has an older format, which is only read."""
    if manifest.format_version != FORMAT_VERSION:
        raise StoreError(
            f"{store}: the store has format {manifest.format_version}, which is only read; this kinedex writes format "
            f"{FORMAT_VERSION}",
            remedy=upgrade(store),
        )


def named_files(store: Path, version: int) -> set[str]:
    """Return the paths of the parts that a version names, read faster than by `read_version`; errors as there."""
    path = manifest_path(store, version)
    content = _content(path)
    try:
        results = chain.from_iterable(content["results"].values())
        return {part["path"] for part in chain(content["frames"], content["takes"], content.get("labels", ()), results)}
    except (KeyError, TypeError, AttributeError) as fault:
        raise _damaged(path, f"it names no parts ({fault!r})") from None


def content_digest_of(store: Path, version: int, newest: Manifest) -> str:
    """Return `Manifest.content_digest` of a version, read faster than by `read_version`; empty where it is damaged.

    `newest` is a later version of the store: feature set and rate are the same in all of them.
    """
    try:
        return replace(newest, content=_content(manifest_path(store, version))["content"]).content_digest()
    except (StoreError, KeyError):
        return ""


def _content(path: Path) -> dict[str, Any]:
    """Return the content of a manifest file, once its format version and its checksum are found to be right."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as fault:
        raise StoreError(f"{path}: cannot be read: {fault.strerror}") from fault
    except ValueError as fault:
        raise _damaged(path, f"it is not valid JSON ({fault})") from None
    if not isinstance(content, dict):
        raise _damaged(path, "it is not a JSON object")
    checksum = content.pop("checksum", None)
    sound = checksum == json_checksum(content)
    if sound and content.get("format_version") not in READ_VERSIONS:
        raise StoreError(
            f"{path}: the store has format version {content.get('format_version')}, this kinedex reads versions "
            f"{' and '.join(map(str, READ_VERSIONS))}; use the kinedex that wrote it, or ingest into a new store"
        )
    if not sound:
        raise _damaged(path, "its content does not fit its checksum")
    return content


class DamagedManifest(StoreError):
    """The manifest of a version is damaged.

    Attributes
    ----------
    problem : str
        The damage.
    """

    problem = ""


def _damaged(path: Path, problem: str) -> DamagedManifest:
    fault = DamagedManifest(f"{path}: the manifest is damaged: {problem}", remedy=repair(path.parents[1]))
    fault.problem = problem
    return fault


def json_checksum(content: dict[str, Any]) -> str:
    """Return the SHA-256 of a JSON object, whatever its blanks and the order of its keys."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def publish(store: Path, manifest: Manifest) -> Path:
    """Make a version visible: write it aside, flush it to disk, then give it its name in one step.

    Parameters
    ----------
    store : Path
        The store's directory.
    manifest : Manifest
        The version to publish.

    Returns
    -------
    Path
        The manifest's file.

    Raises
    ------
    StoreError
        The version exists already, which means that another writer was at work; it has an older format; or the disk is
        full.
    """
    require_current_format(store, manifest)
    path = manifest_path(store, manifest.version)
    temporary = path.with_name(f"{TEMPORARY}{uuid.uuid4().hex}.json")
    with write_errors(path):
        try:
            with open(temporary, "w", encoding="utf-8") as file:
                file.write(_text(manifest))
                file.flush()
                os.fsync(file.fileno())
            _link(temporary, path)
        except FileExistsError:
            raise StoreError(
                f"{path} exists already: another writer has changed the store; nothing was committed, run again"
            ) from None
        finally:
            temporary.unlink(missing_ok=True)
        sync_folder(path.parent)
    return path


def _text(manifest: Manifest) -> str:
    """Return the manifest as JSON that people can read: a line for each part, each record, and everything else."""
    content: dict[str, Any] = {f.name: getattr(manifest, f.name) for f in fields(manifest)}
    content["feature_set"] = manifest.feature_set.encoded
    content["frames"] = [part.encoded for part in manifest.frames]
    content["takes"] = [part.encoded for part in manifest.takes]
    content["labels"] = [asdict(part) for part in manifest.labels]
    content["results"] = {kind: [asdict(part) for part in parts] for kind, parts in manifest.results.items()}
    for name in ("columns", "sources", "pipelines", "stages"):
        content[name] = {key: asdict(record) for key, record in content[name].items()}
    lines = []
    for name, value in {**content, "checksum": json_checksum(content)}.items():
        if name in ("frames", "takes", "labels"):
            text = "[\n  " + ",\n  ".join(map(json.dumps, value)) + "\n ]" if value else "[]"
        elif name in ("columns", "sources", "pipelines", "stages"):
            items = (f"{json.dumps(key)}: {json.dumps(record)}" for key, record in value.items())
            text = "{\n  " + ",\n  ".join(items) + "\n }" if value else "{}"
        else:
            text = json.dumps(value)
        lines.append(f" {json.dumps(name)}: {text}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _link(temporary: Path, path: Path) -> None:
    """Give a finished file its name unless the name is taken; file systems without hard links rely on the lock."""
    try:
        os.link(temporary, path)
    except OSError as fault:
        if fault.errno not in (errno.EPERM, errno.ENOTSUP, errno.ENOSYS, errno.EMLINK, errno.EINVAL):
            raise
        if path.exists():
            raise FileExistsError(path) from None
        os.rename(temporary, path)
