"""A store as a Python object: its takes, SQL, search and rankings."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import ParameterError, StoreError, did_you_mean
from kinedex.pipelines.api.arguments import checked, checked_methods
from kinedex.pipelines.api.take import Take
from kinedex.pipelines.api.take_frames import F32, U64, Frames
from kinedex.pipelines.console.wording import counted
from kinedex.storage.store.store import Store as StoredTakes
from kinedex.storage.store.store import data_frame
from kinedex.storage.store.store import open_store as open_stored_takes

if TYPE_CHECKING:
    import os

    import polars as pl
    import pyarrow as pa

    from kinedex.catalog.queries.keyframe_query import KeyframeQuery
    from kinedex.ops.templates.templates import Kind
    from kinedex.pipelines.api.labels import Labels
    from kinedex.pipelines.api.query import Query
    from kinedex.pipelines.api.template import Template
    from kinedex.pipelines.export.request import How, What
    from kinedex.storage.duck import Connection

Parameters = Sequence[Any] | dict[str, Any] | None

_SHOWN_TAKES = 10
_BESIDE_HITS = ("run", "saved_as")


@checked
def open_store(
    path: str | os.PathLike[str],
    files: Iterable[str | os.PathLike[str]] = (),
    at: int | Literal["newest"] | None = None,
) -> Store:
    """Open a version of a store for reading: the newest one that has its index, unless another is asked for.

    While an ingest runs, this is the version before it. The store keeps showing its version, whatever is written or
    removed meanwhile; open it again to see what is new.

    Parameters
    ----------
    path : str or os.PathLike
        The directory of the store, or an open store.
    files : iterable of str or os.PathLike, optional
        Folders whose files SQL may read as well, with ``read_csv`` for example. SQL reads the store alone without them.
    at : int or "newest", optional
        The number of a version, or "newest" for the newest one, even where its index is still to be built.

    Returns
    -------
    Store
        The takes, to be used as a mapping from names, and all that can be asked about them.

    Raises
    ------
    StoreError
        There is no store or no such version, it is damaged, or it has another format.

    Examples
    --------
    >>> store = kinedex.open_store(store_path)
    >>> len(store) == store.takes().height
    True
    >>> kinedex.open_store(store_path, at=store.version).version == store.version
    True
    """
    return Store(open_stored_takes(Path(path), [Path(folder) for folder in files], at))


@checked_methods
class Store:
    """One version of a store, read-only; `open_store` opens it.

    A store is a collection of takes: ``len(store)``, ``for take in store``, and ``store["name"]`` or ``store[17]`` by
    the id. Wherever a method takes a take, its name, its id or the `Take` itself will do. Tables are polars data
    frames, except that `sql` returns an Arrow table unless ``polars=True`` is given. Later versions may add columns.

    Attributes
    ----------
    path : Path
        The directory of the store.
    version : int
        The version that is shown.
    newest_version : int
        The newest version when the store was opened; it is another one where its index was still to be built.
    rate_hz : float
        Frames per second of its takes.
    feature_set : FeatureSet
        The features of its words, as the store itself recorded them.

    Examples
    --------
    >>> [take.name for take in store][:2] == store.takes()["name"].to_list()[:2]
    True
    """

    def __init__(self, stored: StoredTakes) -> None:
        self.stored = stored
        self.path = stored.path
        self.version = stored.manifest.version
        self.newest_version = stored.newest_version
        self.rate_hz = stored.rate_hz
        self.feature_set: FeatureSet = stored.feature_set

    def __fspath__(self) -> str:
        return str(self.path)

    def __repr__(self) -> str:
        return f"Store({str(self.path)!r}, version {self.version}, {counted(len(self), 'take')})"

    def _repr_html_(self) -> str:
        from kinedex.pipelines.api.html import table_html

        takes = self.takes()
        classes = takes["class"].drop_nulls().unique().sort().to_list()
        facts = [
            ("path", str(self.path)),
            ("version", str(self.version)),
            ("takes", f"{len(self):,}, {float(takes['seconds'].sum() or 0) / 3600:.2f} hours at {self.rate_hz:g} Hz"),
            ("classes", ", ".join(classes[:20]) + (f" and {len(classes) - 20} more" if len(classes) > 20 else "")),
            ("features", f"{len(self.feature_set.features)} ({self.feature_set.name})"),
        ]
        columns = ["name", "class", "actor", "frames", "seconds"]
        rows = takes.select(columns).head(_SHOWN_TAKES).rows()
        note = f"and {takes.height - _SHOWN_TAKES:,} more takes" if takes.height > _SHOWN_TAKES else ""
        return table_html("kinedex store", facts, columns, rows, note)

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the database connections of `sql`, and let `kinedex gc` remove the version.

        The store can still be used for as long as the version is there.

        Examples
        --------
        >>> store.close()
        """
        self.stored.close()

    @property
    def labels(self) -> Labels:
        """Return the labels of people, which can be read and recorded.

        Returns
        -------
        Labels
            The labels; recording one changes no other result of this store.

        Examples
        --------
        >>> store.labels.table().height == len(store.labels)
        True
        """
        from kinedex.pipelines.api.labels import Labels

        return Labels(self.stored)

    # ---- takes -------------------------------------------------------------------------------------------

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
                raise StoreError(f"{self.path}: no take has the id {name}; `store.takes()` lists those that there are")
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
            There is no such take; the message names the nearest.

        Examples
        --------
        >>> store[take.name].take_id == take.take_id
        True
        """
        row = self._row(take)
        source = _StoredFrames(self.stored, row["name"], row["take_id"], 0, row["frames"])
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
            Metres, Y up; NaN where a joint is not known.

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
        """Return the words of a take: of every frame its features as bits.

        Parameters
        ----------
        take : str, int or Take
            The take, by name or id.

        Returns
        -------
        uint64 array (T,)
            Bit i − 1 is feature Fi; ``0xFFFFFFFFFFFFFFFF`` in invalid frames.

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

    # ---- SQL ---------------------------------------------------------------------------------------------

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
        """Run one SQL query that reads, over the views and macros of the store.

        Parameters
        ----------
        query : str
            One statement of DuckDB's SQL. ``FROM help`` lists views and macros.
        params : sequence or dict, optional
            Values for ``?``, or for ``$name``.
        polars : bool, optional
            True returns a polars data frame in place of an Arrow table.
        timeout : float, optional
            Seconds that the query may take; as long as it needs unless given.

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

        The checksums of all parts of the store are compared first, because nobody sees what the connection will read;
        `sql` compares only those of the parts that a query reads.

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
            The index or a part cannot be read; the message names the file and the way out.

        Examples
        --------
        >>> with store.connect(threads=1) as duckdb:
        ...     rows = duckdb.execute("SELECT count(*) FROM takes").fetchall()
        """
        return self.stored.connect(threads, memory_mb)

    def results(self, kind: str, *, pipeline: str | None = None, every: bool = False) -> pl.DataFrame:
        """Return what the current pipeline has stored of one kind: the rows of the view of this name.

        Parameters
        ----------
        kind : str
            The kind of result: annotations, metrics, templates, queries, hits, ranked_hits and others.
        pipeline : str, optional
            Another pipeline, whose results are returned.
        every : bool, optional
            Return the results of all pipelines, as the view with `all_` before the name has them.

        Returns
        -------
        polars.DataFrame
            The rows of the latest runs; no rows, with the right columns, where there are none.

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

    # ---- search and ranking ------------------------------------------------------------------------------

    def search(self, query: Query | Iterable[Query] | str | Path, *, where: str | None = None) -> pl.DataFrame:
        """Search keyframe queries.

        Parameters
        ----------
        query : Query, sequence of Query, str or Path
            Queries, or a query file: a shipped name, or the path of a YAML file, of which all queries are searched.
        where : str, optional
            A SQL filter over the columns of takes.

        Returns
        -------
        polars.DataFrame
            One row per range of frames that holds hits, in the order of queries, take names and starts: query,
            take_id, take, start, stop (frames), start_seconds, stop_seconds.

        Raises
        ------
        KinedexError
            A query is over features that the store does not have, or the filter is not valid.
        ConfigError
            The query file is wrong; the message names the line.
        StoreError
            The index is missing or stale; the message names the command that builds it.

        Warns
        -----
        UserWarning
            A query is not applied to takes whose bodies lack joints, or by its known entries only.

        Examples
        --------
        >>> "squat" in store.search("example")["query"]
        True
        """
        from kinedex.pipelines.api.query import resolved_queries
        from kinedex.pipelines.search.search import load_query_file, search_remarks, search_store

        if isinstance(query, str | Path):
            queries: Sequence[KeyframeQuery] = load_query_file(query, self.feature_set, rate_hz=self.rate_hz)
        else:
            queries = resolved_queries(query, self.feature_set, self.rate_hz)
        for remark in search_remarks(self.stored, queries, where):
            warnings.warn(remark, stacklevel=2)
        return data_frame(search_store(self.stored, queries, where)).drop(_BESIDE_HITS)

    def templates(self, *, stage: str | None = None) -> pl.DataFrame:
        """Return the list of the templates that pipelines have learned.

        Parameters
        ----------
        stage : str, optional
            Only the templates of this stage: ``"pipeline/stage"``, or the name of the pipeline.

        Returns
        -------
        polars.DataFrame
            One row per template: stage, subclass, kind, columns, seconds, clips and others.

        Raises
        ------
        KinedexError
            The store has no templates yet.

        Examples
        --------
        >>> store.templates().select("subclass", "kind").height > 0
        True
        """
        from kinedex.pipelines.templates.stored_templates import templates_overview

        return data_frame(templates_overview(self.stored, 0.05, stage))

    def template(self, name: str, kind: Kind = "soft", *, stage: str | None = None) -> Template:
        """Return a template that a pipeline has learned.

        Parameters
        ----------
        name : str
            The class (subclass) of the template.
        kind : {"soft", "hard"}
            The kind of the template.
        stage : str, optional
            The stage that learned it, where several did: ``"pipeline/stage"``, or the name of the pipeline.

        Returns
        -------
        Template
            The template.

        Raises
        ------
        KinedexError
            There is none of that name or kind, or several stages have one.

        Examples
        --------
        >>> store.template("squat1Reps").kind
        'soft'
        """
        from kinedex.pipelines.api.template import Template
        from kinedex.pipelines.templates.stored_templates import choose_template

        learned = choose_template(self.stored, name, kind, stage)
        return Template(learned, self.feature_set, self.rate_hz, lambda: self._clips(learned.clips))

    def _clips(self, names: Sequence[str]) -> Mapping[str, U64]:
        """Return the words of those of the clips that are still takes of the store, or intervals of them."""
        from kinedex.pipelines.templates.examples import interval_of

        places = {name: interval_of(name, self._rows) for name in names}
        return {name: self.words(take)[frames] for name, (take, frames) in places.items() if take in self._rows}

    def rank(
        self,
        template: Template | str | Sequence[Template | str],
        top: int | None = 20,
        *,
        tau: float = 0.1,
        delta: float = 0.1,
        queries: Query | Iterable[Query] | None = None,
        where: str | None = None,
        workers: int | None = None,
        mirror: bool = False,
    ) -> pl.DataFrame:
        """Rank the places of the store by how well templates fit them.

        Parameters
        ----------
        template : Template, str, or a sequence of them
            Templates, names of learned templates, or paths of template files.
        top : int, optional
            The largest number of hits of a template; None returns all.
        tau : float, optional
            Distances below tau make a hit.
        delta : float, optional
            Entries of a template within delta of 0 or 1 count, the others are wildcards.
        queries : Query or sequence of Query, optional
            A template is ranked within the hits of the queries whose target has its name; in all frames where there
            are none.
        where : str, optional
            A SQL filter over the columns of takes.
        workers : int, optional
            The number of threads; that of the cores unless given. The hits do not depend on it.
        mirror : bool, optional
            True ranks by the mirror images of the templates, too: the same motions of the other side of the body.

        Returns
        -------
        polars.DataFrame
            One row per hit, the best of each template first: template, rank, take_id, take, start, stop (frames),
            start_seconds, stop_seconds, cost; with `mirror` also mirrored, which is true of hits by an image.

        Raises
        ------
        KinedexError
            A template cannot be found or is wildcards alone, no take is selected, or features cannot be mirrored.
        ParameterError
            The number of hits or the threshold is out of range.

        Warns
        -----
        UserWarning
            Templates are excluded or not applied to some takes, or some have no query where others do; or one has no
            hit: the warning names its nearest place and the tau that makes it one.

        Examples
        --------
        >>> hits = store.rank("squat1Reps", top=3)
        >>> hits.columns[:4]
        ['template', 'rank', 'take_id', 'take']
        """
        from kinedex.pipelines.api.query import resolved_queries
        from kinedex.pipelines.api.template import Template
        from kinedex.pipelines.ranking.store_ranking import rank_store

        if top is not None and top < 1:
            raise ParameterError("top", "at least 1, or None", top)
        if not tau > 0:
            raise ParameterError("tau", "above 0", tau)
        wanted = [template] if isinstance(template, Template | str) else list(template)
        found = rank_store(
            self.stored,
            [one.named if isinstance(one, Template) else one for one in wanted],
            queries=None if queries is None else resolved_queries(queries, self.feature_set, self.rate_hz),
            delta=delta,
            tau=tau,
            top=top,
            where=where,
            workers=workers,
            mirror=mirror,
            nearest=1,
        )
        for remark in (*found.remarks, *found.misses(tau, "tau=")):
            warnings.warn(remark, stacklevel=2)
        return data_frame(found.table()).drop("run")

    def similar(
        self,
        take: str | int | Take,
        start: int | str | None = None,
        stop: int | str | None = None,
        top: int | None = 20,
        *,
        tau: float = 0.1,
        delta: float = 0.1,
        where: str | None = None,
        workers: int | None = None,
    ) -> pl.DataFrame:
        """Rank the places of the store by how similar they are to an example.

        Parameters
        ----------
        take : str, int or Take
            The take that is the example or holds it. A `Take` may be of no store, and then start and stop count its own
            frames.
        start, stop : int or str, optional
            The frames of the example within the take, ``45`` or ``"1.5s"``, stop excluded; the whole take unless given.
        top : int, optional
            The largest number of hits; None returns all.
        tau : float, optional
            Distances below tau make a hit.
        delta : float, optional
            Entries of the template within delta of 0 or 1 count, the others are wildcards.
        where : str, optional
            A SQL filter over the columns of takes.
        workers : int, optional
            The number of threads; that of the cores unless given. The hits do not depend on it.

        Returns
        -------
        polars.DataFrame
            One row per hit as for `rank`, the best first; the example itself is among them where it is searched.

        Raises
        ------
        KinedexError
            There is no such take, the interval is not inside it, or it has invalid frames in the middle.

        Examples
        --------
        >>> store.similar(take, 0, 30, top=1)["cost"][0]
        0.0
        """
        from kinedex.pipelines.api.template import Template

        whole = take if isinstance(take, Take) else self[take]
        example = Template.from_clip(whole, start, stop)
        return self.rank(example, top, tau=tau, delta=delta, where=where, workers=workers)

    # ---- files -------------------------------------------------------------------------------------------

    def export(
        self,
        folder: str | os.PathLike[str],
        takes: Sequence[str] = (),
        *,
        format: str = "npz",
        joints: bool = False,
        where: str | None = None,
        annotations: bool = False,
        labels: bool = False,
        hits: str | None = None,
        ranges: str | os.PathLike[str] | None = None,
        sql: str | None = None,
        classes: Sequence[str] = (),
        pipeline: str | None = None,
        min_confidence: float | None = None,
        margin: float = 0.0,
        context: float = 0.0,
        min_length: float = 0.0,
        mirror: bool = False,
        resample: float | None = None,
        in_place: bool = False,
        split: str | None = None,
        shares: Sequence[float] = (0.8, 0.1, 0.1),
        seed: int = 0,
        balance: bool = False,
        per_class: int | None = None,
        distinct: float | None = None,
        workers: int = 1,
    ) -> pl.DataFrame:
        """Write clips as files of a data set, with ``metadata.csv`` and ``dataset.json``.

        The clips are whole takes, unless one of `annotations`, `labels`, `hits`, `ranges` and `sql` is given. The same
        request writes the same bytes, and an export that was stopped goes on where it was.

        Parameters
        ----------
        folder : str or os.PathLike
            The folder: new, empty, or that of an earlier export.
        takes : sequence of str, optional
            Names of takes; all unless given.
        format : str, optional
            The form of the files, such as "npz", "csv", "parquet" or "bvh".
        joints : bool, optional
            True writes the 24 joints also where the source's own channels can be cut.
        where : str, optional
            A SQL filter over the columns of takes.
        annotations, labels : bool, optional
            True cuts out annotated segments, or the labels of people.
        hits : str, optional
            The name of saved hits that are cut out.
        ranges : str or os.PathLike, optional
            A CSV file with the columns take, start, stop, and perhaps class.
        sql : str, optional
            A query for take, and perhaps start, stop, class, confidence, and columns for ``metadata.csv``.
        classes : sequence of str, optional
            Only these classes.
        pipeline : str, optional
            The pipeline of the annotations; the current one unless given.
        min_confidence : float, optional
            The least confidence.
        margin, context : float, optional
            Seconds before and after each interval that belong to the clip, and that its file holds besides.
        min_length : float, optional
            The least seconds of an interval.
        mirror : bool, optional
            True adds a twin of each clip with left and right exchanged, in the name of its class, too.
        resample : float, optional
            Frames per second of the files.
        in_place : bool, optional
            True begins each clip above the origin, facing +Z.
        split : str, optional
            A column of takes, no value of which is in two of the splits.
        shares : sequence of float, optional
            The shares of training, validation and test by seconds; two are training and test.
        seed : int, optional
            Another number draws another of equally good splits, and other clips.
        balance : bool, optional
            True takes, in each split, as many clips of each class as of its rarest.
        per_class : int, optional
            The largest number of clips of a class.
        distinct : float, optional
            Clips whose joints differ from those of an earlier clip by less are left out, in metres.
        workers : int, optional
            The number of processes. A script that asks for more than one must guard its start with
            ``if __name__ == "__main__":``.

        Returns
        -------
        polars.DataFrame
            The rows of ``metadata.csv``, one per clip.

        Raises
        ------
        KinedexError
            Nothing is selected, no clip can be written, the folder holds other files, or it cannot be written.
        ParameterError
            A value is out of its domain.

        Warns
        -----
        UserWarning
            Clips were left out, or could not be written.

        Examples
        --------
        >>> made = store.export(folder / "clips", [take.name], in_place=True)
        >>> made["file"].to_list() == [f"clips/{take.name}.npz"]
        True
        """
        from kinedex.pipelines.export.request import How, What, source_of

        kind, name = source_of(annotations=annotations, labels=labels, hits=hits, ranges=ranges, sql=sql)
        what = What(kind, name, tuple(takes), where, tuple(classes), pipeline, min_confidence)
        how = How(
            format, joints, margin, context, min_length, mirror, resample, in_place, split, tuple(shares), seed,
            balance, per_class, distinct,
        )  # fmt: skip
        return _exported(self.stored, what, how, Path(folder), workers)


def _exported(stored: StoredTakes, what: What, how: How, folder: Path, workers: int) -> pl.DataFrame:
    """Write a data set, and return its rows; what was left out is a warning."""
    import polars as pl
    from rich.console import Console

    from kinedex.pipelines.console.terminal import Terminal
    from kinedex.pipelines.engine.executors import make_executor
    from kinedex.pipelines.export.export import export_data_set

    executor, quiet = make_executor("processes", workers), Terminal(Console(quiet=True))
    try:
        done = export_data_set(stored, what, how, folder, executor=executor, progress=quiet.progress)
    finally:
        executor.close()
    for remark in (*done.remarks, *(f"{file}: {reason}" for file, reason in done.excluded.items())):
        warnings.warn(remark, stacklevel=4)
    return pl.DataFrame(done.rows, infer_schema_length=None)


class _StoredFrames:
    """Frames that are read from the parts of a store when they are needed."""

    def __init__(self, stored: StoredTakes, name: str, take_id: int, start: int, stop: int) -> None:
        self._stored, self._name, self._take_id = stored, name, take_id
        self._start, self._stop = start, stop

    def frames(self) -> Frames:
        """Read all columns."""
        return stored_frames(self._stored, self._name, self._start, self._stop)

    def words(self) -> U64:
        """Read the words alone."""
        return self._stored.words([self._take_id]).take(0)[self._start : self._stop]

    def part(self, start: int, stop: int) -> _StoredFrames:
        """Return the source of an interval of these frames."""
        return _StoredFrames(self._stored, self._name, self._take_id, self._start + start, self._start + stop)


def stored_frames(stored: StoredTakes, name: str, start: int, stop: int) -> Frames:
    """Read the frames of a take from the parts of its store."""
    from kinedex.storage.snapshot.frames import words_of
    from kinedex.storage.snapshot.parts import joint_positions

    table = stored.frames(name, start, stop)
    positions = joint_positions(table, stored.feature_set.joints)
    turned = table.column("root_orientation").combine_chunks().flatten()
    return Frames(
        np.ascontiguousarray(positions.transpose(2, 0, 1)),
        np.stack([part.to_numpy(zero_copy_only=False) for part in turned], axis=1).astype(np.float32),
        words_of(table),
    )
