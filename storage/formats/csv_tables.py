"""Read CSV files that Excel (in any language), LibreOffice and scripts save, and write CSV that is safe in Excel.

The separator is a comma, a semicolon or a tab; it is found from the header, or from Excel's "sep=;" in the first line.
The text is UTF-8 with or without a byte order mark, UTF-16 with one, or Windows-1252, the encoding of Excel's "CSV".
With a separator other than the comma, the decimal sign can be a comma.

A spreadsheet evaluates a cell that begins with = + - @, a tab or a carriage return, and the name of a take can begin
with such a character. An apostrophe before the text prevents this; kinedex removes the apostrophe on reading. Numbers
are written unchanged.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from kinedex.ops.errors import SourceError

_FORMULA = re.compile(r"'*[=+\-@\t\r]")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


def csv_line(cells: Iterable[object]) -> str:
    """Return a line of CSV; texts are guarded, None becomes an empty cell, and other values are written unchanged."""
    line = io.StringIO()
    # with this line terminator the csv module quotes cells that contain either of its characters
    writer = csv.writer(line, lineterminator="\r\n")
    writer.writerow(guarded(cell) if isinstance(cell, str) else cell for cell in cells)
    return line.getvalue().removesuffix("\r\n") + "\n"


def guarded(text: str) -> str:
    """Return a text, with an apostrophe before it if a spreadsheet would evaluate the text."""
    return f"'{text}" if _FORMULA.match(text) and not _NUMBER.fullmatch(text) else text


def unguarded(cell: str) -> str:
    """Return the text of a cell without the apostrophe that `guarded` adds."""
    return cell[1:] if cell.startswith("'") and guarded(cell[1:]) == cell else cell


SEPARATORS = (",", ";", "\t")

_QUOTED = re.compile(r'"(?:[^"]|"")*"?')
_MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
_DECIMAL_COMMA = re.compile(r"([+-]?[0-9]*),([0-9]+)")


def csv_cells(line: str, separator: str, *, strict: bool = True) -> list[str]:
    """Return the cells of a line; quotes are interpreted only if the line is CSV (with `strict`, well-formed CSV)."""
    if '"' in line:
        with suppress(csv.Error):
            return next(csv.reader([line], delimiter=separator, strict=strict), [])
    return line.split(separator)


def decoded(path: str | Path, data: bytes) -> str:
    """Return the bytes of a CSV file as text.

    Raises
    ------
    SourceError
        The bytes are not text in any of the encodings.
    """
    encodings = [encoding for mark, encoding in _MARKS if data.startswith(mark)] or ["utf-8", "cp1252"]
    first: UnicodeDecodeError | None = None
    for encoding in encodings:
        try:
            return data.decode(encoding)
        except UnicodeDecodeError as fault:
            first = first or fault
    assert first is not None
    raise SourceError(path, f"is not UTF-8 text, nor Windows-1252 (byte {first.start}); save it as CSV UTF-8")


@dataclass
class CsvTable:
    """A CSV file with a header, read row by row.

    Attributes
    ----------
    path : str
        The file.
    header : list of str
        The names of the columns, without blanks around them; empty for an empty file.
    separator : str
        The separator of cells.
    """

    path: str
    header: list[str]
    separator: str
    _reader: Iterator[list[str]] = field(repr=False)
    _lines_before: int = 0

    @classmethod
    def of(cls, path: str | Path, data: bytes) -> CsvTable:
        """Open the bytes of a CSV file, and read its header.

        Raises
        ------
        SourceError
            The bytes are not text, or not CSV.
        """
        text = decoded(path, data)
        first, _, rest = text.partition("\n")
        named = re.fullmatch(r"sep=(.)\r?", first, re.IGNORECASE)
        before = 1 if named is not None and named[1] in SEPARATORS else 0
        text = rest if before else text
        separator = named[1] if named is not None and before else _separator(text)
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
        table = cls(str(path), [], separator, reader, before)
        header = next((cells for _, cells in table._rows() if any(cells)), [])
        while header and not header[-1]:
            header.pop()  # Excel ends lines with separators after a column was emptied
        table.header = header
        return table

    @property
    def decimal_comma(self) -> bool:
        """True if a comma can be the decimal sign."""
        return self.separator != ","

    def rows(self, *, strict: bool = False) -> Iterator[tuple[int, dict[str, str]]]:
        """Yield the line number and a dict from column to stripped cell of each row; empty rows are skipped.

        Parameters
        ----------
        strict : bool
            Raise an error for rows with more cells than the header; by default the extra cells are ignored.

        Raises
        ------
        SourceError
            The file is not CSV, or `strict` is set and a row is too long.
        """
        width = len(self.header)
        for line, cells in self._rows():
            if strict and any(cells[width:]):
                raise SourceError(self.path, f"has {len(cells)} cells, and the header has {width}", line=line)
            if any(cells):
                cells += [""] * (width - len(cells))
                yield line, dict(zip(self.header, cells, strict=False))

    def number(self, text: str) -> str:
        """Return a number's text with its decimal comma replaced by a point; any other text unchanged."""
        found = _DECIMAL_COMMA.fullmatch(text) if self.decimal_comma else None
        return f"{found[1]}.{found[2]}" if found else text

    def _rows(self) -> Iterator[tuple[int, list[str]]]:
        try:
            for cells in self._reader:
                line = self._lines_before + self._reader.line_num  # type: ignore[attr-defined]
                yield line, [unguarded(cell.strip()) for cell in cells]
        except csv.Error as fault:
            raise SourceError(self.path, f"is not a CSV file: {fault}") from None


def _separator(text: str) -> str:
    """Return the separator that is most frequent in the first non-empty line, outside quotes."""
    header = next((line for line in io.StringIO(text) if line.strip()), "")
    bare = _QUOTED.sub("", header)
    return max(SEPARATORS, key=lambda one: (bare.count(one), -SEPARATORS.index(one)))
