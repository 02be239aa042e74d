"""Read keypoints from a CSV or Parquet table with camera, frame, keypoint, x, y, and optional further columns."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

from kinedex.catalog.keypoint_sets import MAX_KEYPOINTS
from kinedex.ops.errors import SourceError, did_you_mean
from kinedex.storage.formats.cameras.persons import (
    FARTHEST_PX,
    OUT_OF_BOUNDS,
    Person,
    SeenPersons,
    checked_points,
    refuse_crowds,
)
from kinedex.storage.formats.csv_tables import CsvTable, decoded
from kinedex.storage.formats.source_files import file_size, source_bytes

I64 = npt.NDArray[np.int64]

MAX_ROWS = 50_000_000
"""The largest number of rows in a table."""

_MAX_CSV_BYTES = 2 << 30
_ALIASES = {
    "conf": "confidence",
    "score": "confidence",
    "likelihood": "confidence",
    "view": "camera",
    "person_id": "person",
}
_NUMBERS = ("frame", "x", "y", "confidence")
_COLUMNS = ("recording", "camera", "frame", "person", "keypoint", "x", "y", "confidence")
_REQUIRED = ("frame", "keypoint", "x", "y")
_FIRST_LINE = 2


def read_keypoint_table(path: Path, recording: str = "") -> dict[str, SeenPersons]:
    """Read the persons of all cameras of a table.

    Parameters
    ----------
    path : Path
        A file ending in .csv or .parquet.
    recording : str, optional
        The recording whose rows are read, if the table has a column `recording`.

    Returns
    -------
    dict of str to SeenPersons
        Camera → the persons that it saw; the key is "" for a table without a column `camera`. Keypoints are given by
        names or by numbers from 0.

    Raises
    ------
    SourceError
        The file is not such a table; the message names the line or the row.
    """
    table = _parquet(path) if path.suffix.lower() == ".parquet" else _csv(path)
    if not table.height:
        raise SourceError(path, "has no rows")
    if "recording" in table.columns and recording:
        known = table["recording"].unique().to_list()
        table = table.filter(pl.col("recording") == recording)
        if not table.height:
            near = did_you_mean(recording, [str(name) for name in known if name is not None])
            raise SourceError(path, f"has no rows of the recording '{recording}'{near}")
    for key in ("frame", "keypoint", "camera"):
        if key in table.columns and table[key].null_count():
            row = int(table[key].is_null().arg_true()[0])
            raise _error(path, table, row, f"`{key}` must not be empty")
    names, positions = _keypoints(path, table)
    rows = np.stack([table[key].to_numpy() for key in ("x", "y", "confidence")], axis=1)
    far = np.flatnonzero((np.abs(rows) > FARTHEST_PX).any(axis=1))
    if len(far):
        raise _error(path, table, int(far[0]), OUT_OF_BOUNDS)
    rows = checked_points(path, "a row", rows)
    count = len(names) or int(positions.max()) + 1
    return {
        str(camera): _persons(path, part, rows[part["row"].to_numpy()], positions[part["row"].to_numpy()], names, count)
        for camera, part in _by_camera(table)
    }


def _by_camera(table: pl.DataFrame) -> list[tuple[str, pl.DataFrame]]:
    table = table.with_columns(pl.int_range(pl.len(), dtype=pl.Int64).alias("row"))
    if "camera" not in table.columns:
        return [("", table)]
    return [(str(part["camera"][0]), part) for part in table.partition_by("camera", maintain_order=True)]


def _persons(
    path: Path, table: pl.DataFrame, rows: npt.NDArray[np.float64], positions: I64, names: tuple[str, ...], count: int
) -> SeenPersons:
    """Return the persons of one camera."""
    seen = SeenPersons(path, names=names)
    groups = table.select("frame", "person").with_columns(pl.struct("frame", "person").rank("dense").alias("group"))
    group = groups["group"].to_numpy().astype(np.int64) - 1
    key = group * count + positions
    order = np.argsort(key, kind="stable")
    twice = np.flatnonzero(np.diff(key[order]) == 0)
    if len(twice):
        message = "this keypoint stands twice in its frame; persons of one frame need a column `person`"
        raise _error(path, table, int(order[twice[0] + 1]), message)
    points = np.full((int(group.max()) + 1, count, 3), np.nan)
    points[:, :, 2] = 0.0
    points[group, positions] = rows
    first = groups.unique("group").sort("group")
    for number, (frame, person) in enumerate(first.select("frame", "person").iter_rows()):
        persons = seen.frames.setdefault(int(frame), [])
        if np.isfinite(points[number, :, 0]).any():
            persons.append(Person(str(person), points[number]))
            refuse_crowds(path, f"frame {frame}", persons)
    return seen


def _keypoints(path: Path, table: pl.DataFrame) -> tuple[tuple[str, ...], I64]:
    """Return the names of the keypoints (none if they are numbered), and the index of the keypoint of each row."""
    texts = table["keypoint"]
    numbers = texts.cast(pl.Int64, strict=False)
    if numbers.null_count() == 0:
        positions = numbers.to_numpy()
        wrong = np.flatnonzero((positions < 0) | (positions >= MAX_KEYPOINTS))
        if len(wrong):
            raise _error(path, table, int(wrong[0]), f"`keypoint` must be 0 to {MAX_KEYPOINTS - 1}, or a name")
        return (), positions.astype(np.int64)
    names = texts.unique(maintain_order=True)
    if len(names) > MAX_KEYPOINTS:
        raise SourceError(path, f"has {len(names)} keypoints, and {MAX_KEYPOINTS} are read at most")
    order = {name: i for i, name in enumerate(names.to_list())}
    return tuple(order), texts.replace_strict(order, return_dtype=pl.Int64).to_numpy()


def _error(path: Path, table: pl.DataFrame, row: int, message: str) -> SourceError:
    """Return an error that names the line of a CSV file, or the row of another table, from 0."""
    number = int(table["line"][row])
    if path.suffix.lower() == ".csv":
        return SourceError(path, message, line=number)
    return SourceError(path, f"row {number - _FIRST_LINE}: {message}")


def _csv(path: Path) -> pl.DataFrame:
    """Return a CSV table; raise an error with the line of a cell that should be a number but is not."""
    if file_size(path) > _MAX_CSV_BYTES:
        raise SourceError(path, f"has more than {_MAX_CSV_BYTES >> 30} GB; write Parquet, or a file for each camera")
    data = source_bytes(path)
    head = CsvTable.of(path, data[: data.find(b"\n", 4096) + 1 or len(data)])
    text = decoded(path, data)
    skipped = 1 if text[:4].lower() == "sep=" else 0
    try:
        table = pl.read_csv(
            io.BytesIO(text.encode("utf-8", "replace")), separator=head.separator, infer_schema=False,
            skip_rows=skipped, truncate_ragged_lines=True, raise_if_empty=False, n_rows=MAX_ROWS + 1,
        )  # fmt: skip
    except Exception as fault:  # polars raises many classes of errors, all for a file that is not a table
        raise SourceError(path, f"is no table that can be read: {str(fault).splitlines()[0][:200]}") from None
    table = table.with_columns(pl.int_range(_FIRST_LINE + skipped, pl.len() + _FIRST_LINE + skipped).alias("line"))
    if head.decimal_comma:
        present = [name for name in table.columns if _column(name) in _NUMBERS]
        table = table.with_columns(pl.col(name).str.replace(",", ".", literal=True) for name in present)
    return _typed(path, table)


def _parquet(path: Path) -> pl.DataFrame:
    try:
        with pq.ParquetFile(path) as file:
            if file.metadata.num_rows > MAX_ROWS:
                raise SourceError(path, f"has {file.metadata.num_rows:,} rows, and {MAX_ROWS:,} are read at most")
            wanted = [name for name in file.schema_arrow.names if _column(name) in _COLUMNS]
            found: Any = pl.from_arrow(_plain(file.read(columns=wanted)))
    except SourceError:
        raise
    except (OSError, pa.ArrowException, pl.exceptions.PolarsError, ValueError, TypeError, KeyError) as fault:
        raise SourceError(path, f"cannot be read as Parquet: {str(fault)[:200]}") from None
    table: pl.DataFrame = found
    return _typed(path, table.with_columns(pl.int_range(_FIRST_LINE, pl.len() + _FIRST_LINE).alias("line")))


def _plain(table: pa.Table) -> pa.Table:
    """Return the columns with numbers or valid texts, without metadata, which polars would trust unchecked."""
    columns = {}
    for name in dict.fromkeys(table.column_names):
        column = table.column(table.column_names.index(name))
        if pa.types.is_dictionary(column.type):
            column = pa.chunked_array([chunk.dictionary_decode() for chunk in column.chunks], column.type.value_type)
        if not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type)):
            column = column.cast(pa.large_string())
        columns[name] = column
    plain = pa.table(columns)
    plain.validate(full=True)
    return plain


def _column(name: str) -> str:
    """Return the name that this module uses for a column of a table."""
    plain = name.strip().lower()
    return _ALIASES.get(plain, plain)


def _typed(path: Path, table: pl.DataFrame) -> pl.DataFrame:
    """Return the known columns as texts and numbers; a missing confidence is NaN, a missing person ""."""
    names: dict[str, str] = {}
    for name in table.columns:
        if _column(name) in (*_COLUMNS, "line") and _column(name) not in names.values():
            names[name] = _column(name)
    table = table.select(list(names)).rename(names)
    for key in _REQUIRED:
        if key not in table.columns:
            expected = "camera, frame, keypoint, x, y, confidence"
            raise SourceError(path, f"has no column `{key}`; expected {expected}")
    texts = [key for key in ("recording", "camera", "person", "keypoint") if key in table.columns]
    try:
        table = table.with_columns(pl.col(key).cast(pl.String).str.strip_chars() for key in texts)
        for key in (key for key in _NUMBERS if key in table.columns):
            table = _numeric(path, table, key)
    except pl.exceptions.PolarsError as fault:
        raise SourceError(path, f"has columns of other types than numbers and names: {str(fault)[:200]}") from None
    if "confidence" not in table.columns:
        table = table.with_columns(pl.lit(np.nan).alias("confidence"))
    if "person" not in table.columns:
        table = table.with_columns(pl.lit("").alias("person"))
    table = table.with_columns(pl.col("person").fill_null(""))
    empty = [
        pl.when(pl.col(key) == "").then(None).otherwise(pl.col(key)).alias(key) for key in texts if key != "person"
    ]
    return table.with_columns(*empty, *(pl.col(key).fill_null(np.nan) for key in _NUMBERS[1:]))


def _numeric(path: Path, table: pl.DataFrame, key: str) -> pl.DataFrame:
    """Return a table with one column converted to numbers; raise an error for a text that is not a number."""
    given = table[key]
    if given.dtype == pl.String:
        given = given.str.strip_chars()
        given = given.set(given == "", None)
    numbers = given.cast(pl.Float64, strict=False)
    wrong = (numbers.is_null() & given.is_not_null()).arg_true()
    if key == "frame":
        whole = numbers.is_null() | ((numbers == numbers.round()) & (numbers.abs() < 1e15))
        wrong = (~whole.fill_null(False) | (numbers.is_null() & given.is_not_null())).arg_true()
    if len(wrong):
        row = int(wrong[0])
        kind = "a whole number" if key == "frame" else "a number"
        raise _error(path, table, row, f"`{key}` must be {kind}, got {str(given[row])[:50]!r}")
    return table.with_columns(numbers.cast(pl.Int64) if key == "frame" else numbers)
