"""Read tables from files with several sections, or with a header of any length before the table."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from itertools import islice
from pathlib import Path

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.position_tables import F64, Lines, Table, cells_of

HEADER_BYTES = 4 << 20
"""The largest size of a table's header in bytes, which bounds the cost of files of another kind."""


class Section(Table):
    """The lines of a text file that form one table.

    Parameters
    ----------
    path : Path
        The file.
    separator : str
        The character between cells.
    start, header, stop : int
        Numbers, from 1, of the section's first line, of the last line of its header, and of its last line.
    texts : collection of int, optional
        Columns that hold text, such as time codes; they are read as empty.
    missing : str, optional
        The text of a cell without a number, other than nothing or nan.

    Raises
    ------
    SourceError
        The file cannot be read, or is empty.
    """

    def __init__(
        self,
        path: Path,
        separator: str,
        start: int,
        header: int,
        stop: int,
        texts: Collection[int] = (),
        missing: str = "",
    ) -> None:
        self._start, self._stop, self._texts, self._missing = start, stop, frozenset(texts), missing
        super().__init__(path, separator, header)

    def _lines(self) -> Iterator[str]:
        """Yield the lines up to the section's last one; lines before the section are yielded as empty."""
        for number, line in enumerate(islice(super()._lines(), self._stop), 1):
            empty = number > self.first and not line.strip(f"{self.separator} ")
            if number < self._start or empty:
                yield ""
            elif number > self.first and (self._texts or (self._missing and self._missing in line)):
                cells = cells_of(line, self.separator)
                yield self.separator.join(
                    "" if i in self._texts or cell.strip() == self._missing else cell for i, cell in enumerate(cells)
                )
            else:
                yield line


def first_lines(path: Path, count: int, most: int = HEADER_BYTES) -> list[str]:
    """Return the first lines of a text file, at most `count`, that end within its first `most` bytes.

    Raises
    ------
    SourceError
        The file cannot be read, or is empty.
    """
    try:
        with path.open("rb") as file:
            data = file.read(most)
    except OSError as fault:
        raise SourceError(path, f"cannot be read: {fault.strerror}") from fault
    if not data or data.isspace():
        raise SourceError(path, "the file is empty")
    return text_of(data).splitlines()[:count]


def text_of(data: bytes) -> str:
    """Decode bytes as UTF-8 or else as Latin-1; a character truncated at the end is dropped."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as fault:
        if fault.start >= len(data) - 4:
            return data[: fault.start].decode("utf-8-sig")
        return data.decode("latin-1")


def beginning(path: Path, size: int = 4096) -> str:
    """Return the first bytes of a file as text, for recognition of its format; empty if it cannot be read."""
    try:
        with path.open("rb") as file:
            return text_of(file.read(size))
    except OSError:
        return ""


def refuse_jumps(path: Path, numbers: F64, where: Lines) -> None:
    """Raise SourceError at the first frame number that is not one more than the one before.

    Parameters
    ----------
    path : Path
        The file.
    numbers : float64 array (T,)
        Numbers of the frames.
    where : int64 array (T,)
        Their lines.
    """
    for i, (before, number) in enumerate(zip([numbers[0] - 1, *numbers[:-1]], numbers, strict=True)):
        if not number == before + 1:
            raise SourceError(
                path, f"expected the number of the next frame, {before + 1:g}, got {number:g}; export all frames",
                line=int(where[i]),
            )  # fmt: skip
