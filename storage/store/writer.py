"""Write a store: one writer at a time collects changes and publishes them as one new version."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType

import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import NewStoreError, StoreError
from kinedex.storage.durable_files import TEMPORARY, names_in, write_errors
from kinedex.storage.lock import NO_WAIT, Lock, Wait
from kinedex.storage.snapshot.manifest import Manifest, changed_content, kinedex_version, now, running_command
from kinedex.storage.snapshot.manifest_files import (
    FOLDER,
    named_files,
    publish,
    read_newest,
    require_current_format,
    versions,
)
from kinedex.storage.snapshot.parts import write_part
from kinedex.storage.snapshot.schemas import DATABASE, FORMAT_VERSION, PART_FOLDERS, with_columns
from kinedex.storage.store.record_changes import RecordChanges
from kinedex.storage.store.result_changes import ResultChanges
from kinedex.storage.store.take_changes import TakeChanges
from kinedex.storage.store.version_changes import Facts

FOLDERS = (FOLDER, "frames", "takes", "labels", "index", "results")
"""The folders of a store."""

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
        Time when the store was last opened for writing (`last_opened`). Older files are not leftovers, and are not
        looked up in the manifests, of which there may be a thousand.
    """
    candidates = set()
    for folder in (FOLDER, *PART_FOLDERS):
        for name in names_in(root / folder):
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
    """Remove a leftover file; if Windows refuses because the file is open, the next writer tries again."""
    with suppress(PermissionError if os.name == "nt" else FileNotFoundError):
        path.unlink(missing_ok=True)


class StoreWriter(TakeChanges, ResultChanges, RecordChanges):
    """The only writer of a store, from `open` to `close` (or the end of its `with` block).

    Readers see no change before `commit`; changes that are not committed at the end are discarded. Other processes may
    write parts (`storage.snapshot.parts.FramesWriter`) while this writer is open, but not before: opening it removes
    the leftovers of killed runs, including parts that no manifest names.
    """

    def __init__(self, path: Path, manifest: Manifest, lock: Lock) -> None:
        super().__init__(path, manifest)
        self._opened = manifest.version
        self._lock = lock

    @classmethod
    def open(
        cls, path: str | Path, feature_set: FeatureSet, rate_hz: float = 30.0, wait: Wait = NO_WAIT
    ) -> StoreWriter:
        """Lock a store for writing; create an empty one if there is none.

        Parameters
        ----------
        path : str or Path
            The store's directory.
        feature_set : FeatureSet
            The feature set of its words, which must be that of an existing store.
        rate_hz : float, optional
            Analysis frames per second, which must be those of an existing store.
        wait : Wait, optional
            The time to wait for another writer to finish.

        Raises
        ------
        StoreError
            Another writer holds the lock (the message names its process and host); the directory contains anything but
            a store; or the store has an older format (`kinedex upgrade`), another feature set or another rate.
        """
        root = Path(path)
        refuse_foreign(root)
        with write_errors(root):
            root.mkdir(parents=True, exist_ok=True)
        since = last_opened(root / "lock")
        lock = Lock(root / "lock", "this one", wait)
        try:
            manifest = read_newest(root) if versions(root) else None
            if manifest is not None:
                require_current_format(root, manifest)
            with write_errors(root):
                for folder in FOLDERS:
                    (root / folder).mkdir(exist_ok=True)
            if manifest is None:
                publish(root, _first_version(feature_set, rate_hz))
                manifest = read_newest(root)
            refuse_other_words(root, manifest, feature_set, rate_hz)
            remove_leftovers(root, manifest, since)
            return cls(root, manifest, lock)
        except BaseException:
            lock.release()
            raise

    def commit(self) -> Manifest:
        """Publish all changes since the last commit as one new version; without changes, do nothing.

        Rows in the journal of labels are published as well.

        Returns
        -------
        Manifest
            The newest version.

        Raises
        ------
        StoreError
            The next version exists already, because another writer has bypassed the lock; nothing is published.
        """
        journals = self._add_journal()
        pending = self._manifest
        if self._takes:
            # a column may have been declared after a row was added
            schema = pending.takes_schema
            ordered = (self._takes[take] for take in sorted(self._takes))
            rows = pa.concat_tables(row if row.schema == schema else with_columns(row, schema) for row in ordered)
            part = write_part(self.path, "takes", rows, sorted(self._takes))
            others = tuple(other for other in pending.takes if other.path != part.path)
            pending = replace(pending, takes=(*others, part))
            if self._changes:
                self._changes.append(["rows", part.sha256])
        facts, self._facts = self._facts, Facts()
        if pending == self._committed:
            self._changes = []
            self._empty(journals)
            return self._committed
        if self._changes:
            pending = replace(pending, content=changed_content(pending.content, self._changes))
        version = self._committed.version + 1
        pending = replace(
            pending,
            version=version,
            created=now(),
            next_take_id=self._next,
            kinedex=kinedex_version(),
            command=running_command(),
            changes=facts.encoded,
        )
        publish(self.path, pending)
        self._committed = self._manifest = pending
        self._takes = {}
        self._changes = []
        self._empty(journals)
        return pending

    def close(self) -> None:
        """Release the lock and discard uncommitted changes.

        If a version was committed, the database file for other clients is rewritten, provided that it exists.
        """
        try:
            if self._committed.version != self._opened and (self.path / DATABASE).is_file():
                from kinedex.storage.store.database_file import refresh_database

                refresh_database(self.path)
        finally:
            self._lock.release()

    def __enter__(self) -> StoreWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _first_version(feature_set: FeatureSet, rate_hz: float) -> Manifest:
    """Return the initial version of a store, without takes."""
    return Manifest(
        FORMAT_VERSION,
        1,
        now(),
        feature_set,
        float(rate_hz),
        1,
        kinedex=kinedex_version(),
        command=running_command(),
    )
