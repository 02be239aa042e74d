"""Print Arrow tables on terminals, and encode them as CSV, JSON or Parquet."""

from __future__ import annotations

import io
import json
import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import pyarrow as pa
from rich import box
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, Group, JustifyMethod, RenderableType, RenderResult
from rich.markup import escape
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.wording import counted, name_list, visible, visible_text
from kinedex.pipelines.engine.display import Line, ResultTable
from kinedex.storage.formats.csv_tables import csv_line
from kinedex.storage.formats.json_text import json_text, json_value

FORMATS = ("table", "csv", "json", "parquet")

TALL = 4
"""Average number of lines of a row above which each row is printed as a block."""

_LINES = {b"lines": b"yes"}
"""Metadata that marks a column whose texts have line breaks."""

FEW_ROWS, MANY_COLUMNS = 5, 7
"""Tables with more rows and at least as many columns show only the most important columns if rows would be tall."""

_TRIED = 200  # number of rows that are laid out to choose the form

_HEAD, _FOOT = 2, 2
"""Numbers of lines before the rows of a table with headings of one line, and after its rows."""

_CAP = 60
"""Largest width to which a column is padded in a file or a pipe, and with which it counts on a terminal."""

_NARROWEST = 4
"""Minimum width of a column on a terminal, including the space between two columns."""

_TALL_FIRST = 12
"""Minimum width of the names in a table whose headings have several lines."""

_STYLES = {"plain": "", "main": "bold", "better": "green", "worse": "red", "doubtful": "yellow"}
"""The rich style of each tone of a line or cell."""

_MIN_COLUMNS = 3
"""Minimum number of columns of a table; if fewer fit, each row is printed as a block."""

_WORD = 48
"""Maximum number of characters of a word that is kept whole on a terminal, such as the name of a take; a path may be
broken.
"""

_EARLY = (
    "name", "take", "query", "template", "of_take", "actor", "class", "subclass", "start", "cost", "same", "stop",
    "share",
)  # fmt: skip
"""Columns that are most important to users, the most important first."""

_LATE = re.compile(r"(^|_)(id|run|checksum|recipe|root|source|mtime|bytes|fingerprint)(_|$)")
"""Pattern of the names of columns that are least important to users: keys, checksums and places."""


