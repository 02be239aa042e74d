"""Durable writes: flushed files and folders, and clear errors where the disk is full or refuses."""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from kinedex.ops.errors import StoreError

# Windows has no quota error of its own
_NO_SPACE = {errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC)}


@contextmanager
def write_errors(path: Path) -> Iterator[None]:
    """Turn an error of the operating system while a file of the store is written into a StoreError with the way out.

    Parameters
    ----------
    path : Path
        The file, or the folder that it is written into.
    """
    try:
        yield
    except OSError as fault:
        # pyarrow puts its own words around the reason, but keeps the number
        reason = os.strerror(fault.errno) if fault.errno else str(fault).splitlines()[0]
        way_out = (
            "free some space (`kinedex gc STORE` removes what only old versions of the store need)"
            if fault.errno in _NO_SPACE
            else "mend that"
        )
        raise StoreError(
            f"{path}: cannot be written: {reason}; nothing was committed, what was committed before stays; {way_out}, "
            "then run the same command again: it goes on where it was"
        ) from fault


def sync_file(path: Path) -> tuple[int, str]:
    """Flush a finished file to disk; return its size in bytes and its SHA-256."""
    # Windows flushes only files that are open for writing
    with open(path, "rb+") as file:
        os.fsync(file.fileno())
        return os.fstat(file.fileno()).st_size, hashlib.file_digest(file, "sha256").hexdigest()


def sync_folder(folder: Path) -> None:
    """Flush a folder's entries to disk, so that a rename in it outlives a power cut; Windows has no such call."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
