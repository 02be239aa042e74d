"""Digests of the files and takes that stages read, for their fingerprints."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinedex.ops.errors import KinedexError


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


def hash_of(*parts: object) -> str:
    """Return a hexadecimal hash of values: of the bytes of arrays, and of the `repr` of other values."""
    hasher = hashlib.sha256()
    for part in parts:
        content = np.ascontiguousarray(part).tobytes() if isinstance(part, np.ndarray) else repr(part).encode()
        hasher.update(len(content).to_bytes(8, "little") + content)
    return hasher.hexdigest()[:32]
