"""Make the SELECTs behind the views of results: the parts that each shows, with the origin of their rows."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pyarrow.parquet as pq

from kinedex.catalog.sql.result_columns import ORIGIN
from kinedex.catalog.sql.result_views import ALL
from kinedex.storage import duck
from kinedex.storage.snapshot.part_records import ResultPart
from kinedex.storage.snapshot.parts import part_file, read_errors
from kinedex.storage.snapshot.schemas import RESULT_KINDS, result_schema
from kinedex.storage.snapshot.shown_results import origin_of, shown_parts
from kinedex.storage.snapshot.snapshot import Snapshot

ALL_VIEWS = {f"{ALL}{kind}": kind for kind in RESULT_KINDS}
"""A dict from view that shows the rows of every pipeline to its kind of results."""


def result_parts(store: Snapshot, view: str) -> tuple[ResultPart, ...]:
    """Return the parts that a view of results reads: those of one pipeline, or of all for the prefix `all_`."""
    if view in ALL_VIEWS:
        return store.manifest.results.get(ALL_VIEWS[view], ())
    return shown_parts(store.manifest, view)


def result_select(store: Snapshot, view: str) -> str:
    """Return the SELECT of a view of results."""
    kind = ALL_VIEWS.get(view, view)
    return duck.result_rows(result_schema(kind), ORIGIN, _scans(store, kind, result_parts(store, view)))


def _scans(store: Snapshot, kind: str, parts: Iterable[ResultPart]) -> list[duck.ResultScan]:
    """Return one scan for the parts of each combination of origin and number of columns."""
    found: dict[tuple[object, ...], duck.ResultScan] = {}
    for part in parts:
        file = part_file(store.path, part.path)
        width, origin = part.columns or _columns_of(file), origin_of(store.manifest, kind, part)
        key = (width, *origin.values())
        others = found[key].files if key in found else ()
        found[key] = duck.ResultScan((*others, file), width, origin)
    return list(found.values())


def _columns_of(file: Path) -> int:
    """Return the number of columns of a part of format 3, whose manifest does not record it."""
    with read_errors(file):
        return len(pq.read_schema(file).names)
