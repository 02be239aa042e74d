"""Open DuckDB connections to a store, with its index attached and the views and macros that statements need."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from kinedex.catalog.sql.views import MACROS, VIEWS, Macro, View
from kinedex.ops.errors import KinedexError, StoreError, did_you_mean
from kinedex.storage import duckdb_sql
from kinedex.storage.index.generations import (
    FILE,
    Generation,
    current_generation,
    file_digest,
    missing_index,
    read_generation,
)
from kinedex.storage.index.index_views import features_table, help_table, views_digest
from kinedex.storage.interruption import is_abandoned
from kinedex.storage.remedies import build_index, repair
from kinedex.storage.snapshot.parts import part_file
from kinedex.storage.snapshot.schemas import RESULT_KINDS, frames_schema
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.snapshot.visible_results import pipeline_runs
from kinedex.storage.sql.queries import QueryResult, Unreadable, bounded_query, explained
from kinedex.storage.sql.read_only import UnknownName
from kinedex.storage.sql.read_parts import check_parts
from kinedex.storage.sql.result_scans import ALL_VIEWS, result_select, shown_labels

NAMES = (*(view.name for view in VIEWS), *ALL_VIEWS, *(macro.name for macro in MACROS))
"""The names of all views and macros."""

_left_open: list[Connections] = []
"""Connections in which an abandoned statement still runs."""

_MACROS = frozenset(macro.name for macro in MACROS)

INDEXED = frozenset(
    view.name for view in VIEWS if view.origin == "index" and view.name not in ("takes", "features", "help")
)
"""Names of the views that exist only with an index."""


def connect(store: Snapshot, threads: int | None = None, memory_mb: int | None = None) -> duckdb_sql.Connection:
    """Open a connection with all views and macros of a store, after a check of all of its parts.

    The index is attached read-only. Frames and results are read from the parts of this version. If the index is missing
    or outdated, a query over the views `INDEXED` or the macros over them fails with a message that states the command
    to build it; all other queries work.

    Parameters
    ----------
    store : Snapshot
        The version of the store to query.
    threads : int, optional
        Largest number of threads; by default DuckDB decides.
    memory_mb : int, optional
        Largest memory in MB; by default DuckDB decides.

    Raises
    ------
    StoreError
        The index or a part cannot be read; the message names the file and the remedy.
    """
    store.checked.parts(store.manifest.parts)
    connection = duckdb_sql.connect(threads, memory_mb)
    try:
        index = _attach_index(connection, store)
        # a query over a view of a missing index fails with the reason
        for view in VIEWS if index is None else ():
            if view.name in INDEXED:
                _define_view_that_fails(connection, view, str(missing_index(store.path, store.manifest)))
        Definitions(connection, store, index, complete=True).make(NAMES)
    except BaseException:
        connection.close()
        raise
    return connection


class Connections:
    """The connections of one open store for `run_query`: one for each active thread, all to the same DuckDB database.

    The settings of the connections are locked. The index is attached once, and stays readable while they are open, even
    after its file has been removed.

    Parameters
    ----------
    store : Snapshot
        The version of the store to query.
    files : sequence of Path, optional
        Folders (or files) outside the store that queries may read.
    """

    def __init__(self, store: Snapshot, files: Sequence[Path] = ()) -> None:
        self._store = store
        self._lock = threading.Lock()
        self._first = duckdb_sql.connect()
        try:
            self._index = _attach_index(self._first, store)
            first = Definitions(self._first, store, self._index)
            duckdb_sql.allow_only(self._first, [store.path, *files])
            # settings that write files (logs, profiles) fail from now on
            self._first.execute("SET lock_configuration = true")
        except BaseException:
            self._first.close()
            raise
        self._idle = [first]
        self._taken = 0
        self._closed = False

    @property
    def indexed(self) -> bool:
        """True if the index is attached."""
        return self._index is not None

    def take(self) -> Definitions:
        """Lend a connection for exclusive use until it is given back; must not be called after `close`."""
        with self._lock:
            lent = self._idle.pop() if self._idle else self._another()
            self._taken += 1
            return lent

    def _another(self) -> Definitions:
        connection = self._first.cursor()
        try:
            if self.indexed:
                connection.execute("USE idx")
            return Definitions(connection, self._store, self._index)
        except BaseException:
            connection.close()
            raise

    def give_back(self, lent: Definitions) -> bool:
        """Take a connection back; return False if none of the connections may be used again."""
        if is_abandoned(lent.connection):
            # left open: closing the first connection closes all of them, and would wait for the statement
            _left_open.append(self)
            return False
        with self._lock:
            self._taken -= 1
            self._idle.append(lent)
            self._close()
        return True

    def close(self) -> None:
        """Close all connections as soon as none is in use."""
        with self._lock:
            self._closed = True
            self._close()

    def _close(self) -> None:
        if self._closed and not self._taken:
            # closing the first connection closes its cursors, even while a query runs in one
            self._first.close()


class Definitions:
    """The views and macros of one connection, each created when a statement first needs it.

    Parameters
    ----------
    connection : Connection
        The connection on which views and macros are created.
    store : Snapshot
        The version of the store that they show.
    index : Generation or None
        The record of the attached index.
    complete : bool, optional
        True to create the macros over the index even if it is missing.
    """

    def __init__(
        self, connection: duckdb_sql.Connection, store: Snapshot, index: Generation | None, *, complete: bool = False
    ) -> None:
        self.connection = connection
        self._store, self._index, self._complete = store, index, complete
        self._made: set[str] = set()
        if index is None or index.takes != store.manifest.takes_digest():
            # the index has other rows or columns of takes: they have changed since the build, or its format is older
            with self._errors():
                connection.register("takes", store.take_rows)

    def make(self, names: Iterable[str]) -> None:
        """Create those of the given views and macros that do not exist yet; `names` must include their dependencies."""
        wanted = set(names) - self._made
        with self._errors():
            self._make_stored(wanted)
            for view in VIEWS:
                if view.name in wanted and view.origin != "index" and view.body:
                    _view(self.connection, view.name, view.body)
            for macro in MACROS:
                if macro.name in wanted and self._is_made_here(macro):
                    self.connection.execute(macro.sql(temporary=True))
        self._made |= wanted

    def _make_stored(self, wanted: set[str]) -> None:
        """Create views over the files of the store, its labels and its records."""
        connection, store = self.connection, self._store
        if "features" in wanted and self._index is None:
            _view(connection, "features", duckdb_sql.literal_rows(features_table(store.feature_set)))
        if "help" in wanted:
            _view(connection, "help", duckdb_sql.literal_rows(help_table()))
        if "frames" in wanted:
            # to create a view, DuckDB reads the columns of one part, but no rows
            frames = [(part_file(store.path, part.path), part.dropped) for part in store.manifest.frames]
            _view(
                connection, "frames", duckdb_sql.parquet_rows(frames_schema(store.feature_set, store.rate_hz), frames)
            )
        for kind in (*RESULT_KINDS, *sorted(ALL_VIEWS)):
            if kind in wanted:
                _view(connection, kind, result_select(store, kind))
        if "pipeline_runs" in wanted:
            connection.register("pipeline_runs", pipeline_runs(store.manifest))
        if "label_history" in wanted:
            _define_labels(connection, store)

    def _is_made_here(self, macro: Macro) -> bool:
        """Return whether a macro is defined here rather than in the index, whose macros may be outdated."""
        index, store = self._index, self._store
        own = index is not None and index.surface == views_digest(store.feature_set, store.rate_hz)
        if own and macro.needs == "index":
            return False
        return index is not None or self._complete or not _reads_index(macro)

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Report a damaged file if views cannot be created."""
        try:
            yield
        except (duckdb_sql.Error, UnicodeDecodeError) as fault:
            # a damaged column name may not be UTF-8, which would hide the message
            self._store.checked.parts(self._store.manifest.parts)
            reason = duckdb_sql.first_line(fault) if isinstance(fault, duckdb_sql.Error) else str(fault)
            if (outside := explained(reason)) != reason:
                raise KinedexError(outside) from None
            raise StoreError(f"{self._store.path}: SQL over this store does not work: {reason}") from None


