"""Select annotations or labels by take, class, interval, SQL filter, or the rows of a table file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl
import pyarrow as pa

from kinedex.ops.errors import KinedexError
from kinedex.storage import duckdb_sql
from kinedex.storage.formats.csv_tables import unguarded
from kinedex.storage.store.store import Store, data_frame

KEY = ("take", "class", "start", "stop")
"""The columns that identify an annotation or a label in a file of rows."""


@dataclass(frozen=True)
class RowSelection:
    """The criteria by which a user selects rows.

    Attributes
    ----------
    takes, classes : tuple of str
        Names; empty for all. A class includes its subclasses.
    start, stop : int, optional
        Frames that the rows must overlap.
    where : str, optional
        A SQL filter over the columns of the rows.
    rows : Path, optional
        A file (.csv, .json, .parquet) with the columns of `KEY`, such as `kinedex sql` writes.
    every : bool
        True to select all rows if no other criterion is given.
    """

    takes: tuple[str, ...] = ()
    classes: tuple[str, ...] = ()
    start: int | None = None
    stop: int | None = None
    where: str | None = None
    rows: Path | None = None
    every: bool = False

    @property
    def is_empty(self) -> bool:
        """True if no criterion is given."""
        edges = self.start is not None or self.stop is not None
        return not (self.takes or self.classes or edges or self.where or self.rows or self.every)


def selected_rows(table: pa.Table, selection: RowSelection, noun: str, *, keep_order: bool = False) -> pl.DataFrame:
    """Select rows of annotations or labels by criteria.

    Parameters
    ----------
    table : pyarrow.Table
        Annotations or labels.
    selection : RowSelection
        The criteria.
    noun : str
        The noun for a row, such as "annotation".
    keep_order : bool, optional
        Return the rows in the order of the table, not by take and start.

    Raises
    ------
    KinedexError
        The filter or the file is invalid, or names a row that does not exist.
    """
    if selection.where is not None:
        try:
            table = duckdb_sql.rows_where(table, f"{noun}s", selection.where)
        except duckdb_sql.Error as fault:
            raise KinedexError(
                f"the filter over {noun}s does not work: {selection.where}\n  {duckdb_sql.first_line(fault)}\n"
                f"  columns of {noun}s: {', '.join(table.column_names)}"
            ) from None
    found = data_frame(table)
    if selection.takes:
        found = found.filter(pl.col("take").is_in(selection.takes))
    if selection.classes:
        named = [name for name in ("class", "subclass") if name in found.columns]
        found = found.filter(pl.any_horizontal(pl.col(name).is_in(selection.classes) for name in named))
    if selection.start is not None:
        found = found.filter(pl.col("stop") > selection.start)
    if selection.stop is not None:
        found = found.filter(pl.col("start") < selection.stop)
    if selection.rows is not None:
        found = _of_file(found, selection.rows, noun)
    return found if keep_order else found.sort("take", "start", "stop", "class", maintain_order=True)


def _of_file(found: pl.DataFrame, path: Path, noun: str) -> pl.DataFrame:
    readers: dict[str, Any] = {".csv": pl.read_csv, ".json": pl.read_json, ".parquet": pl.read_parquet}
    reader: Callable[[Path], pl.DataFrame] | None = readers.get(path.suffix.lower())
    if reader is None:
        raise KinedexError(f"{path}: a file of rows must be .csv, .json or .parquet")
    try:
        rows = reader(path)
    except (OSError, pl.exceptions.PolarsError) as fault:
        raise KinedexError(f"{path}: cannot be read: {str(fault).splitlines()[0]}") from None
    missing = [name for name in KEY if name not in rows.columns]
    if missing:
        raise KinedexError(f"{path}: has no column '{missing[0]}'; a file of rows has {', '.join(KEY)}")
    try:
        asked = rows.select(pl.col("take", "class").cast(pl.String), pl.col("start", "stop").cast(pl.Int32)).unique()
    except pl.exceptions.PolarsError as fault:
        raise KinedexError(f"{path}: start and stop must be frames: {str(fault).splitlines()[0]}") from None
    if path.suffix.lower() == ".csv":
        asked = asked.with_columns(pl.col("take", "class").map_elements(unguarded, return_dtype=pl.String))
    unknown = asked.join(found, on=list(KEY), how="anti").sort(KEY)
    if unknown.height:
        take, label, start, stop = unknown.row(0)
        raise KinedexError(
            f"{path}: {unknown.height} of its {asked.height} rows are no {noun}, such as {label} in "
            f"{take}[{start}:{stop}]"
        )
    return found.join(asked, on=list(KEY), how="semi", maintain_order="left")


def least_confident_first(annotations: pl.DataFrame) -> pl.DataFrame:
    """Return annotations in the order in which a person reviews them: the least confident first.

    Of the orders that were compared, this one needs the fewest reviews (docs/studies.md). Annotations of equal
    confidence are ordered by take and start; those without a confidence come last.
    """
    return annotations.sort("confidence", "take", "start", "stop", "class", nulls_last=True)


class Rejections:
    """The intervals that people have rejected for a class.

    Parameters
    ----------
    store : Store
        The store that has the labels.
    """

    def __init__(self, store: Store) -> None:
        self._rejected = frozenset(
            (row["take"], row["class"], row["start"], row["stop"])
            for row in store.labels().to_pylist()
            if row["verdict"] == "negative"
        )

    def include(self, annotation: Mapping[str, Any]) -> bool:
        """Return whether an annotation, a row with class and subclass, was rejected with exactly its start and stop."""
        place = annotation["start"], annotation["stop"]
        names = annotation["class"], annotation["subclass"]
        return any((annotation["take"], name, *place) in self._rejected for name in names)
