"""Hold the draft of a store's next version, the state shared by changes of takes, results, labels and records."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from kinedex.storage.snapshot.checked_files import CheckedFiles
from kinedex.storage.snapshot.manifest import Manifest
from kinedex.storage.snapshot.schemas import TakeColumn
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.store.store import Store
from kinedex.storage.store.version_changes import Facts


class VersionDraft:
    """The next version to commit: the last manifest with the changes made since."""

    def __init__(self, path: Path, manifest: Manifest) -> None:
        self.path = path
        self._committed = manifest
        self._manifest = manifest
        self._takes: dict[int, pa.Table] = {}
        self._changes: list[Any] = []
        self._facts = Facts()
        self._checked = CheckedFiles(path)
        takes = Snapshot(path, manifest, self._checked)
        self._ids = dict(takes.take_ids)
        self._rows = dict(takes.take_frames)
        self._live = set(self._rows)
        self._next = manifest.next_take_id

    @property
    def manifest(self) -> Manifest:
        """The manifest of the last committed version."""
        return self._committed

    @property
    def takes_schema(self) -> pa.Schema:
        """The columns of takes, including columns declared since the last commit."""
        return self._manifest.takes_schema

    @property
    def columns(self) -> Mapping[str, TakeColumn]:
        """The declared columns of takes, including those declared since the last commit."""
        return self._manifest.columns

    @property
    def store(self) -> Store:
        """The store at its last committed version."""
        return Store(self.path, self._committed, checked=self._checked)
