"""Read a text file in blocks, so that a long file is never in memory as a whole."""

from __future__ import annotations

import os
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from io import FileIO
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.source_files import source_bytes, source_errors

BLOCK = 1 << 20
"""The size of a block in bytes, which fits into the processor's cache; a shorter file is one block."""

LONGEST = 64 << 20
"""The largest size of a header, frame or line in bytes; a file with a longer one is refused."""

_LINE_END = re.compile(rb"\r\n?|\n")
_FRAME = re.compile(rb"[\r\n][ \t]*(?=[0-9])")


@dataclass(frozen=True)
class Block:
    """Consecutive bytes of a file, valid until the next block is requested.

    Attributes
    ----------
    path : Path
        The file.
    view : memoryview
        The bytes.
    start : int
        The offset of the first byte in the file.
    last : bool
        True for the last block of the file.
    """

    path: Path
    view: memoryview
    start: int
    last: bool

    @cached_property
    def data(self) -> bytes:
        """A copy of the bytes that outlives the block."""
        whole = self.view.obj
        return whole if isinstance(whole, bytes) and len(whole) == len(self.view) else bytes(self.view)

    @property
    def line(self) -> int:
        r"""The number of the first line, from 1; "\n", "\r\n" and "\r" are line ends.

        It is computed by reading the file up to the block again, since only error messages need it.
        """
        line, left, carry = 1, self.start, b""
        if left:
            with self.path.open("rb") as file:
                while left and (more := file.read(min(left, BLOCK))):
                    left -= len(more)
                    found = carry + more
                    # a line end may be split between two pieces
                    carry = b"\r" if left and found.endswith(b"\r") else b""
                    line += len(_LINE_END.findall(found, 0, len(found) - len(carry)))
        return line


def blocks(path: Path, data: bytes | None, cut: Callable[[bytearray, int], int], least: int = 0) -> Iterator[Block]:
    """Yield a text file in blocks.

    Parameters
    ----------
    path : Path
        The file.
    data : bytes, optional
        Its bytes, if they have been read already; they are one block, as a file of up to `BLOCK` bytes is.
    cut : callable
        Returns the offset at which a block can end within the first bytes of a buffer, given their number; 0 if there
        is none.
    least : int, optional
        Least size of the first block in bytes, if the file is long enough.

    Raises
    ------
    SourceError
        The file cannot be read, is empty, or has no possible end of a block within `LONGEST` bytes.
    """
    if data is None:
        with source_errors(path), path.open("rb", buffering=0) as file:
            if os.fstat(file.fileno()).st_size > BLOCK:
                yield from _long(path, file, cut, least)
                return
            data = file.read()
    yield Block(path, memoryview(source_bytes(path, data)), 0, True)


def _long(path: Path, file: FileIO, cut: Callable[[bytearray, int], int], least: int) -> Iterator[Block]:
    """Yield the blocks of a long file in one reused buffer: new memory would cost as much time as parsing."""
    buffer, held, start, empty = bytearray(BLOCK + BLOCK // 4), 0, 0, True
    while True:
        if len(buffer) < held + BLOCK:
            buffer = buffer[:held] + bytes(BLOCK + BLOCK // 4)
        view = memoryview(buffer)
        more = _fill(file, view[held : held + BLOCK])
        empty = empty and (not more or buffer[held : held + more].isspace())
        held += more
        last = more < BLOCK
        end = cut(buffer, held) if held >= least else 0
        if not (end > 0 and end >= least) and held > LONGEST + least:
            line = Block(path, view[:0], start, False).line
            raise SourceError(path, f"has a header, a frame or a line of more than {LONGEST >> 20} MB", line=line)
        if last:
            break
        if end > 0 and end >= least:
            yield Block(path, view[:end].toreadonly(), start, False)
            view[: held - end] = view[end:held]
            start, held = start + end, held - end
    if empty:
        raise SourceError(path, "the file is empty")
    yield Block(path, view[:held].toreadonly(), start, True)


def _fill(file: FileIO, room: memoryview) -> int:
    """Fill a buffer from a file, up to the end of the file, and return the number of bytes read."""
    held = 0
    while held < len(room) and (more := file.readinto(room[held:])):
        held += more
    return held


class RowMemory:
    """Memory for the parsed rows of a text: one array for all rows, or one that is reused for every block.

    Parameters
    ----------
    columns : int
        The numbers of a row.
    rows : int, optional
        The number of rows of the whole text, to keep all of them.
    size : int, optional
        The size of that text in bytes.
    """

    def __init__(self, columns: int, rows: int | None = None, size: int = 0) -> None:
        self._columns, self._keeps = columns, rows is not None
        self._rows = np.empty((min(rows or 0, self._most(size)), columns))
        self.filled = 0

    def _most(self, size: int) -> int:
        """Return an upper bound of the rows in `size` bytes, since each number takes at least two."""
        return size // max(2 * self._columns, 1) + 1

    def free(self, size: int) -> npt.NDArray[np.float64]:
        """Return an array for the rows of the next block of `size` bytes."""
        if self._keeps:
            return self._rows[self.filled :]
        least = self._most(size)
        if len(self._rows) < least:
            self._rows = np.empty((least + least // 8, self._columns))
        return self._rows

    @property
    def whole(self) -> npt.NDArray[np.float64]:
        """The rows of the whole text, after all have been parsed."""
        return self._rows


class RowFile(ABC):
    """A text file with rows of numbers, which are parsed block by block.

    Attributes
    ----------
    path : Path
        The file.
    frames : int
        The number of its rows.
    size : int
        Its size in bytes.
    columns : int
        The number of values in a row.
    """

    path: Path
    frames: int
    size: int

    @property
    @abstractmethod
    def columns(self) -> int:
        """The number of values in a row."""

    @abstractmethod
    def parsed(self, memory: RowMemory) -> Iterator[npt.NDArray[np.float64]]:
        """Parse block by block into memory, and yield the rows of each block.

        Raises
        ------
        SourceError
            The file is damaged; the error names the line of the first fault.
        """

    def blocks(self) -> Iterator[npt.NDArray[np.float64]]:
        """Yield blocks of consecutive frames, as channels (T, C) in radians and a unit of length.

        The unit of length is the file's own for BVH files, and the metre for AMC files. All blocks share memory, so
        that a block is overwritten by the next one.

        Raises
        ------
        SourceError
            The file is damaged; the error names the line of the first fault.
        """
        return self.parsed(RowMemory(self.columns))

    def channels(self) -> npt.NDArray[np.float64]:
        """Return the channels (T, C) of all frames at once, as `blocks` yields them."""
        memory = RowMemory(self.columns, self.frames, self.size)
        for _ in self.parsed(memory):
            pass
        if memory.filled != self.frames:
            raise changed(self.path)
        return memory.whole


def changed(path: Path) -> SourceError:
    """Return the error for a file that has changed since its frames were counted."""
    return SourceError(path, "was changed while it was read; run again when it is whole")


def after_last_line(data: bytearray, stop: int) -> int:
    """Return the offset after the last line that ends within the first `stop` bytes; 0 if none does."""
    end = data.rfind(b"\n", 0, stop) + 1
    return end or data.rfind(b"\r", 0, max(stop - 1, 0)) + 1


def before_last_frame(data: bytearray, stop: int) -> int:
    """Return the offset of the last line within `stop` bytes that begins with a digit, as AMC frames do; 0 if none."""
    window = 1 << 12
    while True:
        found = list(_FRAME.finditer(data, max(0, stop - window), stop))
        if found:
            return found[-1].start() + 1
        if window >= stop:
            return 0
        window *= 8
