"""Define the Arrow schemas of the Parquet files of a store: takes, frames, labels and every kind of result."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from operator import le
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.sql.result_views import RESULT_VIEWS
from kinedex.ops.errors import KinedexError, StoreError, did_you_mean
from kinedex.ops.intervals import Hit, Interval, in_seconds

FORMAT_VERSION = 4
"""Version of the store's layout; a store of a version that is not in `READ_VERSIONS` is refused."""

READ_VERSIONS = (3, 4)
"""Versions of the layout that can be read; a store older than `FORMAT_VERSION` cannot be written."""

_METADATA = "kinedex."
_FORMAT_KEY = f"{_METADATA}format_version".encode()
_READ_METADATA = {str(version).encode() for version in READ_VERSIONS}


def _fields(*pairs: tuple[str, pa.DataType]) -> pa.Schema:
    return pa.schema([pa.field(name, kind) for name, kind in pairs])


_TAKES = _fields(
    ("take_id", pa.int64()),
    ("name", pa.string()),
    ("source", pa.string()),
    ("source_root", pa.string()),
    ("checksum", pa.string()),
    ("source_bytes", pa.int64()),
    ("source_mtime_ns", pa.int64()),
    ("format", pa.string()),
    ("skeleton", pa.string()),
    ("skeleton_source", pa.string()),
    ("recipe", pa.string()),
    ("unit", pa.string()),
    ("source_rate_hz", pa.float64()),
    ("source_frames", pa.int64()),
    ("rate_hz", pa.float64()),
    ("frames", pa.int64()),
    ("seconds", pa.float64()),
    ("invalid_frames", pa.int64()),
    ("actor", pa.string()),
    ("class", pa.string()),
    ("clip", pa.string()),
    ("groups", pa.string()),
    ("warnings", pa.list_(pa.string())),
    ("known", pa.uint64()),
)
"""The columns of takes, one row per take. `invalid_frames` is the number of frames without a word. `groups` is a JSON
object with the named groups of the source pattern, each of which is also a declared column (`TakeColumn`). `known` is
a mask of the features that the body has joints for, with the bits of the word; null means all.
"""

TRACK_FORMAT, DEPTH_FORMAT = "track", "depth"
"""The `format` of takes that were tracked or stabilised, and of those that were reconstructed from depth images."""

RECORDED_FORMATS = (TRACK_FORMAT, DEPTH_FORMAT)
"""The formats of takes made from recordings: they have no motion file, and an ingest skips them."""

COLUMN_TYPES = {
    "VARCHAR": pa.string(),
    "DOUBLE": pa.float64(),
    "BIGINT": pa.int64(),
    "BOOLEAN": pa.bool_(),
    "VARCHAR[]": pa.list_(pa.string()),
}
"""A dict from the SQL name of a type to its Arrow type, for declared columns of takes."""


@dataclass(frozen=True)
class TakeColumn:
    """A declared column of takes, which a store has in addition to the columns of every store.

    Attributes
    ----------
    type : str
        One of `COLUMN_TYPES`.
    origin : str
        Source of its values: "pattern" (a named group of `patterns`), "metadata" (a table of the user), "quality" (a
        number measured at ingest) or "file" (an entry of the motion file).
    unit : str
        Unit of its values; empty if they have none.
    meaning : str
        A description of the column for users.
    """

    type: str
    origin: Literal["pattern", "metadata", "quality", "file"]
    unit: str = ""
    meaning: str = ""


GROUP_COLUMN = TakeColumn("VARCHAR", "pattern", meaning="a named group of `patterns`")
"""The declaration of a column that holds a named group."""

_LABELS = _fields(
    ("id", pa.string()),
    ("replaces", pa.string()),
    ("take", pa.string()),
    ("checksum", pa.string()),
    ("class", pa.string()),
    ("start", pa.int32()),
    ("stop", pa.int32()),
    ("limb", pa.string()),
    ("verdict", pa.string()),
    ("annotator", pa.string()),
    ("origin", pa.string()),
    ("source", pa.string()),
    ("created", pa.timestamp("us", tz="UTC")),
    ("confidence", pa.float64()),
    ("note", pa.string()),
)
"""The columns of labels, one row per statement of a person about the frames [start, stop) of a take. Rows are never
changed; a row may replace an earlier one, which it names by its id. `checksum` is the checksum of the take's source
when the statement was made.
"""

