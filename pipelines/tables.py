"""Tables for people and for programs: Arrow tables printed, or written as CSV, JSON or Parquet."""

from __future__ import annotations

import csv
import io
import json
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from rich import box
from rich.table import Table

from ops.errors import KinedexError, did_you_mean

FORMATS = ("table", "csv", "json", "parquet")


def rich_table(table: pa.Table, title: str | None = None) -> Table:
    """An Arrow table as a table for the terminal: numbers to the right, floats to four digits, NULL as a dash."""
    shown = Table(title=title, box=box.SIMPLE_HEAD, pad_edge=False, header_style="bold")
    for field in table.schema:
        number = pa.types.is_integer(field.type) or pa.types.is_floating(field.type)
        shown.add_column(field.name, justify="right" if number else "left", overflow="fold")
    for row in table.to_pylist():
        shown.add_row(*(_cell(row[name]) for name in table.column_names))
    return shown


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, dict | list):
        return json.dumps(value, default=str, ensure_ascii=False)
    # rich would take [brackets] for markup
    return str(value).replace("[", r"\[")


def encode(table: pa.Table, form: str) -> bytes:
    """An Arrow table as bytes of CSV (header first), JSON (a list of objects) or Parquet.

    Raises
    ------
    KinedexError: an unknown format.
    """
    if form == "parquet":
        sink = io.BytesIO()
        pq.write_table(table, sink)
        return sink.getvalue()
    if form == "json":
        return (json.dumps(table.to_pylist(), indent=1, default=str, ensure_ascii=False) + "\n").encode()
    if form == "csv":
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(table.column_names)
        for row in table.to_pylist():
            writer.writerow(
                json.dumps(v, default=str, ensure_ascii=False) if isinstance(v, dict | list) else v
                for v in row.values()
            )
        return text.getvalue().encode()
    raise KinedexError(f"no output format '{form}'{did_you_mean(form, FORMATS)}")
