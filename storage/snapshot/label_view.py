"""Return labels with the columns of the view `label_history`."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from kinedex.catalog.sql.views import VIEWS
from kinedex.ops.intervals import in_seconds
from kinedex.storage.snapshot.labels import current_labels
from kinedex.storage.snapshot.snapshot import Snapshot

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