LABEL_VERDICTS = ("positive", "negative", "withdrawn")
"""The verdicts of a label: the frames show the class, the frames do not, or the replaced row is withdrawn."""

LABEL_ORIGINS = ("imported", "accepted", "corrected", "drawn")
"""The origins of a label: read from a file, an accepted (or rejected) or corrected annotation, or drawn by a person."""

_SQL_TYPES = {
    **COLUMN_TYPES,
    "INTEGER": pa.int32(),
    "UBIGINT": pa.uint64(),
    "FLOAT": pa.float32(),
    "TIMESTAMP WITH TIME ZONE": pa.timestamp("us", tz="UTC"),
}


def arrow_type(name: str) -> pa.DataType:
    """Return the Arrow type of a view's column from its DuckDB type."""
    if name.endswith("[]"):
        return pa.list_(arrow_type(name.removesuffix("[]")))
    if name.startswith("STRUCT("):
        parts = (part.split(maxsplit=1) for part in name.removeprefix("STRUCT(").removesuffix(")").split(", "))
        return pa.struct([(field, arrow_type(kind)) for field, kind in parts])
    return _SQL_TYPES[name]


# A new column must be added to a result at the end (`ResultPart.columns`).
_RESULTS = {view.name: _fields(*((one.name, arrow_type(one.type)) for one in view.stored)) for view in RESULT_VIEWS}

_REQUIRED = {
    "takes": tuple(name for name in _TAKES.names if name != "known"),
    "labels": tuple(_LABELS.names),
}
"""The columns that every part of takes or labels has; parts of frames have all columns, parts of results at least
`run`. A column that was added to a schema later is not listed, because older parts lack it; it is null in their rows.
"""

RESULT_KINDS = tuple(_RESULTS)
"""The kinds of results; each has a folder in `results/` and a view of that name."""

DATABASE = "kinedex.duckdb"
"""The file in a store that has all views for other DuckDB clients (`storage.store.database_file`)."""

PART_FOLDERS = ("frames", "takes", "labels", *(f"results/{kind}" for kind in RESULT_KINDS))
"""The folders of parts, relative to the store."""


def takes_schema(columns: Mapping[str, TakeColumn] | None = None) -> pa.Schema:
    """Return the schema of takes.

    Parameters
    ----------
    columns : mapping of str to TakeColumn, optional
        The declared columns of the store (`Manifest.columns`), which come after the others.
    """
    declared = {name: column for name, column in (columns or {}).items() if name.lower() not in _TAKES.names}
    fields = [*_TAKES, *(pa.field(name, COLUMN_TYPES[column.type]) for name, column in declared.items())]
    return pa.schema(fields, {_METADATA + "kind": "takes", _METADATA + "format_version": str(FORMAT_VERSION)})


def labels_schema() -> pa.Schema:
    """Return the schema of a labels part."""
    return _LABELS.with_metadata({_METADATA + "kind": "labels", _METADATA + "format_version": str(FORMAT_VERSION)})


def column_problem(name: str, column: TakeColumn, declared: Mapping[str, TakeColumn]) -> str | None:
    """Return the reason why a column of takes cannot be declared; None if it can.

    Parameters
    ----------
    name : str
        The name of the column; SQL ignores case.
    column : TakeColumn
        Its declaration.
    declared : mapping of str to TakeColumn
        The columns that the store has declared.
    """
    standing = declared.get(name)
    if column.type not in COLUMN_TYPES:
        return f"its type is {column.type}, and must be one of {', '.join(COLUMN_TYPES)}"
    if name.lower() in _TAKES.names:
        return "every store has a column of this name"
    if not name.isprintable() or not name.strip() or len(name) > LONGEST_COLUMN_NAME:
        return f"its name must be printable, of 1 to {LONGEST_COLUMN_NAME} characters"
    if standing is not None and (standing.type, standing.origin) != (column.type, column.origin):
        return f"the store has a column of this name already, {standing.type} of origin {standing.origin}"
    if standing is None and (same := [other for other in declared if other.lower() == name.lower()]):
        return f"the store has a column '{same[0]}', which SQL does not distinguish from it"
    return None


LONGEST_COLUMN_NAME = 100
"""The largest number of characters in the name of a declared column."""


