"""`POST /api/takes`: the takes that fit some filters, in an order, block by block.

{where?: SQL condition, filters?: [{column, values?: [value or null], min?, max?, contains?}],
 sort?: [{column, descending?}], columns?: [name], offset?, limit? ≤ 500}
→ {version, total, hours, offset, columns: [name], rows: [[value]], command, python}
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from pydantic import Field

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.pipelines.explorer.addresses import Question, post
from kinedex.pipelines.explorer.same import command_line, python_lines
from kinedex.storage.duck import identifier, quote

if TYPE_CHECKING:
    from starlette.requests import Request

    from kinedex.pipelines.explorer.archive import Archive
    from kinedex.storage.store.store import Store

BLOCK = 500
"""Most rows of one answer."""

SECONDS = 20.0
"""A condition may take so long."""

KEPT = 32
"""Questions whose takes are kept in their order; each is some bytes a take."""

Scalar = str | int | float | bool | None


class Filter(Question):
    """A condition on one column: it has one of some values, or lies in a range, or contains a text."""

    column: str
    values: tuple[Scalar, ...] | None = None
    min: float | None = None
    max: float | None = None
    contains: str | None = None


class Sort(Question):
    """A column to sort by."""

    column: str
    descending: bool = False


class Selection(Question):
    """Takes that fit conditions."""

    where: str | None = None
    filters: tuple[Filter, ...] = ()


class TakesQuestion(Selection):
    """A block of the takes that fit conditions, in an order."""

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
    """The takes of the latest questions, so that a page that scrolls sorts once."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._found: OrderedDict[tuple[int, str], Found] = OrderedDict()

    def find(self, store: Store, condition: str, order: str) -> Found:
        """Return the takes that fit a condition, in an order; both are SQL."""
        text = f"SELECT take_id FROM takes{condition}{order}"
        key = (store.manifest.version, text)
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
        table = store.answer(text, timeout=SECONDS).table
        ids = store.take_rows.column("take_id").to_numpy()
        order = np.argsort(ids)
        wanted = table.column("take_id").to_numpy()
        rows = order[np.searchsorted(ids, wanted, sorter=order)]
        seconds = store.take_rows.column("seconds").to_numpy()
        return Found(rows, float(seconds[rows].sum()) / 3600)


_ORDERS = Orders()


def find_takes(archive: Archive, asked: TakesQuestion, _request: Request) -> dict[str, Any]:
    """Return a block of takes."""
    store = archive.store()
    known = store.take_rows.column_names
    columns = list(asked.columns) if asked.columns is not None else known
    for name in columns:
        require_column(name, known)
    condition, order = condition_of(asked, known), order_of(asked.sort, known)
    found = _ORDERS.find(store, condition, order)
    block = store.take_rows.select(columns).take(pa.array(found.rows[asked.offset : asked.offset + asked.limit]))
    lists = [block.column(name).to_pylist() for name in columns]
    shown = ", ".join(name if name.isidentifier() else identifier(name) for name in columns)
    return {
        "version": store.manifest.version,
        "total": len(found.rows),
        "hours": found.hours,
        "offset": asked.offset,
        "columns": columns,
        "rows": [list(row) for row in zip(*lists, strict=True)],
        "command": command_line("kinedex", "sql", archive.path, f"SELECT {shown} FROM takes{condition}{order}"),
        "python": python_lines(archive.path, f"store.sql({f'SELECT {shown} FROM takes{condition}{order}'!r})"),
    }


def require_column(name: str, known: list[str]) -> None:
    """Raise a KinedexError if takes have no such column."""
    if name not in known:
        raise KinedexError(f"takes have no column '{name}'{did_you_mean(name, known)}")


def condition_of(asked: Selection, known: list[str]) -> str:
    """Return the conditions of a selection as a WHERE clause, empty where there are none."""
    parts = [_filter(one, known) for one in asked.filters]
    if asked.where is not None and asked.where.strip():
        parts.append(f"(\n{asked.where.strip()}\n)" if "--" in asked.where else f"({asked.where.strip()})")
    return f" WHERE {' AND '.join(parts)}" if parts else ""


def _filter(one: Filter, known: list[str]) -> str:
    """Return a filter as a condition of SQL."""
    require_column(one.column, known)
    name = _name(one.column)
    parts = []
    if one.values is not None:
        values = [value for value in one.values if value is not None]
        choices = [f"{name} IN ({', '.join(map(_literal, values))})"] if values else []
        choices += [f"{name} IS NULL"] if None in one.values else []
        parts.append(f"({' OR '.join(choices)})" if choices else "false")
    if one.min is not None:
        parts.append(f"{name} >= {one.min!r}")
    if one.max is not None:
        parts.append(f"{name} <= {one.max!r}")
    if one.contains:
        parts.append(f"contains(lower({name}::VARCHAR), {quote(one.contains.lower())})")
    return " AND ".join(parts) if parts else "true"


def order_of(sort: Sequence[Sort], known: list[str]) -> str:
    """Return the order as an ORDER BY clause; takes that are equal in it are sorted by name."""
    for one in sort:
        require_column(one.column, known)
    parts = [f"{_name(one.column)} {'DESC' if one.descending else 'ASC'} NULLS LAST" for one in sort]
    return f" ORDER BY {', '.join([*parts, 'name'] if all(one.column != 'name' for one in sort) else parts)}"


def _name(column: str) -> str:
    """Return a column as SQL writes it, quoted where it is a word of SQL or no plain name."""
    return column if column.isidentifier() and column not in ("class", "groups") else identifier(column)


def _literal(value: str | float | bool) -> str:
    return quote(value) if isinstance(value, str) else repr(value)


routes = [post("/api/takes", find_takes, TakesQuestion)]