def _define_labels(connection: duckdb_sql.Connection, store: Snapshot) -> None:
    """Create the table of labels; if they are damaged, define it so that a query over it fails with the reason."""
    try:
        connection.register("label_history", shown_labels(store))
    except StoreError as fault:
        (view,) = (view for view in VIEWS if view.name == "label_history")
        _define_view_that_fails(connection, view, str(fault))


def _define_view_that_fails(connection: duckdb_sql.Connection, view: View, reason: str) -> None:
    failing = f"error({duckdb_sql.quote(reason)})"
    # the columns must fail as well: DuckDB would skip a view whose condition on NULL columns can never hold
    typed = ((column.type, duckdb_sql.identifier(column.name)) for column in view.columns)
    columns = ", ".join(f"{failing}::{kind} AS {name}" for kind, name in typed)
    _view(connection, view.name, f"SELECT {columns} WHERE {failing} IS NULL")


def _attach_index(connection: duckdb_sql.Connection, store: Snapshot) -> Generation | None:
    """Attach the index of these takes read-only and return its record; None if there is no index."""
    while (generation := current_generation(store.path, store.manifest)) is not None:
        file, record = (generation / FILE).absolute(), read_generation(generation)
        try:
            connection.execute(f"ATTACH {duckdb_sql.quote(str(file))} AS idx (READ_ONLY)")
            connection.execute("USE idx")
        except duckdb_sql.Error as fault:
            if not file.is_file():
                # a build has published a newer generation, or somebody has removed the index
                continue
            reason = f"{file}: the index cannot be read: {duckdb_sql.first_line(fault)}"
            raise StoreError(reason, remedy=build_index(store.path)) from None
        if record is not None:
            return record
        connection.execute("USE memory")
        connection.execute("DETACH idx")
    return None


