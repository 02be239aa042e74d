"""Make temporary folders; if a process is killed, the next process removes its folders."""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from filelock import lock_descriptor

PREFIX = "kinedex-unpacked-"
"""The beginning of the names of the folders, and of the locks beside them, in the folder of the system."""

_LOCK = ".lock"


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yield an empty folder of the user, which is removed at the end of the `with` block.

    A locked file beside it shows that its process still runs, however that ends. The first folder that a process makes
    removes those of processes that were killed.
    """
    place = Path(tempfile.gettempdir())
    _remove_abandoned(place)
    descriptor, lock = _new_lock(place)
    folder = lock.with_suffix("")
    try:
        folder.mkdir(0o700)
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _remove_lock(descriptor, lock)


def _new_lock(place: Path) -> tuple[int, Path]:
    """Return the descriptor and path of a new file that this process has locked."""
    while True:
        descriptor, name = tempfile.mkstemp(_LOCK, PREFIX, place)
        with suppress(OSError):  # a file system without locks
            if not lock_descriptor(descriptor, blocking=False):
                os.close(descriptor)  # another process takes it for abandoned, and removes it
                continue
        if os.path.exists(name):
            return descriptor, Path(name)
        os.close(descriptor)


def _remove_lock(descriptor: int, lock: Path) -> None:
    if os.name == "nt":  # which does not remove an open file
        os.close(descriptor)
        lock.unlink(missing_ok=True)
    else:
        lock.unlink(missing_ok=True)
        os.close(descriptor)


@cache
def _remove_abandoned(place: Path) -> None:
    """Remove the folders whose process has ended without removing them."""
    for lock in place.glob(f"{PREFIX}*{_LOCK}"):
        with suppress(OSError):  # of another user, removed meanwhile, or on a file system without locks
            descriptor = os.open(lock, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))
            try:
                found = os.fstat(descriptor)
                own = stat.S_ISREG(found.st_mode) and (os.name == "nt" or found.st_uid == os.getuid())
                free = own and lock_descriptor(descriptor, blocking=False)
            except OSError:
                free = False
            if free:
                shutil.rmtree(lock.with_suffix(""), ignore_errors=True)
                _remove_lock(descriptor, lock)
            else:
                os.close(descriptor)
