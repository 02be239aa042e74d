"""Explain keyframe searches: the inverted list of each keyframe, the remaining frames, and the time of every step.

A search reads bit slices of the index and needs no lists (`pipelines.keyframes.slice_search`). The explanation also
makes the lists, with the algorithm of the thesis (`ops.search.keyframe_search`); both find the same ranges.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import SAME_FRAME, Keyframe, KeyframeQuery, pattern_of, words_of
from kinedex.ops.ranges import TakeRanges
from kinedex.ops.search.inverted_lists import InvertedLists
from kinedex.ops.search.keyframe_search import completable_frames, keyframe_list, search_lists
from kinedex.ops.words import I64
from kinedex.pipelines.engine.executors import cores
from kinedex.pipelines.keyframes.slice_search import sliced_store
from kinedex.pipelines.keyframes.store_search import SearchedTakes
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
    """Statistics of the inverted list of one keyframe of a query.

    Parameters
    ----------
    chain, number : int
        The number of the alternative of the query, and of the keyframe as written in the alternative, from 1.
    part : str
        "a", "b", ... for a keyframe with features in several sets, which has a report for each of them; else "".
    name, set, features, pattern : str
        The name of the keyframe, its feature set, the names of its features, and its pattern as in the papers.
    words, runs : int
        The numbers of matching words, and of their runs.
    segments, frames : int
        The numbers of segments into which the runs merge, and of frames in them.
    surviving : int
        The number of frames from which the rest of the query can be completed.
    milliseconds : float
        The time for making the list.
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
    """The times of the parts of a search, in milliseconds.

    Parameters
    ----------
    filter : float
        Selecting the takes by the filter given with the search.
    own_filter : float
        Selecting the takes by the filter of the query.
    open : float
        Mapping the index; close to zero once a store has been searched.
    search : float
        The search in the mapped slices; the first search of a process also loads compiled code.
    read : float
        Reading the lists of all queries, only for the explanation.
    """

    filter: float = 0.0
    own_filter: float = 0.0
    open: float = 0.0
    search: float = 0.0
    read: float = 0.0


