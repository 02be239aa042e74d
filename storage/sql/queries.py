"""The queries of users: they may only read, and they stop at Ctrl-C."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor, wait

import duckdb
import pyarrow as pa

from kinedex.ops.errors import KinedexError
from kinedex.storage.duck import Connection, Parameters, message
from kinedex.storage.sql.read_only import UnknownName, checked

_MISSING = re.compile(r"(?:Table|Function|Macro) with name \"?(\w+)\"? does not exist")
_DAMAGE = (duckdb.IOException, duckdb.SerializationException, duckdb.InternalException, duckdb.FatalException)


class Unreadable(KinedexError):
    """A query met a file that is missing or damaged."""


def read_query(
    connection: Connection, text: str, parameters: Parameters = None, macros: Iterable[str] = (), *, files: bool = False
) -> pa.Table:
    """Run one reading query and return its whole result.

    Parameters
    ----------
    connection : Connection
        The connection to run it on.
    text : str
        One statement that only reads: SELECT, FROM, WITH, VALUES, TABLE, PIVOT, EXPLAIN, DESCRIBE, SHOW, SUMMARIZE,
        or one of a few PRAGMAs.
    parameters : sequence or dict, optional
        Values for its `?`, or for its `$name`.
    macros : iterable of str, optional
        Names of the macros that it may call.
    files : bool, optional
        If True, it may read files (with `read_csv`, for example) where the connection's settings allow it.

    Raises
    ------
    KinedexError
        The query would change something, holds several statements, or DuckDB refuses it; an `UnknownName` for an
        unknown table or function, an `Unreadable` for a file that cannot be read.
    """
    try:
        relation = connection.sql(checked(connection, text, macros, files=files), params=parameters)
        return pa.table({}) if relation is None else relation.to_arrow_table()
    except _DAMAGE as fault:
        raise Unreadable(message(fault)) from None
    except duckdb.Error as fault:
        missing = _MISSING.search(str(fault))
        raise (UnknownName(missing[1], message(fault)) if missing else KinedexError(message(fault))) from None


def interruptible_query(
    connection: Connection, text: str, parameters: Parameters = None, macros: Iterable[str] = (), *, files: bool = False
) -> pa.Table:
    """Run a query as `read_query` does, so that Ctrl-C stops it; DuckDB alone would notice Ctrl-C only at the end."""
    if threading.current_thread() is not threading.main_thread():
        return read_query(connection, text, parameters, macros, files=files)
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(read_query, connection, text, parameters, macros, files=files)
        try:
            return done.result()
        except KeyboardInterrupt:
            while not done.done():
                connection.interrupt()
                wait([done], timeout=0.05)
            raise


def _tokens(text: str) -> list[tuple[int, str]]:
    """Return the tokens of a statement without its comments, each with the byte where it begins."""
    raw = text.encode()
    found = [(start, kind) for start, kind in duckdb.tokenize(text)]
    stops = [start for start, _ in found[1:]] + [len(raw)] * bool(found)
    return [
        (start, raw[start:stop].decode(errors="replace").strip())
        for (start, kind), stop in zip(found, stops, strict=True)
        if kind != duckdb.token_type.comment
    ]


def split_statements(text: str) -> tuple[list[str], str]:
    """Split typed text into whole statements, each ended by a semicolon, and the rest.

    A semicolon in a text, a quoted name, or a comment ends no statement. A rest of finished comments counts as empty.
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
