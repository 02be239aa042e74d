"""Digests of the files and takes that stages read, for their fingerprints."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted
from kinedex.storage.store.store import Store


@dataclass(frozen=True)
class Reading:
    """The takes that a stage reads: a hash of them, and a description such as "9 clips"."""

    digest: str
    what: str


def files_digest(files: Iterable[Path]) -> str:
    """Return a hash of the contents of files, in their order; raise a KinedexError for a file that cannot be read."""
    hasher = hashlib.sha256()
    for file in files:
        try:
            content = file.read_bytes()
        except OSError as fault:
            raise KinedexError(f"{file}: cannot be read: {fault.strerror}") from None
        hasher.update(len(content).to_bytes(8, "little") + content)
    return hasher.hexdigest()[:16]


def takes_read(store: Store, filters: Mapping[str, str]) -> Reading:
    """Return a digest of the takes that filters select: of their names, classes and words, and of the features.

    The source files of the takes do not count, nor do other takes. The words are read, which takes milliseconds for an
    hour of motion.

    Parameters
    ----------
    store : Store
        The store.
    filters : mapping of str to str
        The noun for the takes of each filter, such as "clip", and the SQL filter over the columns of takes.

    Raises
    ------
    KinedexError
        A filter does not work, or the takes cannot be read.
    """
    hasher = hashlib.sha256(f"{store.feature_set.digest} {store.rate_hz!r}".encode())
    described = []
    for role, where in filters.items():
        takes = store.takes(where).sort("take_id")
        words = store.words(takes["take_id"].to_list())
        hasher.update(repr((role, takes.height)).encode())
        for index, label in enumerate(takes.select("name", "class").iter_rows()):
            own = np.ascontiguousarray(words.take(index))
            hasher.update(repr((label, len(own))).encode() + own.tobytes())
        described.append(counted(takes.height, role))
    return Reading(hasher.hexdigest()[:16], ", ".join(described))


def hash_of(*parts: object) -> str:
    """Return a hexadecimal hash of values: of the bytes of arrays, and of the `repr` of other values."""
    hasher = hashlib.sha256()
    for part in parts:
        content = np.ascontiguousarray(part).tobytes() if isinstance(part, np.ndarray) else repr(part).encode()
        hasher.update(len(content).to_bytes(8, "little") + content)
    return hasher.hexdigest()[:32]
