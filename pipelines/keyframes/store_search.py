"""Search keyframe queries in the index of a store, and make the table of hits."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import KeyframeQuery, choose_queries
from kinedex.catalog.queries.query_reader import ANALYSIS_RATE_HZ, part_names, read_queries
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.ranges import TakeRanges
from kinedex.ops.words import I64
from kinedex.pipelines.engine.executors import cores
from kinedex.pipelines.keyframes.applicability import applicability, known_masks, remarks_on
from kinedex.pipelines.keyframes.slice_search import sliced_store
from kinedex.storage.snapshot.schemas import hits_table, result_schema, sorted_by
from kinedex.storage.store.store import Store


@dataclass(frozen=True)
class SearchedTakes:
    """The T takes that are searched.

    Parameters
    ----------
    ids : int64 array (T,)
        The ids of the takes, ascending.
    names : list of str
        The names of the takes.
    frames : int64 array (T,)
        The lengths of the takes in frames.
    """

    ids: I64
    names: list[str]
    frames: I64

    @classmethod
    def of_store(cls, store: Store, take_filter: str | None) -> SearchedTakes:
        """Return the takes of a store for which a SQL filter holds, or all of them for None."""
        takes = sorted_by(_filtered(store, take_filter), "take_id")
        return cls(
            takes.column("take_id").to_numpy().astype(np.int64),
            takes.column("name").to_pylist(),
            takes.column("frames").to_numpy().astype(np.int64),
        )

    def chosen(self, store: Store, query: KeyframeQuery) -> npt.NDArray[np.bool_]:
        """Return which takes satisfy the filter of a query, bool (T,)."""
        if query.takes is None:
            return np.ones(len(self.ids), bool)
        try:
            return np.isin(self.ids, _filtered(store, query.takes).column("take_id").to_numpy())
        except KinedexError as fault:
            at = f"{query.takes_at}: " if query.takes_at else ""
            raise KinedexError(f"{at}query '{query.name}': {fault}") from None

    def of_query(self, store: Store, query: KeyframeQuery) -> SearchedTakes:
        """Return the takes that satisfy the filter of a query."""
        if query.takes is None:
            return self
        chosen = self.chosen(store, query)
        return SearchedTakes(self.ids[chosen], [self.names[i] for i in np.flatnonzero(chosen)], self.frames[chosen])


_NO_COLUMN = re.compile(r'column "?([^"\n]+?)"? not found')


def _filtered(store: Store, take_filter: str | None) -> pa.Table:
    """Return the takes that satisfy a filter; an error about an unknown column suggests the nearest one."""
    try:
        return store.takes_table(take_filter)
    except KinedexError as fault:
        wrong = _NO_COLUMN.search(str(fault))
        near = did_you_mean(wrong[1], store.takes_table().column_names) if wrong else ""
        if not near.startswith("; did you mean") or "did you mean" in str(fault):
            raise
        first, *others = str(fault).splitlines()
        raise KinedexError("\n".join([first + near, *others])) from None


def load_query_file(
    name_or_path: str | Path,
    feature_set: FeatureSet,
    names: Sequence[str] | None = None,
    rate_hz: float = ANALYSIS_RATE_HZ,
) -> tuple[KeyframeQuery, ...]:
    """Read a query file, and select queries from it.

    Parameters
    ----------
    name_or_path : str or Path
        A file, or the name of a shipped one.
    feature_set : FeatureSet
        The features of the queries.
    names : sequence of str, optional
        The queries to return, in this order; by default all of them.
    rate_hz : float
        The analysis rate in frames per second, which converts seconds to frames.

    Raises
    ------
    ConfigError
        If the file is invalid; the message names line and key.
    KinedexError
        If the file has no query with a requested name, or only a part.
    """
    queries = read_queries(name_or_path, feature_set, rate_hz)
    for name in names or ():
        if name in part_names(name_or_path):
            raise KinedexError(
                f"'{name}' is a part (`part: true`): other queries are made of it, and it is not searched itself; "
                f"ask for one of these, or take `part` out of it: {', '.join(query.name for query in queries)}"
            )
    return choose_queries(queries, names or ())


def search_store(
    store: Store,
    queries: Sequence[KeyframeQuery],
    take_filter: str | None = None,
    run: str = "",
    threads: int | None = None,
) -> pa.Table:
    """Search the index of a store, reading only the slices that the queries need.

    Parameters
    ----------
    store : Store
        A store whose index is built.
    queries : sequence of KeyframeQuery
        Queries over the feature set of the store.
    take_filter : str, optional
        A SQL filter over the columns of takes; by default all takes are searched. The filters of queries apply
        in addition.
    run : str
        The content of the column `run`.
    threads : int, optional
        The number of threads; by default one per core. The hits do not depend on it.

    Returns
    -------
    pyarrow.Table
        The hits, a row for each range, with the schema `result_schema("hits")` of `storage.snapshot.schemas`: in the
        order of the queries, then by take name and start.

    Raises
    ------
    KinedexError
        If a query uses features that the store does not have, or a filter is not valid.
    StoreError
        If the index is missing or stale; the message gives the command that builds it.
    """
    takes = SearchedTakes.of_store(store, take_filter)
    found = sliced_store(store).select(takes.ids).search(queries, cores() if threads is None else threads)
    hits = {
        query.name: ranges_of_takes(ranges, query, store, takes) for query, ranges in zip(queries, found, strict=True)
    }
    return table_of_ranges(hits, takes, store.rate_hz, run)


def search_remarks(store: Store, queries: Sequence[KeyframeQuery], take_filter: str | None = None) -> list[str]:
    """Return remarks on queries that are not applied to some takes, or only by their known entries."""
    if not store.known:
        return []
    known = known_masks(store.known, SearchedTakes.of_store(store, take_filter).ids.tolist())
    return remarks_on(applicability(store.feature_set, known.values(), {}, queries), known)


def ranges_of_takes(ranges: TakeRanges, query: KeyframeQuery, store: Store, takes: SearchedTakes) -> TakeRanges:
    """Return the ranges in those takes that satisfy the filter of a query."""
    if query.takes is None:
        return ranges
    counts = np.diff(ranges.offsets)
    chosen = takes.chosen(store, query)
    selected = np.repeat(chosen, counts)
    offsets = np.concatenate([np.zeros(1, np.int64), np.cumsum(counts * chosen)])
    return TakeRanges(offsets, ranges.ranges[selected])


def save_hits(store: Store, hits: pa.Table, name: str, run: str) -> pa.Table:
    """Save hits as results in the store, replacing those saved under the same name.

    Parameters
    ----------
    store : Store
        The store that was searched.
    hits : pyarrow.Table
        The hits, from `search_store`.
    name : str
        The name for the column `saved_as`.
    run : str
        The id of the pipeline run.

    Returns
    -------
    pyarrow.Table
        The rows as the store has them, with the name.

    Raises
    ------
    StoreError
        If another process writes to the store.
    """
    from kinedex.storage.store.writer import StoreWriter  # imported here, as searching does not write

    column = hits.schema.get_field_index("saved_as")
    saved = hits.set_column(column, hits.schema.field(column), pa.repeat(name, hits.num_rows))
    with StoreWriter.open(store.path, store.feature_set, store.rate_hz) as writer:
        writer.put_results("hits", saved, stage=f"search/{name}", run=run)
        writer.commit()
    return saved


def table_of_ranges(hits: Mapping[str, TakeRanges], takes: SearchedTakes, rate_hz: float, run: str = "") -> pa.Table:
    """Return ranges as the table of hits, in the order of the queries, then by take name and start."""
    schema = result_schema("hits")
    rows = pa.table({"take_id": takes.ids, "take": pa.array(takes.names, pa.string())})
    by_name = np.argsort(np.argsort(np.array(takes.names, dtype=np.str_), kind="stable"))
    tables = []
    for query, ranges in hits.items():
        order = np.lexsort((ranges.starts, by_name[ranges.takes]))
        own = rows.take(ranges.takes[order])
        columns = {"run": pa.repeat(run, len(order)), "saved_as": pa.nulls(len(order), pa.string())}
        columns["query"] = pa.repeat(query, len(order))
        tables.append(hits_table(schema, own, ranges.starts[order], ranges.stops[order], rate_hz, **columns))
    return pa.concat_tables([schema.empty_table(), *tables])
