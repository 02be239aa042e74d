"""Open DuckDB connections with this project's settings, and build SQL text for Arrow schemas and Parquet files."""

from __future__ import annotations

import glob
import os
import re
import tempfile
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa

from kinedex.storage.interruption import is_abandoned, run_bounded

Connection = duckdb.DuckDBPyConnection
Error = duckdb.Error
Parameters = Sequence[Any] | dict[str, Any] | None


def connect(threads: int | None = None, memory_mb: int | None = None) -> Connection:
    """Open an in-memory connection that uses no network and spills to the system's temporary folder.

    Names in a query are resolved to tables only, never to Python variables.

    Parameters
    ----------
    threads : int, optional
        Largest number of threads; by default DuckDB decides.
    memory_mb : int, optional
        Largest memory in MB; by default DuckDB decides.
    """
    connection = duckdb.connect(":memory:")
    # a GLOBAL setting also applies to the cursors of this connection
    connection.execute("SET GLOBAL python_enable_replacements = false")
    _hide_progress(connection)
    connection.execute("SET autoinstall_known_extensions = false")
    connection.execute("SET autoload_known_extensions = false")
    connection.execute(f"SET temp_directory = {quote(str(Path(tempfile.gettempdir()) / 'kinedex-duckdb'))}")
    if threads is not None:
        connection.execute(f"SET threads = {int(threads)}")
    if memory_mb is not None:
        connection.execute(f"SET memory_limit = '{int(memory_mb)}MB'")
    return connection


def _hide_progress(connection: Connection) -> None:
    # in a notebook without ipywidgets DuckDB has no progress bar, and raises an error on switching it off
    with suppress(duckdb.InvalidInputException):
        connection.execute("SET enable_progress_bar = false")


def allow_only(connection: Connection, places: Iterable[Path]) -> None:
    """Restrict a connection to the files in the given folders; databases that are already attached stay open."""
    # DuckDB compares the glob-escaped path of a scan as text, so allow both forms
    paths = [str(place.absolute()) for place in places]
    folders = ", ".join(quote(path) for path in dict.fromkeys([*paths, *map(glob.escape, paths)]))
    connection.execute(f"SET allowed_directories = [{folders}]")
    connection.execute("SET enable_external_access = false")


def rows(connection: Connection, text: str, parameters: Parameters = None) -> pa.Table:
    """Run an internal query and return its rows; `storage.sql.queries` runs the queries of users."""
    return run_bounded(connection, lambda: connection.sql(text, params=parameters).to_arrow_table())


def quote(text: str) -> str:
    """Return a text as a SQL literal."""
    return "'" + text.replace("'", "''") + "'"


def identifier(name: str) -> str:
    """Return a name as a quoted SQL identifier."""
    return '"' + name.replace('"', '""') + '"'


def sql_type(kind: pa.DataType) -> str:
    """Return the DuckDB type of a column of one of the store's schemas."""
    if pa.types.is_list(kind):
        return sql_type(kind.value_type) + "[]"
    if pa.types.is_struct(kind):
        return f"STRUCT({', '.join(f'{identifier(child.name)} {sql_type(child.type)}' for child in kind)})"
    if pa.types.is_timestamp(kind):
        return "TIMESTAMPTZ"
    return {
        pa.bool_(): "BOOLEAN",
        pa.string(): "VARCHAR",
        pa.int32(): "INTEGER",
        pa.int64(): "BIGINT",
        pa.uint8(): "UTINYINT",
        pa.uint64(): "UBIGINT",
        pa.float32(): "FLOAT",
        pa.float64(): "DOUBLE",
    }[kind]


def null_columns(fields: Iterable[pa.Field]) -> list[str]:
    """Return SELECT expressions that give NULL columns with the names and types of the fields."""
    return [f"NULL::{sql_type(field.type)} AS {identifier(field.name)}" for field in fields]


@dataclass(frozen=True)
class ResultScan:
    """Parquet parts of results that are read together.

    Attributes
    ----------
    files : tuple of Path
        The parts.
    width : int
        The number of columns that the parts have: the first ones of the schema. The other columns are null.
    origin : dict of str to str or None
        Column → the one value that it has in all rows of these parts; it replaces a stored column of the same name.
    """

    files: tuple[Path, ...]
    width: int
    origin: dict[str, str | None]


