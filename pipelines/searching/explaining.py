"""How a keyframe query is answered: the lists of its keyframes, the frames that are kept, and the time of each step."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import pyarrow as pa

from catalog.features import FeatureSet
from catalog.queries import Keyframe, KeyframeQuery, pattern_of
from ops.search.preselection import TakeRanges
from pipelines.searching.lists import RunLists, lists_of_store
from pipelines.searching.search import SearchedTakes, of_these_takes
from storage.store import Store

_EXPLANATION = pa.schema(
    [
        *((name, pa.string()) for name in ("query", "step", "name", "set", "pattern")),
        *((name, pa.int64()) for name in ("words", "runs", "segments", "frames")),
        ("share", pa.float64()),
        ("surviving", pa.int64()),
        ("milliseconds", pa.float64()),
    ]
)


@dataclass(frozen=True)
class KeyframeReport:
    """What one keyframe of a query found: words and runs that match, the segments they merge into, and frames.

    chain, number: the alternative and its keyframe, from 1. surviving: those of the frames from which the rest of the
    query can be completed. milliseconds: what making the list took; 0 where it stood already.
    """

    chain: int
    number: int
    name: str
    set: str
    pattern: str
    words: int
    runs: int
    segments: int
    frames: int
    surviving: int
    milliseconds: float


@dataclass(frozen=True)
class QueryReport:
    """How a query was answered: its keyframes, its ranges, and the frames they keep of those searched.

    milliseconds: what the search over the lists took. read_milliseconds: what reading the lists of all queries took.
    """

    query: str
    keyframes: tuple[KeyframeReport, ...]
    ranges: int
    takes: int
    frames_kept: int
    frames_searched: int
    milliseconds: float
    read_milliseconds: float = 0.0


def explain_store(store: Store, queries: Sequence[KeyframeQuery], take_filter: str | None = None) -> list[QueryReport]:
    """Search like `pipelines.searching.search.search_store`, and tell what each query's keyframes found and what was
    kept."""
    takes = SearchedTakes.of_store(store, take_filter)
    began = time.perf_counter()
    lists = lists_of_store(store, queries, takes.ids)
    read = _since(began)
    return [explain(lists, query, store, takes, read) for query in queries]


def explain_search(store: Store, queries: Sequence[KeyframeQuery], take_filter: str | None = None) -> pa.Table:
    """Lay out what `explain_store` tells: reading the lists, then for each query its keyframes, and its hits.

    Returns
    -------
    Columns query, step ("read", "1", "2", ..., "hits"; "2.1" is the first keyframe of a second alternative), name,
    set, pattern, words, runs, segments, frames, share (of the frames searched), surviving and milliseconds; what does
    not apply is null.
    """
    reports = explain_store(store, queries, take_filter)
    rows: list[dict[str, object]] = []
    if reports:
        rows.append({"step": "read", "milliseconds": reports[0].read_milliseconds})
    for report in reports:
        searched = max(report.frames_searched, 1)
        several = report.keyframes[-1].chain > 1
        for keyframe in report.keyframes:
            step = f"{keyframe.chain}.{keyframe.number}" if several else str(keyframe.number)
            told = {name: value for name, value in asdict(keyframe).items() if name in _EXPLANATION.names}
            rows.append({**told, "query": report.query, "step": step, "name": keyframe.name or None})
            rows[-1]["share"] = keyframe.frames / searched
        hits = {"query": report.query, "step": "hits", "segments": report.ranges, "frames": report.frames_kept}
        rows.append({**hits, "share": report.frames_kept / searched, "milliseconds": report.milliseconds})
    return pa.Table.from_pylist(rows, schema=_EXPLANATION)


def explain(
    lists: RunLists, query: KeyframeQuery, store: Store, takes: SearchedTakes, read_milliseconds: float = 0.0
) -> QueryReport:
    """Tell how a query is answered from lists that cover these takes of a store."""
    steps: list[KeyframeReport] = []
    for number, chain in enumerate(query.chains, start=1):
        made = [_list_time(lists, keyframe) for keyframe in chain.keyframes]
        kept = lists.survivors(chain)
        for place, keyframe in enumerate(chain.keyframes):
            surviving = kept[place].frames
            steps.append(_report(lists, keyframe, store.feature_set, (number, place + 1), surviving, made[place]))
    began = time.perf_counter()
    ranges: TakeRanges = of_these_takes(lists.search(query), query, store, takes)
    spent = _since(began)
    with_hits = int(np.count_nonzero(np.diff(ranges.offsets)))
    searched = int(takes.frames[takes.chosen(store, query)].sum())
    return QueryReport(
        query.name, tuple(steps), len(ranges.starts), with_hits, ranges.frames, searched, spent, read_milliseconds
    )


def _list_time(lists: RunLists, keyframe: Keyframe) -> float:
    began = time.perf_counter()
    lists.keyframe(keyframe)
    return _since(began)


def _report(
    lists: RunLists,
    keyframe: Keyframe,
    feature_set: FeatureSet,
    at: tuple[int, int],
    surviving: int,
    milliseconds: float,
) -> KeyframeReport:
    postings = lists.postings[keyframe.set]
    merged = lists.keyframe(keyframe)
    return KeyframeReport(
        chain=at[0],
        number=at[1],
        name=keyframe.name,
        set=keyframe.set,
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
