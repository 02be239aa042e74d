"""The manifest: the JSON file of each version of a store that names every part; the truth, published whole."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import uuid
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, datetime
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, TypeAdapter, ValidationError

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import StoreError
from kinedex.storage.disk import sync_folder, write_errors
from kinedex.storage.snapshot.schemas import FORMAT_VERSION

FOLDER = "manifest"
TEMPORARY = ".tmp-"
"""How the names of unfinished files begin; readers ignore them, the next writer removes them."""

MOST_TAKES = 100_000_000
"""More takes than a part may name: a wrong manifest must not fill the memory."""

_NAME = re.compile(r"^(\d{6,})\.json$")


def ranges(take_ids: Iterable[int]) -> list[list[int]]:
    """Ascending ids as half-open ranges, [[first, last + 1], …]: how manifests write them, since ids come in rows."""
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
    """A Parquet file of frames or takes: its path relative to the store, what is in it, and which takes are gone.

    `take_ids` ascend. `dropped` are tombstones: takes of this part that were replaced or removed. Their `dropped_rows`
    rows stay until compaction.
    """

    path: str
    rows: int
    bytes: int
    sha256: str
    take_ids: TakeIds
    dropped: TakeIds = ()
    dropped_rows: int = 0

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
        values = {name: getattr(self, name) for name in ("path", "rows", "bytes", "sha256", "dropped_rows")}
        return values | {"take_ids": ranges(self.take_ids), "dropped": ranges(self.dropped)}


@dataclass(frozen=True)
class ResultPart:
    """A Parquet file of results: what one run of one stage ("<pipeline>/<stage>") found."""

    path: str
    rows: int
    bytes: int
    sha256: str
    stage: str
    run: str

    @property
    def live_rows(self) -> int:
        """All of its rows count."""
        return self.rows

    @property
    def dropped_rows(self) -> int:
        """It has no tombstones."""
        return 0


@dataclass(frozen=True)
class StageRecord:
    """What a finished stage left: `stage` is "<pipeline>/<stage>", `finished` is ISO 8601 in UTC."""

    stage: str
    fingerprint: str
    run: str
    finished: str
    seconds: float
    summary: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Manifest:
    """One version of a store.

    `content` stands for the takes of this version: every change of takes (not of layout, nor of results) makes a new
    one out of the one before and of what has changed.
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

    @property
    def parts(self) -> tuple[Part | ResultPart, ...]:
        """Every part that this version names."""
        return (*self.frames, *self.takes, *(part for parts in self.results.values() for part in parts))

    @property
    def live_takes(self) -> tuple[int, ...]:
        """The ids of the takes that count, ascending."""
        return tuple(sorted(take for part in self.frames for take in part.live))

    def content_digest(self) -> str:
        """A hash of what the index depends on: feature set, rate, takes and their frames.

        Neither results count, nor how the takes are laid out in parts: compaction keeps an index valid.
        """
        text = json.dumps([self.feature_set.digest, self.rate_hz, self.content], separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


def changed_content(content: str, changes: list[Any]) -> str:
    """The `Manifest.content` that follows another one after changes of takes, given as JSON values."""
    return hashlib.sha256(json.dumps([content, changes], separators=(",", ":")).encode()).hexdigest()


_ADAPTER: TypeAdapter[Manifest] = TypeAdapter(Manifest)


def now() -> str:
    """The present moment as manifests write it: ISO 8601, UTC, to the second."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def manifest_path(store: Path, version: int) -> Path:
    """Where the manifest of a version is."""
    return store / FOLDER / f"{version:06d}.json"


def versions(store: Path) -> list[int]:
    """The versions that a store holds, ascending; empty where there is no store."""
    folder = store / FOLDER
    if not folder.is_dir():
        return []
    return sorted(int(match[1]) for name in os.listdir(folder) if (match := _NAME.match(name)))


def read_newest(store: Path) -> Manifest:
    """Read the newest version of a store.

    Raises
    ------
    StoreError: no store there, a damaged manifest, or another format version.
    """
    found = versions(store)
    if not found:
        there = "is no kinedex store (it has no manifest)" if store.exists() else "does not exist"
        raise StoreError(f"{store} {there}; make one with `kinedex run` or `kinedex ingest`")
    return read_version(store, found[-1])


def read_version(store: Path, version: int) -> Manifest:
    """Read one version of a store; errors as `read_newest`."""
    path = manifest_path(store, version)
    content = _content(path)
    try:
        manifest = _ADAPTER.validate_python(content)
    except ValidationError as fault:
        first = fault.errors(include_url=False)[0]
        raise _damaged(path, f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from None
    if manifest.version != version:
        raise _damaged(path, f"it says that it is version {manifest.version}")
    return manifest


def named_files(store: Path, version: int) -> set[str]:
    """The paths of the parts that a version names: `read_version` without all the rest; errors as there."""
    path = manifest_path(store, version)
    content = _content(path)
    try:
        results = chain.from_iterable(content["results"].values())
        return {part["path"] for part in chain(content["frames"], content["takes"], results)}
    except (KeyError, TypeError, AttributeError) as fault:
        raise _damaged(path, f"it names no parts ({fault!r})") from None


def _content(path: Path) -> dict[str, Any]:
    """What a manifest file holds, once its format version and its checksum are found to be right."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as fault:
        raise StoreError(f"{path}: cannot be read: {fault.strerror}") from fault
    except ValueError as fault:
        raise _damaged(path, f"it is not valid JSON ({fault})") from None
    if not isinstance(content, dict):
        raise _damaged(path, "it is not a JSON object")
    if content.get("format_version") != FORMAT_VERSION:
        raise StoreError(
            f"{path}: the store has format version {content.get('format_version')}, this kinedex reads version "
            f"{FORMAT_VERSION}; use the kinedex that wrote it, or ingest into a new store"
        )
    checksum = content.pop("checksum", None)
    if checksum != _checksum(content):
        raise _damaged(path, "its content does not fit its checksum")
    return content


def _damaged(path: Path, reason: str) -> StoreError:
    return StoreError(
        f"{path}: the manifest is damaged: {reason}; bring the file back from a copy, "
        "or move it away to fall back to the version before"
    )


def _checksum(content: dict[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def publish(store: Path, manifest: Manifest) -> Path:
    """Make a version visible: write it aside, flush it to disk, then give it its name in one step.

    Raises
    ------
    StoreError: that version exists already, which means that another writer was at work.
    """
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
    """The manifest as JSON for people too: a line for each part, each stage, and everything else."""
    content: dict[str, Any] = {f.name: getattr(manifest, f.name) for f in fields(manifest)}
    content["feature_set"] = manifest.feature_set.encoded
    content["frames"] = [part.encoded for part in manifest.frames]
    content["takes"] = [part.encoded for part in manifest.takes]
    content["results"] = {kind: [asdict(part) for part in parts] for kind, parts in manifest.results.items()}
    content["stages"] = {name: asdict(record) for name, record in manifest.stages.items()}
    lines = []
    for name, value in {**content, "checksum": _checksum(content)}.items():
        if name in ("frames", "takes"):
            text = "[\n  " + ",\n  ".join(map(json.dumps, value)) + "\n ]" if value else "[]"
        elif name == "stages":
            items = (f"{json.dumps(stage)}: {json.dumps(record)}" for stage, record in value.items())
            text = "{\n  " + ",\n  ".join(items) + "\n }" if value else "{}"
        else:
            text = json.dumps(value)
        lines.append(f" {json.dumps(name)}: {text}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _link(temporary: Path, path: Path) -> None:
    """Give a finished file its name, unless the name is taken; where there are no hard links, the lock must do."""
    try:
        os.link(temporary, path)
    except OSError as fault:
        if fault.errno not in (errno.EPERM, errno.ENOTSUP, errno.ENOSYS, errno.EMLINK):
            raise
        if path.exists():
            raise FileExistsError(path) from None
        os.rename(temporary, path)