class PrintedTable:
    """An Arrow table that rich prints in a form for a terminal, a file or a pipe; no value is ever truncated.

    In a file or a pipe, each row is one line of any length. On a terminal, columns share the width, and long values are
    wrapped between words. If rows would then have more than `TALL` lines on average, or if words or names of columns
    would be broken, another form is used. A few rows are printed as blocks with a line for every column. Many rows are
    printed as a table of the most important columns, with a line below that names the other columns.

    Parameters
    ----------
    table : pyarrow.Table
        The table.
    null : str
        The text for missing values.
    """

    def __init__(self, table: pa.Table, null: str = "–") -> None:
        self._table = table
        self._null = null

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Print the table in the form that fits the console."""
        if console.soft_wrap and not console.is_terminal:
            yield Segment("".join(f"{line.rstrip()}\n" for line in self._piped(console, options)))
        elif (names := self._columns(console, options)) is not None:
            others = [name for name in self._table.column_names if name not in names]
            yield rich_table(self._table.select(names) if others else self._table, self._null)
            if others:
                remark = (
                    f"{counted(len(others), 'more column')} that would not fit: "
                    f"{name_list(list(map(visible, others)))}; a "
                    "wider terminal shows more, `| less -S` and --format json show all"
                )
                yield Text(textwrap.fill(remark, options.max_width, break_on_hyphens=False))
        else:
            for number, row in enumerate(_texts(self._table, self._null), 1):
                yield Text(f"row {number:,}", style="bold")
                yield pairs(zip(self._table.column_names, row, strict=True))

    def _piped(self, console: Console, options: ConsoleOptions) -> Iterator[str]:
        """Yield the table as lines for a file or a pipe, one per row."""
        rows = _texts(self._table, self._null)
        if rows and all(_is_plain(text) for row in (self._table.column_names, *rows) for text in row):
            yield from _plain_lines(self._table, rows)
            return
        whole = rich_table(self._table, null=self._null)
        for line in console.render_lines(whole, options.update_width(_natural_width(whole, console, options))):
            yield "".join(segment.text for segment in line)

    def _columns(self, console: Console, options: ConsoleOptions) -> list[str] | None:
        """Return the names of the columns that are shown as a table; None if each row is printed as a block."""
        names: list[str] = self._table.column_names
        tried = self._table.slice(0, _TRIED)
        rows = _texts(tried, self._null)
        columns = list(zip(names, *rows, strict=True))
        broken = _width([max(map(_longest_word, texts)) for texts in columns]) > options.max_width
        tall = self._is_tall(tried, console, options)
        if not broken and not tall:
            return names
        if 0 < len(rows) <= FEW_ROWS or len(set(names)) < len(names) or (len(names) < MANY_COLUMNS and tall):
            return None  # few rows, or few columns with long texts; all columns should be shown
        fitting = _fitting({texts[0]: min(_CAP, max(map(cell_len, texts))) for texts in columns}, options.max_width)
        return fitting if len(fitting) >= _MIN_COLUMNS else None if rows else names

    def _is_tall(self, tried: pa.Table, console: Console, options: ConsoleOptions) -> bool:
        """Return whether rich would break the names of columns, or break rows into many lines."""
        if not tried.num_columns:
            return False
        if tried.num_columns * _NARROWEST > options.max_width:
            return True  # rich would lay out columns without any width
        lines = console.render_lines(rich_table(tried), options, pad=False)
        texts = ["".join(segment.text for segment in line).strip() for line in lines]
        rule = next(number for number, text in enumerate(texts) if text and not text.strip("─"))
        if rule > _HEAD and (self._table.num_rows <= FEW_ROWS or self._table.num_columns >= MANY_COLUMNS):
            return True  # names of columns are broken
        return len(texts) - rule - _FOOT > TALL * int(tried.num_rows)


def _longest_word(text: str) -> int:
    """Return the width of the longest word in a text that is not broken."""
    return max((width for word in text.split() if (width := cell_len(word)) <= _WORD), default=1)


def _width(columns: Iterable[int]) -> int:
    """Return the width of a table whose columns have the given widths."""
    return sum(width + 3 for width in columns) - 1


def _fitting(widths: dict[str, int], width: int) -> list[str]:
    """Return as many of the most important columns as fit into a width, in the table's order.

    Keys, checksums and places come after all others.
    """
    chosen: list[str] = []
    for name in sorted(widths, key=_importance):
        if _width(widths[one] for one in (*chosen, name)) > width:
            break
        chosen.append(name)
    return [name for name in widths if name in chosen]


def _importance(name: str) -> int:
    """Return the sort key of a column by its importance to users; equal keys keep the order of the table."""
    return _EARLY.index(name) if name in _EARLY else len(_EARLY) + bool(_LATE.search(name))


def wrapped(table: pa.Table, column: str, width: int) -> pa.Table:
    """Break the texts of a column into lines.

    Parameters
    ----------
    table : pyarrow.Table
        The table.
    column : str
        Name of a column of texts.
    width : int
        Largest number of characters in a line.

    Returns
    -------
    pyarrow.Table
        The table for a file or a pipe, in which rows are as wide as their longest text.
    """
    texts = table.column(column).to_pylist()
    lines = [
        text and textwrap.fill(text, width, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)
        for text in texts
    ]
    index = table.schema.get_field_index(column)
    return table.set_column(index, table.schema.field(index).with_metadata(_LINES), pa.array(lines, pa.string()))


def plain_text(text: str) -> Text:
    """Return a text of one line for a cell, without markup and with control characters escaped."""
    return Text(visible(text))


def pairs(lines: Iterable[tuple[str, str]]) -> Table:
    """Return names and texts as a table of two columns; long texts are wrapped, never truncated."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, text in lines:
        table.add_row(plain_text(name), Text(visible_text(text)))
    return table


def result_tables(parts: Sequence[ResultTable | Line]) -> RenderableType:
    """Convert tables of results, and the lines between them, to a rich renderable."""
    shown = [_line(part) if isinstance(part, Line) else result_table(part) for part in parts]
    return shown[0] if len(shown) == 1 else Group(*shown)


def _line(line: Line) -> Text:
    return Text(visible(line.text), style=_STYLES[line.tone])


def result_table(table: ResultTable) -> Table:
    """Convert a table of results to a rich table."""
    wide, tall = table.layout == "wide", table.layout == "tall"
    shown = Table(
        title=table.title and escape(table.title),
        title_justify="left",
        caption=table.caption and escape(table.caption),
        caption_justify="left" if tall else "center",
        box=box.SIMPLE_HEAD,
        padding=(0, 1) if wide else (0, 1, 0, 0),
        pad_edge=False,
        header_style="bold",
    )
    for place, name in enumerate(table.columns):
        heading = Text(visible_text(name))
        if place in table.texts:
            shown.add_column(heading, overflow="ellipsis" if wide else "fold", min_width=_TALL_FIRST if tall else None)
        else:
            shown.add_column(heading, justify="right", no_wrap=not wide)
    for row in table.rows:
        if row.section:
            shown.add_section()
        shown.add_row(*map(plain_text, row.cells), style=_STYLES[row.tone] or None)
    return shown


def _natural_width(table: Table, console: Console, options: ConsoleOptions) -> int:
    return Measurement.get(console, options.update_width(1_000_000), table).maximum


