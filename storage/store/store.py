"""Reading a store: a snapshot of its newest version, as tables, words and SQL.

DuckDB is loaded when it is needed, which takes as long as answering some hundred keyframe queries.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from threading import Lock
from types import TracebackType
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.parquet as pq

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import KinedexError, ParameterError, StoreError, did_you_mean
from kinedex.ops.words import TakeWords
from kinedex.storage import index
from kinedex.storage.store.frames import read_frames, read_words
from kinedex.storage.store.manifest import Manifest, ResultPart, read_newest
from kinedex.storage.store.parts import part_file
from kinedex.storage.store.schemas import result_schema, takes_schema

if TYPE_CHECKING:
    import polars as pl

    from kinedex.storage.sql import duck
    from kinedex.storage.sql.connection import Connections


def open_store(path: str | Path) -> Store:
    """Open the newest version of a store for reading.

    The store that is returned keeps showing this version, whatever writers do meanwhile; open it again to see theirs.

    Raises
    ------
    StoreError: there is no store, it is damaged, or it has another format version.
    """
    root = Path(path)
    return Store(root, read_newest(root))


class Store:
    """One version of a store, read-only.

    path: the store's directory. manifest: the version it shows. feature_set: what the bits of its words mean.
    """

    def __init__(self, path: Path, manifest: Manifest) -> None:
        self.path = path
        self.manifest = manifest
        self._lock = Lock()
        self._opened: Connections | None = None

    def __repr__(self) -> str:
        return f"Store({str(self.path)!r}, version {self.manifest.version}, {len(self.manifest.live_takes)} takes)"

    @property
    def feature_set(self) -> FeatureSet:
        """The feature set that the store's words were made with, as the store itself recorded it."""
        return self.manifest.feature_set

    @property
    def rate_hz(self) -> float:
        """Analysis frames per second."""
        return self.manifest.rate_hz

    def takes(self, where: str | None = None) -> pl.DataFrame:
        """The takes, sorted by name.

        Parameters
        ----------
        where: a SQL filter over the columns of takes, such as "actor IN ('bd', 'bk') AND class IS NOT NULL".

        Raises
        ------
        KinedexError: the filter is not valid; the message names the columns.
        """
        import polars as pl  # a tenth of a second, which a query from a cold start need not wait for

        found = pl.from_arrow(self.takes_table(where))
        assert isinstance(found, pl.DataFrame)
        return found

    def takes_table(self, where: str | None = None) -> pa.Table:
        """The same as an Arrow table; parameters and errors as `takes`."""
        if where is None:
            return self._takes
        if not where.strip():
            raise KinedexError("the filter over takes is empty; leave it out to get all takes")
        from kinedex.storage.sql import duck

        try:
            found = duck.filtered(self._takes, "takes", where)
        except duck.Error as fault:
            raise KinedexError(
                f"the filter over takes does not work: {where}\n  {duck.first_line(fault)}\n"
                f"  columns of takes: {', '.join(self._takes.column_names)}"
            ) from None
        return found.cast(self._takes.schema).sort_by("name")

    @cached_property
    def _takes(self) -> pa.Table:
        schema = takes_schema()
        tables = []
        for part in self.manifest.takes:
            table = _read_part(part_file(self.path, part.path), schema)
            if part.dropped:
                keep = [take not in set(part.dropped) for take in table.column("take_id").to_pylist()]
                table = table.filter(pa.array(keep, pa.bool_()))
            tables.append(table)
        return pa.concat_tables([schema.empty_table(), *tables]).sort_by("name").combine_chunks()

    def take_id(self, name: str) -> int:
        """The id of a take by its name; a StoreError names the nearest."""
        if name not in self._ids:
            raise StoreError(f"{self.path}: no take is named '{name}'{did_you_mean(name, self._ids)}")
        return self._ids[name]

    @cached_property
    def _ids(self) -> dict[str, int]:
        return dict(zip(*(self._takes.column(name).to_pylist() for name in ("name", "take_id")), strict=True))

    @cached_property
    def _lengths(self) -> dict[int, int]:
        return dict(zip(*(self._takes.column(name).to_pylist() for name in ("take_id", "frames")), strict=True))

    def words(self, take_ids: Sequence[int] | None = None) -> TakeWords:
        """The words of these takes (of all takes for None), in order of take_id, each take once.

        One numpy array for all of them; `TakeWords.take` gives those of one take without a copy.

        Raises
        ------
        StoreError: an id that no take of the store has.
        """
        return read_words(self.path, self.manifest, take_ids)

    def frames(self, take: str, start: int = 0, stop: int | None = None) -> pa.Table:
        """The frames [start, stop) of a take (to its end for None), one row per analysis frame.

        Every column is one chunk, so that `frames("a").column("rwrist").chunk(0).field("y").to_numpy()` is no copy.

        Raises
        ------
        StoreError: no take of that name. ParameterError: the range is not inside the take.
        """
        take_id = self.take_id(take)
        count = self._lengths[take_id]
        end = count if stop is None else stop
        if not 0 <= start <= end <= count:
            raise ParameterError("frame range", f"within [0, {count}), the frames of {take}", (start, end))
        return read_frames(self.path, self.manifest, take_id, start, end)

    def result(
        self, kind: str, run: str | None = None, pipeline: str | None = None, stage: str | None = None
    ) -> pa.Table:
        """The rows of one kind of result of the live runs; with the right columns where there are none.

        Parameters
        ----------
        kind: one of `storage.store.schemas.RESULT_KINDS`.
        run: only the rows of this run.
        pipeline: only the rows that stages of this pipeline wrote. stage: only those of this one, "<pipeline>/<stage>".
        """
        schema = result_schema(kind)
        tables = [
            _read_part(part_file(self.path, part.path), schema)
            for part in self.manifest.results.get(kind, ())
            if (run is None or part.run == run)
            and (pipeline is None or part.stage.startswith(f"{pipeline}/"))
            and (stage is None or part.stage == stage)
        ]
        return pa.concat_tables(tables) if tables else schema.empty_table()

    def result_pieces(self, kind: str, parts: Iterable[ResultPart]) -> Iterator[pa.Table]:
        """The rows of parts of one kind of result, piece by piece as they were written."""
        schema = result_schema(kind)
        for part in parts:
            file = part_file(self.path, part.path)
            with reading(file), pq.ParquetFile(file) as opened:
                for group in range(opened.num_row_groups):
                    yield opened.read_row_group(group).cast(schema)

    def index_path(self) -> Path:
        """The DuckDB file of the index of exactly these takes.

        Raises
        ------
        StoreError: the index is missing or stale; the message says how to build it.
        """
        generation = index.current(self.path, self.manifest)
        if generation is None:
            raise index.missing(self.path, self.manifest)
        return generation / "index.duckdb"

    def connect(self, threads: int | None = None, memory_mb: int | None = None) -> duck.Connection:
        """Open a DuckDB connection with all views and macros (`catalog.sql.views`).

        The index is attached read-only, and nothing done to the views or to tables made here reaches the store. It is
        a whole DuckDB connection, though: COPY and ATTACH write wherever the user may. `sql` runs only what reads.

        Parameters
        ----------
        threads, memory_mb: what DuckDB may use; None leaves it to DuckDB.

        Raises
        ------
        StoreError: the index or a part cannot be read; the message names the file and the way out.
        """
        from kinedex.storage.sql import connection as sql

        return sql.connect(self, threads, memory_mb)

    def sql(self, query: str, params: duck.Parameters = None) -> pa.Table:
        """Run one SQL query over the views and macros (`catalog.sql.views`) and return its rows; threads may ask at
        once.

        Parameters
        ----------
        query: a statement that only reads; it may read other files too (`read_csv` and its kin).
        params: values for its `?` (a sequence) or its `$name` (a dict).

        Raises
        ------
        KinedexError: the query is not valid, or would change something.
        """
        from kinedex.storage.sql import connection as sql

        with self._connection() as connection:
            return sql.query(self, connection, query, params)

    @contextmanager
    def _connection(self) -> Iterator[duck.Connection]:
        """One of the connections for `sql`, which nobody else uses meanwhile."""
        from kinedex.storage.sql import connection as sql

        with self._lock:
            known = self._opened
            # without an index, it may have been published since: look again
            if known is not None and not known.indexed and index.current(self.path, self.manifest) is not None:
                known.close()
                known = None
            if known is None:
                known = sql.Connections(self)
            self._opened = known
            connection = known.take()
        try:
            yield connection
        finally:
            known.give_back(connection)

    def close(self) -> None:
        """Close the connections that `sql` has opened; the store can still be used."""
        with self._lock:
            opened, self._opened = self._opened, None
        if opened is not None:
            opened.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __reduce__(self) -> tuple[type[Store], tuple[Path, Manifest]]:
        # a worker gets the same version, and opens what it needs itself
        return Store, (self.path, self.manifest)


def _read_part(file: Path, schema: pa.Schema) -> pa.Table:
    with reading(file):
        return pq.read_table(file, schema=schema)


@contextmanager
def reading(file: Path) -> Iterator[None]:
    """Turn a fault of reading a part into a StoreError that names it."""
    try:
        yield
    except (OSError, pa.ArrowException) as fault:
        reason = str(fault).splitlines()[0]
        raise StoreError(f"{file}: the part cannot be read: {reason}; see `kinedex verify`") from None
