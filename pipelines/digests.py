"""Digests of files that stages read outside the store, for their fingerprints."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

from ops.errors import KinedexError


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