@dataclass(frozen=True)
class QueryReport:
    """The explanation of one query; all numbers refer to the takes selected by the filters of search and query.

    Parameters
    ----------
    query : str
        The name of the query.
    keyframes : tuple of KeyframeReport
        The keyframes of all alternatives.
    ranges, takes, frames_kept : int
        The numbers of ranges found, of takes with a range, and of frames in the ranges.
    frames_searched : int
        The number of frames of all takes that were searched.
    milliseconds : float
        The time of a search in the inverted lists, which is made for the explanation only.
    times : Times
        The times of the other steps.
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
class _Answer:
    """A query, the takes that were searched for it, and the ranges found in them."""

    query: KeyframeQuery
    takes: SearchedTakes
    ranges: TakeRanges
    times: Times


def explain_store(store: Store, queries: Sequence[KeyframeQuery], take_filter: str | None = None) -> list[QueryReport]:
    """Search like `pipelines.keyframes.store_search.search_store`, each query separately, and explain the results.

    Parameters
    ----------
    store : Store
        A store whose index is built.
    queries : sequence of KeyframeQuery
        Queries over the feature set of the store.
    take_filter : str, optional
        A SQL filter over the columns of takes.

    Returns
    -------
    list of QueryReport
        One for each query.
    """
    began = time.perf_counter()
    takes = SearchedTakes.of_store(store, take_filter)
    filtering = _milliseconds_since(began)
    began = time.perf_counter()
    sliced = sliced_store(store)
    times = Times(filter=filtering, open=_milliseconds_since(began))
    answers: list[_Answer] = []
    for query in queries:
        began = time.perf_counter()
        own = takes.of_query(store, query)
        own_filter = _milliseconds_since(began)
        began = time.perf_counter()
        (ranges,) = sliced.select(own.ids).search([query], cores())
        spent = _milliseconds_since(began)
        answers.append(_Answer(query, own, ranges, replace(times, own_filter=own_filter, search=spent)))
    began = time.perf_counter()
    lists: dict[str | None, dict[str, InvertedLists]] = {}
    for answer in answers:
        if answer.query.takes not in lists:
            alike = [query for query in queries if query.takes == answer.query.takes]
            lists[answer.query.takes] = read_lists(store, alike, answer.takes.ids)
    read = _milliseconds_since(began)
    return [_report(lists[answer.query.takes], answer, store.feature_set, read) for answer in answers]


def explain_search(store: Store, queries: Sequence[KeyframeQuery], take_filter: str | None = None) -> pa.Table:
    """Return the explanation of a search as a table: the steps before it, then the steps of each query.

    All queries share the first steps: "takes" applies the filter of the search, "open" maps the index, "lists" reads
    the lists of the keyframes. The other steps belong to one query: "takes" applies the filter of the query, if it has
    one; "1", "2", ... make the lists of its keyframes as written ("2a" and "2b" if the features of a keyframe are in
    two sets, "2.1" for the first keyframe of a second alternative); "search" is the search in the slices, and "hits"
    are the ranges found. Only the explanation needs "lists" and the steps of keyframes; a search without explanation
    consists of "takes", "open" and "search".

    Parameters
    ----------
    store, queries, take_filter
        As in `explain_store`.

    Returns
    -------
    pyarrow.Table
        Columns query, step, name, set, features (by name), pattern, words, runs, segments, frames, share (of the frames
        searched), surviving and milliseconds; values that do not apply are null.
    """
    reports = explain_store(store, queries, take_filter)
    rows: list[dict[str, object]] = []
    if reports:
        times = reports[0].times
        for step, spent in (("takes", times.filter), ("open", times.open), ("lists", times.read)):
            rows.append({"step": step, "milliseconds": spent})
    for report, query in zip(reports, queries, strict=True):
        rows += _query_rows(report, query)
    return pa.Table.from_pylist(rows, schema=_EXPLANATION)


def _query_rows(report: QueryReport, query: KeyframeQuery) -> list[dict[str, object]]:
    """Return the rows of one query in the table of an explanation."""
    rows: list[dict[str, object]] = []
    searched = max(report.frames_searched, 1)
    several = report.keyframes[-1].chain > 1
    if query.takes is not None:
        rows.append({"query": report.query, "step": "takes", "milliseconds": report.times.own_filter})
    for keyframe in report.keyframes:
        step = f"{keyframe.chain}." * several + f"{keyframe.number}{keyframe.part}"
        row = {name: value for name, value in asdict(keyframe).items() if name in _EXPLANATION.names}
        named = {"query": report.query, "step": step, "name": keyframe.name or None}
        rows.append({**row, **named, "share": keyframe.frames / searched})
    rows.append({"query": report.query, "step": "search", "milliseconds": report.times.search})
    hits = {"query": report.query, "step": "hits", "segments": report.ranges, "frames": report.frames_kept}
    rows.append({**hits, "share": report.frames_kept / searched})
    return rows


def _report(lists: Mapping[str, InvertedLists], answer: _Answer, feature_set: FeatureSet, read: float) -> QueryReport:
    """Return a report on the keyframes, hits and times of a query, from the inverted lists of the searched takes."""
    query, ranges = answer.query, answer.ranges
    reports: list[KeyframeReport] = []
    spent = 0.0
    for number, chain in enumerate(query.chains, start=1):
        made = [_timed_list(lists[keyframe.set], keyframe.mask, keyframe.value) for keyframe in chain.keyframes]
        segments = [one for one, _ in made]
        reports += _keyframe_reports(lists, chain, number, made, feature_set)
        began = time.perf_counter()
        search_lists(segments, chain.bounds)
        spent += _milliseconds_since(began)
    return QueryReport(
        query=query.name,
        keyframes=tuple(reports),
        ranges=len(ranges.ranges),
        takes=int(np.count_nonzero(np.diff(ranges.offsets))),
        frames_kept=ranges.frames,
        frames_searched=int(answer.takes.frames.sum()),
        milliseconds=spent,
        times=replace(answer.times, read=read),
    )


def _timed_list(lists: InvertedLists, mask: int, value: int) -> tuple[I64, float]:
    """Return the inverted list of a keyframe, and the milliseconds for making it."""
    began = time.perf_counter()
    segments = keyframe_list(lists, mask, value)
    return segments, _milliseconds_since(began)


def _keyframe_reports(
    lists: Mapping[str, InvertedLists],
    chain: KeyframeQuery,
    number: int,
    made: Sequence[tuple[I64, float]],
    feature_set: FeatureSet,
) -> list[KeyframeReport]:
    """Return the reports of the keyframes of one alternative, from their lists and the times for making them."""
    remaining = completable_frames([segments for segments, _ in made], chain.bounds)
    reports = []
    for keyframe, at, (segments, spent), surviving in zip(
        chain.keyframes, _numbers(chain), made, remaining, strict=True
    ):
        inverted = lists[keyframe.set]
        words = inverted.matching(keyframe.mask, keyframe.value)
        report = KeyframeReport(
            chain=number,
            number=at[0],
            part=at[1],
            name=keyframe.name,
            set=keyframe.set,
            features=words_of(keyframe, feature_set),
            pattern=pattern_of(keyframe, feature_set),
            words=len(words),
            runs=int(inverted.runs[words].sum()),
            segments=len(segments),
            frames=_frames(segments),
            surviving=_frames(surviving),
            milliseconds=spent,
        )
        reports.append(report)
    return reports


def _frames(segments: I64) -> int:
    return int((segments[:, 1] - segments[:, 0]).sum())


def _numbers(chain: KeyframeQuery) -> list[tuple[int, str]]:
    """Return the number of each keyframe as the query writes it, with a letter if the keyframe has several parts."""
    # parts of one keyframe are separated by this object itself; an equal gap in a query is another object
    numbers = np.cumsum([1, *(gap is not SAME_FRAME for gap in chain.gaps)]).tolist()
    parts = [number if numbers.count(number) > 1 else 0 for number in numbers]
    return [
        (number, chr(ord("a") + i - numbers.index(number)) if part else "")
        for i, (number, part) in enumerate(zip(numbers, parts, strict=True))
    ]


def _milliseconds_since(began: float) -> float:
    return (time.perf_counter() - began) * 1e3


def read_lists(store: Store, queries: Sequence[KeyframeQuery], take_ids: I64) -> dict[str, InvertedLists]:
    """Read the inverted lists of all words that the keyframes of queries match.

    Parameters
    ----------
    store : Store
        A store whose index is built.
    queries : sequence of KeyframeQuery
        Queries over feature sets of the store.
    take_ids : int64 array (T,)
        The takes to read, ascending; take_ids[i] has position i in the lists.

    Returns
    -------
    dict of str to InvertedLists
        The lists of each feature set that the queries use.

    Raises
    ------
    StoreError
        If the index is missing or stale; the message gives the command that builds it.
    """
    store.index_path()
    wanted: dict[str, dict[Keyframe, None]] = {}
    for query in queries:
        for keyframe in (keyframe for chain in query.chains for keyframe in chain.keyframes):
            wanted.setdefault(keyframe.set, {})[keyframe] = None
    return {name: _read_set(store, name, list(keyframes), take_ids) for name, keyframes in wanted.items()}


def _read_set(store: Store, feature_set: str, keyframes: Sequence[Keyframe], take_ids: I64) -> InvertedLists:
    """Read the lists of one feature set."""
    poses = " OR ".join(f"(word & {k.mask}::UBIGINT) = {k.value}::UBIGINT" for k in keyframes)
    table = store.sql(
        f"""SELECT word, take_id, start, stop - start AS frames FROM word_runs WHERE feature_set = ?
            AND word IN (SELECT word FROM vocabulary WHERE feature_set = ? AND ({poses}))""",
        [feature_set, feature_set],
    )
    ids = table.column("take_id").to_numpy()
    place = np.searchsorted(take_ids, ids)
    known = place < len(take_ids)
    known[known] = take_ids[place[known]] == ids[known]
    words, starts, frames = (table.column(name).to_numpy()[known] for name in ("word", "start", "frames"))
    return InvertedLists.from_runs(words.astype(np.uint64), place[known], starts, frames)
