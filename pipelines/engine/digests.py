"""Digests of what stages read, for their fingerprints: files outside the store, and some of its takes."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.console.wording import counted
from kinedex.storage.store.store import Store


@dataclass(frozen=True)
class Reading:
    """What a stage reads of a store's takes: a hash of it, and what it is, in words."""

    digest: str
    what: str


def files_digest(files: Iterable[Path]) -> str:
    """A hash of what stands in these files, in their order; a KinedexError names one that cannot be read."""
    hasher = hashlib.sha256()
    for file in files:
        try:
            content = file.read_bytes()
        except OSError as fault:
            raise KinedexError(f"{file}: cannot be read: {fault.strerror}") from None
        hasher.update(len(content).to_bytes(8, "little") + content)
    return hasher.hexdigest()[:16]


def takes_read(store: Store, filters: Mapping[str, str]) -> Reading:
    """The takes that filters select: their names, classes and words; and what the bits of words mean.

    Where a take has come from does not count, nor do all other takes. Words are read, which for an hour of motion takes
    milliseconds: they are what is learned from, whatever made them.

    Parameters
    ----------
    filters: what the takes are to the stage, in the singular → a SQL filter over the columns of takes.

    Raises
    ------
    KinedexError: a filter does not work, or the takes cannot be read.
    """
    hasher = hashlib.sha256(f"{store.feature_set.digest} {store.rate_hz!r}".encode())
    said = []
    for role, where in filters.items():
        takes = store.takes(where).sort("take_id")
        words = store.words(takes["take_id"].to_list())
        hasher.update(repr((role, takes.height)).encode())
        for index, label in enumerate(takes.select("name", "class").iter_rows()):
            own = np.ascontiguousarray(words.take(index))
            hasher.update(repr((label, len(own))).encode() + own.tobytes())
        said.append(counted(takes.height, role))
    return Reading(hasher.hexdigest()[:16], ", ".join(said))
