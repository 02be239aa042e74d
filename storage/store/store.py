"""Open a store: one version of an archive with its takes, words and results, index and SQL.

DuckDB and polars are imported on first use: a keyframe search in a new process needs neither.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from types import TracebackType
from typing import TYPE_CHECKING, Literal, overload

import pyarrow as pa

from kinedex.ops.errors import KinedexError, ParameterError, StoreError
from kinedex.storage.index.generations import FILE, current_generation, missing_index, readable_version
from kinedex.storage.leases import Lease, take_lease
from kinedex.storage.snapshot.checked_files import CheckedFiles
from kinedex.storage.snapshot.label_journal import journal_rows, read_journals, require_sound
from kinedex.storage.snapshot.manifest import Manifest
from kinedex.storage.snapshot.manifest_files import read_newest, read_version, versions
from kinedex.storage.snapshot.schemas import sorted_by, with_columns
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.snapshot.stored_labels import current_labels

if TYPE_CHECKING:
    import polars as pl

    from kinedex.storage import duckdb_sql
    from kinedex.storage.sql.connection import Connections, Definitions
    from kinedex.storage.sql.queries import QueryResult


AskedVersion = int | Literal["newest"]
"""The version to open: its number, or "newest" for the newest one even without an index."""

_TRIES = 100
"""The largest number of attempts to open a version, since a version may be removed after it was chosen."""


def open_store(path: str | Path, files: Iterable[str | Path] = (), at: AskedVersion | None = None) -> Store:
    """Open a version of a store for reading, by default the newest one that has an index.

    The returned object always shows this version, whatever writers do; open the store again to see their changes. No
    file that the version needs is removed before the object is closed or garbage-collected.

    Parameters
    ----------
    path : str or Path
        The store's directory.
    files : iterable of str or Path, optional
        Folders outside the store whose files SQL may read, with `read_csv` for example. By default SQL can read only
        the store.
    at : int or "newest", optional
        The number of the version, or "newest" for the newest one even if it has no index yet. The default also opens
        the newest version if none has an index.

    Raises
    ------
    StoreError
        There is no store or no such version, the version is damaged, or its format is not supported.
    """
    if not (at is None or at == "newest" or isinstance(at, int)):
        raise ParameterError("at", 'the number of a version, or "newest"', at)
    root, places = Path(path), tuple(Path(place) for place in files)
    for _ in range(_TRIES):
        found = versions(root)
        _require_version(root, found, at)
        opened = _leased(root, at if isinstance(at, int) else found[-1])
        if opened is not None and at is None:
            opened = _with_index(root, *opened)
        if opened is not None:
            return Store(root, opened[0], places, lease=opened[1], newest_version=found[-1], pinned=isinstance(at, int))
    raise StoreError(f"{root}: its versions are removed as fast as they are opened; stop what removes them")


def _leased(root: Path, version: int) -> tuple[Manifest, Lease] | None:
    """Lease and read a version; return None if it has just been removed."""
    lease = take_lease(root, version)
    return None if lease is None else (read_version(root, version), lease)


def _with_index(root: Path, newest: Manifest, lease: Lease) -> tuple[Manifest, Lease] | None:
    """Lease and read the newest version with an index, or the newest of all; return None if it was just removed."""
    version, generation = readable_version(root, newest)
    if version == newest.version:
        return newest, lease
    opened = _leased(root, version)
    return opened if generation is not None and generation.is_dir() else None


def _require_version(root: Path, found: list[int], at: AskedVersion | None) -> None:
    """Raise a StoreError if there is no store, or not the requested version."""
    if not found:
        read_newest(root)  # raises the error for a missing store
    elif isinstance(at, int) and at not in found:
        shown = str(found[0]) if len(found) == 1 else f"{len(found)} versions from {found[0]} to {found[-1]}"
        raise StoreError(f"{root}: it has no version {at} (or no longer); it has {shown}")


class Store(Snapshot):
    """One version of a store, read-only, with its index and SQL.

    `frames`, `result` and `sql` return Arrow tables; `takes` and `sql(…, polars=True)` return polars data frames.

    Parameters
    ----------
    path : Path
        The store's directory.
    manifest : Manifest
        The version to read.
    files : tuple of Path, optional
        Folders outside the store whose files SQL may read.
    checked : CheckedFiles, optional
        The files that have been checked already; by default each file is checked before it is first read.
    lease : Lease, optional
        The lease of the version; by default a new one is taken.
    newest_version : int, optional
        The number of the version that was the newest when this one was opened; by default that of this version.
    pinned : bool, optional
        True to show the labels of this version; by default the newest labels are shown.

    Raises
    ------
    StoreError
        The version does not exist any more.
    """

    def __init__(
        self,
        path: Path,
        manifest: Manifest,
        files: tuple[Path, ...] = (),
        checked: CheckedFiles | None = None,
        *,
        lease: Lease | None = None,
        newest_version: int | None = None,
        pinned: bool = False,
    ) -> None:
        super().__init__(path, manifest, checked)
        self.pinned = pinned
        self._labels: pa.Table | None = None
        self.newest_version = newest_version or manifest.version
        self._files = files
        self._lease = lease or self._take_lease()
        self._lock = Lock()
        self._connections: Connections | None = None

    def _take_lease(self) -> Lease:
        lease = take_lease(self.path, self.manifest.version)
        if lease is None:
            raise StoreError(f"{self.path}: version {self.manifest.version} has been removed; open the store again")
        return lease

    def __repr__(self) -> str:
        takes = len(self.manifest.live_takes)
        count = f"{takes:,} take{'' if takes == 1 else 's'}"
        return f"Store({str(self.path)!r}, version {self.manifest.version}, {count})"

    def labels(self, *, history: bool = False) -> pa.Table:
        """Return the labels of the store, in the order in which they were made.

        The labels are read once, from the newest version and the journal, even if an older version of the takes is
        shown; otherwise a new label would disappear while an index is built. A version that was opened by its number
        shows only the labels that it had.

        Parameters
        ----------
        history : bool, optional
            Also return rows that were replaced or withdrawn by later rows, and the rows that withdraw others.

        Raises
        ------
        StoreError
            A part of labels or the journal is damaged.
        """
        if self.pinned:
            return super().labels(history=history)
        if self._labels is None:
            self._labels = all_labels(self.path, self.manifest, self.checked)
        return self._labels if history else current_labels(self._labels)

    def forget_labels(self) -> None:
        """Discard the cached labels, so that they are read again on the next use, in SQL too."""
        self._labels = None
        with self._lock:
            connections, self._connections = self._connections, None
        if connections is not None:
            connections.close()

    def takes(self, where: str | None = None) -> pl.DataFrame:
        """Return the takes as a data frame, sorted by name.

        Parameters
        ----------
        where : str, optional
            A SQL condition over the columns of takes, such as "actor IN ('bd', 'bk') AND class IS NOT NULL".

        Raises
        ------
        KinedexError
            The condition is not valid; the message names the columns.
        """
        return data_frame(self.takes_table(where))

    def takes_table(self, where: str | None = None) -> pa.Table:
        """Return the takes as an Arrow table; parameters and errors are those of `takes`."""
        if where is None:
            return self.take_rows
        if not where.strip():
            raise KinedexError("the filter over takes is empty; leave it out to get all takes")
        from kinedex.storage import duckdb_sql

        try:
            found = duckdb_sql.rows_where(self.take_rows, "takes", where)
        except duckdb_sql.Error as fault:
            raise KinedexError(
                f"the filter over takes does not work: {where}\n  {duckdb_sql.first_line(fault)}\n"
                f"  columns of takes: {', '.join(self.take_rows.column_names)}"
            ) from None
        return sorted_by(with_columns(found, self.take_rows.schema), "name")

    def index_path(self) -> Path:
        """Return the DuckDB file of the index of the takes of this version.

        Raises
        ------
        StoreError
            The index is missing or outdated; the message names the command that builds it.
        """
        generation = current_generation(self.path, self.manifest)
        if generation is None:
            raise missing_index(self.path, self.manifest)
        return generation / FILE

    def connect(self, threads: int | None = None, memory_mb: int | None = None) -> duckdb_sql.Connection:
        """Open a DuckDB connection with all views and macros (`catalog.sql.views`).

        The index is attached read-only, and changes of views and tables on the connection do not affect the store. It
        is a full DuckDB connection, though: COPY and ATTACH can write wherever the user may. `sql` runs only statements
        that read.

        The checksums of all parts of the store are checked here, because it is unknown what the connection will read;
        `sql` checks only the parts that a query reads.

        Parameters
        ----------
        threads : int, optional
            Largest number of threads; by default DuckDB decides.
        memory_mb : int, optional
            Largest memory in MB; by default DuckDB decides.

        Raises
        ------
        StoreError
            The index or a part cannot be read; the message names the file and the remedy.
        """
        from kinedex.storage.sql.connection import connect

        connection = connect(self, threads, memory_mb)
        # the connection reads the parts as long as it exists, even if this object does not
        weakref.finalize(connection, _release, self._take_lease()).atexit = False
        return connection

    @overload
    def sql(
        self,
        query: str,
        params: duckdb_sql.Parameters = None,
        *,
        polars: Literal[False] = False,
        timeout: float | None = None,
    ) -> pa.Table: ...

    @overload
    def sql(
        self, query: str, params: duckdb_sql.Parameters = None, *, polars: Literal[True], timeout: float | None = None
    ) -> pl.DataFrame: ...

    def sql(
        self, query: str, params: duckdb_sql.Parameters = None, *, polars: bool = False, timeout: float | None = None
    ) -> pa.Table | pl.DataFrame:
        """Run one SQL query over the views and macros (`catalog.sql.views`) and return its rows.

        Several threads may call it at the same time.

        Parameters
        ----------
        query : str
            A statement that only reads. It can read the store, and the folders passed to `open_store`.
        params : sequence or dict, optional
            Values for the placeholders `?` (a sequence) or `$name` (a dict) of the query.
        polars : bool, optional
            Return a polars data frame instead of an Arrow table.
        timeout : float, optional
            Time limit in seconds; None for no limit.

        Raises
        ------
        KinedexError
            The query is not valid, would change something, or does not end in time (`TimeLimitError`).
        """
        table = self.answer(query, params, timeout=timeout).table
        return data_frame(table) if polars else table

    def answer(
        self,
        query: str,
        params: duckdb_sql.Parameters = None,
        *,
        timeout: float | None = None,
        max_rows: int | None = None,
    ) -> QueryResult:
        """Run one SQL query as `sql` does; return at most `max_rows` rows, and the number of all rows.

        Parameters
        ----------
        query, params, timeout
            As for `sql`.
        max_rows : int, optional
            Largest number of rows to return, and to keep in memory; by default all.

        Raises
        ------
        KinedexError
            As for `sql`.
        """
        from kinedex.storage.sql.connection import run_query

        with self._connection() as lent:
            return run_query(self, lent, query, params, files=bool(self._files), timeout=timeout, max_rows=max_rows)

    @contextmanager
    def _connection(self) -> Iterator[Definitions]:
        """Lend one of the connections of `sql` for exclusive use."""
        from kinedex.storage.sql.connection import Connections

        with self._lock:
            if not self._lease.release.alive:
                self._lease = self._take_lease()
            known = self._connections
            # the index may have been published after these connections were opened
            if known is not None and not known.indexed and current_generation(self.path, self.manifest) is not None:
                known.close()
                known = None
            if known is None:
                known = Connections(self, self._files)
            self._connections = known
            lent = known.take()
        try:
            yield lent
        finally:
            if not known.give_back(lent):
                with self._lock:
                    self._connections = None if self._connections is known else self._connections

    def close(self) -> None:
        """Close the connections that `sql` has opened, and let `kinedex gc` remove the version.

        The store can still be used as long as the version exists.
        """
        with self._lock:
            connections, self._connections = self._connections, None
        if connections is not None:
            connections.close()
        self._lease.release()

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __reduce__(self) -> tuple[type[Store], tuple[Path, Manifest, tuple[Path, ...], CheckedFiles]]:
        # a worker gets the same version with its own lease and connections; no worker reads labels
        return Store, (self.path, self.manifest, self._files, self.checked)


def all_labels(path: Path, manifest: Manifest, checked: CheckedFiles) -> pa.Table:
    """Return all rows of labels that a store has now; the rows of the journal come last.

    Parameters
    ----------
    path : Path
        The store's directory.
    manifest : Manifest
        A version; the labels of newer versions are read as well.
    checked : CheckedFiles
        The files that have been checked already.
    """
    for attempt in range(_TRIES):
        # read the journal first: rows that a commit takes from it are then in the version that is read afterwards
        journals = read_journals(path)
        newest = manifest if versions(path)[-1] == manifest.version else read_newest(path)
        try:
            rows = Snapshot(path, newest, checked).labels(history=True)
        except StoreError:
            if attempt + 1 < _TRIES and versions(path)[-1] != newest.version:
                continue  # the version and its parts may just have been removed
            raise
        require_sound(journals, path)
        return pa.concat_tables([rows, journal_rows(journals, rows.column("id").to_pylist())])
    raise StoreError(f"{path}: its versions are removed as fast as they are read; stop what removes them")


def _release(lease: Lease) -> None:
    """Release a lease; as an argument of this finalizer, the lease is kept alive until then."""
    lease.release()


def data_frame(table: pa.Table) -> pl.DataFrame:
    """Return an Arrow table as a polars data frame."""
    import polars as pl

    frame = pl.from_arrow(table)
    assert isinstance(frame, pl.DataFrame)
    return frame
