"""Read label files as text with limits of size, and report faults with file and line."""

from __future__ import annotations

import io
import re
from pathlib import Path

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.source_files import read_bytes, utf8_text

LONGEST_SECONDS = 10_000_000
"""The latest end of a label in seconds; a later one is a typing error."""

MAX_LABELS = 500_000
"""The largest number of labels, and of takes, in a label file."""

MAX_LETTERS = 100_000
"""The largest number of characters of a class or of a take's name."""

_SECONDS = re.compile(r"[0-9]{1,9}(?:\.[0-9]{1,20})?|\.[0-9]{1,20}", re.ASCII)


def label_bytes(path: str | Path) -> bytes:
    """Return the bytes of a label file; raise SourceError if it cannot be read or is too large."""
    return read_bytes(path, "label files", "divide it by takes")


def read_text(path: str | Path) -> str:
    """Return a file as UTF-8 text without a byte order mark; raise SourceError for another encoding."""
    return utf8_text(path, label_bytes(path))


def open_lines(path: str | Path, newline: str | None = None) -> io.TextIOWrapper:
    """Open a file of UTF-8 text to read it line by line; errors are those of `read_text`.

    Parameters
    ----------
    path : str or Path
        The file.
    newline : str or None
        As for `open`: None to convert all line ends (LF, CR LF, CR) to LF; "" to keep them.
    """
    data = label_bytes(path)
    utf8_text(path, data)  # decode it all now, so that a fault is reported with its position in the whole file
    return io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig", newline=newline)


def refuse_many(path: str | Path, count: int, line: int | None = None) -> None:
    """Raise a SourceError if there are more labels (or takes) than `MAX_LABELS`."""
    if count > MAX_LABELS:
        raise SourceError(
            path, f"has more than {MAX_LABELS:,} labels, the most of one file: divide it by takes", line=line
        )


def refuse_long(path: str | Path, length: int, line: int | None = None, place: str = "the text") -> None:
    """Raise a SourceError if a text has more characters than `MAX_LETTERS`."""
    if length > MAX_LETTERS:
        raise SourceError(
            path, f"{place} has {length:,} characters or more; a class or a take's name has at most {MAX_LETTERS:,}",
            line=line,
        )  # fmt: skip


def shown(text: str) -> str:
    """Shorten a text to show it in a message."""
    return text if len(text) <= 40 else f"{text[:40]}… ({len(text)} characters)"


def parse_seconds(text: str) -> float | None:
    """Parse a time in seconds from 0 with a decimal point; return None if the text is not such a time."""
    if not _SECONDS.fullmatch(text):
        return None
    value = float(text)
    return value if value <= LONGEST_SECONDS else None
