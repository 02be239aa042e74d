"""Keep the journal of labels: decisions of users that are on disk before a writer of the store publishes them.

`labels/journal/` has a few text files; each line holds the rows of one decision and their checksum. A process locks a
file while it appends a line; if another process has locked the file, the next file is used, so that nobody waits. A
commit publishes the rows of all lines and then empties the files, except those that have grown in the meantime. Files
are never removed, so that no line can be written to a removed file.
"""

from __future__ import annotations

import json
import os
import time
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import pyarrow as pa
import xxhash

from kinedex.ops.errors import StoreError
from kinedex.storage.durable_files import sync_folder, write_errors
from kinedex.storage.remedies import repair
from kinedex.storage.snapshot.schemas import labels_schema

FOLDER = "labels/journal"
_ENDING = ".jsonl"

_HEADER = b"\n"
"""The first byte of a file, which other processes cannot read on Windows while the file is locked."""

_ROWS = 5_000
"""The largest number of rows in a line, which bounds the memory for checking the line."""

_PREFIX, _BETWEEN = b'{"xxh3":"', b'","rows":'
_SUM = 32

_NOT_THERE_SECONDS = 0.005


@dataclass(frozen=True)
class Journal:
    """The content of one file of the journal.

    Attributes
    ----------
    path : Path
        The file.
    size : int
        Its size in bytes.
    rows : list of dict
        The rows of its undamaged lines, each a mapping from column to value.
    damaged : tuple of int
        Numbers of the lines that do not match their checksum. An incomplete last line is not counted, because the
        process that wrote it ended before it reported the decision as stored.
    """

    path: Path
    size: int
    rows: list[dict[str, Any]]
    damaged: tuple[int, ...]


def append_rows(store: Path, rows: pa.Table) -> None:
    """Append the rows of a decision to the journal of a store; they are on disk when the function returns.

    Parameters
    ----------
    store : Path
        The store's directory.
    rows : pyarrow.Table
        Checked rows of `labels_schema`.

    Raises
    ------
    StoreError
        The disk is full or cannot be written; the journal is unchanged.
    """
    if not rows.num_rows:
        return
    found = rows.to_pylist()
    lines = b"".join(_line(found[first : first + _ROWS]) for first in range(0, len(found), _ROWS))
    folder = store / FOLDER
    with write_errors(folder):
        if not folder.is_dir():
            folder.mkdir(parents=True, exist_ok=True)
            sync_folder(folder.parent)
            sync_folder(store)
        for path in (*_files(store), folder / f"{uuid.uuid4().hex}{_ENDING}"):
            with _locked(path) as descriptor:
                if descriptor is not None:
                    _append(descriptor, lines)
                    sync_folder(folder)
                    return


def read_journals(store: Path) -> list[Journal]:
    """Read the journal of a store: the rows of all undamaged lines, and the numbers of damaged ones."""
    return [_read(path) for path in _files(store)]


def journal_rows(journals: Iterable[Journal], known: Iterable[str] = ()) -> pa.Table:
    """Return the rows of journals without duplicates, sorted by the time of their decisions.

    Parameters
    ----------
    journals : iterable of Journal
        The files.
    known : iterable of str
        Ids of rows to exclude because the store's parts have them.
    """
    seen = set(known)
    rows: list[dict[str, Any]] = []
    for row in sorted((row for one in journals for row in one.rows), key=lambda row: row["created"]):
        if row["id"] not in seen:
            seen.add(row["id"])
            rows.append(row)
    return pa.Table.from_pylist(rows, schema=labels_schema())


def require_sound(journals: Iterable[Journal], store: Path) -> None:
    """Raise a StoreError if a line of the journal is damaged."""
    for one in journals:
        if one.damaged:
            raise StoreError(
                f"{one.path}: line {one.damaged[0]} of the journal of labels is damaged", remedy=repair(store)
            )


