"""Check a directory before writing: it is a store with the same words, without leftovers of killed runs."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import NewStoreError, StoreError
from kinedex.storage.disk import TEMPORARY
from kinedex.storage.snapshot.manifest import Manifest
from kinedex.storage.snapshot.manifest_files import FOLDER, named_files, versions
from kinedex.storage.snapshot.schemas import PART_FOLDERS

FOLDERS = (FOLDER, "frames", "takes", "labels", "index", "results")
"""The folders of a store."""

DATABASE = "kinedex.duckdb"
"""The file in a store that has all views for other DuckDB clients (`storage.store.database_file`)."""

DUCKDB_SIGNS = "?\\"
"""Characters that DuckDB does not read literally in file paths."""

_CLOCK_SECONDS = 2.0
"""The accuracy of file times on some file systems, in seconds."""


def refuse_foreign(root: Path) -> None:
    """Raise a StoreError if a directory contains anything but a store, or has a path that DuckDB cannot open."""
    if os.name != "nt" and set(DUCKDB_SIGNS).intersection(str(root.absolute())):
        raise StoreError(
            f"{root}: the path of a store cannot have a ? or a backslash in it, which DuckDB reads as signs of its "
            "own; name another directory"
        )
    if root.exists() and not root.is_dir():
        raise StoreError(f"{root} is a file; a store is a directory")
    if not root.exists() or versions(root):
        return
    foreign = sorted(set(os.listdir(root)) - {*FOLDERS, "lock"})
    if foreign:
        raise StoreError(
            f"{root} holds other things ({', '.join(foreign[:3])}) and is no kinedex store; "
            "name a new or an empty directory"
        )


def refuse_other_words(root: Path, manifest: Manifest, feature_set: FeatureSet, rate_hz: float) -> None:
    """Raise a StoreError if the words of a store have another feature set or another rate."""
    has = manifest.feature_set
    if has.digest != feature_set.digest:
        raise NewStoreError(
            f"{root} was made with the feature set {has.name} version {has.version} ({has.digest}), not with "
            f"{feature_set.name} version {feature_set.version} ({feature_set.digest}); ingest into a new store"
        )
    if manifest.rate_hz != rate_hz:
        raise NewStoreError(
            f"{root} holds frames at {manifest.rate_hz:g} Hz, not {rate_hz:g} Hz; ingest into a new store"
        )


def last_opened(lock: Path) -> float:
    """Return the time when a store was last opened for writing, from its lock file; 0 if it never was."""
    try:
        return lock.stat().st_mtime
    except FileNotFoundError:
        return 0.0


def remove_leftovers(root: Path, newest: Manifest, since: float = 0.0) -> None:
    """Remove the leftovers of killed runs: unfinished files, and parts that no manifest names.

    Only the holder of the lock may call this, because another writer could be about to commit such a part.

    Parameters
    ----------
    root : Path
        The store's directory.
    newest : Manifest
        The newest version.
    since : float, optional
        Time when the store was last opened for writing (`last_opened`). Older files are not leftovers, so that older
        parts need not be looked up in manifests, of which there may be a thousand.
    """
    candidates = set()
    for folder in (FOLDER, *PART_FOLDERS):
        for name in os.listdir(root / folder) if (root / folder).is_dir() else ():
            if name.startswith(TEMPORARY):
                _remove(root / folder / name)
            elif name.startswith("part-") and (root / folder / name).stat().st_mtime > since - _CLOCK_SECONDS:
                candidates.add(f"{folder}/{name}")
    candidates -= {part.path for part in newest.parts}
    for version in reversed(versions(root)[:-1]):
        # readers of an older version may still be active
        if not candidates:
            break
        try:
            candidates -= named_files(root, version)
        except StoreError:
            # the parts that a damaged manifest names are unknown, so nothing is removed; `kinedex verify` reports the
            # manifest
            return
    for path in candidates:
        _remove(root / path)


def _remove(path: Path) -> None:
    """Remove a leftover file; if Windows refuses because it is open, the next writer tries again."""
    with suppress(PermissionError if os.name == "nt" else FileNotFoundError):
        path.unlink(missing_ok=True)
