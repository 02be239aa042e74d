"""Define a store as a collection of takes and tables: positions and words, runs, SQL, results of pipelines, views."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np

from kinedex.catalog.features import FeatureSet
from kinedex.library.take import Take
from kinedex.library.take_frames import StoredFrames
from kinedex.ops.arrays import F32, U64
from kinedex.ops.errors import StoreError, did_you_mean
from kinedex.storage.store.store import Store as StoredTakes
from kinedex.storage.store.store import data_frame

if TYPE_CHECKING:
    import polars as pl
    import pyarrow as pa

    from kinedex.storage.duckdb_sql import Connection

Parameters = Sequence[Any] | dict[str, Any] | None


class TakeCollection:
    """The methods of `Store` that return takes, by name or id, and tables about them."""

    def __init__(self, stored: StoredTakes) -> None:
        self.stored = stored
        self.path = stored.path
        self.version = stored.manifest.version
        self.newest_version = stored.newest_version
        self.rate_hz = stored.rate_hz
        self.feature_set: FeatureSet = stored.feature_set

    @cached_property
    def _rows(self) -> dict[str, dict[str, Any]]:
        return {row["name"]: row for row in self.stored.takes_table().to_pylist()}

    @cached_property
    def _names(self) -> dict[int, str]:
        return {row["take_id"]: name for name, row in self._rows.items()}

    def _row(self, take: str | int | Take) -> dict[str, Any]:
        """Return the row of a take that is given by name, by id, or as a take."""
        name = take.name if isinstance(take, Take) else take
        if isinstance(name, int | np.integer) and not isinstance(name, bool):
            if int(name) not in self._names:
                raise StoreError(f"{self.path}: no take has the id {name}; `store.takes()` lists the takes")
            return self._rows[self._names[int(name)]]
        if name not in self._rows:
            raise StoreError(f"{self.path}: no take is named '{name}'{did_you_mean(str(name), self._rows)}")
        return self._rows[name]

    def __len__(self) -> int:
        return len(self.stored.manifest.live_takes)

    def __iter__(self) -> Iterator[Take]:
        return (self[name] for name in self._rows)

    def __contains__(self, take: object) -> bool:
        return take in self._rows or take in self._names

    def __getitem__(self, take: str | int) -> Take:
        """Return a take by its name or its id.

        Parameters
        ----------
        take : str or int
            The name or the id.

        Returns
        -------
        Take
            The take, whose frames are read when they are first needed.

        Raises
        ------
        StoreError
            There is no such take; the message suggests the nearest name.

        Examples
        --------
        >>> store[take.name].take_id == take.take_id
        True
        """
        row = self._row(take)
        source = StoredFrames(self.stored, row["name"], row["take_id"], 0, row["frames"])
        return Take(row["name"], source, row["frames"], self.feature_set, self.rate_hz, row, row["take_id"])

    def takes(self, where: str | None = None) -> pl.DataFrame:
        """Return the table of takes.

        Parameters
        ----------
        where : str, optional
            A SQL filter over the columns of takes, such as ``"actor IN ('al', 'bo') AND class IS NOT NULL"``.

        Returns
        -------
        polars.DataFrame
            One row per take, sorted by name: take_id, name, source, format, skeleton, source_rate_hz, frames, seconds,
            actor, class, clip, warnings and others.

        Raises
        ------
        KinedexError
            The filter is not valid; the message names the columns.

        Examples
        --------
        >>> store.takes("class IS NOT NULL").select("name", "class").columns
        ['name', 'class']
        """
        return self.stored.takes(where)

    def positions(self, take: str | int | Take) -> F32:
        """Return the joint positions of a take.

        Parameters
        ----------
        take : str, int or Take
            The take, by name or id.

        Returns
        -------
        float32 array (T, J, 3)
            Positions in metres, Y up; NaN where a joint is not known.

        Raises
        ------
        StoreError
            There is no such take.

        Examples
        --------
        >>> store.positions(take.name).shape == (len(take), 24, 3)
        True
        """
        return self[self._row(take)["name"]].positions

    def words(self, take: str | int | Take) -> U64:
        """Return the words of a take, which have the features of each frame as bits.

        Parameters
        ----------
        take : str, int or Take
            The take, by name or id.

        Returns
        -------
        uint64 array (T,)
            Bit i − 1 is feature Fi; ``0xFFFFFFFFFFFFFFFF`` stands for an invalid frame.

        Raises
        ------
        StoreError
            There is no such take.

        Examples
        --------
        >>> len(store.words(take)) == len(take)
        True
        """
        return self[self._row(take)["name"]].words()

    def runs(
        self,
        feature: str | int,
        *,
        take: str | int | Take | None = None,
        min_seconds: float = 0.0,
        where: str | None = None,
    ) -> pl.DataFrame:
        """Return the runs of a feature: the longest intervals of frames in which it is on.

        Parameters
        ----------
        feature : str or int
            The feature, by name or number.
        take : str, int or Take, optional
            The take whose runs are returned; by default the runs of all takes.
        min_seconds : float, optional
            The shortest duration of a run.
        where : str, optional
            A SQL filter over the columns of takes.

        Returns
        -------
        polars.DataFrame
            One row per run, by take name and start: take, take_id, start, stop (frames), start_seconds, stop_seconds,
            seconds.

        Raises
        ------
        KinedexError
            There is no such feature, take or column.
        StoreError
            The index is missing or stale; the message names the command that builds it.

        Examples
        --------
        >>> runs = store.runs("rknee_bent", min_seconds=0.2)
        >>> runs.columns[:4]
        ['take', 'take_id', 'start', 'stop']
        """
        number = self.feature_set.feature(feature).number
        ids = None if where is None else self.takes(where)["take_id"].to_list()
        if take is not None:
            one = self._row(take)["take_id"]
            ids = [one] if ids is None or one in ids else []
        chosen = "" if ids is None else "AND list_contains($ids, r.take_id)"
        statement = f"""
            SELECT t.name AS take, r.take_id, r.start, r.stop, r.start / t.rate_hz AS start_seconds,
                r.stop / t.rate_hz AS stop_seconds, r.seconds
            FROM feature_runs AS r JOIN takes AS t ON t.take_id = r.take_id
            WHERE r.feature = $number AND r.seconds >= $least {chosen} ORDER BY t.name, r.start"""
        values: dict[str, Any] = {"number": number, "least": float(min_seconds)}
        return self.sql(statement, values if ids is None else {**values, "ids": ids}, polars=True)

    @overload
    def sql(
        self, query: str, params: Parameters = None, *, polars: Literal[False] = False, timeout: float | None = None
    ) -> pa.Table: ...

    @overload
    def sql(
        self, query: str, params: Parameters = None, *, polars: Literal[True], timeout: float | None = None
    ) -> pl.DataFrame: ...

    def sql(
        self, query: str, params: Parameters = None, *, polars: bool = False, timeout: float | None = None
    ) -> pa.Table | pl.DataFrame:
        """Run a read-only SQL query over the views and macros of the store.

        Parameters
        ----------
        query : str
            One statement of DuckDB's SQL. ``FROM help`` lists views and macros.
        params : sequence or dict, optional
            Values for the placeholders ``?`` (a sequence) or ``$name`` (a dict) of the query.
        polars : bool, optional
            True returns a polars data frame instead of an Arrow table.
        timeout : float, optional
            Seconds that the query may take; by default there is no limit.

        Returns
        -------
        pyarrow.Table or polars.DataFrame
            The rows.

        Raises
        ------
        KinedexError
            The query is not valid, would change something, or does not end in time.

        Examples
        --------
        >>> store.sql("SELECT count(*) AS n FROM takes").column("n").to_pylist() == [len(store)]
        True
        >>> store.sql("SELECT name FROM takes WHERE frames > ?", [10_000], polars=True).height
        0
        """
        table = self.stored.sql(query, params, timeout=timeout)
        return data_frame(table) if polars else table

    def connect(self, threads: int | None = None, memory_mb: int | None = None) -> Connection:
        """Open a DuckDB connection with all views and macros, on which you can create tables and macros.

        The checksums of all parts of the store are verified first, because kinedex cannot know what the connection will
        read; `sql` verifies only the parts that a query reads.

        Parameters
        ----------
        threads : int, optional
            The number of threads that DuckDB may use.
        memory_mb : int, optional
            The memory that DuckDB may use, in megabytes.

        Returns
        -------
        duckdb.DuckDBPyConnection
            A new connection, to which the index is attached read-only.

        Raises
        ------
        StoreError
            The index or a part cannot be read; the message names the file and the remedy.

        Examples
        --------
        >>> with store.connect(threads=1) as duckdb:
        ...     rows = duckdb.execute("SELECT count(*) FROM takes").fetchall()
        """
        return self.stored.connect(threads, memory_mb)

    def results(self, kind: str, *, pipeline: str | None = None, every: bool = False) -> pl.DataFrame:
        """Return the results of one kind of the current pipeline, which are the rows of the view with this name.

        Parameters
        ----------
        kind : str
            The kind of result: annotations, metrics, templates, queries, hits, ranked_hits and others.
        pipeline : str, optional
            The pipeline whose results are returned; the current one by default.
        every : bool, optional
            True returns the results of all pipelines, as the view with the prefix `all_` does.

        Returns
        -------
        polars.DataFrame
            The rows of the latest runs; an empty frame with the same columns if there are none.

        Raises
        ------
        KinedexError
            There is no such kind; the message suggests the nearest name.

        Examples
        --------
        >>> "class" in store.results("annotations").columns
        True
        """
        return data_frame(self.stored.result_view(kind, pipeline, every=every))

    def scan(self, view: str) -> pl.LazyFrame:
        """Return a view as a lazy frame of polars, over exactly the files of this version.

        Use this method instead of a pattern such as ``frames/*.parquet``, which would also read rows of older versions.

        Parameters
        ----------
        view : str
            ``takes``, ``frames``, or a view of results such as ``annotations`` or ``all_annotations``.

        Returns
        -------
        polars.LazyFrame
            The rows; nothing is read before ``collect``.

        Raises
        ------
        KinedexError
            The view cannot be scanned, or a part is damaged.

        Examples
        --------
        >>> store.scan("frames").select("take_id").unique().collect().height == store.takes().height
        True
        """
        from kinedex.storage.store.lazy_frames import scan

        return scan(self.stored, view)
