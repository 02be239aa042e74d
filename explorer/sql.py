"""Run read-only SQL queries, and return their rows block by block.

`POST /api/ask/sql` {text, offset?, limit? ≤ 1000}
→ {columns: [{name, type}], rows: [[value]], offset, total, counted, kept, seconds, version,
   hits: [hit] or null, command, python}: at most 100,000 rows are kept; `counted` is false where there are more rows
 than `total`. A result with the columns take or take_id, start and stop also has its first rows as hits.

`GET /api/ask/views` → {views: [{name, about, columns: [{name, type, about}], example}]}
"""

from __future__ import annotations

import time
from typing import Annotated, Any

import pyarrow as pa
from pydantic import Field
from starlette.requests import Request

from kinedex.catalog.sql.views import VIEWS
from kinedex.explorer.answers import command_line, python_lines
from kinedex.explorer.endpoints import RequestBody, get, post
from kinedex.explorer.hits import MAX_HITS, shown_hits
from kinedex.explorer.open_archive import Archive
from kinedex.ops.cache import Cache
from kinedex.ops.intervals import Hit, Interval
from kinedex.storage.duckdb_sql import sql_type
from kinedex.storage.sql.queries import QueryResult
from kinedex.storage.store.store import Store

MAX_ROWS = 100_000
"""Maximum number of rows of a result that are kept for scrolling."""

MAX_BYTES = 100_000_000
"""Maximum number of bytes of all results that are kept."""

SECONDS = 30.0
"""The longest time of a query, in seconds."""

BLOCK = 1000


class SqlRequest(RequestBody):
    """A request for rows of the result of a statement."""

    text: Annotated[str, Field(min_length=1, max_length=100_000)]
    offset: Annotated[int, Field(ge=0)] = 0
    limit: Annotated[int, Field(ge=1, le=BLOCK)] = 200


_RESULTS: Cache[tuple[str, int, str], tuple[QueryResult, float]] = Cache(MAX_BYTES, lambda one: one[0].table.nbytes)
"""The results of the latest statements with their run times; offset 0 runs a statement anew."""


def run_sql(archive: Archive, asked: SqlRequest, _request: Request) -> dict[str, Any]:
    """Run a SQL statement, or use its cached result, and return a block of rows."""
    store = archive.store()
    # the first block runs the statement anew: labels and journals may have changed in the same version
    key = (str(store.path), store.manifest.version, asked.text)
    found = _RESULTS.get(key) if asked.offset else None
    if found is None:
        begin = time.perf_counter()
        made = store.answer(asked.text, timeout=SECONDS, max_rows=MAX_ROWS)
        found = _RESULTS.put(key, (made, time.perf_counter() - begin))
    answer, seconds = found
    table = answer.table
    block = table.slice(asked.offset, asked.limit)
    lists = [column.to_pylist() for column in block.columns]
    return {
        "columns": [{"name": field.name, "type": _type(field.type)} for field in table.schema],
        "rows": [list(row) for row in zip(*lists, strict=True)],
        "offset": asked.offset,
        "total": answer.rows,
        "counted": answer.counted,
        "kept": table.num_rows,
        "seconds": seconds,
        "version": store.manifest.version,
        "hits": hits_of(store, table) if asked.offset == 0 else None,
        "command": command_line("kinedex", "sql", archive.path, asked.text),
        "python": python_lines(archive.path, f"store.sql({asked.text!r})"),
    }


def _type(kind: pa.DataType) -> str:
    try:
        return sql_type(kind)
    except (KeyError, ValueError):
        return str(kind)


def hits_of(store: Store, table: pa.Table) -> list[dict[str, Any]] | None:
    """Return the first rows of a result as hits, or None without the columns take or take_id, start and stop.

    Rows that name no take, or no interval within it, are skipped. The answer is also None if two columns have the same
        name.
    """
    columns = set(table.column_names)
    if not {"start", "stop"} <= columns or not {"take", "take_id"} & columns or len(columns) < table.num_columns:
        return None
    names = store.take_names
    wanted = [name for name in ("take", "take_id", "start", "stop", "cost", "mirrored", "class") if name in columns]
    found: list[Hit] = []
    for row in table.select(wanted).slice(0, 4 * MAX_HITS).to_pylist():
        take_id = row.get("take_id", store.take_ids.get(row.get("take")))
        start, stop = row["start"], row["stop"]
        if take_id not in names or not isinstance(start, int) or not isinstance(stop, int):
            continue
        if not 0 <= start < stop <= store.take_frames[take_id]:
            continue
        cost = row.get("cost")
        known = float(cost) if isinstance(cost, int | float) else None
        where = Interval(names[take_id], start, stop)
        found.append(Hit(where, str(row.get("class") or "sql"), known, row.get("mirrored") is True))
    return shown_hits(store, found[:MAX_HITS])


def list_views(archive: Archive, _request: Request) -> dict[str, Any]:
    """Return the SQL views with their columns; `takes` has the columns that this store declares, too."""
    takes = archive.store().take_rows.schema
    views = []
    for view in VIEWS:
        columns = {one.name: {"name": one.name, "type": one.type, "about": one.meaning} for one in view.columns}
        if view.name == "takes":
            columns = {
                field.name: columns.get(field.name, {"name": field.name, "type": _type(field.type), "about": ""})
                for field in takes
            }
        views.append(
            {"name": view.name, "about": view.summary, "columns": list(columns.values()), "example": view.example}
        )
    return {"views": views}


routes = [post("/api/ask/sql", run_sql, SqlRequest), get("/api/ask/views", list_views)]
