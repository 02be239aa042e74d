"""The SQL side of a store: one connection on which every view and macro stands."""

from __future__ import annotations

import re
import threading
from typing import TYPE_CHECKING

import pyarrow as pa

from kinedex.catalog.sql.views import MACROS, VIEWS, Macro
from kinedex.ops.errors import KinedexError, StoreError, did_you_mean
from kinedex.storage import index
from kinedex.storage.sql import duck
from kinedex.storage.store.parts import part_file
from kinedex.storage.store.schemas import RESULT_KINDS, frames_schema, result_schema, takes_schema

if TYPE_CHECKING:
    from kinedex.storage.store.store import Store

NAMES = tuple(view.name for view in VIEWS) + tuple(macro.name for macro in MACROS)
"""Everything that a query can ask for by name."""

INDEXED = frozenset(
    view.name for view in VIEWS if view.origin == "index" and view.name not in ("takes", "features", "help")
)
"""The views that exist only with an index."""


def connect(store: Store, threads: int | None = None, memory_mb: int | None = None) -> duck.Connection:
    """Open a connection with all views and macros of a store.

    The index is attached read-only. Frames and results are read from the parts of this version, wherever the store is.
    Where the index is missing or stale, the views `INDEXED` and the macros over them say so when they are asked, and
    the rest works.

    Raises
    ------
    StoreError: the index or a part cannot be read; the message names the file and the way out.
    """
    connection = duck.connect(threads, memory_mb)
    try:
        indexed = _attach_index(connection, store)
        if not indexed:
            _tell_missing(connection, store)
        _define(connection, store, indexed, complete=True)
    except BaseException:
        connection.close()
        raise
    return connection


class Connections:
    """The connections of one open store for `query`: as many as threads ask at the same time, all to one DuckDB.

    What a query must not do is locked for all of them. The index is attached once: it stays readable for as long as
    they are open, also when it has been removed.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._lock = threading.Lock()
        self._first = duck.connect()
        try:
            self.indexed = _attach_index(self._first, store)
            _define(self._first, store, self.indexed)
            duck.lock(self._first)
        except BaseException:
            self._first.close()
            raise
        self._idle = [self._first]
        self._taken = 0
        self._closed = False

    def take(self) -> duck.Connection:
        """A connection that nobody else uses until it is given back; not after `close`."""
        with self._lock:
            connection = self._idle.pop() if self._idle else self._another()
            self._taken += 1
            return connection

    def _another(self) -> duck.Connection:
        connection = self._first.cursor()
        try:
            if self.indexed:
                connection.execute("USE idx")
            _define(connection, self._store, self.indexed)
        except BaseException:
            connection.close()
            raise
        return connection

    def give_back(self, connection: duck.Connection) -> None:
        """Take a connection back."""
        with self._lock:
            self._taken -= 1
            self._idle.append(connection)
            self._close()

    def close(self) -> None:
        """Close them, as soon as none is in use."""
        with self._lock:
            self._closed = True
            self._close()

    def _close(self) -> None:
        if self._closed and not self._taken:
            # with the first go its cursors, also one in which a query runs
            self._first.close()


def _define(connection: duck.Connection, store: Store, indexed: bool, *, complete: bool = False) -> None:
    """Make the views and macros of a connection; complete: also the macros over an index that is not there."""
    try:
        if not indexed:
            _without_index(connection, store)
        _view(connection, "help", duck.literal_rows(index.help_table()))
        frames = frames_schema(store.feature_set, store.rate_hz)
        files = [(part_file(store.path, part.path), part.dropped) for part in store.manifest.frames]
        _view(connection, "frames", duck.parquet_rows(frames, files))
        for kind in RESULT_KINDS:
            parts = [(part_file(store.path, part.path), ()) for part in store.manifest.results.get(kind, ())]
            _view(connection, kind, duck.parquet_rows(result_schema(kind), parts))
        for view in VIEWS:
            if view.origin == "derived":
                _view(connection, view.name, view.body)
        for macro in MACROS:
            # also those that the index file has for other clients: it may be of an older kinedex
            if indexed or complete or not _reads_index(macro):
                connection.execute(macro.sql(temporary=True))
    except duck.Error as fault:
        raise StoreError(f"{store.path}: SQL over this store does not work: {duck.first_line(fault)}") from None


def _tell_missing(connection: duck.Connection, store: Store) -> None:
    """Views in place of those of an index that is not there, which say why when they are asked."""
    failing = f"error({duck.quote(str(index.missing(store.path, store.manifest)))})"
    for view in VIEWS:
        if view.name in INDEXED:
            # also in the columns: a condition on NULL would be known to hold for nothing before anything is asked
            columns = ", ".join(f"{failing}::{column.type} AS {duck.name(column.name)}" for column in view.columns)
            _view(connection, view.name, f"SELECT {columns} WHERE {failing} IS NULL")


def _attach_index(connection: duck.Connection, store: Store) -> bool:
    """Attach the index of these takes read-only; False where there is none."""
    while (generation := index.current(store.path, store.manifest)) is not None:
        file = (generation / "index.duckdb").absolute()
        try:
            connection.execute(f"ATTACH {duck.quote(str(file))} AS idx (READ_ONLY)")
            connection.execute("USE idx")
        except duck.Error as fault:
            if not file.is_file():
                # a build has put a newer generation in its place, or somebody removes the index
                continue
            raise StoreError(f"{file}: the index cannot be read: {duck.first_line(fault)}; {index.BUILD}") from None
        return True
    return False


def query(store: Store, connection: duck.Connection, text: str, parameters: duck.Parameters) -> pa.Table:
    """Run one reading query on a connection of `Connections`; errors say what of the store is missing or damaged."""
    try:
        return duck.interruptible_query(connection, text, parameters)
    except duck.UnknownName as fault:
        raise explain_unknown(store, fault) from None
    except duck.Unreadable as fault:
        raise KinedexError(
            f"{fault}\n  where this is a file of the store: `kinedex verify` says which are damaged; "
            f"an index is built again: {index.BUILD}"
        ) from None


def explain_unknown(store: Store, fault: duck.UnknownName) -> KinedexError:
    """Say why a name is not there: it needs the index, or it is nobody's; then with the nearest and with all names."""
    name = fault.name.lower()
    if name in INDEXED or any(macro.name == name and _reads_index(macro) for macro in MACROS):
        return index.missing(store.path, store.manifest)
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


def _without_index(connection: duck.Connection, store: Store) -> None:
    takes = [(part_file(store.path, part.path), part.dropped) for part in store.manifest.takes]
    _view(connection, "takes", duck.parquet_rows(takes_schema(), takes))
    _view(connection, "features", duck.literal_rows(index.features_table(store)))


def _view(connection: duck.Connection, name: str, query: str) -> None:
    try:
        connection.execute(f"CREATE TEMP VIEW {name} AS {query}")
    except duck.Error as fault:
        raise StoreError(
            f"the parts of {name} cannot be read: {duck.first_line(fault)}; see `kinedex verify`"
        ) from None
