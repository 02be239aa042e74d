"""Label files as text: limits of size, decoding, lines and times, with the file and line of every fault."""

from __future__ import annotations

import io
import re
from pathlib import Path

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.small_files import read_bytes

LONGEST_SECONDS = 10_000_000
"""Of a take; a label that ends later is a slip of the pen."""

MOST_LABELS = 500_000
"""Labels, and takes, of a label file."""

MOST_LETTERS = 100_000
"""Characters of a class or of a take's name."""

_SECONDS = re.compile(r"[0-9]{1,9}(?:\.[0-9]{1,20})?|\.[0-9]{1,20}", re.ASCII)


def label_bytes(path: str | Path) -> bytes:
    """Return the bytes of a label file; a SourceError reports that it cannot be read, or is too large."""
    return read_bytes(path, "label files", "divide it by takes")


def read_text(path: str | Path) -> str:
    """Return a file as UTF-8 text, without a byte order mark; a SourceError reports another encoding."""
    return _decoded(path, label_bytes(path))


def _decoded(path: str | Path, data: bytes) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as fault:
        raise SourceError(path, f"is not UTF-8 text (byte {fault.start})") from None


def open_lines(path: str | Path, newline: str | None = None) -> io.TextIOWrapper:
    """Return the lines of a file one by one, as UTF-8 text; errors as `read_text`.

    Parameters
    ----------
    path : str or Path
        The file.
    newline : str or None
        As for `open`: None to end every line by LF, whatever ends it in the file (LF, CR LF, CR); "" to leave it so.
    """
    data = label_bytes(path)
    _decoded(path, data)  # a fault is found here, with its place in the whole file
    return io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig", newline=newline)


def refuse_many(path: str | Path, count: int, line: int | None = None) -> None:
    """Raise a SourceError if there are more labels (or takes) than `MOST_LABELS`."""
    if count > MOST_LABELS:
        raise SourceError(
            path, f"has more than {MOST_LABELS:,} labels, the most of one file: divide it by takes", line=line
        )


def refuse_long(path: str | Path, length: int, line: int | None = None, place: str = "the text") -> None:
    """Raise a SourceError if a text has more characters than `MOST_LETTERS`."""
    if length > MOST_LETTERS:
        raise SourceError(
            path, f"{place} has {length:,} characters or more; a class or a take's name has at most {MOST_LETTERS:,}",
            line=line,
        )  # fmt: skip


def shown(text: str) -> str:
    """Shorten a text for a message."""
    return text if len(text) <= 40 else f"{text[:40]}… ({len(text)} characters)"


def parse_seconds(text: str) -> float | None:
    """Parse a time in seconds from 0 with a decimal point; None if the text is none."""
    if not _SECONDS.fullmatch(text):
        return None
    value = float(text)
    return value if value <= LONGEST_SECONDS else None
