"""Selections of takes: filters by column and conditions of SQL, as clauses over the view `takes`.

A column is one of the view `takes`, or `folder`: the folder of the source file. `chosen` is a set of take ids in few
characters, so that an address can hold any set of takes (a lasso on the map): a bit set in base64url without `=`, in
which bit i, counted from the highest bit of the first byte, is set if the take with id i is chosen.

The module also evaluates SQL conditions of users over other views, and quotes them in error messages.
"""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Callable, Collection, Sequence
from functools import wraps
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
from starlette.requests import Request

from kinedex.explorer.endpoints import RequestBody
from kinedex.explorer.open_archive import Archive
from kinedex.ops.errors import KinedexError, ParameterError, did_you_mean
from kinedex.storage import duckdb_sql
from kinedex.storage.duckdb_sql import identifier, quote
from kinedex.storage.store.store import Store

SQL_SECONDS = 20.0
"""The longest time of a SQL query, in seconds."""

FOLDER = "folder"
"""A column that takes do not have: the folder of the source file, below the folder of the archive."""

_FOLDER = "coalesce(nullif(parse_dirpath(source, 'forward_slash'), ''), '.')"

_PLAIN = frozenset({"groups", "order", "group", "table", "set", "limit", "offset", "all", "end", "case", "class"})
"""Words of SQL that a column may have as its name; these are quoted."""

Scalar = str | int | float | bool | None


FEW_IDS = 100
"""Maximum number of ids that are listed in SQL; more are looked up in the bit set, as a list of 33,000 ids takes half a
second.
"""

_QUOTE = re.compile(r"(.*?)\n\nLINE (\d+): (.*)\n( *)\^+\s*", re.DOTALL)
"""A message of DuckDB: the error, and the line of the statement, cut to the part around the position that ^ marks."""

_SHOWN = 60
"""Maximum number of characters of a condition that a message quotes."""


class Filter(RequestBody):
    """A condition on one column: its value is one of a list, lies in a range, contains a text, or is chosen."""

    column: str
    values: tuple[Scalar, ...] | None = None
    min: float | None = None
    max: float | None = None
    contains: str | None = None
    chosen: str | None = None


class Selection(RequestBody):
    """Takes that fit all filters and a SQL condition."""

    where: str | None = None
    filters: tuple[Filter, ...] = ()


def columns_with_nan(store: Store) -> frozenset[str]:
    """Return the columns of takes that hold NaN somewhere; filters treat NaN as a missing value."""
    rows = store.take_rows
    numbers = [field.name for field in rows.schema if pa.types.is_floating(field.type)]
    return frozenset(name for name in numbers if pc.any(pc.is_nan(rows.column(name))).as_py())


def expression(column: str, known: Sequence[str], *, shown: bool = False, nan: Collection[str] = ()) -> str:
    """Return the SQL expression for a column.

    Parameters
    ----------
    column : str
        Name of the column.
    known : sequence of str
        The columns of takes.
    shown : bool, optional
        Name the column, for a SELECT.
    nan : collection of str, optional
        Columns whose NaN counts as no value.

    Raises
    ------
    KinedexError
        Takes have no such column; the message names the nearest.
    """
    if column == FOLDER and FOLDER not in known:
        return f"{_FOLDER} AS {FOLDER}" if shown else _FOLDER
    if column not in known:
        raise KinedexError(f"takes have no column '{column}'{did_you_mean(column, [*known, FOLDER])}")
    name = column if column.isidentifier() and column.lower() not in _PLAIN else identifier(column)
    if column not in nan:
        return name
    return f"nullif({name}, 'NaN'::DOUBLE) AS {name}" if shown else f"nullif({name}, 'NaN'::DOUBLE)"


def condition_of(asked: Selection, known: Sequence[str], nan: Collection[str] = ()) -> str:
    """Return a selection as a WHERE clause that begins with a space; empty where it has no condition."""
    parts = [_condition(one, known, nan) for one in asked.filters]
    if asked.where is not None and asked.where.strip():
        text = asked.where.strip()
        parts.append(f"({text}\n)" if "--" in text else f"({text})")  # a comment would hide the bracket
    return f" WHERE {' AND '.join(parts)}" if parts else ""


def _condition(one: Filter, known: Sequence[str], nan: Collection[str]) -> str:
    """Return a filter as a SQL condition."""
    name = expression(one.column, known, nan=nan)
    parts = []
    if one.values is not None:
        values = [value for value in one.values if value is not None]
        choices = [f"{name} IN ({', '.join(map(_literal, values))})"] if values else []
        choices += [f"{name} IS NULL"] if None in one.values else []
        parts.append(f"({' OR '.join(choices)})" if choices else "false")
    if one.min is not None:
        parts.append(f"{name} >= {_number(one.min)}")
    if one.max is not None:
        parts.append(f"{name} <= {_number(one.max)}")
    if one.contains:
        parts.append(f"contains(lower({name}::VARCHAR), {quote(one.contains.lower())})")
    if one.chosen is not None:
        parts.append(_chosen(name, one.chosen))
    return " AND ".join(parts) if parts else "true"


def packed_ids(ids: npt.NDArray[np.int64]) -> str:
    """Encode ids as the text of a filter's `chosen`.

    Examples
    --------
    >>> packed_ids(np.array([1, 3, 9]))
    'UEA'
    """
    marks = np.zeros(int(ids.max()) + 1 if len(ids) else 0, bool)
    marks[ids] = True
    return base64.urlsafe_b64encode(np.packbits(marks).tobytes()).decode().rstrip("=")


