"""Everything that speaks to DuckDB: how connections are set up, what queries may do, how errors are told."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa

from ops.errors import KinedexError

Connection = duckdb.DuckDBPyConnection
Error = duckdb.Error
Parameters = Sequence[Any] | dict[str, Any] | None

_READING = {
    duckdb.StatementType.SELECT,
    duckdb.StatementType.EXPLAIN,
    duckdb.StatementType.PRAGMA,
    duckdb.StatementType.CALL,
    duckdb.StatementType.MULTI,  # what PIVOT becomes
}
_READING_WORDS = re.compile(
    r"\(*\s*(select|from|with|values|table|pivot|unpivot|explain|show|describe|desc|summarize|pragma|call)\b", re.I
)
_COMMENT = re.compile(r"\s*(--[^\n]*(\n|$)|/\*.*?\*/)", re.S)
_MISSING = re.compile(r"(?:Table|Function|Macro) with name \"?(\w+)\"? does not exist")
_EXPLAIN = re.compile(r"\s*explain\b\s*(analyze\b)?\s*(\([^)]*\))?", re.I)


def connect(threads: int | None = None, memory_mb: int | None = None) -> Connection:
    """Open an in-memory connection that never reaches for the network and spills to the system's temporary folder."""
    connection = duckdb.connect(":memory:")
    connection.execute("SET enable_progress_bar = false")
    connection.execute("SET autoinstall_known_extensions = false")
    connection.execute("SET autoload_known_extensions = false")
    connection.execute(f"SET temp_directory = {quote(str(Path(tempfile.gettempdir()) / 'kinedex-duckdb'))}")
    if threads is not None:
        connection.execute(f"SET threads = {int(threads)}")
    if memory_mb is not None:
        connection.execute(f"SET memory_limit = '{int(memory_mb)}MB'")
    return connection


def quote(text: str) -> str:
    """A text as a SQL literal."""
    return "'" + text.replace("'", "''") + "'"


def name(identifier: str) -> str:
    """A name as a quoted SQL identifier."""
    return '"' + identifier.replace('"', '""') + '"'


def sql_type(kind: pa.DataType) -> str:
    """The DuckDB type of a column of one of the store's schemas."""
    if pa.types.is_list(kind):
        return sql_type(kind.value_type) + "[]"
    if pa.types.is_struct(kind):
        return f"STRUCT({', '.join(f'{name(child.name)} {sql_type(child.type)}' for child in kind)})"
    if pa.types.is_timestamp(kind):
        return "TIMESTAMPTZ"
    return {
        pa.string(): "VARCHAR",
        pa.int32(): "INTEGER",
        pa.int64(): "BIGINT",
        pa.uint8(): "UTINYINT",
        pa.uint64(): "UBIGINT",
        pa.float32(): "FLOAT",
        pa.float64(): "DOUBLE",
    }[kind]


def parquet_rows(schema: pa.Schema, files: Sequence[tuple[Path, Sequence[int]]]) -> str:
    """The SELECT that reads Parquet parts.

    Parameters
    ----------
    schema: what the parts hold; with no part, an empty relation of this schema.
    files: each part with the take ids of its rows that do not count.
    """
    if not files:
        columns = ", ".join(f"NULL::{sql_type(field.type)} AS {name(field.name)}" for field in schema)
        return f"SELECT {columns} WHERE false"
    whole = [file for file, dropped in files if not dropped]
    branches = [f"SELECT * FROM read_parquet([{', '.join(quote(str(file)) for file in whole)}])"] if whole else []
    branches += [
        f"SELECT * FROM read_parquet({quote(str(file))}) WHERE take_id NOT IN ({', '.join(map(str, dropped))})"
        for file, dropped in files
        if dropped
    ]
    return "\nUNION ALL ".join(branches)


def literal_rows(table: pa.Table) -> str:
    """The SELECT that gives the rows of a small table of texts and numbers."""
    rows = [
        ", ".join(quote(value) if isinstance(value, str) else f"{value}::{sql_type(kind)}" for value, kind in cells)
        for cells in (zip(row.values(), table.schema.types, strict=True) for row in table.to_pylist())
    ]
    names = ", ".join(map(name, table.column_names))
    return f"SELECT * FROM (VALUES {', '.join(f'({row})' for row in rows)}) AS given({names})"


def filtered(table: pa.Table, called: str, where: str) -> pa.Table:
    """The rows of a table for which a SQL condition holds; a wrong condition is an `Error` of DuckDB's.

    Parameters
    ----------
    table: what to filter. called: the table's name in the condition.
    where: one condition; it sees the table and nothing outside this process.
    """
    connection = connect(threads=1)
    try:
        connection.register(called, table)
        connection.execute("SET enable_external_access = false")
        text = f"SELECT * FROM {called} WHERE (\n{where}\n)"
        if len(connection.extract_statements(text)) != 1:
            raise duckdb.ParserException("more than one statement")
        return connection.sql(text).to_arrow_table()
    finally:
        connection.close()


class UnknownName(KinedexError):
    """A query asks for a table or a function that is not there."""

    def __init__(self, name: str, message: str) -> None:
        super().__init__(message)
        self.name = name


def query(connection: Connection, text: str, parameters: Parameters = None) -> pa.Table:
    """Run one reading query and return its whole result.

    Parameters
    ----------
    connection: where to run it.
    text: one statement that only reads (SELECT, FROM, WITH, PIVOT, EXPLAIN, DESCRIBE, SHOW, SUMMARIZE, PRAGMA).
    parameters: values for its `?`, or for its `$name`.

    Raises
    ------
    KinedexError: the query would change something, holds several statements, or DuckDB refuses it; an UnknownName
        where it asks for a table or a function that is not there.
    """
    _refuse_writing(connection, text)
    try:
        relation = connection.sql(text, params=parameters)
        return pa.table({}) if relation is None else relation.to_arrow_table()
    except duckdb.Error as fault:
        missing = _MISSING.search(str(fault))
        raise (UnknownName(missing[1], explain(fault)) if missing else KinedexError(explain(fault))) from None


def _refuse_writing(connection: Connection, text: str) -> None:
    try:
        statements = connection.extract_statements(text)
    except duckdb.Error as fault:
        raise KinedexError(explain(fault)) from None
    if len(statements) != 1:
        raise KinedexError(f"expected one SQL statement, got {len(statements)}")
    bare = text
    while match := _COMMENT.match(bare):
        bare = bare[match.end() :]
    kind = statements[0].type
    if kind not in _READING or not _READING_WORDS.match(bare.strip()):
        raise KinedexError(
            f"only queries that read are run here, this is {kind.name}; "
            "to work with copies, write the result to a file or open the store with `Store.connect()`"
        )
    if kind == duckdb.StatementType.EXPLAIN:
        # EXPLAIN ANALYZE runs what it explains
        _refuse_writing(connection, _EXPLAIN.sub("", bare, count=1))


def explain(fault: duckdb.Error) -> str:
    """DuckDB's message without the class of error in front."""
    return re.sub(r"^(Invalid Input|\w+) Error: ", "", str(fault).strip(), count=1)


def first_line(fault: duckdb.Error) -> str:
    """DuckDB's reason in one line."""
    return explain(fault).splitlines()[0]
