"""The content of a store as values, without what differs from run to run: ids, times, and names of runs."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from kinedex.storage.snapshot.schemas import RESULT_KINDS
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.store.store import Store

_PASSING = {"take_id", "run", "logged_at", "source_mtime_ns"}
"""Columns whose values differ between two runs of the same work."""

_PASSING_TEXT = re.compile(
    r"\d{8}-\d{6}-[0-9a-f]{4,6}|\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?(Z| UTC)?|\d+(\.\d+)? (s|min)\b"
    r"|\"(seconds|version)\": [\d.]+|work-\d+"
)
"""Names of runs, times, durations and versions as pages and JSON files show them."""


def contents(store: Store) -> dict[str, str]:
    """Return a digest of each take (its row, words and frames), of each kind of result, of labels, and of the stages.

    The labels are those that the version itself holds, without the journal.
    """
    found = {}
    for row in store.take_rows.to_pylist():
        frames = store.frames(row["name"]).drop_columns(["take_id"])
        words = store.words([row["take_id"]]).take(0).tobytes()
        found[f"take {row['name']}"] = _digest(_lasting(row), words, frames.to_pylist())
    for kind in RESULT_KINDS:
        rows = sorted(repr(_lasting(row)) for row in store.result(kind).to_pylist())
        if rows:
            found[f"results {kind}"] = _digest(rows)
    labels = Snapshot.labels(store, history=True)
    if labels.num_rows:
        found["labels"] = _digest(sorted(repr(row) for row in labels.drop_columns(["created"]).to_pylist()))
    for name, record in store.manifest.stages.items():
        parts = record.summary.get("fingerprint_parts")
        found[f"stage {name}"] = _digest(record.summary.get("params"), parts and parts["code"])
    return found


def reports(path: Path) -> dict[str, str]:
    """Return a digest of each report file of a store, unfinished ones included."""
    folder = path / "results" / "reports"
    return {
        f"report {file.relative_to(folder)}": _digest(_PASSING_TEXT.sub("", file.read_text(encoding="utf-8")))
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


def _lasting(row: dict[str, object]) -> list[tuple[str, object]]:
    return [(name, value) for name, value in row.items() if name not in _PASSING]


def _digest(*values: object) -> str:
    return hashlib.sha256(repr(values).encode()).hexdigest()[:16]
