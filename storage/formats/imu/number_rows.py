"""Read chosen columns of numbers from text tables with any kind of header, in which cells may be empty."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.csv_tables import csv_cells, decoded
from kinedex.storage.formats.source_files import file_size, source_bytes

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

MAX_TEXT_BYTES = 2 << 30
"""The largest text file in bytes; an hour of twenty sensors takes half of this in Parquet or HDF5."""

LARGEST = 1e20
"""The largest number that a sensor can write: nanoseconds since 1970 are 1.7e18."""

SEPARATORS = ("\t", ",", ";", " ")

_BLOCK_ROWS = 4096
_NAN = float("nan")


@dataclass(frozen=True, eq=False)
class NumberRows:
    """Chosen columns of a table.

    Attributes
    ----------
    numbers : float64 array (rows, columns)
        The wanted columns of numbers; NaN for an empty cell.
    texts : list of list of str
        The columns of text.
    lines : int64 array (rows,)
        The line of each row, from 1.
    """

    numbers: F64
    lines: I64
    texts: list[list[str]] = field(default_factory=list)


def text_lines(path: Path) -> list[str]:
    """Return the lines of a text file, without their ends.

    Raises
    ------
    SourceError
        The file cannot be read, is empty, too large, or not text.
    """
    size = file_size(path)
    if size > MAX_TEXT_BYTES:
        most = MAX_TEXT_BYTES / 1e9
        raise SourceError(path, f"has {size / 1e9:.1f} GB, and texts have at most {most:.1f} GB; convert it to Parquet")
    text = decoded(path, source_bytes(path))
    if "\0" in text:
        raise SourceError(path, "has zero bytes, and is no text")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def separator_of(header: str) -> str:
    """Return the most frequent separator of a header; a blank only if there is no other, since names contain blanks."""
    *others, blank = SEPARATORS
    found = max(others, key=lambda one: (header.count(one), -others.index(one)))
    return found if found in header else blank


def cells_of(line: str, separator: str) -> list[str]:
    """Return the cells of a line, without blanks and quotes around them."""
    return [cell.strip() for cell in csv_cells(line, separator, strict=False)]


def number_rows(
    path: Path, lines: Sequence[str], first: int, separator: str, header: Sequence[str], wanted: Sequence[int],
    texts: Sequence[int] = (),
) -> NumberRows:  # fmt: skip
    """Return chosen columns of the rows of a table; blank lines are skipped.

    Parameters
    ----------
    path : Path
        The file, for messages.
    lines : sequence of str
        All lines of the file.
    first : int
        The index of the first row.
    separator : str
        The character between cells.
    header : sequence of str
        The names of all columns.
    wanted : sequence of int
        The columns of numbers, at least one.
    texts : sequence of int, optional
        The columns of text.

    Raises
    ------
    SourceError
        A cell is not a number, or a row has fewer or more cells than the header; the message names line and column.
    """
    table = _Table(path, separator, header, list(wanted), list(texts))
    blocks: list[F64] = []
    numbers: list[I64] = []
    found: list[list[str]] = [[] for _ in texts]
    for start in range(first, len(lines), _BLOCK_ROWS):
        block = [(start + i + 1, line) for i, line in enumerate(lines[start : start + _BLOCK_ROWS]) if line.strip()]
        if not block:
            continue
        numbers.append(np.array([number for number, _ in block], np.int64))
        plain = None if texts else table.plain_numbers([line for _, line in block])
        if plain is not None:
            blocks.append(plain)
            continue
        rows = [table.cells(line, number) for number, line in block]
        blocks.append(table.numbers(rows, [number for number, _ in block]))
        for column, values in zip(texts, found, strict=True):
            values.extend(cells[column].strip() for cells in rows)
    if not blocks:
        raise SourceError(path, "has a header and no rows")
    return NumberRows(np.concatenate(blocks), np.concatenate(numbers), found)


@dataclass(frozen=True)
class _Table:
    """The columns of a table and its conversion of rows to numbers."""

    path: Path
    separator: str
    header: Sequence[str]
    wanted: list[int]
    texts: list[int]

    def plain_numbers(self, lines: list[str]) -> F64 | None:
        """Return the wanted cells of rows if all of them are plain numbers; otherwise None."""
        others = len(self.header) - 1
        if any(line.count(self.separator) != others or '"' in line for line in lines):
            return None
        try:
            found = np.loadtxt(lines, np.float64, comments=None, delimiter=self.separator, usecols=self.wanted, ndmin=2)
        except ValueError:
            return None
        return found if found.shape == (len(lines), len(self.wanted)) and not (np.abs(found) > LARGEST).any() else None

    def cells(self, line: str, number: int) -> list[str]:
        """Return the cells of a row; raise an error if it lacks wanted cells or has more cells than the header."""
        cells = cells_of(line, self.separator) if '"' in line else line.split(self.separator)
        count = len(self.header)
        if len(cells) <= max(self.wanted + self.texts):
            raise SourceError(
                self.path, f"has {len(cells)} cells, and the header has {count}; is the line cut off?", line=number
            )
        if len(cells) > count and any(cell.strip() for cell in cells[count:]):
            raise SourceError(
                self.path, f"has {len(cells)} cells, and the header has {count}; does a cell contain the separator?",
                line=number,
            )  # fmt: skip
        return cells

    def numbers(self, rows: list[list[str]], lines: list[int]) -> F64:
        """Return the wanted cells as numbers."""
        chosen: Iterator[str] = (cell for cells in map(self._wanted, rows) for cell in cells)
        try:
            found = np.array([float(cell) if cell and cell != " " else _NAN for cell in chosen])
        except ValueError:
            found = np.array(list(self._slowly(rows, lines)))
        found = found.reshape(len(rows), len(self.wanted))
        wrong = np.argwhere(np.abs(found) > LARGEST)
        if len(wrong):
            row, column = wrong[0]
            raise self._error(column, rows[row], lines[row])
        return found

    @property
    def _wanted(self) -> Callable[[list[str]], Sequence[str]]:
        pick = itemgetter(*self.wanted)
        return pick if len(self.wanted) > 1 else lambda cells: (pick(cells),)

    def _slowly(self, rows: list[list[str]], lines: list[int]) -> Iterator[float]:
        """Yield the wanted cells as numbers, one by one; decimal commas are read if the separator allows them."""
        for cells, line in zip(rows, lines, strict=True):
            for column, place in enumerate(self.wanted):
                cell = cells[place].strip()
                if self.separator != ",":
                    cell = cell.replace(",", ".")
                try:
                    yield float(cell) if cell else _NAN
                except ValueError:
                    raise self._error(column, cells, line) from None

    def _error(self, column: int, cells: list[str], line: int) -> SourceError:
        place = self.wanted[column]
        return SourceError(
            self.path, f"column '{self.header[place]}' must be a number, got {cells[place].strip()[:50]!r}", line=line
        )
