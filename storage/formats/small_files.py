"""Read files that fit into memory, such as labels and tables of users, and refuse larger ones before reading."""

from __future__ import annotations

import io
from pathlib import Path

from kinedex.ops.errors import SourceError

MOST_BYTES = 64_000_000
"""The largest size of such a file in bytes."""


def read_bytes(path: str | Path, kind: str, way_out: str) -> bytes:
    """Return the bytes of a file.

    Parameters
    ----------
    path : str or Path
        The file.
    kind : str
        The kind of file, in the plural, for messages.
    way_out : str
        The remedy if it is too large, for messages.

    Raises
    ------
    SourceError
        The file cannot be read, or is larger than `MOST_BYTES`.
    """
    try:
        with Path(path).open("rb") as file:
            size = file.seek(0, io.SEEK_END) if file.seekable() else 0
            if size <= MOST_BYTES:
                if size:
                    file.seek(0)
                data = file.read(MOST_BYTES + 1)
                size = len(data)
    except OSError as fault:
        raise SourceError(path, f"cannot be read: {fault.strerror}") from fault
    if size > MOST_BYTES:
        got = f"has {size / 1e6:.1f} MB" if size != MOST_BYTES + 1 else "is larger"
        raise SourceError(path, f"{got}; {kind} have at most {MOST_BYTES / 1e6:g} MB: {way_out}")
    return data
