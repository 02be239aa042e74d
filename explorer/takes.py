"""`POST /api/takes` returns the takes that fit filters, sorted, block by block.

{where?: SQL condition, filters?: [{column, values?: [value or null], min?, max?, contains?}],
 sort?: [{column, descending?}], columns?: [name], offset?, limit? ≤ 500}
→ {version, total, hours, offset, columns: [name], rows: [[value]], ids: [take_id], names: [name],
   warnings: [[text]], command, python}

Totals of takes: groups with their hours, values of a column with their counts.

    POST /api/totals {where?, filters?, by: [one or two columns], order?: "hours" or "value", limit?}
    → {groups: [{values: [value], takes, hours}], total: groups in all, takes, hours, command, python}
    POST /api/values {where?, filters?, column, contains?, limit?}
    → {column, values: [{value, takes}], distinct, empty, min?, max?, bins?: [{from, to, takes}]}

Groups are sorted by hours, or by value as `POST /api/takes` sorts takes by these columns; values are sorted by their
number of takes. `distinct` and `total` count what the limit cuts off.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from pydantic import Field
from starlette.requests import Request

from kinedex.explorer.answers import equivalent_query
from kinedex.explorer.endpoints import RequestBody, post
from kinedex.explorer.open_archive import Archive
from kinedex.explorer.selections import (
    SQL_SECONDS,
    Selection,
    columns_with_nan,
    condition_of,
    expression,
    quoting_condition,
    values_of,
)
from kinedex.explorer.store import NUMERIC
from kinedex.ops.cache import Cache
from kinedex.storage.duckdb_sql import quote, sql_type
from kinedex.storage.store.store import Store

BLOCK = 500
"""Maximum number of rows of one answer."""

KEPT = 32
"""Maximum number of queries whose sorted takes are cached; each needs some bytes a take."""


SortedTakes = tuple[npt.NDArray[np.int64], float]
"""The takes of a request: their rows in `Store.take_rows`, in the order asked for, and their duration in hours."""

BINS = 24
"""Number of bins of the histogram of a numeric column."""

Rows = Annotated[int, Field(ge=1, le=2000)]


class Sort(RequestBody):
    """A column to sort by."""

    column: str
    descending: bool = False


class TakesRequest(Selection):
    """A request for a block of the takes that fit conditions, sorted."""

    sort: tuple[Sort, ...] = ()
    columns: tuple[str, ...] | None = None
    offset: Annotated[int, Field(ge=0)] = 0
    limit: Annotated[int, Field(ge=0, le=BLOCK)] = 100


_FOUND: Cache[tuple[str, int, str], SortedTakes] = Cache(KEPT)
"""The sorted takes of the latest queries, so that they are sorted once while a page scrolls."""


def _sorted_takes(store: Store, condition: str, order: str) -> SortedTakes:
    """Return the takes that fit a condition, in an order; both are SQL."""
    text = f"SELECT take_id FROM takes{condition}{order}"
    key = (str(store.path), store.manifest.version, text)
    found = _FOUND.get(key)
    if found is not None:
        return found
    wanted = store.answer(text, timeout=SQL_SECONDS).table.column("take_id").to_numpy()
    ids = store.take_rows.column("take_id").to_numpy()
    by_id = np.argsort(ids)
    rows = by_id[np.searchsorted(ids, wanted, sorter=by_id)]
    seconds = store.take_rows.column("seconds").to_numpy()
    return _FOUND.put(key, (rows, float(seconds[rows].sum()) / 3600))


def order_of(sort: Sequence[Sort], known: Sequence[str], nan: Collection[str] = ()) -> str:
    """Return the order as an ORDER BY clause; takes with equal values are sorted by name."""
    directions = ("ASC", "DESC")
    parts = [f"{expression(one.column, known, nan=nan)} {directions[one.descending]} NULLS LAST" for one in sort]
    if all(one.column != "name" for one in sort):
        parts.append("name")
    return f" ORDER BY {', '.join(parts)}"


@quoting_condition
def find_takes(archive: Archive, asked: TakesRequest, _request: Request) -> dict[str, Any]:
    """Return up to `limit` takes, from `offset` on, of those that match filters, in the requested order."""
    store = archive.store()
    known = store.take_rows.column_names
    columns = list(asked.columns) if asked.columns is not None else known
    nan = columns_with_nan(store)
    shown = ", ".join(expression(name, known, shown=True) for name in columns)
    condition, order = condition_of(asked, known, nan), order_of(asked.sort, known, nan)
    rows, hours = _sorted_takes(store, condition, order)
    block = store.take_rows.take(pa.array(rows[asked.offset : asked.offset + asked.limit]))
    lists = [values_of(block, name) for name in columns]
    return {
        "version": store.manifest.version,
        "total": len(rows),
        "hours": hours,
        "offset": asked.offset,
        "columns": columns,
        "rows": [list(row) for row in zip(*lists, strict=True)] if lists else [],
        "ids": block.column("take_id").to_pylist(),
        "names": block.column("name").to_pylist(),
        "warnings": [texts or [] for texts in block.column("warnings").to_pylist()],
        **equivalent_query(archive, f"SELECT {shown} FROM takes{condition}{order}"),
    }


class TotalsRequest(Selection):
    """A request for totals of takes, grouped by one or two columns."""

    by: Annotated[tuple[str, ...], Field(min_length=1, max_length=2)]
    order: Literal["hours", "value"] = "hours"
    limit: Rows = 200


class ValuesRequest(Selection):
    """A request for at most `limit` values of `column`; if `contains` is given, only texts that contain it."""

    column: str
    contains: str | None = None
    limit: Rows = 200


@quoting_condition
def totals(archive: Archive, asked: TotalsRequest, _request: Request) -> dict[str, Any]:
    """Return groups of takes with their hours."""
    store = archive.store()
    known = store.take_rows.column_names
    nan = columns_with_nan(store)
    shown = ", ".join(expression(column, known, shown=True, nan=nan) for column in asked.by)
    keys = ", ".join(str(number + 1) for number in range(len(asked.by)))
    values = ", ".join(f"{number + 1} ASC NULLS LAST" for number in range(len(asked.by)))
    order = values if asked.order == "value" else f"hours DESC, {values}"
    text = (
        f"SELECT {shown}, count(*) AS takes, sum(seconds) / 3600 AS hours FROM takes{condition_of(asked, known, nan)} "
        f"GROUP BY {keys} ORDER BY {order}"
    )
    counted = f"SELECT *, count(*) OVER () AS n, sum(takes) OVER () AS t, sum(hours) OVER () AS h FROM ({text})"
    rows = list(
        zip(
            *store.answer(f"{counted} LIMIT {asked.limit}", timeout=SQL_SECONDS).table.to_pydict().values(), strict=True
        )
    )
    width = len(asked.by)
    return {
        "groups": [{"values": row[:width], "takes": row[width], "hours": row[width + 1]} for row in rows],
        "total": rows[0][width + 2] if rows else 0,
        "takes": rows[0][width + 3] if rows else 0,
        "hours": rows[0][width + 4] if rows else 0,
        **equivalent_query(archive, text),
    }


@quoting_condition
def values(archive: Archive, asked: ValuesRequest, _request: Request) -> dict[str, Any]:
    """Return the values of a column, and the histogram of numbers."""
    store = archive.store()
    known = store.take_rows.column_names
    nan = columns_with_nan(store)
    name, condition = expression(asked.column, known, nan=nan), condition_of(asked, known, nan)
    inside = f"SELECT {name} AS value FROM takes{condition}"
    fitting = f" AND contains(lower(value::VARCHAR), {quote(asked.contains.lower())})" if asked.contains else ""
    grouped = (
        f"SELECT value, count(*) AS takes, count(*) OVER () AS n FROM ({inside}) WHERE value IS NOT NULL{fitting} "
        f"GROUP BY value ORDER BY takes DESC, value LIMIT {asked.limit}"
    )
    rows = store.answer(grouped, timeout=SQL_SECONDS).table.to_pylist()
    empty = f"SELECT count(*) AS n FROM ({inside}) WHERE value IS NULL"
    (missing,) = store.answer(empty, timeout=SQL_SECONDS).table.column("n").to_pylist()
    answer: dict[str, Any] = {
        "column": asked.column,
        "values": [{"value": row["value"], "takes": row["takes"]} for row in rows],
        "distinct": rows[0]["n"] if rows else 0,
        "empty": missing,
    }
    field = store.take_rows.schema.field(asked.column) if asked.column in known else None
    if field is not None and sql_type(field.type) in NUMERIC:
        answer |= _histogram(archive, inside)
    return answer


def _histogram(archive: Archive, inside: str) -> dict[str, Any]:
    """Return the smallest and the largest value, and the number of takes in each bin between them."""
    store = archive.store()
    number = f"SELECT value::DOUBLE AS value FROM ({inside}) WHERE isfinite(value::DOUBLE)"
    ends = f"SELECT min(value) AS low, max(value) AS high FROM ({number})"
    low, high = store.answer(ends, timeout=SQL_SECONDS).table.to_pylist()[0].values()
    if low is None:
        return {"min": None, "max": None, "bins": []}
    width = (high - low) / BINS or 1.0
    text = (
        f"SELECT least(floor((value - {low!r}) / {width!r}), {BINS - 1})::INTEGER AS bin, count(*) AS takes "
        f"FROM ({number}) GROUP BY bin"
    )
    counts = {row["bin"]: row["takes"] for row in store.answer(text, timeout=SQL_SECONDS).table.to_pylist()}
    bins = [
        {"from": low + number * width, "to": low + (number + 1) * width, "takes": counts.get(number, 0)}
        for number in range(BINS if high > low else 1)
    ]
    return {"min": low, "max": high, "bins": bins}


routes = [
    post("/api/takes", find_takes, TakesRequest),
    post("/api/totals", totals, TotalsRequest),
    post("/api/values", values, ValuesRequest),
]
