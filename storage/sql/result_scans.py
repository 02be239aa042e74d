"""Build the SELECTs behind the views of results, with the origin of each row, and the table behind those of labels."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pyarrow as pa

from kinedex.catalog.sql.columns import ORIGIN
from kinedex.catalog.sql.result_views import ALL
from kinedex.catalog.sql.views import VIEWS
from kinedex.ops.intervals import in_seconds
from kinedex.storage import duckdb_sql
from kinedex.storage.snapshot.manifest import ResultPart
from kinedex.storage.snapshot.parts import column_count, part_file
from kinedex.storage.snapshot.schemas import RESULT_KINDS, result_schema
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.snapshot.stored_labels import current_labels
from kinedex.storage.snapshot.visible_results import origin_of, shown_parts

ALL_VIEWS = {f"{ALL}{kind}": kind for kind in RESULT_KINDS}
"""A dict from the name of each view that shows the rows of every pipeline to its kind of results."""


def result_parts(store: Snapshot, view: str) -> tuple[ResultPart, ...]:
    """Return the parts that a view of results reads: of one pipeline, or of all pipelines for the prefix `all_`."""
    if view in ALL_VIEWS:
        return store.manifest.results.get(ALL_VIEWS[view], ())
    return shown_parts(store.manifest, view)


def result_select(store: Snapshot, view: str) -> str:
    """Return the SELECT of a view of results."""
    kind = ALL_VIEWS.get(view, view)
    return duckdb_sql.result_rows(result_schema(kind), ORIGIN, _scans(store, kind, result_parts(store, view)))


def _scans(store: Snapshot, kind: str, parts: Iterable[ResultPart]) -> list[duckdb_sql.ResultScan]:
    """Return one scan for the parts of each combination of origin and number of columns."""
    found: dict[tuple[object, ...], duckdb_sql.ResultScan] = {}
    for part in parts:
        file = part_file(store.path, part.path)
        width, origin = part.columns or column_count(file), origin_of(store.manifest, kind, part)
        key = (width, *origin.values())
        others = found[key].files if key in found else ()
        found[key] = duckdb_sql.ResultScan((*others, file), width, origin)
    return list(found.values())


_COLUMNS = [column.name for view in VIEWS if view.name == "label_history" for column in view.columns]


def shown_labels(store: Snapshot) -> pa.Table:
    """Return all rows of labels with the columns of the view `label_history`."""
    rows = store.labels(history=True)
    current = set(current_labels(rows).column("id").to_pylist())
    ids, checksums = (store.take_ids, store.checksums) if rows.num_rows else ({}, {})
    takes = rows.column("take").to_pylist()
    checks = zip(takes, rows.column("checksum").to_pylist(), strict=True)
    changed = [
        checksums[take] != (checksum or checksums[take]) if take in checksums else None for take, checksum in checks
    ]
    added = {
        "take_id": pa.array([ids.get(take) for take in takes], pa.int64()),
        "start_seconds": _seconds(rows.column("start"), store.rate_hz),
        "stop_seconds": _seconds(rows.column("stop"), store.rate_hz),
        "file_changed": pa.array(changed, pa.bool_()),
        "current": pa.array([one in current for one in rows.column("id").to_pylist()], pa.bool_()),
    }
    for name, column in added.items():
        rows = rows.append_column(name, column)
    return rows.select(_COLUMNS).replace_schema_metadata(None)


def _seconds(frames: pa.ChunkedArray, rate_hz: float) -> pa.Array:
    return pa.array(in_seconds(frames.to_numpy().astype(np.float64), rate_hz), from_pandas=True)  # NaN is null