def _chosen(name: str, text: str) -> str:
    """Return the SQL condition that a column of integers is one of the numbers whose bits are set.

    Raises
    ------
    ParameterError
        The text is not base64url.
    """
    try:
        octets = base64.b64decode(text + "=" * (-len(text) % 4), altchars=b"-_", validate=True)
    except (binascii.Error, ValueError):
        raise ParameterError("chosen", "the bits of ids in base64url, as the map writes them", text[:40]) from None
    ids = np.flatnonzero(np.unpackbits(np.frombuffer(octets, np.uint8)))
    if len(ids) == 0:
        return "false"
    if len(ids) <= FEW_IDS:
        return f"{name} IN ({', '.join(map(str, ids.tolist()))})"
    bit = f"get_bit(from_base64('{base64.b64encode(octets).decode()}')::BIT, {name}::INTEGER) = 1"
    return f"CASE WHEN {name} BETWEEN 0 AND {8 * len(octets) - 1} THEN {bit} ELSE false END"


def _literal(value: str | float | bool) -> str:
    if isinstance(value, str):
        return quote(value)
    return str(value).lower() if isinstance(value, bool) else _number(value)


def _number(value: float) -> str:
    """Return a number as SQL has it, without a fraction that is zero."""
    return repr(int(value)) if float(value).is_integer() and abs(value) < 2**53 else repr(value)


def values_of(rows: pa.Table, column: str) -> list[Any]:
    """Return the values of a column, `folder` included, of some rows of takes."""
    if column == FOLDER and FOLDER not in rows.column_names:
        return [source.rpartition("/")[0] or "." for source in rows.column("source").to_pylist()]
    found: list[Any] = rows.column(column).to_pylist()
    return found


Asked = TypeVar("Asked", bound=Selection)
Answer = Callable[["Archive", Asked, "Request"], dict[str, Any]]


def quoting_condition(function: Answer[Asked]) -> Answer[Asked]:
    """Wrap the handler of an address, so that SQL errors quote the user's condition, not the statement around it.

    Parameters
    ----------
    function : callable
        The handler, which takes the archive, a selection and the request, and returns the answer.
    """

    @wraps(function)
    def answer(archive: Archive, asked: Asked, request: Request) -> dict[str, Any]:
        try:
            return function(archive, asked, request)
        except KinedexError as fault:
            if type(fault) is KinedexError and (asked.where or "").strip():
                matching_takes(archive.store(), asked.where or "")
            raise

    return answer


def matching_takes(store: Store, where: str) -> npt.NDArray[np.int64]:
    """Return the ids of the takes for which a SQL condition holds; the condition may refer to any view.

    Parameters
    ----------
    store : Store
        The store to read.
    where : str
        The condition.

    Raises
    ------
    KinedexError
        The condition is invalid; the message states the position of the error.
    """
    text = where.strip()
    try:
        found = store.answer(f"SELECT take_id FROM takes WHERE (\n{text}\n)", timeout=SQL_SECONDS).table
    except KinedexError as fault:
        if type(fault) is not KinedexError:  # it took too long, or the client has disconnected
            raise
        raise KinedexError(message_for_condition(str(fault), text)) from None
    ids: npt.NDArray[np.int64] = found.column("take_id").to_numpy()
    return ids


def message_for_condition(message: str, text: str) -> str:
    """Return DuckDB's error message with the position relative to the user's condition, not the statement.

    Parameters
    ----------
    message : str
        The message of DuckDB about a statement in which the condition begins on line 2.
    text : str
        The condition.

    Examples
    --------
    >>> fault = 'syntax error at or near "ORDER"' + chr(10) * 2 + "LINE 2: class ORDER" + chr(10) + " " * 14 + "^"
    >>> message_for_condition(fault, "class ORDER")
    'syntax error at or near "ORDER": character 7, “ORDER”'
    """
    lines = text.split("\n")
    found = _QUOTE.fullmatch(message)
    if found is None:
        short = message.partition("\n  the views and macros of a store")[0]
        return short.replace(" in FROM clause!\nCandidate bindings:", "; the nearest are").replace(
            " in FROM clause!", ""
        )
    what, number, shown, before = found[1], int(found[2]) - 2, found[3], found[4]
    if number >= len(lines):
        return "syntax error at the end: something is missing there, or a bracket is closed that was not opened"
    # a long line is cut at both ends
    part = shown.removeprefix("...").removesuffix("...")
    begin = max(0, lines[number].find(part))
    column = begin + max(0, len(before) - len(f"LINE {found[2]}: ") - (3 if shown.startswith("...") else 0))
    rest = lines[number][column:]
    place = f"character {column + 1}" if len(lines) == 1 else f"line {number + 1}, character {column + 1}"
    return f"{what}: {place}, “{rest if len(rest) <= _SHOWN else rest[:_SHOWN] + '…'}”"


def takes_only_selection(store: Store, asked: Selection) -> Selection:
    """Return a selection whose condition, if it has one, names columns of takes alone.

    Searches and exports filter the rows of takes. A condition over other views (`suspect_takes`) becomes the choice of
    the takes for which it holds now.

    Parameters
    ----------
    store : Store
        The store to read.
    asked : Selection
        The selection as the user made it.

    Raises
    ------
    KinedexError
        The condition is invalid; the message states the position of the error.
    """
    where = (asked.where or "").strip()
    if not where:
        return asked
    try:
        duckdb_sql.rows_where(store.take_rows.slice(0, 0), "takes", where)
    except duckdb_sql.Error:
        found = matching_takes(store, where)
        if len(found) == 0:
            raise KinedexError(f"no take fits the condition {where}") from None
        chosen = Filter(column="take_id", chosen=packed_ids(found))
        return asked.model_copy(update={"where": None, "filters": (*asked.filters, chosen)})
    return asked
