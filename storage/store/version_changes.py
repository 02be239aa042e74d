"""The changes of each version of a store: small facts that its manifest keeps, and the list of all versions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinedex.ops.errors import KinedexError
from kinedex.storage.index.generations import current_generation
from kinedex.storage.snapshot.manifest import read_version, versions

COUNTS = (
    "takes_added",
    "takes_replaced",
    "takes_dropped",
    "takes_restated",
    "labels",
    "parts_compacted",
)
"""The facts that are numbers; "takes_restated" are those whose file has another place or time."""

NAMES = ("stages_begun", "stages_done", "results", "columns")
"""The facts that are lists: stages whose record was removed or written, kinds of results, declared columns."""


class Facts:
    """The changes that a writer has made since its last commit."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._names: dict[str, list[str]] = {}

    def count(self, fact: str, number: int) -> None:
        """Add to a fact of `COUNTS`."""
        self._counts[fact] += number

    def name(self, fact: str, name: str) -> None:
        """Add a name to a fact of `NAMES`, unless it is there."""
        names = self._names.setdefault(fact, [])
        if name not in names:
            names.append(name)

    @property
    def encoded(self) -> dict[str, Any]:
        """The facts as the manifest keeps them (`Manifest.changes`); only those that are not zero or empty."""
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
        Version of the kinedex that made it; empty if it is not known.
    command : str
        The command that made it; empty if it is not known.
    changes : dict of str to object
        Its differences from the version before (`COUNTS`, `NAMES`).
    takes : int
        Number of its takes.
    index : bool
        True if there is an index of its takes.
    problem : str
        The reason for which it cannot be read; empty for a sound one.
    """

    version: int
    created: str = ""
    format: int = 0
    kinedex: str = ""
    command: str = ""
    changes: Mapping[str, Any] | None = None
    takes: int = 0
    index: bool = False
    problem: str = ""


def list_versions(store: Path) -> list[Version]:
    """Return all versions of a store, oldest first; of one that cannot be read only its number and the reason."""
    found = []
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
                current_generation(store, manifest) is not None,
            )
        )
    return found