def empty(journal: Journal) -> None:
    """Empty a file whose rows were published, unless it has grown since it was read, or is being written."""
    if journal.size <= len(_HEADER):
        return
    with _locked(journal.path) as descriptor:
        if descriptor is not None and os.fstat(descriptor).st_size == journal.size:
            os.ftruncate(descriptor, len(_HEADER))
            os.fsync(descriptor)


def _files(store: Path) -> list[Path]:
    folder = store / FOLDER
    return sorted(folder.glob(f"*{_ENDING}")) if folder.is_dir() else []


@contextmanager
def _locked(path: Path) -> Iterator[int | None]:
    """Open and lock a file, which is created if missing; yield None if another process has locked it."""
    from filelock import lock_descriptor, unlock_descriptor  # imported here, since readers do not lock

    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o666)
    try:
        try:
            free = lock_descriptor(descriptor, blocking=False)
        except OSError as fault:
            raise StoreError(f"{path}: this file system does not lock files ({fault.strerror})") from None
        try:
            yield descriptor if free else None
        finally:
            if free:
                unlock_descriptor(descriptor)
    finally:
        os.close(descriptor)


def _append(descriptor: int, lines: bytes) -> None:
    """Write lines after the last complete line and flush them; on failure restore the file."""
    content = _content(descriptor)
    end = content.rfind(b"\n") + 1
    rest = content[end:]
    if rest and _rows_of(rest) is not None:  # complete but for its line end
        lines, end = b"\n" + lines, len(content)
    lines = lines if content else _HEADER + lines
    try:
        if end < len(content):
            os.ftruncate(descriptor, end)
        os.lseek(descriptor, end, os.SEEK_SET)
        left = memoryview(lines)
        while left:
            left = left[os.write(descriptor, left) :]
        os.fsync(descriptor)
    except OSError:
        os.ftruncate(descriptor, end)
        raise


def _content(descriptor: int) -> bytes:
    os.lseek(descriptor, 0, os.SEEK_SET)
    blocks = []
    while block := os.read(descriptor, 1 << 20):
        blocks.append(block)
    return b"".join(blocks)


def _read(path: Path) -> Journal:
    content = _bytes_of(path)
    *lines, rest = content.split(b"\n")
    rows: list[dict[str, Any]] = []
    damaged = []
    for number, line in enumerate(lines, 1):
        if line:
            found = _rows_of(line)
            rows += found or ()
            if found is None:
                damaged.append(number)
    rows += _rows_of(rest) or ()
    return Journal(path, len(content), rows, tuple(damaged))


def _bytes_of(path: Path) -> bytes:
    """Return the content of a file, with its header byte replaced by a constant."""
    deadline = time.monotonic() + 5.0
    while True:
        try:
            with open(path, "rb", buffering=0) as file:
                file.seek(len(_HEADER))
                found = file.read()
            return _HEADER + found if found or path.stat().st_size else b""
        except PermissionError as fault:  # on Windows, while another process writes the file
            if os.name != "nt" or time.monotonic() > deadline:
                raise StoreError(f"{path}: cannot be read: {fault.strerror}") from fault
            time.sleep(_NOT_THERE_SECONDS)
        except OSError as fault:
            raise StoreError(f"{path}: cannot be read: {fault.strerror}") from fault


def _line(rows: list[dict[str, Any]]) -> bytes:
    text = json.dumps([{**row, "created": row["created"].isoformat()} for row in rows], separators=(",", ":")).encode()
    return _PREFIX + xxhash.xxh3_128_hexdigest(text).encode() + _BETWEEN + text + b"}\n"


def _rows_of(line: bytes) -> list[dict[str, Any]] | None:
    """Return the rows of a line; None if its content does not match its checksum."""
    first = len(_PREFIX) + _SUM + len(_BETWEEN)
    text = line[first:-1]
    if line != _PREFIX + xxhash.xxh3_128_hexdigest(text).encode() + _BETWEEN + text + b"}":
        return None
    rows: list[dict[str, Any]] = json.loads(text)
    for row in rows:
        row["created"] = datetime.fromisoformat(row["created"])
    return rows
