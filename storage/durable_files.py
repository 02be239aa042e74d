"""Write files durably: flush files and folders to disk, and report a full disk or a refused write clearly."""

from __future__ import annotations

import errno
import hashlib
import os
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import xxhash

from kinedex.ops.errors import StoreError

# Windows has no separate error for an exceeded quota
_NO_SPACE = {errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC)}

TEMPORARY = ".tmp-"
"""The prefix of the names of unfinished files; readers ignore them, writers and garbage collection remove them."""

_ATTEMPTS = 5

_BLOCK = 1 << 18
"""The number of bytes read at a time to compute checksums; they fit into the cache of a core."""


class WriteError(StoreError):
    """The disk is full or the operating system refuses to write; the same call can succeed later."""


@contextmanager
def write_errors(path: Path) -> Iterator[None]:
    """Turn an operating system's error on writing a file of the store into a WriteError that states a remedy.

    Parameters
    ----------
    path : Path
        The file, or the folder that it is written into.
    """
    try:
        yield
    except OSError as fault:
        # pyarrow wraps the reason in its own words, but keeps the error number
        reason = os.strerror(fault.errno) if fault.errno else str(fault).splitlines()[0]
        way_out = (
            "free some space (`kinedex gc STORE` removes what only old versions of the store need)"
            if fault.errno in _NO_SPACE
            else "mend that"
        )
        raise WriteError(
            f"{path}: cannot be written: {reason}; nothing was committed, what was committed before stays; {way_out}, "
            "then run the same command again: it goes on where it was"
        ) from fault


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Write a file atomically: either completely or not at all.

    Parameters
    ----------
    path : Path
        The file; an existing one is replaced.

    Yields
    ------
    Path
        A temporary path in the same folder to write to. It replaces the file when the block ends; if the block raises,
        the file stays as it was.
    """
    temporary = path.with_name(f"{TEMPORARY}{uuid.uuid4().hex}")
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def replace_file(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file of a store atomically, without holding the store's write lock.

    Garbage collection cannot tell a temporary file that is being written from one that a killed run left behind. If it
    removes the temporary file, `write` is called again.

    Parameters
    ----------
    path : Path
        The file; an existing one is replaced.
    write : callable
        Writes the content to a path.
    """
    for left in reversed(range(_ATTEMPTS)):
        try:
            with whole_file(path) as unfinished:
                write(unfinished)
            return
        except FileNotFoundError:
            if not left or not path.parent.is_dir():
                raise


def write_flushed(path: Path, content: str | bytes) -> None:
    """Write a new file and flush it to disk; text is encoded as UTF-8."""
    with open(path, "wb") as file:
        file.write(content.encode() if isinstance(content, str) else content)
        file.flush()
        os.fsync(file.fileno())


def names_in(folder: Path) -> list[str]:
    """Return the sorted names in a folder; empty if there is no such folder."""
    return sorted(os.listdir(folder)) if folder.is_dir() else []


class FileSums(NamedTuple):
    """The size of a file in bytes and its checksums: SHA-256, and XXH3 with 128 bits, which readers verify."""

    bytes: int
    sha256: str
    xxh3: str


def sync_file(path: Path) -> FileSums:
    """Flush a finished file to disk and return its size and checksums, from one pass over its content."""
    # Windows flushes only files that are open for writing
    with open(path, "rb+") as file:
        os.fsync(file.fileno())
        sha256, xxh3 = hashlib.sha256(), xxhash.xxh3_128()
        while block := file.read(_BLOCK):
            sha256.update(block)
            xxh3.update(block)
        return FileSums(os.fstat(file.fileno()).st_size, sha256.hexdigest(), xxh3.hexdigest())


def xxh3_of(path: Path) -> tuple[str, os.stat_result]:
    """Return the XXH3 of a file, and the status that it had when it was opened."""
    xxh3 = xxhash.xxh3_128()
    # read, not mapped into memory: a disk error in mapped memory would kill the process
    with open(path, "rb", buffering=0) as file:
        status = os.fstat(file.fileno())
        block = memoryview(bytearray(min(_BLOCK, max(1, status.st_size))))
        while count := file.readinto(block):
            xxh3.update(block[:count])
    return xxh3.hexdigest(), status


def sync_folder(folder: Path) -> None:
    """Flush a folder's entries to disk, so that a rename in it survives a power cut; a no-op on Windows."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
