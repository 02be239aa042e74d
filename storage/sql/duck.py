"""Everything that speaks to DuckDB: how connections are set up, what queries may do, how errors are told."""

from __future__ import annotations

import glob
import re
import tempfile
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa

from kinedex.ops.errors import KinedexError

Connection = duckdb.DuckDBPyConnection
Error = duckdb.Error
Parameters = Sequence[Any] | dict[str, Any] | None

_READING = {
    duckdb.StatementType.SELECT,
    duckdb.StatementType.EXPLAIN,
    duckdb.StatementType.PRAGMA,
    duckdb.StatementType.MULTI,  # what PIVOT becomes
}
_READING_WORDS = set("select from with values table pivot unpivot explain show describe desc summarize pragma".split())
_PRAGMAS = set(
    "collations database_list database_size functions metadata_info platform show show_databases show_tables "
    "show_tables_expanded storage_info table_info user_agent version".split()
)
# What may stand where a query has a WITH part, and does not read.
_WRITING_WORDS = {"copy", "insert", "update", "delete", "merge", "truncate"}
# Functions that change something, or run SQL that is not seen here.
_WRITING_FUNCTIONS = set(
    "checkpoint force_checkpoint enable_logging disable_logging truncate_duckdb_logs write_log enable_profiling "
    "disable_profiling create_external_resource destroy_external_resource register_external_resource "
    "register_external_resource_type deregister_external_resource query json_execute_serialized_sql".split()
)
_MISSING = re.compile(r"(?:Table|Function|Macro) with name \"?(\w+)\"? does not exist")
_DAMAGE = (duckdb.IOException, duckdb.SerializationException, duckdb.InternalException, duckdb.FatalException)


def connect(threads: int | None = None, memory_mb: int | None = None) -> Connection:
    """Open an in-memory connection that never reaches for the network and spills to the system's temporary folder.

    A name in a query is that of a table, never of a variable of the program that happens to be called so.
    """
    connection = duckdb.connect(":memory:")
    # global, and so also of the cursors of this connection
    connection.execute("SET GLOBAL python_enable_replacements = false")
    connection.execute("SET enable_progress_bar = false")
    connection.execute("SET autoinstall_known_extensions = false")
    connection.execute("SET autoload_known_extensions = false")
    connection.execute(f"SET temp_directory = {quote(str(Path(tempfile.gettempdir()) / 'kinedex-duckdb'))}")
    if threads is not None:
        connection.execute(f"SET threads = {int(threads)}")
    if memory_mb is not None:
        connection.execute(f"SET memory_limit = '{int(memory_mb)}MB'")
    return connection


def lock(connection: Connection) -> None:
    """Fix the settings of a connection; what writes files through a setting (logs, profiles) fails from now on."""
    connection.execute("SET lock_configuration = true")


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
        pa.bool_(): "BOOLEAN",
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
    branches = [f"SELECT * FROM {_read_parquet(whole)}"] if whole else []
    tombstones = [(file, take) for file, dropped in files for take in dropped]
    if tombstones:
        # one scan and one join for any number of parts; the pairs are one literal, which is parsed faster than a list
        pairs = ", ".join(f"{{part: {file.name}, take_id: {take}}}" for file, take in tombstones)
        gone = f"SELECT unnest({quote(f'[{pairs}]')}::STRUCT(part VARCHAR, take_id BIGINT)[], recursive := true)"
        branches.append(
            f"SELECT rows.* FROM {_read_parquet([file for file, dropped in files if dropped])} AS rows "
            f"ANTI JOIN ({gone}) AS gone ON gone.take_id = rows.take_id AND gone.part = parse_filename(rows.filename)"
        )
    return "\nUNION ALL ".join(branches)


def _read_parquet(files: Sequence[Path]) -> str:
    """The scan of just these files: nothing in their paths is a pattern, a home folder, or a partition's key."""
    paths = ", ".join(quote(glob.escape(str(file.absolute()))) for file in files)
    return f"read_parquet([{paths}], hive_partitioning = false)"


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


class Unreadable(KinedexError):
    """A query met a file that is missing, or whose content makes no sense."""


