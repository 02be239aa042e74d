"""How a keyframe query is answered: the lists of its keyframes, the frames that are kept, and what took how long.

The search that answers looks at bit slices of the index and makes no list (`pipelines.search.resident_slices`). What
the
lists say of each keyframe is found beside it; both find the same.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.queries import SAME_FRAME, Keyframe, KeyframeQuery, pattern_of, words_of
from kinedex.ops.ranges import TakeRanges
from kinedex.pipelines.engine.executors import cores
from kinedex.pipelines.search.inverted_lists import RunLists, lists_of_store
from kinedex.pipelines.search.resident_slices import resident_store
from kinedex.pipelines.search.search import SearchedTakes
from kinedex.storage.store.store import Store

_EXPLANATION = pa.schema(
    [
        *((name, pa.string()) for name in ("query", "step", "name", "set", "features", "pattern")),
        *((name, pa.int64()) for name in ("words", "runs", "segments", "frames")),
        ("share", pa.float64()),
        ("surviving", pa.int64()),
        ("milliseconds", pa.float64()),
    ]
)


@dataclass(frozen=True)
class KeyframeReport:
    """What one keyframe of a query found: words and runs that match, the segments they merge into, and frames.

    chain, number: the alternative and its keyframe as written, from 1. part: "a", "b", ... of a keyframe whose features
    lie in several sets, which has a report for each of them; else "". surviving: those of the frames from which the
    rest of the query can be completed. milliseconds: what making the list took; 0 where it stood already.
    """

    chain: int
    number: int
    part: str
    name: str
    set: str
    features: str
    pattern: str
    words: int
    runs: int
    segments: int
    frames: int
    surviving: int
    milliseconds: float


@dataclass(frozen=True)
class Times:
    """What parts of a search took, in milliseconds.

    filter: choosing the takes by the filter given with the search. own_filter: by that of the query. open: mapping the
    index; next to nothing once a store has been searched. search: the search that answers, in the mapped slices; the
    first of a process loads its compiled code as well. read: reading the lists of all queries, for the explanation
    alone.
    """

    filter: float = 0.0
    own_filter: float = 0.0
    open: float = 0.0
    search: float = 0.0
    read: float = 0.0


@dataclass(frozen=True)
class QueryReport:
    """How a query was answered: its keyframes, its ranges, and the frames they keep of those searched.

    Searched are the takes that the filter of the search and the query's own leave; all numbers are of these.
    milliseconds: what the search over the lists took, which only the explanation does. times: what else took how long.
    """

    query: str
    keyframes: tuple[KeyframeReport, ...]
    ranges: int
    takes: int
    frames_kept: int
    frames_searched: int
    milliseconds: float
    times: Times = Times()


@dataclass(frozen=True)
class _Answered:
    """A query, the takes that were searched for it, and what the search found in them."""

    query: KeyframeQuery
    takes: SearchedTakes
    ranges: TakeRanges
    times: Times


def explain_store(store: Store, queries: Sequence[KeyframeQuery], take_filter: str | None = None) -> list[QueryReport]:
    """Search like `pipelines.search.search.search_store`, each query by itself, and tell what its keyframes found
    and what was kept, in the takes that its own filter leaves."""
    began = time.perf_counter()
    takes = SearchedTakes.of_store(store, take_filter)
    filtering = _since(began)
    began = time.perf_counter()
    resident = resident_store(store)
    times = Times(filter=filtering, open=_since(began))
    answered: list[_Answered] = []
    for query in queries:
        began = time.perf_counter()
        own = takes.of_query(store, query)
        choosing = _since(began)
        began = time.perf_counter()
        (ranges,) = resident.of(own.ids).search([query], cores())
        answered.append(_Answered(query, own, ranges, replace(times, own_filter=choosing, search=_since(began))))
    began = time.perf_counter()
    lists: dict[str | None, RunLists] = {}
    for one in answered:
        if one.query.takes not in lists:
            alike = [query for query in queries if query.takes == one.query.takes]
            lists[one.query.takes] = lists_of_store(store, alike, one.takes.ids)
    read = _since(began)
    return [_explain(lists[one.query.takes], one, store.feature_set, read) for one in answered]


def explain_search(store: Store, queries: Sequence[KeyframeQuery], take_filter: str | None = None) -> pa.Table:
    """Lay out what `explain_store` tells: what went before the search, then each query's keyframes, search, and hits.

    Returns
    -------
    Columns query, step, name, set, features (by name), pattern, words, runs, segments, frames, share (of the frames
    searched), surviving and milliseconds; what does not apply is null. The steps are, first for all queries, "takes",
    their filter; "open", mapping the index; "lists", reading the lists of the keyframes. Then for each query "takes",
    where it has a filter of its own; "1", "2", ..., its keyframes as written ("2a" and "2b" where the features of one
    lie in two sets, "2.1" for the first keyframe of a second alternative); "search", the search that answers; "hits",
    what it found. What "lists" and keyframes took goes into the explanation alone: a search without one does "takes",
    "open" and "search".
    """
    reports = explain_store(store, queries, take_filter)
    rows: list[dict[str, object]] = []
    if reports:
        times = reports[0].times
        for step, spent in (("takes", times.filter), ("open", times.open), ("lists", times.read)):
            rows.append({"step": step, "milliseconds": spent})
    for report, query in zip(reports, queries, strict=True):
        searched = max(report.frames_searched, 1)
        several = report.keyframes[-1].chain > 1
        if query.takes is not None:
            rows.append({"query": report.query, "step": "takes", "milliseconds": report.times.own_filter})
        for keyframe in report.keyframes:
            step = f"{keyframe.chain}." * several + f"{keyframe.number}{keyframe.part}"
            told = {name: value for name, value in asdict(keyframe).items() if name in _EXPLANATION.names}
            rows.append({**told, "query": report.query, "step": step, "name": keyframe.name or None})
            rows[-1]["share"] = keyframe.frames / searched
        rows.append({"query": report.query, "step": "search", "milliseconds": report.times.search})
        hits = {"query": report.query, "step": "hits", "segments": report.ranges, "frames": report.frames_kept}
        rows.append({**hits, "share": report.frames_kept / searched})
    return pa.Table.from_pylist(rows, schema=_EXPLANATION)


def _explain(lists: RunLists, answered: _Answered, feature_set: FeatureSet, read: float) -> QueryReport:
    """Tell how a query found its ranges, from lists of the same takes."""
    query, ranges = answered.query, answered.ranges
    steps: list[KeyframeReport] = []
    for number, chain in enumerate(query.chains, start=1):
        made = [_list_time(lists, keyframe) for keyframe in chain.keyframes]
        kept = lists.survivors(chain)
        for place, (keyframe, at) in enumerate(zip(chain.keyframes, _numbers(chain), strict=True)):
            steps.append(_report(lists, keyframe, feature_set, (number, *at), kept[place].frames, made[place]))
    began = time.perf_counter()
    lists.search(query)
    spent = _since(began)
    return QueryReport(
        query=query.name,
        keyframes=tuple(steps),
        ranges=len(ranges.ranges),
        takes=int(np.count_nonzero(np.diff(ranges.offsets))),
        frames_kept=ranges.frames,
        frames_searched=int(answered.takes.frames.sum()),
        milliseconds=spent,
        times=replace(answered.times, read=read),
    )


def _list_time(lists: RunLists, keyframe: Keyframe) -> float:
    began = time.perf_counter()
    lists.keyframe(keyframe)
    return _since(began)


def _numbers(chain: KeyframeQuery) -> list[tuple[int, str]]:
    """The number of each keyframe as written, and which part of it this is: "" where it has only one."""
    # the very same object stands between parts of one keyframe; an equal gap that somebody wrote is another
    numbers = np.cumsum([1, *(gap is not SAME_FRAME for gap in chain.gaps)]).tolist()
    parts = [number if numbers.count(number) > 1 else 0 for number in numbers]
    return [
        (number, chr(ord("a") + i - numbers.index(number)) if part else "")
        for i, (number, part) in enumerate(zip(numbers, parts, strict=True))
    ]


def _report(
    lists: RunLists,
    keyframe: Keyframe,
    feature_set: FeatureSet,
    at: tuple[int, int, str],
    surviving: int,
    milliseconds: float,
) -> KeyframeReport:
    postings = lists.postings[keyframe.set]
    merged = lists.keyframe(keyframe)
    return KeyframeReport(
        chain=at[0],
        number=at[1],
        part=at[2],
        name=keyframe.name,
        set=keyframe.set,
        features=words_of(keyframe, feature_set),
        pattern=pattern_of(keyframe, feature_set),
        words=len(postings.matching(keyframe.mask, keyframe.value)),
        runs=postings.runs(keyframe.mask, keyframe.value),
        segments=len(merged),
        frames=merged.frames,
        surviving=surviving,
        milliseconds=milliseconds,
    )


def _since(began: float) -> float:
    return (time.perf_counter() - began) * 1e3
