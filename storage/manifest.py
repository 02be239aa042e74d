"""The manifest: the JSON file of each version of a store that names every part; the truth, published whole."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import uuid
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from catalog.features import FeatureSet
from ops.errors import StoreError
from storage.schemas import FORMAT_VERSION

FOLDER = "manifest"
TEMPORARY = ".tmp-"
"""How the names of unfinished files begin; readers ignore them, the next writer removes them."""

_NAME = re.compile(r"^(\d{6,})\.json$")


@dataclass(frozen=True)
class Part:
    """A Parquet file of frames or takes: its path relative to the store, what is in it, and which takes are gone.

    `dropped` are tombstones: takes of this part that were replaced or removed. Their rows stay until compaction.
    """

    path: str
    rows: int
    bytes: int
    sha256: str
    take_ids: tuple[int, ...]
    dropped: tuple[int, ...] = ()

    @property
    def live(self) -> tuple[int, ...]:
        """The takes of this part that count, ascending."""
        gone = set(self.dropped)
        return tuple(take for take in self.take_ids if take not in gone)


@dataclass(frozen=True)
class ResultPart:
    """A Parquet file of results: what one run of one stage ("<pipeline>/<stage>") found."""

    path: str
    rows: int
    bytes: int
    sha256: str
    stage: str
    run: str


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
    """One version of a store."""

    format_version: int
    version: int
    created: str
    feature_set: FeatureSet
    rate_hz: float
    next_take_id: int
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
        """A hash of what the index depends on: feature set, rate, live frames and takes. Results do not count."""
        parts = [[p.sha256, sorted(p.dropped)] for p in sorted(self.frames + self.takes, key=lambda p: p.path)]
        text = json.dumps([self.feature_set.digest, self.rate_hz, parts], separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


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
    try:
        manifest = _ADAPTER.validate_python(content)
    except ValidationError as fault:
        first = fault.errors(include_url=False)[0]
        raise _damaged(path, f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from None
    if manifest.version != version:
        raise _damaged(path, f"it says that it is version {manifest.version}")
    return manifest


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
    content = json.loads(json.dumps(asdict(manifest)))
    content["checksum"] = _checksum(content)
    path = manifest_path(store, manifest.version)
    temporary = path.with_name(f"{TEMPORARY}{uuid.uuid4().hex}.json")
    with open(temporary, "w", encoding="utf-8") as file:
        json.dump(content, file, indent=1)
        file.flush()
        os.fsync(file.fileno())
    try:
        _link(temporary, path)
    except FileExistsError:
        raise StoreError(
            f"{path} exists already: another writer has changed the store; nothing was committed, run again"
        ) from None
    finally:
        temporary.unlink(missing_ok=True)
    sync_folder(path.parent)
    return path


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


def sync_folder(folder: Path) -> None:
    """Flush a folder's entries to disk, so that a rename in it outlives a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
