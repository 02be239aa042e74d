"""The open store of the explorer: the newest version that can be read, for every request."""

from __future__ import annotations

import threading
import time
from pathlib import Path

from kinedex.explorer.events import Events
from kinedex.ops.errors import KinedexError, StoreError
from kinedex.storage.snapshot.label_journal import FOLDER as JOURNAL
from kinedex.storage.snapshot.manifest_files import versions
from kinedex.storage.store.store import Store, open_store

LOOK_SECONDS = 1.0
"""The shortest time between two checks for a newer version."""


class ReadOnlyError(KinedexError):
    """The explorer was started with `--read-only` and is asked to write."""


class Archive:
    """A store that stays open while others write to it.

    Attributes
    ----------
    path : Path
        The directory of the store.
    read_only : bool
        True if nothing may be written.
    events : Events
        Messages to the pages that are open.
    kernels : Lock
        To be held while numba kernels run on several threads: two such calls at once can end the process.

    Parameters
    ----------
    path : Path
        The directory of the store.
    read_only : bool, optional
        Refuse everything that writes.

    Raises
    ------
    StoreError
        There is no store, it is damaged, or it has another format.
    """

    def __init__(self, path: Path, *, read_only: bool = False) -> None:
        self.path = path
        self.read_only = read_only
        self.events = Events()
        self.kernels = threading.Lock()
        self._looking = threading.Lock()
        self._store = open_store(path)
        self._fault: KinedexError | OSError | None = None
        self._looked = time.monotonic()
        self._newest = self._newest_files()
        self._journal = self._journal_files()

    def store(self) -> Store:
        """Return the store, opened at its newest version that has an index.

        The store stays valid while the caller holds it, because its version is leased. While one thread opens a newer
        version, other threads get the former one, or the error of the last attempt.

        Raises
        ------
        StoreError
            A newer version is damaged or cannot be read, or the folder no longer exists.
        """
        if time.monotonic() - self._looked >= LOOK_SECONDS and self._looking.acquire(blocking=False):
            try:
                self._look()
                self._looked, self._fault = time.monotonic(), None
            except (KinedexError, OSError) as fault:
                self._fault = fault
            finally:
                self._looking.release()
        if self._fault is not None:
            raise self._fault.with_traceback(None)
        return self._store

    def state(self, *, look: bool = False) -> dict[str, object]:
        """Return the version that is shown, and a text that changes whenever the version or the labels change.

        Parameters
        ----------
        look : bool, optional
            Check for a newer version now, even if the last check was a moment ago.
        """
        if look:
            with self._looking:
                self._look()
        version = self.store().manifest.version
        return {"version": version, "labels": f"{hash((version, self._journal)):x}"}

    def labels_changed(self) -> None:
        """Drop the cached labels, and tell all pages that labels have changed."""
        self._journal = self._journal_files()
        self._store.forget_labels()
        self.events.publish("labels", {})

    def _look(self) -> None:
        """Open the store again if a newer version can be read, and forget labels that have changed."""
        newest = self._newest_files()
        if newest != self._newest:
            opened = open_store(self.path)
            self._newest = newest
            if opened.manifest.version != self._store.manifest.version:
                self._store = opened
                self.events.publish("version", {"version": opened.manifest.version})
        journal = self._journal_files()
        if journal != self._journal:
            self._journal = journal
            self._store.forget_labels()
            self.events.publish("labels", {})

    def _newest_files(self) -> tuple[int, str]:
        """Return the newest version and the name of the newest index; the store must be reopened if either has changed.

        Raises
        ------
        StoreError
            The folder no longer exists, or is no longer a store.
        """
        index = self.path / "index"
        names = [entry.name for entry in index.iterdir()] if index.is_dir() else []
        found = versions(self.path)
        if not found:
            gone = "has no manifest any more" if self.path.exists() else "does not exist any more"
            raise StoreError(f"the store {self.path} {gone}; put it back there, or stop this explorer and open another")
        return found[-1], max((name for name in names if name.startswith("gen-")), default="")

    def _journal_files(self) -> tuple[tuple[str, int, int], ...]:
        """Return name, size and time of the files of the labels' journal."""
        folder = self.path / JOURNAL
        if not folder.is_dir():
            return ()
        found = ((entry.name, entry.stat()) for entry in sorted(folder.iterdir()))
        return tuple((name, facts.st_size, facts.st_mtime_ns) for name, facts in found)
