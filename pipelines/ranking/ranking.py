"""Ranking a store: takes batch by batch through threads, and of every template the best hits."""

from __future__ import annotations

import heapq
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice

import numpy as np
import pyarrow as pa

from kinedex.catalog.queries.queries import KeyframeQuery
from kinedex.ops.distances.costs import I64, encode
from kinedex.ops.errors import KinedexError
from kinedex.ops.ranges import TakeRanges
from kinedex.ops.ranking.hit_selection import KEYS
from kinedex.ops.ranking.ranking import Hits, rank, rank_together
from kinedex.ops.templates.templates import QuantisedTemplate, quantise
from kinedex.ops.words import TakeWords
from kinedex.pipelines.engine.executors import cores
from kinedex.pipelines.search.preselection import template_ranges
from kinedex.pipelines.search.search import preselect_stored
from kinedex.pipelines.templates.learning import SubclassTemplate
from kinedex.storage.store.schemas import result_schema
from kinedex.storage.store.store import Store

BATCH_FRAMES = 200_000
"""Analysis frames (under two hours) that a thread reads and ranks at a time; a longer take makes a batch of its own."""

Item = tuple[tuple[int, ...], tuple[float, ...]]
"""Takes, by id, and the threshold of every template."""


@dataclass(frozen=True)
class Searched:
    """A template to rank with, by a name for the results, and the keyframe queries that preselect frames for it."""

    name: str
    template: QuantisedTemplate
    queries: tuple[KeyframeQuery, ...] = ()


@dataclass(frozen=True)
class Hit:
    """A place in a take where a template fits: frames [start, stop), and the distance."""

    take_id: int
    take: str
    start: int
    stop: int
    cost: float


@dataclass(frozen=True)
class Found:
    """What a batch holds: its takes and how many frames they have, and of each template the hits and the seconds."""

    ids: I64
    frames: int
    hits: tuple[Hits, ...]
    reading: float
    ranking: tuple[float, ...]


@dataclass(frozen=True)
class Ranking:
    """The hits of one template, the best first; of how many frames were searched, how many were looked at closely.

    bounded: whether a bound was tried, without which nothing is skipped. reading: the seconds of the whole pass that
    are no ranking: takes are listed, words read and coded, keyframes looked up. ranking: the template's own seconds, of
    templates that are ranked together its part by columns. Seconds are those of all threads added up.
    """

    name: str
    hits: tuple[Hit, ...]
    frames: int
    searched: int
    computed: int
    bounded: bool
    reading: float
    ranking: float

    @property
    def skipped(self) -> float | None:
        """The share of the searched frames that provably had no hit; None where no bound was tried."""
        if not self.bounded:
            return None
        return max(0.0, 1 - self.computed / self.searched) if self.searched else 0.0

    @property
    def kept(self) -> float:
        """The share of all frames that keyframe queries left."""
        return self.searched / self.frames if self.frames else 0.0


def searched_templates(
    learned: Sequence[SubclassTemplate], delta: float, queries: Sequence[KeyframeQuery] = ()
) -> tuple[list[Searched], list[str]]:
    """Quantise templates, and give each the queries for its subclass.

    Returns
    -------
    What to search for; and the subclasses whose template is wildcards alone and would fit anything, left out.

    Raises
    ------
    KinedexError: no template is left.
    """
    searched, vague = [], []
    for one in learned:
        template = quantise(one.learned.template, delta)
        if template.fixed:
            own = tuple(query for query in queries if query.target == one.subclass)
            searched.append(Searched(one.subclass, template, own))
        else:
            vague.append(one.subclass)
    if not searched:
        raise KinedexError(f"at delta = {delta:g} no template is left to rank with; raise `delta`")
    return searched, vague


def rank_store(
    store: Store,
    templates: Sequence[Searched],
    tau: float,
    top: int | None = None,
    where: str | None = None,
    workers: int | None = None,
) -> list[Ranking]:
    """Rank the takes of a store by each of some templates, all of them in one pass over the words.

    Of equal hits that of the take whose name comes first is first, and within it the one that ends first: the best 3
    are the head of the best 10, whatever takes share a batch and in whatever order they were ingested.

    Memory does not grow with the archive: besides the hits that are kept it holds a batch or two for each thread.
    The hits are the same for any number of threads, and for templates together or one by one; how many frames can
    be skipped depends on what is known already when a batch begins.

    Parameters
    ----------
    templates: what to look for. tau: distances below it make a hit. top: how many hits a template at most.
    where: a SQL filter over the columns of takes. workers: threads; all cores unless told.

    Raises
    ------
    KinedexError: no take is selected, or a query does not fit the features.
    """
    begin = time.perf_counter()
    takes = store.takes(where).sort("take_id")
    if not takes.height:
        raise KinedexError("no take to rank" + (f": the filter `{where}` selects none" if where else " in this store"))
    names = dict(takes.select("take_id", "name").iter_rows())
    batches = _batches(takes["take_id"].to_list(), takes["frames"].to_list())
    best: list[list[tuple[float, str, int, Hit]]] = [[] for _ in templates]
    counts = np.zeros((len(templates), 3), np.int64)
    bounded = np.zeros(len(templates), np.bool_)
    reading, seconds = time.perf_counter() - begin, np.zeros(len(templates))

    # Where enough hits are known, one that is no better than the last of them is of no interest any more. The others
    # stay as they are: what is taken rules out what is dearer, never the other way round.
    bars = [tau] * len(templates)

    def work(item: Item) -> Found:
        return _rank_batch(store, templates, *item, top, names)

    items = ((batch, tuple(bars)) for batch in batches)
    for found in _in_threads(work, items, cores() if workers is None else workers):
        reading += found.reading
        seconds += found.ranking
        for place, hits in enumerate(found.hits):
            counts[place] += (found.frames, hits.frames, hits.computed)
            bounded[place] |= hits.bounded
            entries = [
                (round(cost * KEYS), names[take_id], stop, Hit(take_id, names[take_id], start, stop, cost))
                for take_id, start, stop, cost in zip(
                    found.ids[hits.takes].tolist(), hits.starts.tolist(), hits.stops.tolist(), hits.costs.tolist(),
                    strict=True,
                )
            ]  # fmt: skip
            merged = best[place] + entries
            best[place] = sorted(merged, key=_order) if top is None else heapq.nsmallest(top, merged, key=_order)
            if len(best[place]) == top:
                # equal costs (keys that are the same, and the tolerance below a threshold) are still let in
                bars[place] = min(tau, (best[place][-1][0] + 2) / KEYS)
    return [
        Ranking(one.name, tuple(entry[3] for entry in kept), count[0], count[1], count[2], tried, reading, own)
        for one, kept, count, tried, own in zip(
            templates, best, counts.tolist(), bounded.tolist(), seconds.tolist(), strict=True
        )
    ]