def result_rows(schema: pa.Schema, origin: Sequence[str], scans: Sequence[ResultScan]) -> str:
    """Return the SELECT that reads the rows of Parquet parts of results.

    Parameters
    ----------
    schema : pyarrow.Schema
        Columns of the parts. If there is no part, the SELECT gives these columns and those of `origin`, and no rows.
    origin : sequence of str
        Names of the text columns that follow those of the schema.
    scans : sequence of ResultScan
        The parts.
    """
    stored = [field for field in schema if field.name not in origin]
    if not scans:
        texts = [pa.field(name, pa.string()) for name in origin]
        return f"SELECT {', '.join(null_columns([*stored, *texts]))} WHERE false"
    branches = []
    for scan in scans:
        held = frozenset(schema.names[: scan.width])
        # every column is qualified by its table: a bare name could be taken for an argument of a macro
        columns = [
            f"part.{identifier(field.name)}" if field.name in held else null_columns([field])[0] for field in stored
        ]
        for name in origin:
            value = scan.origin[name]
            columns.append(f"{'NULL' if value is None else quote(value)}::VARCHAR AS {identifier(name)}")
        branches.append(f"SELECT {', '.join(columns)} FROM {_read_parquet(scan.files)} AS part")
    return "\nUNION ALL ".join(branches)


def parquet_rows(schema: pa.Schema, files: Sequence[tuple[Path, Sequence[int]]]) -> str:
    """Return the SELECT that reads the live rows of Parquet parts of frames.

    Parameters
    ----------
    schema : pyarrow.Schema
        Columns of the parts. If there is no part, the SELECT gives these columns and no rows.
    files : sequence of (Path, sequence of int)
        Each part with the ids of the takes whose rows in it are dropped.
    """
    if not files:
        return f"SELECT {', '.join(null_columns(schema))} WHERE false"
    whole = [file for file, dropped in files if not dropped]
    branches = [f"SELECT * FROM {_read_parquet(whole)}"] if whole else []
    tombstones = [(file, take) for file, dropped in files for take in dropped]
    if tombstones:
        # one scan and one join for any number of parts; one literal with all pairs is parsed faster than a list of them
        pairs = ", ".join(f"{{part: {file.name}, take_id: {take}}}" for file, take in tombstones)
        gone = f"SELECT unnest({quote(f'[{pairs}]')}::STRUCT(part VARCHAR, take_id BIGINT)[], recursive := true)"
        branches.append(
            f"SELECT rows.* FROM {_read_parquet([file for file, dropped in files if dropped])} AS rows "
            f"ANTI JOIN ({gone}) AS gone ON gone.take_id = rows.take_id AND gone.part = parse_filename(rows.filename)"
        )
    return "\nUNION ALL ".join(branches)


def _read_parquet(files: Sequence[Path]) -> str:
    """Return a scan of exactly these files: no path is read as a glob, a home folder or a partition key."""
    paths = ", ".join(quote(glob.escape(str(file.absolute()))) for file in files)
    return f"read_parquet([{paths}], hive_partitioning = false)"


def literal_rows(table: pa.Table) -> str:
    """Return the SELECT that gives the rows of a small table of texts and numbers."""
    cells = [
        ", ".join(quote(value) if isinstance(value, str) else f"{value}::{sql_type(kind)}" for value, kind in row)
        for row in (zip(row.values(), table.schema.types, strict=True) for row in table.to_pylist())
    ]
    names = ", ".join(map(identifier, table.column_names))
    return f"SELECT * FROM (VALUES {', '.join(f'({row})' for row in cells)}) AS given({names})"


def rows_where(table: pa.Table, name: str, condition: str) -> pa.Table:
    """Return the rows of a table for which a SQL condition holds.

    Parameters
    ----------
    table : pyarrow.Table
        The table to filter.
    name : str
        The table's name in the condition.
    condition : str
        A single condition on the columns of the table; it cannot read files.

    Raises
    ------
    Error
        DuckDB refuses the condition.
    """
    connection = _closed_database(os.getpid()).cursor()
    try:
        _hide_progress(connection)
        connection.register(name, table)
        text = f"SELECT * FROM {name} WHERE (\n{condition}\n)"
        if len(connection.extract_statements(text)) != 1:
            raise duckdb.ParserException("more than one statement")
        return run_bounded(connection, lambda: connection.sql(text).to_arrow_table())
    except (duckdb.FatalException, duckdb.InternalException):
        _closed_database.cache_clear()  # after such an error DuckDB refuses every further statement
        raise
    finally:
        if not is_abandoned(connection):
            connection.close()


@cache
def _closed_database(_process: int) -> Connection:
    """Open an in-memory database without file access, once for each process, since opening one takes 15 ms."""
    connection = connect(threads=1)
    connection.execute("SET enable_external_access = false")
    return connection


def message(fault: duckdb.Error) -> str:
    """Return DuckDB's message without the name of the error's class in front."""
    return re.sub(r"^(Invalid Input|\w+) Error: ", "", str(fault).strip(), count=1)


def first_line(fault: duckdb.Error) -> str:
    """Return the first line of DuckDB's message."""
    return message(fault).splitlines()[0]
