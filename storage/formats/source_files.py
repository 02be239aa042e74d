"""Read source files as bytes or text, completely or in part; disk errors become a SourceError that names the file."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from kinedex.ops.errors import ConfigError, SourceError

MAX_BYTES = 64_000_000
"""The largest size in bytes of a file that must fit into memory, such as labels and tables of users."""
MAX_JSON_BYTES = 64 << 20
"""The largest size of a JSON file in bytes."""


@contextmanager
def source_errors(path: str | Path) -> Iterator[None]:
    """Turn an operating system's error on reading a file into a SourceError that names the file."""
    try:
        yield
    except OSError as fault:
        raise SourceError(path, f"cannot be read: {fault.strerror}") from fault


def file_size(path: Path) -> int:
    """Return the size of a file in bytes; raise SourceError if it cannot be read."""
    with source_errors(path):
        return path.stat().st_size


def stamp_of(path: Path) -> tuple[int, int]:
    """Return the size of a file and the time of its last change in nanoseconds; zeros if it cannot be read."""
    try:
        found = path.stat()
    except OSError:
        return 0, 0
    return found.st_size, found.st_mtime_ns


def source_bytes(path: str | Path, data: bytes | None = None) -> bytes:
    """Return the bytes of a source file.

    Parameters
    ----------
    path : str or Path
        The file.
    data : bytes, optional
        The bytes of the file, if they have been read already.

    Raises
    ------
    SourceError
        The file cannot be read, or is empty.
    """
    if data is None:
        with source_errors(path):
            data = Path(path).read_bytes()
    if not data or data.isspace():
        raise SourceError(path, "the file is empty")
    return data


def part_of(path: Path, size: int, start: int = 0) -> bytes:
    """Return at most `size` bytes of a file, from byte `start` on; raise SourceError if it cannot be read."""
    with source_errors(path), path.open("rb") as file:
        if start:
            file.seek(start)
        return file.read(size)


def read_bytes(path: str | Path, kind: str, way_out: str) -> bytes:
    """Return the bytes of a file that must fit into memory; a file that is too large is not read.

    Parameters
    ----------
    path : str or Path
        The file.
    kind : str
        The kind of file, in the plural, for messages.
    way_out : str
        The remedy for a file that is too large, for messages.

    Raises
    ------
    SourceError
        The file cannot be read, or is larger than `MAX_BYTES`.
    """
    with source_errors(path), Path(path).open("rb") as file:
        size = file.seek(0, io.SEEK_END) if file.seekable() else 0
        if size <= MAX_BYTES:
            if size:
                file.seek(0)
            data = file.read(MAX_BYTES + 1)
            size = len(data)
    if size > MAX_BYTES:
        got = f"has {size / 1e6:.1f} MB" if size != MAX_BYTES + 1 else "is larger"
        raise SourceError(path, f"{got}; {kind} have at most {MAX_BYTES / 1e6:g} MB: {way_out}")
    return data


def utf8_text(path: str | Path, data: bytes, error: type[SourceError | ConfigError] = SourceError) -> str:
    """Return UTF-8 text without a byte order mark; raise an error of the given class for another encoding."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as fault:
        raise error(path, f"is not UTF-8 text (byte {fault.start})") from None


def any_text(data: bytes, encoding: str = "utf-8") -> str:
    """Decode text in the given encoding or, if that fails, in Latin-1, which decodes every byte."""
    try:
        return data.decode(encoding)
    except UnicodeDecodeError:
        return data.decode("latin-1")


def text_of(data: bytes) -> str:
    """Decode bytes as UTF-8 or else as Latin-1; a character truncated at the end is dropped."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as fault:
        if fault.start >= len(data) - 4:
            return data[: fault.start].decode("utf-8-sig")
        return data.decode("latin-1")


def as_number(text: str | bytes) -> float | None:
    """Return the number that a text states in Python's notation; None if the text is not a number."""
    try:
        return float(text)
    except ValueError:
        return None


def first_bytes(path: Path, size: int) -> bytes:
    """Return the first bytes of a file, for recognition of its format; empty if it cannot be read."""
    try:
        return part_of(path, size)
    except SourceError:
        return b""


def beginning(path: Path, size: int = 4096) -> str:
    """Return the first bytes of a file as text, for recognition of its format; empty if it cannot be read."""
    return text_of(first_bytes(path, size))


def load_json(path: Path) -> Any:
    """Return the content of a JSON file; all numbers are floats, so that no integer of a million digits is built.

    Raises
    ------
    SourceError
        The file is too large, too deeply nested, or not JSON.
    """
    if file_size(path) > MAX_JSON_BYTES:
        raise SourceError(
            path, f"has more than {MAX_JSON_BYTES >> 20} MB of JSON; write shorter takes, or a table (CSV, NPZ)"
        )
    with source_errors(path):
        data = path.read_bytes()
    try:
        return json.loads(data, parse_int=float)
    except json.JSONDecodeError as fault:
        raise SourceError(path, f"is not JSON: {fault.msg}", line=fault.lineno) from None
    except (RecursionError, ValueError) as fault:
        raise SourceError(path, f"is no JSON that can be read: {str(fault)[:200]}") from None
