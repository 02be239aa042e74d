"""The Arrow schemas of a store: takes, frames, and every kind of result. They are the contract of its Parquet files."""

from __future__ import annotations

import json

import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import KinedexError, StoreError, did_you_mean

FORMAT_VERSION = 4
"""Version of the store's layout. A store of a version that is not in `READ_VERSIONS` is refused, never guessed at."""

READ_VERSIONS = (3, 4)
"""Versions of the layout that are read; a store of an older one than `FORMAT_VERSION` is not written."""

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
)
"""One row per take. `invalid_frames` of its frames have no word. `groups` is a JSON object with the further named
groups of the source pattern."""

_RUN = ("run", pa.string())
_TAKE = (("take_id", pa.int64()), ("take", pa.string()))
_RANGE = (
    *((name, pa.int32()) for name in ("start", "stop")),
    *((name, pa.float64()) for name in ("start_seconds", "stop_seconds")),
)
"""Frames [start, stop) of a take, and the same in seconds."""

_COUNTS = (
    "frames_both",
    "frames_automatic",
    "frames_manual",
    "segments_automatic_hit",
    "segments_automatic",
    "segments_manual_hit",
    "segments_manual",
)
_QUERY = (
    *((name, pa.list_(pa.uint64())) for name in ("masks", "values")),
    *((name, pa.list_(pa.int32())) for name in ("positions", "lows", "highs")),
)
"""A keyframe query in bits of whole words."""

_RESULTS: dict[str, pa.Schema] = {
    "templates": _fields(
        _RUN,
        ("subclass", pa.string()),
        ("kind", pa.string()),
        ("features", pa.int32()),
        ("columns", pa.int32()),
        ("values", pa.list_(pa.float64())),
        ("weights", pa.list_(pa.float64())),
        ("clips", pa.list_(pa.string())),
        ("rounds", pa.int32()),
        ("costs", pa.list_(pa.float64())),
        ("take_filter", pa.string()),
        ("origin", pa.string()),
        ("clip_costs", pa.list_(pa.float64())),
        ("feature_weights", pa.list_(pa.float64())),
        ("remarks", pa.list_(pa.string())),
    ),
    "annotated_takes": _fields(
        _RUN,
        *_TAKE,
        ("frames", pa.int64()),
        ("searched", pa.float64()),
        ("fingerprint", pa.string()),
    ),
    "distance_curves": _fields(
        _RUN,
        *_TAKE,
        ("class", pa.string()),
        ("subclass", pa.string()),
        ("costs", pa.list_(pa.float32())),
        ("preselected", pa.float64()),
    ),
    "annotations": _fields(
        _RUN,
        *_TAKE,
        ("class", pa.string()),
        ("subclass", pa.string()),
        *_RANGE,
        ("cost", pa.float64()),
        ("confidence", pa.float64()),
        ("method", pa.string()),
    ),
    "ground_truth": _fields(
        _RUN,
        *_TAKE,
        ("class", pa.string()),
        ("start", pa.int32()),
        ("stop", pa.int32()),
        ("source_start", pa.int64()),
        ("source_stop", pa.int64()),
        ("origin", pa.string()),
    ),
    "metrics": _fields(
        _RUN,
        ("evaluation", pa.string()),
        ("scope", pa.string()),
        ("name", pa.string()),
        *((name, pa.float64()) for name in ("p1", "r1", "f1", "p2", "r2", "f2")),
        *((name, pa.int64()) for name in _COUNTS),
    ),
    "queries": _fields(
        _RUN,
        ("subclass", pa.string()),
        ("number", pa.int32()),
        ("origin", pa.string()),
        *_QUERY,
        ("left", pa.int32()),
        ("right", pa.int32()),
        ("columns", pa.int32()),
        *((name, pa.float64()) for name in ("fitness", "rank", "median", "best", "agreement", "precision", "recall")),
        ("runs", pa.int32()),
        ("settled", pa.bool_()),
        ("matrix", pa.list_(pa.float64())),
        ("clips", pa.list_(pa.string())),
    ),
    "keyframe_runs": _fields(
        _RUN,
        ("key", pa.string()),
        ("subclass", pa.string()),
        ("number", pa.int32()),
        ("fitness", pa.float64()),
        ("rank", pa.float64()),
        ("evaluated", pa.int64()),
        *_QUERY,
        ("history", pa.list_(pa.float64())),
    ),
    "hits": _fields(
        _RUN,
        ("saved_as", pa.string()),
        ("query", pa.string()),
        *_TAKE,
        *_RANGE,
    ),
    "ranked_hits": _fields(
        _RUN,
        ("template", pa.string()),
        ("rank", pa.int32()),
        *_TAKE,
        *_RANGE,
        ("cost", pa.float64()),
    ),
    "precision_recall": _fields(
        _RUN,
        ("variant", pa.string()),
        ("stiffness", pa.float64()),
        ("class", pa.string()),
        ("relevant", pa.int32()),
        ("ranked", pa.int32()),
        ("found", pa.int32()),
        *((name, pa.float64()) for name in ("kept", "average_precision")),
        *((name, pa.list_(pa.float64())) for name in ("precision", "recall")),
    ),
    "retrieval": _fields(
        _RUN,
        ("evaluation", pa.string()),
        ("fold", pa.string()),
        ("class", pa.string()),
        ("relevant", pa.int32()),
        ("found", pa.int32()),
        ("average_precision", pa.float64()),
        ("recall_at_tau", pa.float64()),
        ("confused_with", pa.list_(pa.string())),
    ),
    "method_cells": _fields(
        _RUN,
        ("cell", pa.string()),
        ("split", pa.string()),
        ("fold", pa.string()),
        ("method", pa.string()),
        ("take", pa.string()),
        ("frames", pa.int32()),
        ("classes", pa.list_(pa.string())),
        *((name, pa.list_(pa.int32())) for name in ("starts", "stops")),
        ("confidences", pa.list_(pa.float64())),
    ),
    "skeleton_files": _fields(
        _RUN,
        ("source_root", pa.string()),
        ("source", pa.string()),
        ("source_bytes", pa.int64()),
        ("source_mtime_ns", pa.int64()),
        ("checksum", pa.string()),
    ),
    "ingest_log": _fields(
        _RUN,
        ("source", pa.string()),
        ("stage", pa.string()),
        ("error", pa.string()),
        ("message", pa.string()),
        ("file", pa.string()),
        ("line", pa.int32()),
        ("logged_at", pa.timestamp("us", tz="UTC")),
    ),
}

