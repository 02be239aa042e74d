"""The tables of a store in Python: runs of features, SQL, results of pipelines, and views as lazy frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, overload

from kinedex.library.take import Take
from kinedex.library.take_collection import TakeCollection
from kinedex.storage.store.store import data_frame

if TYPE_CHECKING:
    import polars as pl
    import pyarrow as pa

    from kinedex.storage.duck import Connection

Parameters = Sequence[Any] | dict[str, Any] | None


class SqlTables(TakeCollection):
    """The methods of `Store` for runs, SQL queries, results of pipelines and views."""

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
            Only the runs of this take.
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
            Values for ``?``, or for ``$name``.
        polars : bool, optional
            True returns a polars data frame in place of an Arrow table.
        timeout : float, optional
            Seconds that the query may take; by default as long as it needs.

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
        """Open a DuckDB connection with all views and macros, for tables and macros of your own.

        The checksums of all parts of the store are verified first, because kinedex cannot see what the connection will
        read; `sql` verifies only those of the parts that a query reads.

        Parameters
        ----------
        threads : int, optional
            The number of threads that DuckDB may use.
        memory_mb : int, optional
            The memory that DuckDB may use, in megabytes.

        Returns
        -------
        duckdb.DuckDBPyConnection
            A connection of its own; the index is attached read-only.

        Raises
        ------
        StoreError
            The index or a part cannot be read; the message names the file and what to do.

        Examples
        --------
        >>> with store.connect(threads=1) as duckdb:
        ...     rows = duckdb.execute("SELECT count(*) FROM takes").fetchall()
        """
        return self.stored.connect(threads, memory_mb)

    def results(self, kind: str, *, pipeline: str | None = None, every: bool = False) -> pl.DataFrame:
        """Return the results of one kind of the current pipeline: the rows of the view of this name.

        Parameters
        ----------
        kind : str
            The kind of result: annotations, metrics, templates, queries, hits, ranked_hits and others.
        pipeline : str, optional
            The pipeline whose results are returned; the current one by default.
        every : bool, optional
            Return the results of all pipelines, as the view with `all_` before the name has them.

        Returns
        -------
        polars.DataFrame
            The rows of the latest runs; an empty frame with the same columns if there are none.

        Raises
        ------
        KinedexError
            There is no such kind; the message names the nearest.

        Examples
        --------
        >>> "class" in store.results("annotations").columns
        True
        """
        return data_frame(self.stored.result_view(kind, pipeline, every=every))

    def scan(self, view: str) -> pl.LazyFrame:
        """Return a view as a lazy frame of polars, over exactly the files of this version.

        A pattern such as ``frames/*.parquet`` would read the rows of older versions, too.

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
            The view is another one, or a part is damaged.

        Examples
        --------
        >>> store.scan("frames").select("take_id").unique().collect().height == store.takes().height
        True
        """
        from kinedex.storage.store.lazy_frames import scan

        return scan(self.stored, view)
