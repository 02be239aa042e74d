"""`POST /api/takes` returns the takes that fit filters, sorted, block by block.

{where?: SQL condition, filters?: [{column, values?: [value or null], min?, max?, contains?}],
 sort?: [{column, descending?}], columns?: [name], offset?, limit? ≤ 500}
→ {version, total, hours, offset, columns: [name], rows: [[value]], ids: [take_id], names: [name],
   warnings: [[text]], command, python}
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from pydantic import Field

from kinedex.explorer.addresses import Question, post
from kinedex.explorer.conditions import own_words
from kinedex.explorer.same import same_query
from kinedex.explorer.selections import (
    SQL_SECONDS,
    Selection,
    columns_with_nan,
    condition_of,
    expression,
    values_of,
)

if TYPE_CHECKING:
    from starlette.requests import Request

    from kinedex.explorer.archive import Archive
    from kinedex.storage.store.store import Store

BLOCK = 500
"""Maximum number of rows of one answer."""

KEPT = 32
"""Maximum number of queries whose sorted takes are cached; each needs some bytes a take."""


class Sort(Question):
    """A column to sort by."""

    column: str
    descending: bool = False


class TakesQuestion(Selection):
    """A request for a block of the takes that fit conditions, sorted."""

    sort: tuple[Sort, ...] = ()
    columns: tuple[str, ...] | None = None
    offset: Annotated[int, Field(ge=0)] = 0
    limit: Annotated[int, Field(ge=0, le=BLOCK)] = 100


@dataclass(frozen=True)
class Found:
    """The takes of a question.

    Attributes
    ----------
    rows : int64 array (n,)
        Their rows in `Store.take_rows`, in the order asked for.
    hours : float
        Their duration.
    """

    rows: npt.NDArray[np.int64]
    hours: float


class Orders:
    """A cache of the sorted takes of the latest queries, so that they are sorted once while a page scrolls."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._found: OrderedDict[tuple[str, int, str], Found] = OrderedDict()

    def find(self, store: Store, condition: str, order: str) -> Found:
        """Return the takes that fit a condition, in an order; both are SQL."""
        text = f"SELECT take_id FROM takes{condition}{order}"
        key = (str(store.path), store.manifest.version, text)
        with self._lock:
            if key in self._found:
                self._found.move_to_end(key)
                return self._found[key]
        found = self._search(store, text)
        with self._lock:
            self._found[key] = found
            while len(self._found) > KEPT:
                self._found.popitem(last=False)
        return found

    def _search(self, store: Store, text: str) -> Found:
        table = store.answer(text, timeout=SQL_SECONDS).table
        ids = store.take_rows.column("take_id").to_numpy()
        order = np.argsort(ids)
        wanted = table.column("take_id").to_numpy()
        rows = order[np.searchsorted(ids, wanted, sorter=order)]
        seconds = store.take_rows.column("seconds").to_numpy()
        return Found(rows, float(seconds[rows].sum()) / 3600)


_ORDERS = Orders()


def order_of(sort: Sequence[Sort], known: Sequence[str], nan: Collection[str] = ()) -> str:
    """Return the order as an ORDER BY clause; takes that are equal in it are sorted by name."""
    directions = ("ASC", "DESC")
    parts = [f"{expression(one.column, known, nan=nan)} {directions[one.descending]} NULLS LAST" for one in sort]
    if all(one.column != "name" for one in sort):
        parts.append("name")
    return f" ORDER BY {', '.join(parts)}"


@own_words
def find_takes(archive: Archive, asked: TakesQuestion, _request: Request) -> dict[str, Any]:
    """Return up to `limit` takes, from `offset` on, of those that match filters, in the requested order."""
    store = archive.store()
    known = store.take_rows.column_names
    columns = list(asked.columns) if asked.columns is not None else known
    nan = columns_with_nan(store)
    shown = ", ".join(expression(name, known, shown=True) for name in columns)
    condition, order = condition_of(asked, known, nan), order_of(asked.sort, known, nan)
    found = _ORDERS.find(store, condition, order)
    block = store.take_rows.take(pa.array(found.rows[asked.offset : asked.offset + asked.limit]))
    lists = [values_of(block, name) for name in columns]
    return {
        "version": store.manifest.version,
        "total": len(found.rows),
        "hours": found.hours,
        "offset": asked.offset,
        "columns": columns,
        "rows": [list(row) for row in zip(*lists, strict=True)] if lists else [],
        "ids": block.column("take_id").to_pylist(),
        "names": block.column("name").to_pylist(),
        "warnings": [texts or [] for texts in block.column("warnings").to_pylist()],
        **same_query(archive, f"SELECT {shown} FROM takes{condition}{order}"),
    }


routes = [post("/api/takes", find_takes, TakesQuestion)]