def frames_schema(feature_set: FeatureSet, rate_hz: float) -> pa.Schema:
    """Return the schema of a frames part: take and frame, joints in metres, the root's orientation, the word.

    The word of an invalid frame (one that lacks a joint that the take has otherwise) is null. The schema's metadata
    name the feature of each bit of the word, so that a part is self-describing.
    """
    point = pa.struct([("x", pa.float32()), ("y", pa.float32()), ("z", pa.float32())])
    quaternion = pa.struct([(axis, pa.float32()) for axis in "wxyz"])
    fields = [pa.field("take_id", pa.int64(), nullable=False), pa.field("frame", pa.int32(), nullable=False)]
    fields += [pa.field(joint, point) for joint in feature_set.joints]
    fields += [pa.field("root_orientation", quaternion), pa.field("word", pa.uint64())]
    bits = {
        str(feature.number - 1): {
            "number": feature.number,
            "name": feature.name,
            "feature_set": feature_set.set_of(feature.number).name,
        }
        for feature in feature_set.features
    }
    metadata = {
        "kind": "frames",
        "format_version": str(FORMAT_VERSION),
        "rate_hz": repr(float(rate_hz)),
        "feature_set": feature_set.name,
        "feature_set_version": str(feature_set.version),
        "feature_set_digest": feature_set.digest,
        "bits": json.dumps(bits, separators=(",", ":")),
    }
    return pa.schema(fields, {_METADATA + key: value for key, value in metadata.items()})


def result_schema(kind: str) -> pa.Schema:
    """Return the schema of a kind of result; raise a KinedexError with the nearest name if it is unknown."""
    if kind not in _RESULTS:
        raise KinedexError(f"no kind of result is named '{kind}'{did_you_mean(kind, RESULT_KINDS)}")
    metadata = {_METADATA + "kind": kind, _METADATA + "format_version": str(FORMAT_VERSION)}
    return _RESULTS[kind].with_metadata(metadata)


def ranking_schema() -> pa.Schema:
    """Return the schema of ranked hits in memory: the stored columns and `mirrored`, for searches of mirror images.

    Hits of keyframe queries have the schema of the results `hits`. The columns of an interval come first in both.
    """
    return result_schema("ranked_hits").append(pa.field("mirrored", pa.bool_()))


def comparison_schema() -> pa.Schema:
    """Return the schema of hits that were compared with examples: that of ranked hits, with two more columns."""
    return ranking_schema().append(pa.field("similarity", pa.float64())).append(pa.field("probable", pa.bool_()))


def hits_table(
    schema: pa.Schema, takes: pa.Table, starts: npt.NDArray[np.int64], stops: npt.NDArray[np.int64], rate_hz: float,
    **columns: object,
) -> pa.Table:  # fmt: skip
    """Make a table of hits, the form that stages, the store, Python, SQL, reports and the explorer share.

    Parameters
    ----------
    schema : pyarrow.Schema
        The schema of the results `hits`, or `ranking_schema`.
    takes : pyarrow.Table
        The id and the name of the take of each hit.
    starts, stops : int64 array (H,)
        Half-open ranges of analysis frames.
    rate_hz : float
        The analysis rate.
    **columns
        The other columns of the schema; `run` is empty unless given.
    """
    places = {
        "take_id": takes.column(0),
        "take": takes.column(1),
        "start": starts.astype(np.int32),
        "stop": stops.astype(np.int32),
        "start_seconds": in_seconds(starts, rate_hz),
        "stop_seconds": in_seconds(stops, rate_hz),
    }
    return pa.table({"run": pa.repeat("", len(starts)), **places, **columns}, schema=schema)


def hits_of(table: pa.Table, named: str = "template") -> list[Hit]:
    """Return the rows of a table of hits as objects, for a few hits that are printed or shown on a page.

    Parameters
    ----------
    table : pyarrow.Table
        Rows with the columns take, start and stop, and optionally cost, mirrored, similarity and probable.
    named : str
        The column with the name of the template or query.
    """
    return [
        Hit(
            Interval(row["take"], row["start"], row["stop"]), row[named], row.get("cost"), row.get("mirrored", False),
            row.get("similarity"), row.get("probable"),
        )
        for row in table.to_pylist()
    ]  # fmt: skip