def run_query(
    store: Snapshot,
    lent: Definitions,
    text: str,
    parameters: duckdb_sql.Parameters,
    *,
    files: bool = False,
    timeout: float | None = None,
    max_rows: int | None = None,
) -> QueryResult:
    """Run one read-only query on a connection of `Connections`.

    Parameters
    ----------
    store : Snapshot
        The store of the connection.
    lent : Definitions
        The connection to run it on.
    text : str
        The query, as in `storage.sql.queries.bounded_query`.
    parameters : sequence or dict, optional
        Values for the placeholders `?` or `$name` of the query.
    files : bool, optional
        If True, it may read the files that the connection's settings allow.
    timeout, max_rows : optional
        As for `storage.sql.queries.bounded_query`.

    Raises
    ------
    KinedexError
        The query is refused, fails, or does not end in time; the message names what is missing or damaged in the
        store.
    """
    lent.make(check_parts(store, lent.connection, text))
    try:
        return bounded_query(
            lent.connection, text, parameters, _MACROS, files=files, timeout=timeout, max_rows=max_rows
        )
    except UnknownName as fault:
        raise _explain_unknown(store, fault) from None
    except Unreadable as fault:
        _report_damaged_index(store, str(fault))
        raise KinedexError(f"{fault}\n  a file of the store may be damaged", remedy=repair(store.path)) from None


def _report_damaged_index(store: Snapshot, reason: str) -> None:
    """Raise a StoreError that names the index file if it is damaged; DuckDB checks every block that it reads."""
    generation = current_generation(store.path, store.manifest)
    record = None if generation is None else read_generation(generation)
    if generation is not None and record is not None and file_digest(generation / FILE) != record.xxh3:
        raise StoreError(
            f"{generation / FILE}: the index is damaged: {reason.splitlines()[0]}", remedy=build_index(store.path)
        )


def _explain_unknown(store: Snapshot, fault: UnknownName) -> KinedexError:
    """Return the error for a name that needs the missing index or does not exist; the message lists all names."""
    name = fault.name.lower()
    if name in INDEXED or any(macro.name == name and _reads_index(macro) for macro in MACROS):
        return missing_index(store.path, store.manifest)
    if name in NAMES:
        return KinedexError(str(fault))
    near = did_you_mean(fault.name, NAMES)
    kind = "function" if re.search(r"(Function|Macro) with name", str(fault)) else "view"
    return KinedexError(
        f"no {kind} or macro is named '{fault.name}'{near if near.startswith('; did') else ''}\n"
        f"  the views and macros of a store: {', '.join(sorted(NAMES))}"
    )


def _reads_index(macro: Macro) -> bool:
    return any(re.search(rf"\b{view}\b", macro.body) for view in INDEXED)


def _view(connection: duckdb_sql.Connection, name: str, query: str) -> None:
    connection.execute(f"CREATE TEMP VIEW {name} AS {query}")
