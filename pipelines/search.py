"""Keyframe search over a store or over words: hits, what a query costs, and the frames left for a template."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from catalog.features import FeatureSet
from catalog.queries import Keyframe, KeyframeQuery, choose_queries, pattern_of
from catalog.queryfiles import read_queries
from ops.errors import KinedexError
from ops.keyframes import Segments, keyframe_list, search, survivors, to_axis
from ops.preselection import KeyframeFit, TakeRanges, extend, fit_keyframes, margins, ranges_of_takes, unite
from ops.runs import word_runs
from ops.words import I64, U64, TakeWords, cut
from storage.schemas import result_schema
from storage.store import Store

_EXPLANATION = pa.schema(
    [
        *((name, pa.string()) for name in ("query", "step", "set", "pattern")),
        *((name, pa.int64()) for name in ("words", "runs", "segments", "frames")),
        ("share", pa.float64()),
        ("surviving", pa.int64()),
    ]
)


@dataclass(frozen=True)
class AxisRuns:
    """Word runs of one feature set on the axis of positions: int64 starts and stops, uint64 words, all (R,)."""

    starts: I64
    stops: I64
    words: U64


class RunLists:
    """The word runs that queries are answered from; every keyframe's list is made once.

    takes: number of takes T, whose indices the positions hold. runs: feature set → its runs, at least those of the
    words that the queries ask for.
    """

    def __init__(self, takes: int, runs: Mapping[str, AxisRuns]) -> None:
        self.takes = takes
        self.runs = dict(runs)
        self._lists: dict[Keyframe, Segments] = {}

    def keyframe(self, keyframe: Keyframe) -> Segments:
        """The inverted list of one keyframe."""
        if keyframe not in self._lists:
            runs = self.runs[keyframe.set]
            self._lists[keyframe] = keyframe_list(runs.starts, runs.stops, runs.words, keyframe.mask, keyframe.value)
        return self._lists[keyframe]

    def of_query(self, query: KeyframeQuery) -> list[Segments]:
        """The lists of all keyframes of a query."""
        return [self.keyframe(keyframe) for keyframe in query.keyframes]

    def search(self, query: KeyframeQuery) -> TakeRanges:
        """The union of all hit relevant ranges of a query, take by take."""
        return ranges_of_takes(search(self.of_query(query), query.bounds), self.takes)


@dataclass(frozen=True)
class KeyframeReport:
    """What one keyframe of a query found: words and runs that match, the segments they merge into, and frames.

    surviving: those of the frames from which the rest of the query can be completed.
    """

    set: str
    pattern: str
    words: int
    runs: int
    segments: int
    frames: int
    surviving: int


@dataclass(frozen=True)
class QueryReport:
    """How a query was answered: its keyframes, its ranges, and the frames they keep of those searched."""

    query: str
    keyframes: tuple[KeyframeReport, ...]
    ranges: int
    takes: int
    frames_kept: int
    frames_searched: int


@dataclass(frozen=True)
class TemplateWindow:
    """How far a template reaches out of the hits of a query, in frames; `fit` is None where the query has positions."""

    left: int
    right: int
    positions: tuple[int, ...]
    fit: KeyframeFit | None


def load_query_file(
    name_or_path: str | Path, feature_set: FeatureSet, names: Sequence[str] | None = None
) -> tuple[KeyframeQuery, ...]:
    """Read a query file, and of it only the queries named, in that order; all of them where none is.

    Raises
    ------
    ConfigError: the file is wrong; with line and key. KinedexError: it has no query of a name asked for.
    """
    return choose_queries(read_queries(name_or_path, feature_set), names or ())


def search_store(
    store: Store, queries: Sequence[KeyframeQuery], take_filter: str | None = None, run: str = ""
) -> pa.Table:
    """Search the published index of a store.

    Parameters
    ----------
    store: a store whose index is built.
    queries: keyframe queries over the store's feature set.
    take_filter: a SQL filter over the columns of takes; None searches all.
    run: what the column `run` says.

    Returns
    -------
    The hits, one row per range, as `storage.schemas.result_schema("hits")` has them: in the order of the queries, then
    by take name and start.

    Raises
    ------
    KinedexError: a query over features that the store does not have, or a filter that is not valid.
    StoreError: the index is missing or stale; the message says how to build it.
    """
    takes = _Takes.of_store(store, take_filter)
    lists = lists_of_store(store, queries, takes.ids)
    return hits_table(
        {query.name: lists.search(query) for query in queries}, takes.ids, takes.names, store.rate_hz, run
    )


def explain_store(store: Store, queries: Sequence[KeyframeQuery], take_filter: str | None = None) -> list[QueryReport]:
    """Search like `search_store`, and tell for each query what its keyframes found and how many frames are left."""
    takes = _Takes.of_store(store, take_filter)
    lists = lists_of_store(store, queries, takes.ids)
    return [explain(lists, query, store.feature_set, int(takes.frames.sum())) for query in queries]


def explain_search(store: Store, queries: Sequence[KeyframeQuery], take_filter: str | None = None) -> pa.Table:
    """Lay out what `explain_store` tells: one row per keyframe, and one for the hits of each query.

    Returns
    -------
    Columns query, step ("1", "2", ..., "hits"), set, pattern, words, runs, segments, frames, share (of the frames
    searched) and surviving; what does not apply to the hits is null.
    """
    rows: list[dict[str, object]] = []
    for report in explain_store(store, queries, take_filter):
        searched = max(report.frames_searched, 1)
        for number, keyframe in enumerate(report.keyframes, start=1):
            step = {"query": report.query, "step": str(number), **asdict(keyframe)}
            rows.append({**step, "share": keyframe.frames / searched})
        hits = {"query": report.query, "step": "hits", "segments": report.ranges, "frames": report.frames_kept}
        rows.append({**hits, "share": report.frames_kept / searched})
    return pa.Table.from_pylist(rows, schema=_EXPLANATION)


def explain(lists: RunLists, query: KeyframeQuery, feature_set: FeatureSet, frames: int) -> QueryReport:
    """Tell how a query is answered from these lists, which cover this many frames."""
    found = lists.search(query)
    kept = survivors(lists.of_query(query), query.bounds)
    steps = []
    for keyframe, surviving in zip(query.keyframes, kept, strict=True):
        words = lists.runs[keyframe.set].words
        matching = words[(words & np.uint64(keyframe.mask)) == np.uint64(keyframe.value)]
        merged = lists.keyframe(keyframe)
        steps.append(
            KeyframeReport(
                set=keyframe.set,
                pattern=pattern_of(keyframe, feature_set),
                words=len(np.unique(matching)),
                runs=len(matching),
                segments=len(merged),
                frames=merged.frames,
                surviving=surviving.frames,
            )
        )
    takes = int(np.count_nonzero(np.diff(found.offsets)))
    return QueryReport(query.name, tuple(steps), len(found.starts), takes, found.frames, frames)


def preselect(words: TakeWords, feature_set: FeatureSet, queries: Sequence[KeyframeQuery]) -> dict[str, TakeRanges]:
    """Search words in memory: query name → its ranges in each take, from first to last keyframe, without margins."""
    lists = lists_of_words(words, feature_set, {keyframe.set for query in queries for keyframe in query.keyframes})
    return {query.name: lists.search(query) for query in queries}


def template_window(query: KeyframeQuery, template: npt.NDArray[np.float64], feature_set: FeatureSet) -> TemplateWindow:
    """Find how far a template reaches out of the hits of a query.

    Parameters
    ----------
    query: a query with positions; one without gets those at which its keyframes fit the template best.
    template: float64 (N, f), the template's columns; entry i − 1 of a column belongs to F_i. A quantised template has
        0 and 1, and one half for wildcards.
    feature_set: the features of the query's sets.

    Raises
    ------
    KinedexError: the query's positions lie outside the template, or it asks for features the template does not have.
    """
    columns, features = template.shape
    fit = None
    positions = query.positions
    if positions is None:
        masks = np.zeros((len(query.keyframes), features), bool)
        values = np.zeros_like(masks)
        for k, keyframe in enumerate(query.keyframes):
            for bit, number in enumerate(feature_set.word_set(keyframe.set).numbers):
                if keyframe.mask >> bit & 1:
                    if number > features:
                        raise KinedexError(f"query '{query.name}' asks for F{number}, the template has {features}")
                    masks[k, number - 1] = True
                    values[k, number - 1] = keyframe.value >> bit & 1
        fit = fit_keyframes(template, masks, values, query.bounds)
        positions = fit.positions
    elif positions[-1] >= columns:
        raise KinedexError(
            f"query '{query.name}' puts a keyframe in template column {positions[-1]}, but the template has {columns}"
            " columns, counted from 0; leave `positions` out to have them found"
        )
    left, right = margins(positions[0], positions[-1], columns, query.least_stiffness)
    return TemplateWindow(left, right, positions, fit)


def template_ranges(
    hits: Mapping[str, TakeRanges],
    queries: Sequence[KeyframeQuery],
    template: npt.NDArray[np.float64],
    feature_set: FeatureSet,
    frames: I64,
) -> TakeRanges:
    """Return the frames in which a template is to be matched: the hits of its queries with their margins, united.

    Parameters
    ----------
    hits: what `preselect` returns. queries: those of them that are for this template, at least one.
    template: float64 (N, f), see `template_window`.
    feature_set: the features of the queries' sets.
    frames: int64 (T,), the length of each take (`TakeWords.frames`).
    """
    extended = []
    for query in queries:
        window = template_window(query, template, feature_set)
        extended.append(extend(hits[query.name], window.left, window.right, frames))
    return unite(extended)


def lists_of_words(words: TakeWords, feature_set: FeatureSet, sets: Iterable[str]) -> RunLists:
    """The run lists of words in memory; take i of the words has index i."""
    runs = {}
    for name in sets:
        word_set = feature_set.word_set(name)
        found = word_runs(cut(words.words, word_set.first, word_set.count), words.offsets)
        runs[name] = AxisRuns(to_axis(found.take, found.start), to_axis(found.take, found.stop), found.word)
    return RunLists(len(words), runs)


def lists_of_store(store: Store, queries: Sequence[KeyframeQuery], take_ids: I64) -> RunLists:
    """Read from the index of a store the runs of the words that queries ask for, in these takes only.

    Parameters
    ----------
    take_ids: int64 (T,), ascending; take_ids[i] has index i.

    Raises
    ------
    StoreError: the index is missing or stale; the message says how to build it.
    """
    store.index_path()
    wanted: dict[str, dict[Keyframe, None]] = {}
    for query in queries:
        for keyframe in query.keyframes:
            store.feature_set.word_set(keyframe.set)
            wanted.setdefault(keyframe.set, {})[keyframe] = None
    return RunLists(len(take_ids), {name: _stored_runs(store, name, list(of), take_ids) for name, of in wanted.items()})


def hits_table(
    hits: Mapping[str, TakeRanges], take_ids: I64, names: Sequence[str], rate_hz: float, run: str = ""
) -> pa.Table:
    """Lay out ranges as the table of hits: in the order of the queries, then by take name and start."""
    schema = result_schema("hits")
    by_name = np.argsort(np.argsort(np.array(names, dtype=np.str_), kind="stable"))
    tables = []
    for query, ranges in hits.items():
        index = np.repeat(np.arange(len(ranges)), np.diff(ranges.offsets))
        order = np.lexsort((ranges.starts, by_name[index]))
        index, starts, stops = index[order], ranges.starts[order], ranges.stops[order]
        columns = {
            "run": pa.repeat(run, len(index)),
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


@dataclass(frozen=True)
class _Takes:
    ids: I64
    names: list[str]
    frames: I64

    @classmethod
    def of_store(cls, store: Store, take_filter: str | None) -> _Takes:
        takes = store.takes(take_filter).sort("take_id")
        return cls(
            takes["take_id"].to_numpy().astype(np.int64),
            takes["name"].to_list(),
            takes["frames"].to_numpy().astype(np.int64),
        )


def _stored_runs(store: Store, feature_set: str, keyframes: Sequence[Keyframe], take_ids: I64) -> AxisRuns:
    poses = " OR ".join(f"(word & {k.mask}::UBIGINT) = {k.value}::UBIGINT" for k in keyframes)
    table = store.sql(
        f"""SELECT word, take_id, start, stop FROM word_runs WHERE feature_set = ?
            AND word IN (SELECT word FROM vocabulary WHERE feature_set = ? AND ({poses}))""",
        [feature_set, feature_set],
    )
    ids = table.column("take_id").to_numpy()
    index = np.searchsorted(take_ids, ids)
    known = index < len(take_ids)
    known[known] = take_ids[index[known]] == ids[known]
    return AxisRuns(
        to_axis(index[known], table.column("start").to_numpy()[known]),
        to_axis(index[known], table.column("stop").to_numpy()[known]),
        table.column("word").to_numpy().astype(np.uint64)[known],
    )
