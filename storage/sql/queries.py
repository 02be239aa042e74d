"""The queries of users: they may only read, and they stop at Ctrl-C."""

from __future__ import annotations

import re
import threading
from concurrent.futures import ThreadPoolExecutor, wait

import duckdb
import pyarrow as pa

from kinedex.ops.errors import KinedexError
from kinedex.storage.duck import Connection, Parameters, message

_READING = {
    duckdb.StatementType.SELECT,
    duckdb.StatementType.EXPLAIN,
    duckdb.StatementType.PRAGMA,
    duckdb.StatementType.MULTI,  # the parser turns PIVOT into several statements
}
_READING_WORDS = set("select from with values table pivot unpivot explain show describe desc summarize pragma".split())
_PRAGMAS = set(
    "collations database_list database_size functions metadata_info platform show show_databases show_tables "
    "show_tables_expanded storage_info table_info user_agent version".split()
)
# These statements may stand in a WITH part and write.
_WRITING_WORDS = {"copy", "insert", "update", "delete", "merge", "truncate"}
# These functions change something, or run SQL that is not checked here.
_WRITING_FUNCTIONS = set(
    "checkpoint force_checkpoint enable_logging disable_logging truncate_duckdb_logs write_log enable_profiling "
    "disable_profiling create_external_resource destroy_external_resource register_external_resource "
    "register_external_resource_type deregister_external_resource query json_execute_serialized_sql".split()
)
_MISSING = re.compile(r"(?:Table|Function|Macro) with name \"?(\w+)\"? does not exist")
_DAMAGE = (duckdb.IOException, duckdb.SerializationException, duckdb.InternalException, duckdb.FatalException)


class UnknownName(KinedexError):
    """A query asks for a table or a function that does not exist."""

    def __init__(self, name: str, text: str) -> None:
        super().__init__(text)
        self.name = name


class Unreadable(KinedexError):
    """A query met a file that is missing or damaged."""


def read_query(connection: Connection, text: str, parameters: Parameters = None) -> pa.Table:
    """Run one reading query and return its whole result.

    Parameters
    ----------
    connection : Connection
        The connection to run it on.
    text : str
        One statement that only reads: SELECT, FROM, WITH, VALUES, TABLE, PIVOT, EXPLAIN, DESCRIBE, SHOW, SUMMARIZE,
        or one of a few PRAGMAs. It may read any file (with `read_csv`, for example) and write none.
    parameters : sequence or dict, optional
        Values for its `?`, or for its `$name`.

    Raises
    ------
    KinedexError
        The query would change something, holds several statements, or DuckDB refuses it; an `UnknownName` for an
        unknown table or function, an `Unreadable` for a file that cannot be read.
    """
    _refuse_writing(connection, text)
    try:
        relation = connection.sql(text, params=parameters)
        return pa.table({}) if relation is None else relation.to_arrow_table()
    except _DAMAGE as fault:
        raise Unreadable(message(fault)) from None
    except duckdb.Error as fault:
        missing = _MISSING.search(str(fault))
        raise (UnknownName(missing[1], message(fault)) if missing else KinedexError(message(fault))) from None


def interruptible_query(connection: Connection, text: str, parameters: Parameters = None) -> pa.Table:
    """Run a query as `read_query` does, so that Ctrl-C stops it; DuckDB alone would notice Ctrl-C only at the end."""
    if threading.current_thread() is not threading.main_thread():
        return read_query(connection, text, parameters)
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(read_query, connection, text, parameters)
        try:
            return done.result()
        except KeyboardInterrupt:
            while not done.done():
                connection.interrupt()
                wait([done], timeout=0.05)
            raise


def _refuse_writing(connection: Connection, text: str) -> None:
    try:
        parsed = connection.extract_statements(text)
    except duckdb.Error as fault:
        raise KinedexError(message(fault)) from None
    if len(parsed) != 1:
        raise KinedexError(f"expected one SQL statement, got {len(parsed)}")
    kind = parsed[0].type
    words = [word.lower() for _, word in _tokens(text)]
    first = next((word for word in words if word != "("), "")
    if kind not in _READING or first not in _READING_WORDS:
        raise _refused(kind.name)
    if first == "pragma" and (words[1:2] == [] or words[1] not in _PRAGMAS or "=" in words[2:3]):
        raise KinedexError(f"only these PRAGMAs are allowed: {', '.join(sorted(_PRAGMAS))}")
    for before, word, after in zip(words, words[1:], [*words[2:], ""], strict=False):
        # a WITH entry begins after a parenthesis; a column of such a name follows something else
        if before in ("(", ")") and word in _WRITING_WORDS and re.match(r'[\w"(]', after):
            raise _refused(word.upper())
        if after == "(" and word.strip('"') in _WRITING_FUNCTIONS:
            raise _refused(f"{word}(…)")
    if kind == duckdb.StatementType.EXPLAIN:
        # EXPLAIN ANALYZE runs the statement that it explains
        _refuse_writing(connection, _explained(text))


def _refused(found: str) -> KinedexError:
    return KinedexError(
        f"only queries that read are allowed, got {found}; "
        "to work with copies, write the result to a file or open the store with `Store.connect()`"
    )


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


def _explained(text: str) -> str:
    """Return the statement that an EXPLAIN explains."""
    tokens = _tokens(text)
    place = 1
    if place < len(tokens) and tokens[place][1].lower() == "analyze":
        place += 1
    # options, as in EXPLAIN (ANALYZE, FORMAT json) SELECT …; a query in parentheses begins otherwise
    if [word.lower() for _, word in tokens[place : place + 2]] in (["(", "analyze"], ["(", "format"]):
        place = next(at for at in range(place, len(tokens)) if tokens[at][1] == ")") + 1
    return text.encode()[tokens[place][0] :].decode() if place < len(tokens) else ""
