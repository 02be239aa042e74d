"""Read and publish manifests, one JSON file for each version of a store, which define what the version contains."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import uuid
from dataclasses import asdict, fields, replace
from itertools import chain
from pathlib import Path
from typing import Any

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import StoreError
from kinedex.storage.durable_files import TEMPORARY, names_in, sync_folder, write_errors, write_flushed
from kinedex.storage.remedies import repair, upgrade
from kinedex.storage.snapshot.manifest import Manifest
from kinedex.storage.snapshot.plain_records import record_of
from kinedex.storage.snapshot.schemas import FORMAT_VERSION, READ_VERSIONS

FOLDER = "manifest"

_NAME = re.compile(r"^(\d{6,})\.json$")

_FEATURE_SETS: dict[str, FeatureSet] = {}  # by digest: versions share an object, so that its `encoded` is computed once


def manifest_path(store: Path, version: int) -> Path:
    """Return the path of the manifest of a version."""
    return store / FOLDER / f"{version:06d}.json"


def versions(store: Path) -> list[int]:
    """Return the numbers of a store's versions, ascending; empty if there is no store."""
    return sorted(int(match[1]) for name in names_in(store / FOLDER) if (match := _NAME.match(name)))


def read_newest(store: Path) -> Manifest:
    """Read the newest version of a store.

    Parameters
    ----------
    store : Path
        The store's directory.

    Raises
    ------
    StoreError
        There is no store, its manifest is damaged, or it has an unsupported format.
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
        The manifest is missing or damaged, or has an unsupported format.
    """
    path = manifest_path(store, version)
    content = _content(path)
    try:
        manifest = record_of(Manifest, content)
    except (ValueError, OverflowError):
        manifest = _validated(path, content)
    if manifest.version != version:
        raise _damaged(path, f"it names version {manifest.version}")
    known = _FEATURE_SETS.setdefault(manifest.feature_set.digest, manifest.feature_set)
    return replace(manifest, feature_set=known) if known == manifest.feature_set else manifest


def _validated(path: Path, content: dict[str, Any]) -> Manifest:
    """Validate a manifest with pydantic, whose errors name the wrong value; it is slow and imported only here."""
    from pydantic import TypeAdapter, ValidationError

    try:
        return TypeAdapter(Manifest).validate_python(content)
    except ValidationError as fault:
        first = fault.errors(include_url=False)[0]
        raise _damaged(path, f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from None


def require_current_format(store: Path, manifest: Manifest) -> None:
    """Raise a StoreError if a version of a store has an older format, which is read-only."""
    if manifest.format_version != FORMAT_VERSION:
        raise StoreError(
            f"{store}: the store has format {manifest.format_version}, which is only read; this kinedex writes format "
            f"{FORMAT_VERSION}",
            remedy=upgrade(store),
        )


def named_files(store: Path, version: int) -> set[str]:
    """Return the paths of the parts that a version names, with the errors of `read_version`, but faster."""
    path = manifest_path(store, version)
    content = _content(path)
    try:
        results = chain.from_iterable(content["results"].values())
        return {part["path"] for part in chain(content["frames"], content["takes"], content.get("labels", ()), results)}
    except (KeyError, TypeError, AttributeError) as fault:
        raise _damaged(path, f"it names no parts ({fault!r})") from None


def content_digest_of(store: Path, version: int, newest: Manifest) -> str:
    """Return `Manifest.content_digest` of a version, faster than `read_version`; empty if its manifest is damaged.

    `newest` is a later version of the store; all versions have the same feature set and rate.
    """
    try:
        return replace(newest, content=_content(manifest_path(store, version))["content"]).content_digest()
    except (StoreError, KeyError):
        return ""


def _content(path: Path) -> dict[str, Any]:
    """Return the content of a manifest file after a check of its format version and checksum."""
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
    """Return the SHA-256 of a JSON object, independent of whitespace and the order of keys."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def publish(store: Path, manifest: Manifest) -> Path:
    """Publish a version atomically: write its manifest to a temporary file, flush it to disk, then rename it.

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
        The version exists already, which means that another writer was active; it has an older format; or the disk is
        full.
    """
    require_current_format(store, manifest)
    path = manifest_path(store, manifest.version)
    temporary = path.with_name(f"{TEMPORARY}{uuid.uuid4().hex}.json")
    with write_errors(path):
        try:
            write_flushed(temporary, _text(manifest))
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
    """Return the manifest as readable JSON, with one line for each part, each record and each other entry."""
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
    """Name a finished file unless the name is taken; without hard links only the lock prevents a race."""
    try:
        os.link(temporary, path)
    except OSError as fault:
        if fault.errno not in (errno.EPERM, errno.ENOTSUP, errno.ENOSYS, errno.EMLINK, errno.EINVAL):
            raise
        if path.exists():
            raise FileExistsError(path) from None
        os.rename(temporary, path)
