"""Run users' queries, which may only read; Ctrl-C and a time limit stop them, and their rows can be limited."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass

import duckdb
import pyarrow as pa

from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.storage.duckdb_sql import Connection, Parameters, message
from kinedex.storage.interruption import run_bounded
from kinedex.storage.sql.read_only import UnknownName, checked_statement

COUNTED = 1_000_000
"""The number of rows up to which the rows of a query beyond its limit are counted."""

_BATCH = 20_000
_MISSING = re.compile(r"(?:Table|Function|Macro) with name \"?(\w+)\"? does not exist")
_ELSEWHERE = re.compile(r"Cannot access (?:file|directory) \"(.*?)\" - file system operations are disabled")
_DAMAGE = re.compile(r"(IO|Serialization|INTERNAL|FATAL) Error: |Corrupt database file: ")


class Unreadable(KinedexError):
    """A query failed because a file is missing or damaged."""


@dataclass(frozen=True)
class QueryResult:
    """The rows of a query, or the first of them.

    Attributes
    ----------
    table : pyarrow.Table
        The rows, up to the limit of the query.
    rows : int
        The number of rows of the query, or a lower bound of it if `counted` is False.
    counted : bool
        False if the query has more than `rows` rows.
    """

    table: pa.Table
    rows: int
    counted: bool = True


def _answer(
    connection: Connection, text: str, parameters: Parameters, macros: Iterable[str], files: bool, max_rows: int | None
) -> QueryResult:
    """Run one read-only query on the calling thread, and return its result as `bounded_query` does."""
    try:
        relation: duckdb.DuckDBPyRelation | None = connection.sql(
            checked_statement(connection, text, macros, files=files), params=parameters
        )
        if relation is None:
            return QueryResult(pa.table({}), 0)
        if max_rows is not None:
            return _first_rows(relation, max_rows)
        table = relation.to_arrow_table()
        return QueryResult(table, table.num_rows)
    except duckdb.Error as fault:
        if _DAMAGE.match(str(fault)):
            raise Unreadable(message(fault)) from None
        if missing := _MISSING.search(str(fault)):
            raise UnknownName(missing[1], message(fault)) from None
        raise KinedexError(explained(message(fault))) from None


def explained(text: str) -> str:
    """Return DuckDB's message, or one that states the remedy if a query reads a file outside the store."""
    if found := _ELSEWHERE.search(text):
        # access to a linked file is decided by the path of its target
        return (
            f"{os.path.realpath(found[1])}: SQL reads the store and folders that were opened for it, and this file is "
            "in neither; open its folder with `--allow-files DIR`, or `files=[…]` of `open_store`"
        )
    return text


def _first_rows(relation: duckdb.DuckDBPyRelation, max_rows: int) -> QueryResult:
    """Return the first rows, and count the others batch by batch."""
    reader = relation.to_arrow_reader(_BATCH)
    batches, rows = [], 0
    try:
        for batch in reader:
            if rows < max_rows:
                batches.append(batch.slice(0, max_rows - rows))
            rows += batch.num_rows
            if rows > max(max_rows, COUNTED):
                return QueryResult(pa.Table.from_batches(batches, reader.schema), rows, counted=False)
    except OSError as fault:  # Arrow's reader raises DuckDB's errors as OSError
        text = message(duckdb.Error(str(fault)))
        raise (Unreadable(text) if _DAMAGE.match(str(fault)) else KinedexError(explained(text))) from None
    finally:
        # a connection with an open result cannot run another statement
        reader.close()
    return QueryResult(pa.Table.from_batches(batches, reader.schema), rows)


def bounded_query(
    connection: Connection,
    text: str,
    parameters: Parameters = None,
    macros: Iterable[str] = (),
    *,
    files: bool = False,
    timeout: float | None = None,
    max_rows: int | None = None,
) -> QueryResult:
    """Run one read-only query and return its result; Ctrl-C and a time limit end it.

    Parameters
    ----------
    connection : Connection
        The connection to run it on.
    text : str
        One statement that only reads: SELECT, FROM, WITH, VALUES, TABLE, PIVOT, EXPLAIN, DESCRIBE, SHOW, SUMMARIZE,
        or one of a few PRAGMAs.
    parameters : sequence or dict, optional
        Values for the placeholders `?` or `$name` of the query.
    macros : iterable of str, optional
        Names of the macros that it may call.
    files : bool, optional
        If True, it may read files (with `read_csv`, for example) where the connection's settings allow it.
    timeout : float, optional
        Time limit in seconds; None for no limit.
    max_rows : int, optional
        Largest number of rows to return; the others are counted, up to `COUNTED`, and not kept in memory.

    Raises
    ------
    TimeLimitError, KeyboardInterrupt
        As for `storage.interruption.run_bounded`.
    KinedexError
        The query would change something, has several statements, or is refused by DuckDB. The error is an `UnknownName`
        for an unknown table or function, and an `Unreadable` for a file that cannot be read.
    """
    if max_rows is not None and max_rows < 0:
        raise ParameterError("max_rows", "at least 0", max_rows)

    return run_bounded(connection, lambda: _answer(connection, text, parameters, macros, files, max_rows), timeout)


def _tokens(text: str) -> list[tuple[int, str]]:
    """Return the tokens of a statement without its comments, each with its byte offset."""
    raw = text.encode()
    found = [(start, kind) for start, kind in duckdb.tokenize(text)]
    stops = [start for start, _ in found[1:]] + [len(raw)] * bool(found)
    return [
        (start, raw[start:stop].decode(errors="replace").strip())
        for (start, kind), stop in zip(found, stops, strict=True)
        if kind != duckdb.token_type.comment
    ]


def split_statements(text: str) -> tuple[list[str], str]:
    """Split typed text into complete statements, each ended by a semicolon, and the text after the last one.

    A semicolon in a string, a quoted name, or a comment does not end a statement. If the text after the last statement
    consists of complete comments only, an empty text is returned for it.
    """
    raw = text.encode()
    whole, begin = [], 0
    for start, word in _tokens(text):
        if word == ";":
            whole.append(raw[begin : start + 1].decode().strip())
            begin = start + 1
    rest = raw[begin:].decode()
    open_comment = rest.rfind("/*") > rest.rfind("*/")
    return [one for one in whole if _tokens(one)[0][1] != ";"], rest if _tokens(rest) or open_comment else ""