def query(connection: Connection, text: str, parameters: Parameters = None) -> pa.Table:
    """Run one reading query and return its whole result.

    Parameters
    ----------
    connection: where to run it.
    text: one statement that only reads: SELECT, FROM, WITH, VALUES, TABLE, PIVOT, EXPLAIN, DESCRIBE, SHOW, SUMMARIZE,
        or one of a few PRAGMAs. It may read any file (`read_csv` and its kin), and write none.
    parameters: values for its `?`, or for its `$name`.

    Raises
    ------
    KinedexError: the query would change something, holds several statements, or DuckDB refuses it; an UnknownName
        where it asks for a table or a function that is not there, Unreadable where a file cannot be read.
    """
    _refuse_writing(connection, text)
    try:
        relation = connection.sql(text, params=parameters)
        return pa.table({}) if relation is None else relation.to_arrow_table()
    except _DAMAGE as fault:
        raise Unreadable(explain(fault)) from None
    except duckdb.Error as fault:
        missing = _MISSING.search(str(fault))
        raise (UnknownName(missing[1], explain(fault)) if missing else KinedexError(explain(fault))) from None


def interruptible_query(connection: Connection, text: str, parameters: Parameters = None) -> pa.Table:
    """Run a query as `query` does, so that Ctrl-C stops it: DuckDB by itself would hear of that when it is done."""
    if threading.current_thread() is not threading.main_thread():
        return query(connection, text, parameters)
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(query, connection, text, parameters)
        try:
            return done.result()
        except KeyboardInterrupt:
            while not done.done():
                connection.interrupt()
                wait([done], timeout=0.05)
            raise


def _refuse_writing(connection: Connection, text: str) -> None:
    try:
        statements = connection.extract_statements(text)
    except duckdb.Error as fault:
        raise KinedexError(explain(fault)) from None
    if len(statements) != 1:
        raise KinedexError(f"expected one SQL statement, got {len(statements)}")
    kind = statements[0].type
    words = [word.lower() for _, word in _tokens(text)]
    first = next((word for word in words if word != "("), "")
    if kind not in _READING or first not in _READING_WORDS:
        raise _refused(kind.name)
    if first == "pragma" and (words[1:2] == [] or words[1] not in _PRAGMAS or "=" in words[2:3]):
        raise KinedexError(f"only these PRAGMAs are run here: {', '.join(sorted(_PRAGMAS))}")
    for before, word, after in zip(words, words[1:], [*words[2:], ""], strict=False):
        # the body of a WITH entry, which may have a WITH of its own in front; a column of such a name stands otherwise
        if before in ("(", ")") and word in _WRITING_WORDS and re.match(r'[\w"(]', after):
            raise _refused(word.upper())
        if after == "(" and word.strip('"') in _WRITING_FUNCTIONS:
            raise _refused(f"{word}(…)")
    if kind == duckdb.StatementType.EXPLAIN:
        # EXPLAIN ANALYZE runs what it explains
        _refuse_writing(connection, _explained(text))


def _refused(what: str) -> KinedexError:
    return KinedexError(
        f"only queries that read are run here, this is {what}; "
        "to work with copies, write the result to a file or open the store with `Store.connect()`"
    )


def _tokens(text: str) -> list[tuple[int, str]]:
    """The tokens of a statement without its comments, each with the byte where it begins."""
    raw = text.encode()
    found = [(start, kind) for start, kind in duckdb.tokenize(text)]
    stops = [start for start, _ in found[1:]] + [len(raw)] * bool(found)
    return [
        (start, raw[start:stop].decode(errors="replace").strip())
        for (start, kind), stop in zip(found, stops, strict=True)
        if kind != duckdb.token_type.comment
    ]


def statements(text: str) -> tuple[list[str], str]:
    """Split what is being typed into whole statements, each ended by a semicolon, and the rest.

    A semicolon in a text, a quoted name, or a comment ends nothing. A rest of finished comments is no rest.
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
    """The statement that an EXPLAIN explains."""
    tokens = _tokens(text)
    place = 1
    if place < len(tokens) and tokens[place][1].lower() == "analyze":
        place += 1
    # options, as in EXPLAIN (ANALYZE, FORMAT json) SELECT …; a query in parentheses begins otherwise
    if [word.lower() for _, word in tokens[place : place + 2]] in (["(", "analyze"], ["(", "format"]):
        place = next(at for at in range(place, len(tokens)) if tokens[at][1] == ")") + 1
    return text.encode()[tokens[place][0] :].decode() if place < len(tokens) else ""


def explain(fault: duckdb.Error) -> str:
    """DuckDB's message without the class of error in front."""
    return re.sub(r"^(Invalid Input|\w+) Error: ", "", str(fault).strip(), count=1)


def first_line(fault: duckdb.Error) -> str:
    """DuckDB's reason in one line."""
    return explain(fault).splitlines()[0]
