"""Blocks of a text file: a long file is parsed piece by piece, and is never in memory as a whole."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.reader import source_bytes

BLOCK = 4 << 20
"""Bytes that are read at once; a shorter file is one block."""

LONGEST = 64 << 20
"""Bytes of a header, of a frame or of a line; a file with a longer one is refused."""

_FRAME = re.compile(rb"[\r\n][ \t]*(?=[0-9])")


@dataclass(frozen=True)
class Block:
    """Consecutive bytes of a file.

    Attributes
    ----------
    data : bytes
        The bytes.
    line : int
        The number of the first line, from 1.
    last : bool
        True if nothing follows.
    """

    data: bytes
    line: int
    last: bool

    @property
    def next_line(self) -> int:
        r"""The number of the line after the block; "\n", "\r\n" and "\r" end one."""
        return self.line + self.data.count(b"\n") + self.data.count(b"\r") - self.data.count(b"\r\n")


def blocks(path: Path, data: bytes | None, cut: Callable[[bytes], int], least: int = 0) -> Iterator[Block]:
    """Yield a text file in blocks.

    Parameters
    ----------
    path : Path
        The file.
    data : bytes, optional
        Its bytes, if they have been read already; they are one block.
    cut : callable
        Returns the place in some bytes at which a block can end; 0 where there is none.
    least : int, optional
        Bytes that the first block has at least, where the file has so many.

    Raises
    ------
    SourceError
        The file cannot be read, is empty, or has no place to end a block in `LONGEST` bytes.
    """
    if data is not None:
        yield Block(source_bytes(path, data), 1, True)
        return
    line, carry, empty = 1, b"", True
    try:
        with path.open("rb") as file:
            while more := file.read(BLOCK):
                carry += more
                empty = empty and more.isspace()
                end = cut(carry) if len(carry) >= least else 0
                if end > 0 and end >= least:
                    block = Block(carry[:end], line, False)
                    line, carry = block.next_line, carry[end:]
                    yield block
                elif len(carry) > LONGEST + least:
                    raise SourceError(
                        path, f"has a header, a frame or a line of more than {LONGEST >> 20} MB", line=line
                    )
    except OSError as fault:
        raise SourceError(path, f"cannot be read: {fault.strerror}") from fault
    if empty:
        raise SourceError(path, "the file is empty")
    yield Block(carry, line, True)


def after_last_line(data: bytes) -> int:
    """Return the place after the last line that ends in some bytes; 0 where none does."""
    end = data.rfind(b"\n") + 1
    return end or data.rfind(b"\r", 0, len(data) - 1) + 1


def before_last_frame(data: bytes) -> int:
    """Return the place of the last line that begins with a digit, as frames of AMC files do; 0 where there is none."""
    window = 1 << 16
    while True:
        found = list(_FRAME.finditer(data, max(0, len(data) - window)))
        if found:
            return found[-1].start() + 1
        if window >= len(data):
            return 0
        window *= 8
