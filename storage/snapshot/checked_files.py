"""Check the files of an open store: the checksum of each is computed once, before anything is read from it."""

from __future__ import annotations

import hashlib
import os
import uuid
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Lock

from kinedex.ops.errors import StoreError
from kinedex.storage.durable_files import xxh3_of
from kinedex.storage.remedies import repair
from kinedex.storage.snapshot.manifest import AnyPart
from kinedex.storage.snapshot.parts import part_file, read_errors

_THREADS = min(4, os.cpu_count() or 1)
"""The number of files checked at once: four cores read memory as fast as more."""

_Identity = tuple[int, int, int, int]
"""Device, inode, size and time of a file; they change whenever its content does, unless the disk is faulty."""


def _identity(status: os.stat_result) -> _Identity:
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


class CheckedFiles:
    """The files of one open store that were found to match their checksums; the class is thread-safe.

    A file is checked when it is first requested, and again if its inode, size or time has changed. A process that
    receives the object from another one keeps the sender's results and adds its own.

    Parameters
    ----------
    store : Path
        The store's directory.
    """

    def __init__(self, store: Path) -> None:
        self.store = store
        self._origin = uuid.uuid4().hex
        self._known: dict[str, _Identity] = {}
        self._busy: dict[str, Lock] = {}

    def part(self, part: AnyPart) -> Path:
        """Return the file of a part after checking it against its checksum.

        Raises
        ------
        StoreError
            The file is missing, cannot be read, or has another checksum than the manifest records.
        """
        file = part_file(self.store, part.path)
        # parts of format 3 have no XXH3
        recorded, compute = (part.xxh3, xxh3_of) if part.xxh3 else (part.sha256, _sha256_of)
        with read_errors(file):
            if not self.is_sound(file, recorded, compute):
                raise StoreError(
                    f"{file}: the part is damaged: its content does not fit its checksum", remedy=repair(self.store)
                )
        return file

    def parts(self, parts: Iterable[AnyPart]) -> list[Path]:
        """Return the files of parts as `part` does, checking several at once."""
        asked = list(parts)
        if len(asked) < 2 or all(str(self.store / part.path) in self._known for part in asked):
            return [self.part(part) for part in asked]
        pool = ThreadPoolExecutor(_THREADS)
        try:
            return list(pool.map(self.part, asked))
        finally:
            pool.shutdown(cancel_futures=True)

    def is_sound(
        self, file: Path, recorded: str, compute: Callable[[Path], tuple[str, os.stat_result]] = xxh3_of
    ) -> bool:
        """Return whether a file has a given checksum; the result is cached while the file is unchanged.

        Parameters
        ----------
        file : Path
            A file of the store.
        recorded : str
            The expected checksum.
        compute : callable, optional
            Returns the checksum of a file, and its status when it was opened.

        Raises
        ------
        OSError
            The file cannot be read.
        """
        name = str(file)
        if self._known.get(name) == _identity(os.stat(file)):
            return True
        # if several threads need a file, one computes and the others wait
        with self._busy.setdefault(name, Lock()):
            if self._known.get(name) == _identity(os.stat(file)):
                return True
            found, status = compute(file)
            if found == recorded:
                self._known[name] = _identity(status)
            return found == recorded

    def __reduce__(self) -> tuple[Callable[..., CheckedFiles], tuple[object, ...]]:
        return _received, (self._origin, self.store, dict(self._known))


_copies: dict[str, CheckedFiles] = {}
"""A dict with the object that this process received last, so that the tasks of one run share its results."""


def _received(origin: str, store: Path, known: dict[str, _Identity]) -> CheckedFiles:
    """Return this process's copy of a `CheckedFiles` from another process, with the sender's results added."""
    copy = _copies.get(origin)
    if copy is None:
        copy = CheckedFiles(store)
        copy._origin = origin
        _copies.clear()
        _copies[origin] = copy
    copy._known.update(known)
    return copy


def _sha256_of(file: Path) -> tuple[str, os.stat_result]:
    with open(file, "rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest(), os.fstat(content.fileno())
