"""Files with one flipped bit."""

from __future__ import annotations

import os
from pathlib import Path


def flip_bit(file: Path, at: int, bit: int = 2, *, keep_time: bool = False) -> None:
    """Flip one bit of the byte at a position, in place; a second call undoes it."""
    status = file.stat()
    with open(file, "rb+") as content:
        content.seek(at)
        byte = content.read(1)[0]
        content.seek(at)
        content.write(bytes([byte ^ 1 << bit]))
    if keep_time:
        os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))
