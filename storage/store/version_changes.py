"""Record the changes of each version in its manifest, list all versions, and define the draft of the next version."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa

from kinedex.ops.errors import KinedexError
from kinedex.storage.index.generations import INDEX_VERSION, generations, read_generation, wrong_sizes
from kinedex.storage.snapshot.checked_files import CheckedFiles
from kinedex.storage.snapshot.manifest import Manifest
from kinedex.storage.snapshot.manifest_files import read_newest, read_version, versions
from kinedex.storage.snapshot.schemas import TakeColumn
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.store.store import Store

COUNTS = (
    "takes_added",
    "takes_replaced",
    "takes_dropped",
    "takes_restated",
    "labels",
    "parts_compacted",
)
"""The facts that are numbers; "takes_restated" counts takes whose row changed but whose frames did not."""

NAMES = ("stages_begun", "stages_done", "results", "columns", "mappings", "current_pipeline")
"""The facts that are lists of names: stages whose record was removed or written, kinds of results, declared columns,
skeleton mappings, and the pipeline that became the current one.
"""


class Facts:
    """The changes that a writer has made since its last commit."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._names: dict[str, list[str]] = {}

    def count(self, fact: str, number: int) -> None:
        """Add `number` to the count `fact`, one of `COUNTS`."""
        self._counts[fact] += number

    def name(self, fact: str, name: str) -> None:
        """Append `name` to the list `fact`, one of `NAMES`, unless it is there already."""
        names = self._names.setdefault(fact, [])
        if name not in names:
            names.append(name)

    @property
    def encoded(self) -> dict[str, Any]:
        """The facts in the form of `Manifest.changes`, without those that are zero or empty."""
        counts = {fact: self._counts[fact] for fact in COUNTS if self._counts[fact]}
        return counts | {fact: self._names[fact] for fact in NAMES if self._names.get(fact)}


@dataclass(frozen=True)
class Version:
    """A version of a store, as `kinedex versions` lists it.

    Attributes
    ----------
    version : int
        Its number.
    created : str
        Time of the commit, ISO 8601 in UTC.
    format : int
        Version of the store's layout.
    kinedex : str
        Version of the kinedex that made it; empty if unknown.
    command : str
        The command that made it; empty if unknown.
    changes : dict of str to object
        Its differences from the version before (`COUNTS`, `NAMES`).
    takes : int
        Number of its takes.
    index : bool
        True if there is an index of its takes.
    problem : str
        The reason why it cannot be read; empty if it can.
    """

    version: int
    created: str = ""
    format: int = 0
    kinedex: str = ""
    command: str = ""
    changes: dict[str, Any] = field(default_factory=dict)
    takes: int = 0
    index: bool = False
    problem: str = ""


def list_versions(store: Path) -> list[Version]:
    """Return all versions of a store, oldest first; an unreadable one has only its number and the reason.

    Raises
    ------
    StoreError
        There is no store.
    """
    found = []
    if not versions(store):
        read_newest(store)
    indexed = _indexed_contents(store)
    for number in versions(store):
        try:
            manifest = read_version(store, number)
        except KinedexError as fault:
            found.append(Version(number, problem=str(fault)))
            continue
        found.append(
            Version(
                number,
                manifest.created,
                manifest.format_version,
                manifest.kinedex,
                manifest.command,
                manifest.changes,
                len(manifest.live_takes),
                manifest.content_digest() in indexed,
            )
        )
    return found


def _indexed_contents(store: Path) -> set[str]:
    """Return the `Manifest.content_digest` values for which an index exists."""
    records = ((generation, read_generation(generation)) for generation in generations(store))
    return {
        record.content
        for generation, record in records
        if record is not None and record.index_version == INDEX_VERSION and not any(wrong_sizes(generation, record))
    }


def versions_table(found: Iterable[Version]) -> pa.Table:
    """Return versions as a table to show to users, the newest last."""
    rows = [
        {
            "version": one.version,
            "time": one.created,
            "takes": None if one.problem else one.takes,
            "index": None if one.problem else "yes" if one.index else "no",
            "changes": one.problem or described(one.changes) or None,
            "command": one.command or None,
        }
        for one in found
    ]
    kinds = (pa.int64(), pa.string(), pa.int64(), pa.string(), pa.string(), pa.string())
    names = ("version", "time", "takes", "index", "changes", "command")
    return pa.Table.from_pylist(rows, schema=pa.schema(list(zip(names, kinds, strict=True))))


def described(changes: Mapping[str, Any]) -> str:
    """Describe the changes of a version in words, such as "3 takes added, annotate/ingest done"."""
    return ", ".join(_phrase(fact, value) for fact, value in changes.items())


def _phrase(fact: str, value: Any) -> str:
    if fact in COUNTS:
        noun, _, verb = fact.partition("_")
        noun = noun.removesuffix("s") if value == 1 else noun
        return f"{value:,} {noun} {verb}".rstrip()
    names = ", ".join(value) if isinstance(value, list) else str(value)
    return {
        "stages_begun": f"{names} begun",
        "stages_done": f"{names} done",
        "results": f"results: {names}",
        "columns": f"columns: {names}",
        "mappings": f"mappings: {names}",
        "upgraded_from": f"upgraded from format {names}",
    }.get(fact, f"{fact.replace('_', ' ')}: {names}")


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
