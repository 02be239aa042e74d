"""Label files as text: decoding, lines and times, with the file and line of every fault."""

from __future__ import annotations

import re
from pathlib import Path

from kinedex.ops.errors import SourceError

LONGEST_SECONDS = 10_000_000
"""Of a take; a label that ends later is a slip of the pen."""

_SECONDS = re.compile(r"[0-9]{1,9}(?:\.[0-9]{1,20})?|\.[0-9]{1,20}", re.ASCII)


def read_bytes(path: str | Path) -> bytes:
    """Return the bytes of a file; a SourceError reports that it cannot be read."""
    try:
        return Path(path).read_bytes()
    except OSError as fault:
        raise SourceError(path, f"cannot be read: {fault.strerror}") from fault


def read_text(path: str | Path) -> str:
    """Return a file as UTF-8 text, without a byte order mark; a SourceError reports another encoding."""
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as fault:
        raise SourceError(path, f"is not UTF-8 text (byte {fault.start})") from None


def lines_of(text: str) -> list[str]:
    """Split a text into lines, whatever ends them (LF, CR LF, CR)."""
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def shown(text: str) -> str:
    """Shorten a text for a message."""
    return text if len(text) <= 40 else f"{text[:40]}… ({len(text)} characters)"


def parse_seconds(text: str) -> float | None:
    """Parse a time in seconds from 0 with a decimal point; None if the text is none."""
    if not _SECONDS.fullmatch(text):
        return None
    value = float(text)
    return value if value <= LONGEST_SECONDS else None