def result_table(kind: str, rows: Iterable[Mapping[str, Any]], run: str) -> pa.Table:
    """Return rows of a kind of result of one run as a table; columns that a row lacks are null."""
    return pa.Table.from_pylist([{"run": run, **row} for row in rows], schema=result_schema(kind))


def columns_table(kind: str, columns: Mapping[str, Any], **constants: object) -> pa.Table:
    """Return rows of a kind of result, made from columns and from values that are the same in every row."""
    schema, count = result_schema(kind), len(next(iter(columns.values())))
    same = {name: pa.repeat(pa.scalar(value, schema.field(name).type), count) for name, value in constants.items()}
    return with_columns(pa.table({**columns, **same}), schema)


def with_columns(table: pa.Table, schema: pa.Schema) -> pa.Table:
    """Return the table with exactly the columns of the schema; missing columns are filled with nulls.

    This is for parts that were written before a column existed. Columns that are not in the schema are dropped.
    """
    there = dict(zip(table.column_names, table.columns, strict=True))
    return pa.table([_column(there.get(field.name), field, table.num_rows) for field in schema], schema=schema)


def _column(column: pa.ChunkedArray | None, field: pa.Field, rows: int) -> pa.ChunkedArray:
    """Return a column with the field's type, or nulls if it is None; conversion needs the slow `pyarrow.compute`."""
    if column is None:
        return pa.chunked_array([pa.nulls(rows, field.type)])
    return column if column.type == field.type else column.cast(field.type)


def sorted_by(table: pa.Table, name: str) -> pa.Table:
    """Return the rows sorted by a column without nulls; sorted rows are returned unchanged, without slow imports."""
    values = table.column(name).to_pylist()
    return table if all(map(le, values, values[1:])) else table.sort_by(name)


def conform(table: pa.Table, schema: pa.Schema, what: str) -> pa.Table:
    """Convert a table to exactly the columns of the schema, in order and type.

    Parameters
    ----------
    table : pyarrow.Table
        The table to convert.
    schema : pyarrow.Schema
        The required columns.
    what : str
        The name of the table in messages.

    Raises
    ------
    StoreError
        A column is missing, unknown, or cannot be converted; the message names it.
    """
    names, there = schema.names, table.column_names
    missing = [name for name in names if name not in there]
    if missing:
        raise StoreError(f"{what}: missing column {', '.join(missing)}")
    extra = [name for name in there if name not in names]
    if extra:
        raise StoreError(f"{what}: no column '{extra[0]}'{did_you_mean(extra[0], names)}")
    columns = []
    for field in schema:
        try:
            column = table.column(field.name)
            columns.append(column if column.type == field.type else column.cast(field.type))
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as fault:
            reason = str(fault).splitlines()[0]
            raise StoreError(f"{what}: column {field.name} must be {field.type}: {reason}") from None
        if not field.nullable and columns[-1].null_count:
            raise StoreError(f"{what}: column {field.name} must not be null")
    return pa.table(columns, schema=schema)


def schema_problem(found: pa.Schema, expected: pa.Schema) -> str | None:
    """Return the first difference between a part's schema and the expected one; None if there is none.

    Columns that were added later may be missing (`_REQUIRED`), since a part keeps the columns that it was written with.
    """
    kind = (expected.metadata or {}).get(f"{_METADATA}kind".encode(), b"").decode()
    required = expected.names if kind == "frames" else _REQUIRED.get(kind, ("run",))
    for field in expected:
        position = found.get_field_index(field.name)
        if position < 0 and field.name in required:
            return f"column {field.name} is missing"
        if position >= 0 and found.field(position).type != field.type:
            return f"column {field.name} is {found.field(position).type}, expected {field.type}"
    unknown = [name for name in found.names if name not in expected.names]
    if unknown or len(set(found.names)) != len(found.names):
        return f"columns are {', '.join(found.names)}, expected {', '.join(expected.names)}"
    has = found.metadata or {}
    for key, value in (expected.metadata or {}).items():
        # a part keeps the format version it was written in: upgrading the store does not rewrite it
        fits = _READ_METADATA if key == _FORMAT_KEY else {value}
        if has.get(key) not in fits:
            got = has.get(key, b"nothing").decode("utf-8", "replace")
            return f"metadata {key.decode()} is {got}, expected {value.decode()}"
    return None
