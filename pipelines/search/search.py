"""Keyframe search over a store or over words in memory, and the table of its hits."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.queries import KeyframeQuery, choose_queries
from kinedex.catalog.queries.query_files import ANALYSIS_RATE_HZ, part_names, read_queries
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.ranges import TakeRanges
from kinedex.ops.words import I64, TakeWords
from kinedex.pipelines.engine.executors import cores
from kinedex.pipelines.search.resident_slices import indexed_words, resident_store, resident_words
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store
from kinedex.storage.store.writer import StoreWriter


@dataclass(frozen=True)
class SearchedTakes:
    """The takes that are searched, by take_id: ids, names, and frames, each (T,)."""

    ids: I64
    names: list[str]
    frames: I64

    @classmethod
    def of_store(cls, store: Store, take_filter: str | None) -> SearchedTakes:
        """The takes of a store for which a SQL filter holds; all of them for None."""
        takes = _filtered(store, take_filter).sort_by("take_id")
        return cls(
            takes.column("take_id").to_numpy().astype(np.int64),
            takes.column("name").to_pylist(),
            takes.column("frames").to_numpy().astype(np.int64),
        )

    def chosen(self, store: Store, query: KeyframeQuery) -> npt.NDArray[np.bool_]:
        """bool (T,), the takes that the query's own filter leaves."""
        if query.takes is None:
            return np.ones(len(self.ids), bool)
        try:
            return np.isin(self.ids, _filtered(store, query.takes).column("take_id").to_numpy())
        except KinedexError as fault:
            at = f"{query.takes_at}: " if query.takes_at else ""
            raise KinedexError(f"{at}query '{query.name}': {fault}") from None

    def of_query(self, store: Store, query: KeyframeQuery) -> SearchedTakes:
        """Of these takes those that the query's own filter leaves."""
        if query.takes is None:
            return self
        kept = self.chosen(store, query)
        return SearchedTakes(self.ids[kept], [self.names[i] for i in np.flatnonzero(kept)], self.frames[kept])


_NO_COLUMN = re.compile(r'column "?([^"\n]+?)"? not found')


def _filtered(store: Store, take_filter: str | None) -> pa.Table:
    """The takes for which a filter holds; the error for a column that they do not have names the nearest."""
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
    """Read a query file, and of it only the queries named, in that order; all of them where none is.

    Raises
    ------
    ConfigError: the file is wrong; with line and key. KinedexError: it has no query of a name asked for, or a part.
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
    """Search the published index of a store, reading no more of it than the queries ask for.

    Parameters
    ----------
    store: a store whose index is built.
    queries: keyframe queries over the store's feature set.
    take_filter: a SQL filter over the columns of takes; None searches all. A query's own filter holds besides.
    run: what the column `run` says.
    threads: how many may search; None takes one for every core. The hits do not depend on it.

    Returns
    -------
    The hits, one row per range, as `storage.snapshot.schemas.result_schema("hits")` has them: in the order of the
    queries, then
    by take name and start.

    Raises
    ------
    KinedexError: a query over features that the store does not have, or a filter that is not valid.
    StoreError: the index is missing or stale; the message says how to build it.
    """
    takes = SearchedTakes.of_store(store, take_filter)
    found = resident_store(store).of(takes.ids).search(queries, cores() if threads is None else threads)
    hits = {
        query.name: of_these_takes(ranges, query, store, takes) for query, ranges in zip(queries, found, strict=True)
    }
    return hits_table(hits, takes.ids, takes.names, store.rate_hz, run)


def of_these_takes(ranges: TakeRanges, query: KeyframeQuery, store: Store, takes: SearchedTakes) -> TakeRanges:
    """Of ranges those of the takes that a query's own filter leaves."""
    if query.takes is None:
        return ranges
    counts = np.diff(ranges.offsets)
    chosen = takes.chosen(store, query)
    kept = np.repeat(chosen, counts)
    offsets = np.concatenate([np.zeros(1, np.int64), np.cumsum(counts * chosen)])
    return TakeRanges(offsets, ranges.ranges[kept])


def save_hits(store: Store, hits: pa.Table, name: str, run: str) -> pa.Table:
    """Keep hits in the store as results, in place of those that were kept under this name before.

    Returns
    -------
    The rows as the store has them, with the name.

    Raises
    ------
    StoreError: another process writes to the store.
    """
    column = hits.schema.get_field_index("saved_as")
    kept = hits.set_column(column, hits.schema.field(column), pa.repeat(name, hits.num_rows))
    with StoreWriter.open(store.path, store.feature_set, store.rate_hz) as writer:
        writer.put_results("hits", kept, stage=f"search/{name}", run=run)
        writer.commit()
    return kept


def preselect_stored(
    store: Store, words: TakeWords, queries: Sequence[KeyframeQuery]
) -> dict[KeyframeQuery, TakeRanges]:
    """Search takes of a store as `preselect` does: in the slices of its index, which all workers share, where it has
    one; else in the words.

    Parameters
    ----------
    words: of the takes to search, as `Store.words` gives them.
    """
    shared = indexed_words(store) if queries else None
    if shared is None:
        return preselect(words, store.feature_set, queries)
    _refuse_filters(queries)
    found = shared.of(words.take_ids).search(queries)
    return dict(zip(queries, found, strict=True))


def preselect(
    words: TakeWords, feature_set: FeatureSet, queries: Sequence[KeyframeQuery]
) -> dict[KeyframeQuery, TakeRanges]:
    """Search words in memory: query → its ranges in each take, from first to last keyframe, without margins.

    Several queries may have the same name: one that was learned, and one that somebody wrote.

    Raises
    ------
    KinedexError: a query with a filter over takes, of which words in memory say nothing.
    """
    _refuse_filters(queries)
    if not queries:
        return {}
    resident = resident_words(words, feature_set)
    return {query: resident.search(query) for query in queries}


def _refuse_filters(queries: Sequence[KeyframeQuery]) -> None:
    for query in queries:
        if query.takes is not None:
            raise KinedexError(
                f"query '{query.name}' has a filter over takes (`takes: {query.takes}`), which preselection does not "
                "know; choose the takes by the stage's own filter, and leave it out of the query"
            )


def hits_table(
    hits: Mapping[str, TakeRanges], take_ids: I64, names: Sequence[str], rate_hz: float, run: str = ""
) -> pa.Table:
    """Lay out ranges as the table of hits: in the order of the queries, then by take name and start."""
    schema = result_schema("hits")
    by_name = np.argsort(np.argsort(np.array(names, dtype=np.str_), kind="stable"))
    tables = []
    for query, ranges in hits.items():
        index = ranges.takes
        order = np.lexsort((ranges.starts, by_name[index]))
        index, starts, stops = index[order], ranges.starts[order], ranges.stops[order]
        columns = {
            "run": pa.repeat(run, len(index)),
            "saved_as": pa.nulls(len(index), pa.string()),
            "query": pa.repeat(query, len(index)),
            "take_id": take_ids[index],
            "take": pa.array([names[i] for i in index.tolist()], pa.string()),
            "start": starts.astype(np.int32),
            "stop": stops.astype(np.int32),
            "start_seconds": starts / rate_hz,
            "stop_seconds": stops / rate_hz,
        }
        tables.append(pa.table(columns, schema=schema))
    return pa.concat_tables([schema.empty_table(), *tables])