def rich_table(table: pa.Table, null: str = "–") -> Table:
    """Convert an Arrow table to a rich table: numbers right-aligned, floats with four digits, NULL as a dash."""
    shown = Table(box=box.SIMPLE_HEAD, pad_edge=False, header_style="bold")
    for field in table.schema:
        justify: JustifyMethod = "right" if _is_number(field.type) else "left"
        shown.add_column(plain_text(field.name), justify=justify, overflow="fold")
    for row in _texts(table, null):
        # use plain text, because rich would interpret [brackets] as markup
        shown.add_row(*map(Text, row))
    return shown


def _is_plain(text: str) -> bool:
    """Return whether a text is one line."""
    return "\n" not in text


def _plain_lines(table: pa.Table, rows: list[list[str]]) -> Iterator[str]:
    """Yield the lines of `rich_table` at its natural width, some 70 times as fast as rich itself.

    No column is padded beyond `_CAP` characters: cells after a longer text are shifted to the right.
    """
    names = table.column_names
    widths = [min(_CAP, max(cell_len(text) for text in column)) for column in zip(names, *rows, strict=True)]
    right = [_is_number(field.type) for field in table.schema]

    def line(texts: list[str]) -> str:
        cells = (
            " " * (width - cell_len(text)) + text if number else text + " " * (width - cell_len(text))
            for text, width, number in zip(texts, widths, right, strict=True)
        )
        return " " + "   ".join(cells)

    yield ""
    yield line(names)
    yield " " + "─" * (sum(widths) + 3 * len(widths) - 3)
    yield from map(line, rows)
    yield ""


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind))


def _texts(table: pa.Table, null: str) -> list[list[str]]:
    """Return the texts of the cells, row by row; only columns marked as having several lines have line breaks."""
    lines = [field.name == "explain_value" or field.metadata == _LINES for field in table.schema]
    return [
        [visible_text(text) if broken else visible(text) for text, broken in zip(cells, lines, strict=True)]
        for cells in ([_cell(value, null) for value in row] for row in _rows(table))
    ]


def _cell(value: Any, null: str) -> str:
    if value is None:
        return null
    if isinstance(value, float):
        return f"{value:.4g}"
    return _nested(value) if isinstance(value, dict | list) else str(value)


def encode(table: pa.Table, form: str) -> bytes:
    """Encode an Arrow table as CSV (header first), JSON (a list of objects) or Parquet.

    Columns of equal names are all kept. CSV files repeat the name; in JSON and Parquet, where names must differ, the
    second x is called x_1. `json_value` describes the values of JSON. In CSV, an apostrophe is put before a text that
    a spreadsheet would take for a formula.

    Parameters
    ----------
    table : pyarrow.Table
        The table.
    form : str
        The format: csv, json or parquet.

    Returns
    -------
    bytes
        The content of a file.

    Raises
    ------
    KinedexError
        If the format is unknown, or Python cannot represent a value.
    """
    if form == "parquet":
        import pyarrow.parquet as pq

        sink = io.BytesIO()
        pq.write_table(table.rename_columns(distinct_names(table.column_names)), sink)
        return sink.getvalue()
    if form == "json":
        names = distinct_names(table.column_names)
        return json_text([dict(zip(names, row, strict=True)) for row in _rows(table)]).encode()
    if form == "csv":
        rows = ([_nested(value) if isinstance(value, dict | list) else value for value in row] for row in _rows(table))
        return "".join(map(csv_line, [table.column_names, *rows])).encode()
    raise KinedexError(f"no output format '{form}'{did_you_mean(form, FORMATS)}")


def _rows(table: pa.Table) -> Iterator[tuple[Any, ...]]:
    """Yield the rows as tuples, since two columns may have the same name."""
    columns = [_values(name, column) for name, column in zip(table.column_names, table.columns, strict=True)]
    return zip(*columns, strict=True)


def _values(name: str, column: pa.ChunkedArray) -> list[Any]:
    try:
        values: list[Any] = column.to_pylist()
    except (ValueError, OverflowError) as fault:
        raise KinedexError(
            f"column {name} holds a {column.type} that cannot be written: {fault}; "
            f"turn it into text in the query: {name}::VARCHAR"
        ) from None
    return values


def distinct_names(names: list[str]) -> list[str]:
    """Return the names, with _1, _2, … appended to repeated names."""
    taken = set(names)
    seen: set[str] = set()
    result = []
    for name in names:
        free = name
        number = 0
        while free in seen or (number and free in taken):
            number += 1
            free = f"{name}_{number}"
        seen.add(free)
        result.append(free)
    return result


def _nested(value: Any) -> str:
    """Return a list or a struct as JSON text."""
    return json.dumps(json_value(value), ensure_ascii=False, allow_nan=False)
