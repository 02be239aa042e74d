"""Read tables of numbers in text, one line a frame, in blocks of lines; also after long headers and in sections."""

from __future__ import annotations

import codecs
import re
from abc import abstractmethod
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.csv_tables import csv_cells
from kinedex.storage.formats.motion.points import PointsReader
from kinedex.storage.formats.motion.reader import MotionFile
from kinedex.storage.formats.motion.shared_labels import unique_names
from kinedex.storage.formats.motion.subjects import bodies_of, labels_of_person
from kinedex.storage.formats.motion.text_blocks import BLOCK, LONGEST
from kinedex.storage.formats.source_files import file_size, part_of, source_bytes, source_errors, text_of

F64 = npt.NDArray[np.float64]
Lines = npt.NDArray[np.int64]

_NOT_A_NUMBER = re.compile(r"[+-]?1\.#(IND|QNAN|SNAN|R|QO|QNB)0*")  # as Microsoft's C library writes and rounds NaN
_NUMBERS = 250_000  # numbers of rows that are kept before they are copied into the result


class Table:
    """A text file of a header and rows of numbers; blank lines between rows are skipped.

    Parameters
    ----------
    path : Path
        The file.
    separator : str
        The character between cells; lines without it are split at blanks.
    first : int
        The number of lines of the header.
    unlabelled : bool, optional
        True if rows may have whole points, of three cells each, after the columns of the header; they are dropped.

    Attributes
    ----------
    head : list of str
        The lines of the header, as many as there are.
    lines, rows : int
        The numbers of all lines, and of those with numbers.
    dropped : list of int
        The number of points without a label in each row that had some; they are dropped by `points`.

    Raises
    ------
    SourceError
        The file cannot be read, is empty, or has a line of more than `LONGEST` characters.
    """

    def __init__(self, path: Path, separator: str, first: int, unlabelled: bool = False) -> None:
        self.path, self.separator, self.first = path, separator, first
        self._unlabelled, self.dropped = unlabelled, list[int]()
        self._encoding = "utf-8-sig"
        try:
            self._count()
        except UnicodeDecodeError:
            self._encoding = "latin-1"
            self._count()
        self._size = file_size(path)
        self.head = list(islice(self._lines(), first))

    @property
    def columns(self) -> int:
        """The largest number of columns that the header can name."""
        return max((line.count(self.separator) + 1 for line in self.head), default=0)

    @property
    def bytes(self) -> int:
        """The memory, in bytes, of rows that are not yet in the result, as text and as numbers."""
        rows = min(self.rows, max(1, _NUMBERS // max(1, self.columns)))
        return rows * (40 * self.columns + 200) + 200 * self.columns + 12 * min(self._size, BLOCK)

    def _count(self) -> None:
        self.lines = self.rows = 0
        for line in self._lines():
            self.lines += 1
            self.rows += self.lines > self.first and bool(line.strip())

    def _lines(self) -> Iterator[str]:
        """Yield all lines without their line ends, which may be LF, CRLF or CR."""
        decoder, carry, empty = codecs.getincrementaldecoder(self._encoding)(), "", True
        with source_errors(self.path), self.path.open("rb") as file:
            while data := file.read(BLOCK):
                empty = empty and data.isspace()
                carry += decoder.decode(data)
                end = carry.rfind("\n") + 1 or carry.rfind("\r", 0, len(carry) - 1) + 1
                if len(carry) - end > LONGEST:
                    raise SourceError(self.path, f"has a line of more than {LONGEST >> 20} million characters")
                lines, carry = carry[:end].splitlines(), carry[end:]
                yield from lines
        if empty:
            raise SourceError(self.path, "the file is empty")
        yield from (carry + decoder.decode(b"", True)).splitlines()

    def points(
        self, header: Sequence[str], order: Sequence[int], others: Sequence[int]
    ) -> tuple[F64, list[F64], Lines]:
        """Read all rows.

        Parameters
        ----------
        header : sequence of str
            The names of the C columns.
        order : sequence of int
            The columns of x, y and z of N points.
        others : sequence of int
            Further columns.

        Returns
        -------
        positions : float64 array (N, 3, T)
            NaN in all coordinates of a point if one is missing.
        columns : list of float64 array (T,)
            The further columns.
        where : int64 array (T,)
            The line of every row.

        Raises
        ------
        SourceError
            A row has another number of cells, a cell is not a number, there are no rows, or the file changes during
            reading.
        """
        if not self.rows:
            raise SourceError(self.path, "no frames: the file ends after its header", line=self.lines)
        positions = np.empty((len(order) // 3, 3, self.rows))
        columns, where = [np.empty(self.rows) for _ in others], np.empty(self.rows, np.int64)
        at = 0
        for values, lines in self._blocks(header):
            stop = at + len(values)
            if stop > self.rows:
                break
            block = values[:, order].reshape(len(values), -1, 3).transpose(1, 2, 0)
            positions[:, :, at:stop] = whole_points(np.ascontiguousarray(block))
            for column, index in zip(columns, others, strict=True):
                column[at:stop] = values[:, index]
            where[at:stop] = lines
            at = stop
        if at != self.rows:
            raise SourceError(self.path, "was changed while it was read; run again when it is whole")
        return positions, columns, where

    def _blocks(self, header: Sequence[str]) -> Iterator[tuple[F64, list[int]]]:
        """Yield numbers (n, C) of consecutive rows, and their lines."""
        most = max(1, _NUMBERS // len(header))
        rows, where = [], []
        for number, line in enumerate(islice(self._lines(), self.first, None), self.first + 1):
            if line.strip():
                rows.append(self._row(line, number, header))
                where.append(number)
                if len(rows) == most:
                    yield np.stack(rows), where
                    rows, where = [], []
        if rows:
            yield np.stack(rows), where

    def _row(self, line: str, number: int, header: Sequence[str]) -> F64:
        """Return the numbers of a line, NaN for empty cells."""
        cells = csv_cells(line, self.separator) if self.separator in line else line.split()
        written = len(cells)
        while len(cells) > len(header) and not cells[-1].strip():
            cells.pop()
        if self._unlabelled and len(cells) > len(header):
            cells = self._labelled(cells, written, number, len(header))
        if len(cells) != len(header):
            raise SourceError(self.path, f"{len(cells)} cells, the header has {len(header)} columns", line=number)
        try:
            if "_" in line:
                raise ValueError
            row = np.array([cell if cell.strip() else "nan" for cell in cells], dtype=np.float64)
        except ValueError:
            pairs = zip(cells, header, strict=True)
            row = np.array([parse_number(self.path, cell, name, number) for cell, name in pairs])
        if np.isinf(row).any():
            at = int(np.flatnonzero(np.isinf(row))[0])
            raise SourceError(self.path, f"column '{header[at]}': not a finite number: {cells[at]!r}", line=number)
        return row

    def _labelled(self, cells: list[str], written: int, number: int, count: int) -> list[str]:
        """Return the cells of the header's columns, and count the others, which must be whole points.

        Parameters
        ----------
        cells : list of str
            The cells of a row, of which the last one is not empty.
        written : int
            The number of cells with the empty ones at the end.
        number : int
            The line.
        count : int
            The number of columns of the header.
        """
        points = -(-(len(cells) - count) // 3)
        if count + 3 * points > written:
            raise SourceError(
                self.path, f"{written} cells, the header has {count} columns, and the cells after them are no whole "
                "points of three cells each: is a cell of this row missing, or one too many?", line=number,
            )  # fmt: skip
        self.dropped.append(points)
        return cells[:count]


def parse_number(path: Path, cell: str, column: str, line: int) -> float:
    """Parse a cell, NaN if it is empty; raise a SourceError that names the column if it is not a number."""
    text = cell.strip()
    if text.lstrip("+-").startswith("1.#"):
        if _NOT_A_NUMBER.fullmatch(text):
            return float("nan")
        raise SourceError(
            path, f"column '{column}': {cell[:40]!r} is infinite, or may be, in the notation of Microsoft's C library; "
            "leave the cell empty if the value is missing", line=line,
        )  # fmt: skip
    try:
        if "_" in text:  # underscores in numbers are only Python's notation
            raise ValueError
        return float(text or "nan")
    except ValueError:
        raise SourceError(path, f"column '{column}': not a number: {cell[:40]!r}", line=line) from None


def whole_points(positions: F64) -> F64:
    """Set all coordinates of a point (N, 3, T) to NaN, in place, if one is missing."""
    positions[np.broadcast_to(np.isnan(positions).any(axis=1, keepdims=True), positions.shape)] = np.nan
    return positions


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
    header : int
        The number, from 1, of the last line of its header.
    start, stop : int, optional
        The numbers of its first and its last line.
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
        header: int,
        start: int = 1,
        stop: int = 1 << 62,
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
                cells = csv_cells(line, self.separator)
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
    return text_of(source_bytes(path, part_of(path, most))).splitlines()[:count]


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


@dataclass(frozen=True)
class PointTable:
    """A table of labelled points in a text file.

    Attributes
    ----------
    path : Path
        The file.
    labels : tuple of str
        The labels of the points, some with their subject in front, as `Ann:LKNE`.
    header : tuple of str
        A name for each column, for messages.
    columns : tuple of (int, int, int)
        The columns of x, y and z of each point.
    line : int
        The last line before the rows.
    separator, start, stop, texts, missing
        As for `Section`.
    numbered : bool
        True if the first column is the number of the frame.
    unit_m : float, optional
        Metres per unit, if the file states it.
    origin_missing : bool
        True if a point at exactly 0, 0, 0 is missing.
    """

    path: Path
    labels: tuple[str, ...]
    header: tuple[str, ...]
    columns: tuple[tuple[int, int, int], ...]
    line: int
    separator: str = ","
    start: int = 1
    stop: int = 1 << 62
    texts: tuple[int, ...] = ()
    missing: str = ""
    numbered: bool = True
    unit_m: float | None = None
    origin_missing: bool = False

    def section(self) -> Section:
        """Open the lines of the table, and count its rows."""
        return Section(self.path, self.separator, self.line, self.start, self.stop, self.texts, self.missing)

    def read(self, person: str, warnings: list[str]) -> tuple[tuple[str, ...], F64]:
        """Return names and positions (N, 3, T) of the points of one person, as `labels_of_person` chooses them.

        Of points with the same label see `unique_names`.

        Raises
        ------
        SourceError
            A cell is no number, or frames are missing between others.
        """
        places, names = labels_of_person(self.path, self.labels, person, warnings)
        order = [column for i in places for column in self.columns[i]]
        positions, numbers, where = self.section().points(self.header, order, (0,) if self.numbered else ())
        if numbers:
            refuse_jumps(self.path, numbers[0], where)
        if self.origin_missing:
            positions[np.broadcast_to((positions == 0.0).all(axis=1, keepdims=True), positions.shape)] = np.nan
        return unique_names(names, positions, self.unit_m, warnings), positions


class TableReader(PointsReader):
    """A reader of text files with one table of labelled points; subclasses define `points` and `table`."""

    @abstractmethod
    def table(self, path: Path) -> PointTable:
        """Return the table of a file; raise SourceError if its header is not that of the format."""

    def persons(self, file: MotionFile, mappings: Mappings) -> tuple[str, ...]:
        """Return the names of the subjects, if several have the landmarks of a body."""
        return tuple(bodies_of(self.table(file.path).labels))

    def size(self, file: MotionFile) -> tuple[int, int, int]:
        """Return the numbers of rows and points of the table, and the memory in bytes that reading it needs."""
        table = self.table(file.path)
        section = table.section()
        return section.rows, len(table.labels), section.bytes + 24 * section.rows