def _order(entry: tuple[float, str, int, Hit]) -> tuple[float, str, int]:
    return entry[:3]


def _batches(take_ids: Sequence[int], frames: Sequence[int]) -> list[tuple[int, ...]]:
    """Divide takes into batches of about `BATCH_FRAMES`."""
    batches: list[list[int]] = []
    room = 0
    for take_id, length in zip(take_ids, frames, strict=True):
        if not batches or length > room:
            batches.append([])
            room = BATCH_FRAMES
        batches[-1].append(take_id)
        room -= length
    return [tuple(batch) for batch in batches]


def _rank_batch(
    store: Store,
    templates: Sequence[Searched],
    take_ids: tuple[int, ...],
    taus: tuple[float, ...],
    top: int | None,
    names: Mapping[int, str],
) -> Found:
    """The hits of each template in some takes."""
    begin = time.perf_counter()
    words = store.words(take_ids)
    coded = encode(words.words)
    queries = dict.fromkeys(query for one in templates for query in one.queries)
    hits = preselect_stored(store, words, list(queries))
    by_name = {take_id: place for place, take_id in enumerate(sorted(take_ids, key=lambda each: names[each]))}
    order = np.array([by_name[take_id] for take_id in words.take_ids.tolist()], np.int64)
    ranges = {place: _ranges(store, one, words, hits) for place, one in enumerate(templates) if one.queries}
    reading = time.perf_counter() - begin
    seconds = [0.0] * len(templates)
    begin = time.perf_counter()
    free = [place for place, one in enumerate(templates) if not one.queries]
    found = rank_together(
        [templates[place].template for place in free], words, np.array([taus[place] for place in free]), top, coded,
        order,
    )  # fmt: skip
    ranked = dict(zip(free, found, strict=True))
    columns = sum(len(templates[place].template) for place in free)
    spent = time.perf_counter() - begin
    for place in free:
        seconds[place] = spent * len(templates[place].template) / columns
    for place, own in ranges.items():
        begin = time.perf_counter()
        ranked[place] = rank(templates[place].template, words, taus[place], top, own, coded, order=order)
        seconds[place] = time.perf_counter() - begin
    every = tuple(ranked[place] for place in range(len(templates)))
    return Found(words.take_ids, len(words.words), every, reading, tuple(seconds))


def _ranges(store: Store, one: Searched, words: TakeWords, hits: Mapping[KeyframeQuery, TakeRanges]) -> I64:
    """The frames of words laid end to end that the hits of a template's queries leave, int64 (R, 2)."""
    columns = one.template.values(len(store.feature_set.features))
    return template_ranges(hits, one.queries, columns, store.feature_set, words.offsets)


def _in_threads(work: Callable[[Item], Found], items: Iterable[Item], workers: int) -> Iterator[Found]:
    """Apply the work to every item in threads, two a thread in flight; results come in the items' order.

    An item is asked for only when there is room, after the results before it have been looked at.

    The kernels let go of the interpreter, so that threads share the cores as processes would, without a copy.
    """
    source = iter(items)
    with ThreadPoolExecutor(max(1, workers)) as pool:
        waiting: deque[Future[Found]] = deque(pool.submit(work, item) for item in islice(source, 2 * workers))
        try:
            while waiting:
                yield waiting.popleft().result()
                waiting.extend(pool.submit(work, item) for item in islice(source, 1))
        finally:
            for future in waiting:
                future.cancel()


def ranking_table(rankings: Iterable[Ranking], rate_hz: float, run: str = "") -> pa.Table:
    """Lay hits out as results of the kind `ranked_hits`, in the order of templates and ranks."""
    rows = [
        {
            "run": run,
            "template": ranking.name,
            "rank": place,
            "take_id": hit.take_id,
            "take": hit.take,
            "start": hit.start,
            "stop": hit.stop,
            "start_seconds": hit.start / rate_hz,
            "stop_seconds": hit.stop / rate_hz,
            "cost": hit.cost,
        }
        for ranking in rankings
        for place, hit in enumerate(ranking.hits, start=1)
    ]
    return pa.Table.from_pylist(rows, schema=result_schema("ranked_hits"))
