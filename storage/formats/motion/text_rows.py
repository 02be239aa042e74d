"""Find the byte offsets of rows of numbers in a text motion file, so that any of them can be read alone."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops import textnumbers
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.reader import file_size
from kinedex.storage.formats.motion.text_blocks import blocks

_LINE_END = re.compile(rb"\r\n?|\n")


class TextRows:
    """The rows, or the frames of several lines, of a motion file.

    Parameters
    ----------
    path : Path
        The file.
    start : int
        The byte after which they begin.
    numbered : bool
        True for frames that begin with a line for their number, as in AMC files; False for one row per line.
    cut : callable
        Returns the offset at which a block of the file can end, see `text_blocks.blocks`.

    Attributes
    ----------
    starts : int64 array (frames + 1,)
        The byte at which each frame begins; the last one is the end of the file.
    head : bytes
        The text before the first frame.
    newline : bytes
        The first line end in the file.
    """

    def __init__(self, path: Path, start: int, numbered: bool, cut: Callable[[bytearray, int], int]) -> None:
        self.path = path
        found: list[npt.NDArray[np.int64]] = []
        at, self.newline, self.head = 0, b"", b""
        for block in blocks(path, None, cut):
            begin = min(max(0, start - at), len(block.view))
            rows = textnumbers.row_starts(block.view, begin, numbered)
            if not any(map(len, found)):
                self.head += bytes(block.view[: rows[0]] if len(rows) else block.view)
            found.append(rows + at)
            first = None if self.newline else _LINE_END.search(block.view)
            self.newline = bytes(first[0]) if first is not None else self.newline
            at += len(block.view)
        self.newline = self.newline or b"\n"
        self.starts = np.concatenate([*found, [at]])

    def __len__(self) -> int:
        return len(self.starts) - 1

    def read(self, start: int, stop: int) -> list[bytes]:
        """Return the text of frames [start, stop) with line ends, blank lines and comments after each.

        Raises
        ------
        SourceError
            The file cannot be read, or has another size than before.
        """
        begin, end = int(self.starts[start]), int(self.starts[stop])
        try:
            with self.path.open("rb") as file:
                file.seek(begin)
                data = file.read(end - begin)
        except OSError as fault:
            raise SourceError(self.path, f"cannot be read: {fault.strerror}") from fault
        if len(data) != end - begin or file_size(self.path) != self.starts[-1]:
            raise SourceError(self.path, "was changed while it was read; run again when it is whole")
        places = self.starts[start : stop + 1] - begin
        frames = [data[a:b] for a, b in pairwise(places)]
        if frames and not frames[-1].endswith((b"\n", b"\r")):
            frames[-1] += self.newline
        return frames
