"""Read tables about takes that users write in CSV or YAML, such as tags and licences, as typed columns.

One column, the key, names takes or their files; every other column holds values. The type of a column is BOOLEAN,
BIGINT, DOUBLE, VARCHAR, or VARCHAR[]. In YAML, a VARCHAR[] is a list. In CSV, the column `tags` and columns whose names
end with "[]" are VARCHAR[], with |, ; or a comma between the elements in a cell.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import date, datetime
from pathlib import Path
from typing import Any

from kinedex.catalog.configs import Located, parse_yaml
from kinedex.ops.errors import ConfigError, SourceError
from kinedex.storage.formats.csv_tables import CsvTable
from kinedex.storage.formats.source_files import read_bytes, utf8_text

KEYS = ("take", "file", "path", "source", "filename", "name", "stem")
"""The names of key columns; in a table without any of them, the first column is the key."""

ENDINGS = (".csv", ".tsv", ".txt", ".yaml", ".yml", ".json")
"""File endings of tables about takes."""

MAX_ROWS = 500_000
MAX_COLUMNS = 200
MAX_LETTERS = 10_000
"""The largest number of rows and of columns of a table, and of characters in a cell."""

_SIXTY_FOUR_BITS = 2**63
_WHOLE = re.compile(r"[+-]?(?:0|[1-9][0-9]{0,17})")
_NUMBER = re.compile(r"[+-]?(?:(?:0|[1-9][0-9]{0,17})(?:\.[0-9]{0,30})?|\.[0-9]{1,30})(?:[eE][+-]?[0-9]{1,3})?")
_TRUTHS = {"true": True, "false": False, "yes": True, "no": False, "wahr": True, "falsch": False}
_PARTS = re.compile(r"[|;,]")

Value = bool | int | float | str | tuple[str, ...]


@dataclass(frozen=True)
class Cell:
    """A value of a table, and its text in the file."""

    text: str
    value: Value

    @property
    def type(self) -> str:
        """The type that a column with only this value would have."""
        return _TYPES[type(self.value)]


_TYPES = {bool: "BOOLEAN", int: "BIGINT", float: "DOUBLE", str: "VARCHAR", tuple: "VARCHAR[]"}


@dataclass(frozen=True)
class MetadataRow:
    """A row of a table.

    Attributes
    ----------
    path : str
        The file.
    line : int or None
        The line.
    key : str
        The cell that names takes or files.
    cells : dict of str to Cell
        Column → value, for cells that are not empty.
    """

    path: str
    line: int | None
    key: str
    cells: Mapping[str, Cell]

    def error(self, message: str) -> SourceError:
        """Return an error that names file and line."""
        return SourceError(self.path, message, line=self.line)


@dataclass(frozen=True)
class MetadataTable:
    """A table about takes: its file, the name of its key column, and its rows."""

    path: str
    key: str
    columns: tuple[str, ...]
    rows: tuple[MetadataRow, ...]


def wider(one: str, other: str) -> str | None:
    """Return the type of column that can hold values of two types; None if there is none.

    Parameters
    ----------
    one, other : str
        Types of columns.
    """
    if one == other:
        return one
    if "VARCHAR[]" in (one, other):
        return "VARCHAR[]" if "VARCHAR" in (one, other) else None
    return "DOUBLE" if {one, other} == {"BIGINT", "DOUBLE"} else "VARCHAR"


def converted(cell: Cell, kind: str) -> object:
    """Return the value of a cell in a column of a type that can hold it (`wider`)."""
    if kind == "VARCHAR[]":
        return list(cell.value) if isinstance(cell.value, tuple) else [cell.text]
    if kind == "VARCHAR":
        return cell.text
    return float(cell.value) if kind == "DOUBLE" and isinstance(cell.value, int) else cell.value


def read_metadata(path: str | Path) -> MetadataTable:
    """Read a table about takes.

    Parameters
    ----------
    path : str or Path
        The file; its extension is one of `ENDINGS`. YAML and JSON hold a mapping from keys to mappings, or a list of
        mappings.

    Raises
    ------
    SourceError
        The file cannot be read, or is too large; a row or column is invalid. The message names the line.
    ConfigError
        The file is not valid YAML.
    """
    ending = Path(path).suffix.lower()
    if ending not in ENDINGS:
        raise SourceError(path, f"is no table of metadata; expected a file with the ending {', '.join(ENDINGS)}")
    data = read_bytes(path, "tables of metadata", "divide it, and give a list of tables")
    return _read_csv(path, data) if ending in ENDINGS[:3] else _read_yaml(path, data)


def _checked(path: str | Path, columns: Iterable[str], line: int | None) -> list[str]:
    """Return the names of columns; raise SourceError for an empty or repeated one."""
    seen: dict[str, str] = {}
    for number, name in enumerate(columns, 1):
        if not name:
            raise SourceError(path, f"column {number} has no name", line=line)
        if name.lower() in seen:
            raise SourceError(path, f"has two columns '{name}' (letter case does not count); rename one", line=line)
        seen[name.lower()] = name
    if len(seen) > MAX_COLUMNS:
        raise SourceError(path, f"has {len(seen):,} columns; tables of metadata have at most {MAX_COLUMNS}", line=line)
    return list(seen.values())


def _key_of(columns: list[str]) -> str:
    by_name = {name.lower(): name for name in columns}
    return next((by_name[name] for name in KEYS if name in by_name), columns[0])


def _refuse_many(path: str | Path, count: int) -> None:
    if count > MAX_ROWS:
        raise SourceError(path, f"has more than {MAX_ROWS:,} rows; divide it, and give a list of tables")


def _refuse_long(path: str | Path, text: str, line: int | None, column: str) -> None:
    if len(text) > MAX_LETTERS:
        raise SourceError(
            path, f"the cell of '{column}' has {len(text):,} characters; the most is {MAX_LETTERS:,}", line=line
        )


def read_sidecar(path: str | Path, key: str) -> MetadataRow:
    """Read a YAML file that describes the motion file beside it: a mapping from columns to values.

    Columns with the name of a key, such as `take` or `file`, repeat the name of the file and are ignored.

    Parameters
    ----------
    path : str or Path
        The file.
    key : str
        The key of the row, which is not in the file.

    Raises
    ------
    SourceError
        The file cannot be read, or is too large.
    ConfigError
        The file is not valid YAML, or has a value that is not a text, number, true, false, or list of texts.
    """
    from kinedex.storage.formats.motion.unpacked_files import unpacked  # imported here since it imports all readers

    with unpacked(Path(path)) as copy:
        data = read_bytes(copy.path, "files beside motion files", "give a table of metadata instead")
    located = _located(path, data)
    if not isinstance(located.data, dict):
        raise located.error("expected a mapping from columns to values")
    _checked(path, map(str, located.data), None)
    values = {name: value for name, value in located.data.items() if str(name).lower() not in KEYS}
    return _yaml_row(located, (), key, values, "")


# ---- CSV -------------------------------------------------------------------------------------------------


def _read_csv(path: str | Path, data: bytes) -> MetadataTable:
    table = CsvTable.of(path, data)
    if len(table.header) < 2:
        raise SourceError(path, "must have a header with two columns or more: the take or file, and its values", line=1)
    columns = table.header = _checked(path, table.header, 1)
    key = _key_of(columns)
    lines, texts = list[int](), list[dict[str, str]]()
    for line, row in table.rows(strict=True):
        _refuse_many(path, len(lines) + 1)
        for name, text in row.items():
            _refuse_long(path, text, line, name)
        if not row[key]:
            raise SourceError(path, f"has no value in '{key}', which names the take or its file", line=line)
        lines.append(line)
        texts.append(row)
    names = {name: name.removesuffix("[]").strip() or name for name in columns if name != key}
    _checked(path, names.values(), 1)
    cells = {name: list(_cells(name, [row[name] for row in texts], table)) for name in names}
    rows = tuple(
        MetadataRow(
            str(path), line, texts[number][key],
            {short: cell for name, short in names.items() if (cell := cells[name][number]) is not None},
        )
        for number, line in enumerate(lines)
    )  # fmt: skip
    return MetadataTable(str(path), key, tuple(names.values()), rows)


def _cells(name: str, texts: list[str], table: CsvTable) -> Iterator[Cell | None]:
    """Yield the cells of a column, None for an empty one."""
    if name.endswith("[]") or name.lower() == "tags":
        for text in texts:
            parts = tuple(part.strip() for part in _PARTS.split(text) if part.strip())
            yield Cell(text, parts) if parts else None
        return
    points = [table.number(text) for text in texts]
    # in a column that also has "12,5", "1.234" may be a thousand or a fraction
    mixed = points != texts and any("." in text and _NUMBER.fullmatch(text) for text in texts)
    for text, point in zip(texts, points, strict=True):
        yield Cell(text, text if mixed else _value(point, text)) if text else None


def _value(point: str, text: str) -> Value:
    """Return the value of a text; `point` is the text with a decimal point. Texts such as 007 stay texts."""
    if text.lower() in _TRUTHS:
        return _TRUTHS[text.lower()]
    if _WHOLE.fullmatch(point):
        return int(point)
    number = float(point) if _NUMBER.fullmatch(point) else math.nan
    return number if math.isfinite(number) else text


# ---- YAML ------------------------------------------------------------------------------------------------


def _read_yaml(path: str | Path, data: bytes) -> MetadataTable:
    located = _located(path, data)
    content = located.data
    if isinstance(content, dict):
        key, entries = "take", [((name,), str(name), values) for name, values in content.items()]
    elif isinstance(content, list) and content and isinstance(content[0], dict):
        if not content[0]:
            raise located.error("is empty; expected columns, one of which names the take or its file", 0)
        key = _key_of(list(map(str, content[0])))
        entries = [((number,), "", values) for number, values in enumerate(content)]
    else:
        raise located.error("expected a mapping from takes or files to their values, or a list of mappings")
    _refuse_many(path, len(entries))
    rows = [_yaml_row(located, place, name, values, key) for place, name, values in entries]
    columns = _checked(path, dict.fromkeys(name for row in rows for name in row.cells), None)
    return MetadataTable(str(path), key, tuple(columns), tuple(rows))


def _located(path: str | Path, data: bytes) -> Located:
    """Parse YAML, and keep the line of every key."""
    return parse_yaml(utf8_text(path, data, ConfigError), path)


def _yaml_row(located: Located, place: tuple[Any, ...], name: str, values: Any, key: str) -> MetadataRow:
    if not isinstance(values, dict):
        raise located.error("expected a mapping from columns to values", *place)
    values = {str(column): value for column, value in values.items()}
    if not name:
        name = str(values.pop(key, "") or "")
    if not name:
        raise located.error(f"has no '{key}', which names the take or its file", *place)
    cells = {column: _yaml_cell(located, (*place, column), value) for column, value in values.items()}
    path, line = str(located.path), located.line(*place)
    for column, cell in cells.items():
        _refuse_long(path, "" if cell is None else cell.text, line, column)
    return MetadataRow(path, line, name, {column: cell for column, cell in cells.items() if cell is not None})


def _yaml_cell(located: Located, place: tuple[Any, ...], value: Any) -> Cell | None:
    if value is None or value == "" or value == [] or (isinstance(value, float) and math.isnan(value)):
        return None
    if isinstance(value, bool):
        return Cell(str(value).lower(), value)
    if isinstance(value, int):
        return Cell(str(value), value if -_SIXTY_FOUR_BITS <= value < _SIXTY_FOUR_BITS else str(value))
    if isinstance(value, float):
        return Cell(repr(value), value)
    if isinstance(value, date | datetime):
        return Cell(value.isoformat(), value.isoformat())
    if isinstance(value, list) and not any(isinstance(part, dict | list) for part in value):
        parts = tuple(str(part) for part in value if part is not None)
        return Cell(", ".join(parts), parts)
    if isinstance(value, str):
        return Cell(value.strip(), value.strip()) if value.strip() else None
    raise located.error("expected a text, a number, true or false, or a list of texts", *place)
