"""Damaged manifests: an older one is kept aside; in the place of the newest the version before counts."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from kinedex.ops.errors import StoreError
from kinedex.storage.disk import sync_folder
from kinedex.storage.repair.quarantine import KeptFile, Quarantine
from kinedex.storage.snapshot.manifest import (
    FOLDER,
    DamagedManifest,
    Manifest,
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
        Paths of the parts that no other version names, which are lost with it.
    """

    version: int
    problem: str
    lost: tuple[str, ...] = ()

    @property
    def file(self) -> str:
        """Path of the manifest relative to the store."""
        return f"{FOLDER}/{self.version:06d}.json"


def bad_manifests(store: Path) -> list[BadManifest]:
    """Return the damaged manifests of a store, oldest first.

    Raises
    ------
    StoreError
        There is no store; a manifest has a format that is not read; or no version is sound.
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
    return [BadManifest(version, problem, unnamed if version > sound[-1] else ()) for version, problem in found.items()]


def newest_sound(store: Path, bad: list[BadManifest]) -> Manifest:
    """Return the newest version whose manifest is not damaged."""
    wrong = {one.version for one in bad}
    return read_version(store, max(version for version in versions(store) if version not in wrong))


def set_aside(quarantine: Quarantine, bad: list[BadManifest]) -> None:
    """Move damaged manifests into the quarantine, with the parts that only they name; newer versions go first.

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
    """Return the parts on disk that no sound version names."""
    named = set().union(*(named_files(store, version) for version in sound))
    found = (
        f"{folder}/{name}"
        for folder in PART_FOLDERS
        for name in (sorted(os.listdir(store / folder)) if (store / folder).is_dir() else ())
        if name.startswith("part-")
    )
    return tuple(path for path in found if path not in named)
