"""Lease versions to readers: files that a manifest names are not removed while a reader has the manifest locked.

A reader opens the manifest of its version read-only and holds a shared lock on it. A lease therefore writes nothing,
and ends with the process, however the process ends. A process that was forked from a reader shares the reader's lease
until both have closed the store or ended. Windows needs no lock, because it does not remove open files. On a file
system without locks, or with locks that other machines do not see, a lease gives no protection.
"""

from __future__ import annotations

import os
import sys
import time
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from kinedex.ops.errors import StoreError
from kinedex.storage.snapshot.manifest_files import manifest_path, versions

if sys.platform != "win32":
    import fcntl

_SECONDS = 10.0
"""The longest time in seconds that a process about to remove a version keeps it locked."""

_POLL_SECONDS = 0.005


class Lease:
    """A lease of one version until `release`, the end of the object or the end of the process.

    Parameters
    ----------
    descriptor : int
        File descriptor of the open manifest, which the lease closes at its end.
    """

    def __init__(self, descriptor: int) -> None:
        # the lock ends with the last copy of the descriptor; unlocking would also end the lease of a forked process
        self.release = weakref.finalize(self, os.close, descriptor)


def take_lease(store: Path, version: int) -> Lease | None:
    """Take a lease of a version of a store; return None if the version does not exist.

    Raises
    ------
    StoreError
        The manifest cannot be opened, or another process keeps it locked.
    """
    path = manifest_path(store, version)
    deadline = time.monotonic() + _SECONDS
    while True:
        try:
            descriptor = os.open(path, os.O_RDONLY)
        except FileNotFoundError:
            return None
        except OSError as fault:
            raise StoreError(f"{path}: cannot be read: {fault.strerror}") from fault
        lease = Lease(descriptor)
        if _share(descriptor) and _is_open(descriptor, path):
            return lease
        lease.release()
        if time.monotonic() > deadline:
            raise StoreError(f"{path}: another process has kept this file locked for {_SECONDS:.0f} s; stop it")
        time.sleep(_POLL_SECONDS)


def _share(descriptor: int) -> bool:
    """Take a shared lock if the file system has locks; return False if a process is about to remove the file."""
    if sys.platform != "win32":
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:
            pass  # no locks on this file system
    return True


def _is_open(descriptor: int, path: Path) -> bool:
    """Return whether a path still refers to the file that was opened."""
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(path))
    except FileNotFoundError:
        return False


@contextmanager
def without_readers(store: Path, version: int) -> Iterator[bool]:
    """Keep readers from opening a version in the `with` block; yield False if a reader has it open."""
    path = manifest_path(store, version)
    if sys.platform == "win32":
        try:
            os.rename(path, path)  # refused while the file is open
        except PermissionError:
            yield False
        else:
            yield True
        return
    from filelock import lock_descriptor  # imported here, since readers take no exclusive lock

    descriptor = _open_to_lock(path)
    if descriptor is None:
        yield True
        return
    try:
        try:
            free = lock_descriptor(descriptor, blocking=False)
        except OSError:
            free = True  # no locks on this file system
        yield free
    finally:
        os.close(descriptor)


def _open_to_lock(path: Path) -> int | None:
    """Open a manifest for an exclusive lock; return None if it does not exist."""
    for mode in (os.O_RDWR, os.O_RDONLY):  # NFS refuses an exclusive lock on a file that is open only for reading
        try:
            return os.open(path, mode)
        except FileNotFoundError:
            return None
        except OSError as fault:
            reason = fault
    raise StoreError(f"{path}: cannot be opened: {reason.strerror}") from reason


@dataclass(frozen=True)
class OpenVersion:
    """A version that readers have open.

    Attributes
    ----------
    version : int
        Number of the version.
    processes : int, optional
        Number of processes that have it open; None if the system does not report it.
    """

    version: int
    processes: int | None

    def __str__(self) -> str:
        """Return a clause for messages: the version and the number of processes that have it open."""
        if self.processes is None:
            return f"version {self.version} is open in a process"
        return f"version {self.version} is open in {self.processes} process{'' if self.processes == 1 else 'es'}"


def open_versions(store: Path, among: list[int] | None = None) -> list[OpenVersion]:
    """Return the versions of a store that readers have open, ascending; only those of `among` if given."""
    found = []
    for version in versions(store) if among is None else among:
        with without_readers(store, version) as free:
            if not free:
                found.append(OpenVersion(version, _processes(manifest_path(store, version))))
    return found


def _processes(path: Path) -> int | None:
    """Count the processes that hold a shared lock on a file; return None if there is none, or outside Linux."""
    try:
        number = str(path.stat().st_ino)
        with open("/proc/locks", encoding="ascii") as locks:
            lines = [line.split() for line in locks]
    except OSError:
        return None
    # 12: FLOCK ADVISORY READ 4711 fe:00:2646740 0 EOF
    holders = {
        line[4] for line in lines if line[1:4] == ["FLOCK", "ADVISORY", "READ"] and line[5].endswith(f":{number}")
    }
    return len(holders) or None
