"""Move damaged manifests to quarantine; if the newest is damaged, the version before it becomes the current one."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from kinedex.ops.errors import StoreError
from kinedex.storage.durable_files import names_in, sync_folder
from kinedex.storage.repair.quarantine import KeptFile, Quarantine
from kinedex.storage.snapshot.manifest import Manifest
from kinedex.storage.snapshot.manifest_files import (
    FOLDER,
    DamagedManifest,
    manifest_path,
    named_files,
    read_version,
    versions,
)
from kinedex.storage.snapshot.schemas import PART_FOLDERS


@dataclass(frozen=True)
class BadManifest:
    """A version whose manifest is damaged.

    Attributes
    ----------
    version : int
        Number of the version.
    problem : str
        The damage.
    lost : tuple of str
        Paths of the parts that no other version names, which are lost with the manifest.
    changes : str
        The changes of the version and the command that made it, as far as the manifest can be read.
    """

    version: int
    problem: str
    lost: tuple[str, ...] = ()
    changes: str = ""

    @property
    def file(self) -> str:
        """Path of the manifest relative to the store."""
        return f"{FOLDER}/{self.version:06d}.json"


def bad_manifests(store: Path) -> list[BadManifest]:
    """Return the damaged manifests of a store, oldest first.

    Raises
    ------
    StoreError
        There is no store; a manifest has an unsupported format; or all versions are damaged.
    """
    found, sound = {}, []
    for version in versions(store):
        try:
            read_version(store, version)
            sound.append(version)
        except DamagedManifest as fault:
            found[version] = fault.problem
    if not sound:
        if found:
            raise StoreError(f"{store}: no manifest is sound; ingest the sources into a new store")
        raise StoreError(f"{store} is no kinedex store (it has no manifest)")
    unnamed = _unnamed(store, sound) if found else ()
    return [
        BadManifest(version, problem, unnamed if version > sound[-1] else (), _changes(manifest_path(store, version)))
        for version, problem in found.items()
    ]


def _changes(path: Path) -> str:
    """Return the changes that a damaged manifest records; empty if they cannot be read."""
    try:
        # each line of a manifest is separate JSON, so that most lines survive damage
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return ""
    stated = {}
    for line in lines:
        name, colon, value = line.strip().rstrip(",").partition(": ")
        if colon and name in ('"changes"', '"command"'):
            with suppress(ValueError):
                stated[name.strip('"')] = json.loads(value)
    changes = ", ".join(f"{fact} {value}" for fact, value in dict(stated.get("changes") or {}).items())
    return f"{changes} (by `{stated['command']}`)" if stated.get("command") and changes else changes


def newest_sound(store: Path, bad: list[BadManifest]) -> Manifest:
    """Return the newest version whose manifest is not damaged."""
    wrong = {one.version for one in bad}
    return read_version(store, max(version for version in versions(store) if version not in wrong))


def set_aside(quarantine: Quarantine, bad: list[BadManifest]) -> None:
    """Move damaged manifests into the quarantine, with the parts that only these manifests name; newest first.

    Only the holder of the store's lock may do this.
    """
    store = quarantine.store
    for one in reversed(bad):
        for part in one.lost:
            quarantine.keep(KeptFile(part, f"only version {one.version} names it, whose manifest is damaged", "a part"))
        quarantine.keep(KeptFile(one.file, one.problem, f"the manifest of version {one.version}"))
        os.unlink(manifest_path(store, one.version))
        sync_folder(store / FOLDER)
        for part in one.lost:
            (store / part).unlink(missing_ok=True)


def _unnamed(store: Path, sound: list[int]) -> tuple[str, ...]:
    """Return the parts on disk that no undamaged version names."""
    named = set().union(*(named_files(store, version) for version in sound))
    found = (
        f"{folder}/{name}" for folder in PART_FOLDERS for name in names_in(store / folder) if name.startswith("part-")
    )
    return tuple(path for path in found if path not in named)