RESULT_KINDS = tuple(_RESULTS)
"""The kinds of result; each is a folder of `results/` and a view of that name."""


def takes_schema() -> pa.Schema:
    """Return the schema of a takes part."""
    return _TAKES.with_metadata({_METADATA + "kind": "takes", _METADATA + "format_version": str(FORMAT_VERSION)})


def frames_schema(feature_set: FeatureSet, rate_hz: float) -> pa.Schema:
    """Return the schema of a frames part: take and frame, joints in metres, the root's orientation, the word.

    The word of an invalid frame (one that lacks a joint that the take has otherwise) is null. The metadata name the
    feature of each bit of the word, so that a part explains itself to any reader.
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
    """Return the schema of one kind of result; a KinedexError about an unknown kind names the nearest one."""
    if kind not in _RESULTS:
        raise KinedexError(f"no kind of result is named '{kind}'{did_you_mean(kind, RESULT_KINDS)}")
    metadata = {_METADATA + "kind": kind, _METADATA + "format_version": str(FORMAT_VERSION)}
    return _RESULTS[kind].with_metadata(metadata)


def conform(table: pa.Table, schema: pa.Schema, what: str) -> pa.Table:
    """Return the table with exactly the columns of the schema, in order and type.

    Parameters
    ----------
    table : pyarrow.Table
        The table to convert.
    schema : pyarrow.Schema
        The columns that it must have.
    what : str
        The name of the table in messages.

    Raises
    ------
    StoreError
        A column is missing, unknown, or does not convert; the message names it.
    """
    missing = [name for name in schema.names if name not in table.column_names]
    if missing:
        raise StoreError(f"{what}: missing column {', '.join(missing)}")
    extra = [name for name in table.column_names if name not in schema.names]
    if extra:
        raise StoreError(f"{what}: no column '{extra[0]}'{did_you_mean(extra[0], schema.names)}")
    columns = []
    for field in schema:
        try:
            columns.append(table.column(field.name).cast(field.type))
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as fault:
            reason = str(fault).splitlines()[0]
            raise StoreError(f"{what}: column {field.name} must be {field.type}: {reason}") from None
        if not field.nullable and columns[-1].null_count:
            raise StoreError(f"{what}: column {field.name} must not be null")
    return pa.table(columns, schema=schema)


def schema_problem(found: pa.Schema, expected: pa.Schema) -> str | None:
    """Return the first difference of a part's schema from the one that the store expects; None if there is none."""
    for field in expected:
        position = found.get_field_index(field.name)
        if position < 0:
            return f"column {field.name} is missing"
        if found.field(position).type != field.type:
            return f"column {field.name} is {found.field(position).type}, expected {field.type}"
    if found.names != expected.names:
        return f"columns are {', '.join(found.names)}, expected {', '.join(expected.names)}"
    has = found.metadata or {}
    for key, value in (expected.metadata or {}).items():
        # a part keeps the version that it was written in: an upgrade of the store does not rewrite it
        fits = _READ_METADATA if key == _FORMAT_KEY else {value}
        if has.get(key) not in fits:
            got = has.get(key, b"nothing").decode("utf-8", "replace")
            return f"metadata {key.decode()} is {got}, expected {value.decode()}"
    return None
