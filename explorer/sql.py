"""Run read-only SQL queries, and return their rows block by block.

`POST /api/ask/sql` {text, offset?, limit? ≤ 1000}
→ {columns: [{name, type}], rows: [[value]], offset, total, counted, kept, seconds, version,
   hits: [hit] or null, command, python}: at most 100,000 rows are kept; `counted` is false where there are more rows
 than `total`. A result with the columns take or take_id, start and stop also has its first rows as hits.

`GET /api/ask/views` → {views: [{name, about, columns: [{name, type, about}], example}]}
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from typing import TYPE_CHECKING, Annotated, Any

import pyarrow as pa
from pydantic import Field

from kinedex.catalog.sql.views import VIEWS
from kinedex.explorer.addresses import Question, get, post
from kinedex.explorer.hits import MOST_HITS
from kinedex.explorer.same import command_line, python_lines
from kinedex.storage.duck import sql_type

if TYPE_CHECKING:
    from starlette.requests import Request

    from kinedex.explorer.archive import Archive
    from kinedex.storage.sql.queries import Answer
    from kinedex.storage.store.store import Store

MOST_ROWS = 100_000
"""Maximum number of rows of a result that are kept for scrolling."""

MOST_BYTES = 100_000_000
"""Maximum number of bytes of all results that are kept."""

SECONDS = 30.0
"""The longest time of a query, in seconds."""

BLOCK = 1000


class SqlQuestion(Question):
    """A request for rows of the result of a statement."""

    text: Annotated[str, Field(min_length=1, max_length=100_000)]
    offset: Annotated[int, Field(ge=0)] = 0
    limit: Annotated[int, Field(ge=1, le=BLOCK)] = 200


class Results:
    """A cache of the results of the latest statements, bounded in memory; any thread may use it."""

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self._most_bytes = most_bytes
        self._lock = threading.Lock()
        self._held: OrderedDict[tuple[str, int, str], tuple[Answer, float]] = OrderedDict()

    def find(self, store: Store, text: str, *, anew: bool) -> tuple[Answer, float]:
        """Return the rows of a statement and its run time in seconds, cached unless `anew` is True."""
        key = (str(store.path), store.manifest.version, text)
        with self._lock:
            if not anew and key in self._held:
                self._held.move_to_end(key)
                return self._held[key]
        begin = time.perf_counter()
        answer = store.answer(text, timeout=SECONDS, max_rows=MOST_ROWS)
        found = (answer, time.perf_counter() - begin)
        with self._lock:
            self._held[key] = found
            self._held.move_to_end(key)
            while len(self._held) > 1 and sum(one.table.nbytes for one, _ in self._held.values()) > self._most_bytes:
                self._held.popitem(last=False)
        return found


_RESULTS = Results()


def run_sql(archive: Archive, asked: SqlQuestion, _request: Request) -> dict[str, Any]:
    """Run a SQL statement, or use its cached result, and return a block of rows."""
    store = archive.store()
    # the first block runs the statement anew: labels and journals may have changed in the same version
    answer, seconds = _RESULTS.find(store, asked.text, anew=asked.offset == 0)
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
    """Return the first rows of a result as hits; None where it lacks the columns take or take_id, start and stop.

    Rows that name no take, or no interval within it, are skipped.
    """
    columns = set(table.column_names)
    if not {"start", "stop"} <= columns or not {"take", "take_id"} & columns or len(columns) < table.num_columns:
        return None
    names = {take_id: name for name, take_id in store.take_ids.items()}
    wanted = [name for name in ("take", "take_id", "start", "stop", "cost", "mirrored", "class") if name in columns]
    found: list[dict[str, Any]] = []
    for row in table.select(wanted).slice(0, 4 * MOST_HITS).to_pylist():
        take_id = row.get("take_id", store.take_ids.get(row.get("take")))
        start, stop = row["start"], row["stop"]
        if take_id not in names or not isinstance(start, int) or not isinstance(stop, int):
            continue
        if not 0 <= start < stop <= store.take_frames[take_id]:
            continue
        cost = row.get("cost")
        found.append(
            {
                "take_id": take_id,
                "take": names[take_id],
                "start": start,
                "stop": stop,
                "cost": float(cost) if isinstance(cost, int | float) else None,
                "mirrored": row.get("mirrored") is True,
                "name": str(row.get("class") or "sql"),
            }
        )
    return found[:MOST_HITS]


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


routes = [post("/api/ask/sql", run_sql, SqlQuestion), get("/api/ask/views", list_views)]
