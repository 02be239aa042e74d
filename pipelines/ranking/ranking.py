"""The pass of a ranking over the takes of a store: batch by batch through threads, the best hits of every template."""

from __future__ import annotations

import heapq
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import polars as pl
import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.ops.distances.costs import I64, encode
from kinedex.ops.errors import KinedexError
from kinedex.ops.ranges import TakeRanges
from kinedex.ops.ranking.hit_selection import KEYS
from kinedex.ops.ranking.ranking import Hits, rank, rank_together
from kinedex.ops.templates.derived_templates import restricted_template
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import ALL_KNOWN, TakeWords
from kinedex.pipelines.engine.executors import batches_of, cores
from kinedex.pipelines.search.bit_slices import stored_words
from kinedex.pipelines.search.not_applied import Applicability, applicability
from kinedex.pipelines.search.preselection import known_queries, preselect_stored, template_ranges, widest_margins
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store

BATCH_FRAMES = 200_000
"""A thread reads and ranks so many analysis frames (under two hours) at a time; a longer take is a batch of its own."""

Item = tuple[tuple[int, ...], int, tuple[float, ...]]
"""The ids of some takes that know the same features, their mask, and the threshold of every template."""


@dataclass(frozen=True)
class RankedTemplate:
    """A template to rank with: its name in the results, and the keyframe queries that preselect frames for it."""

    name: str
    template: QuantisedTemplate
    queries: tuple[KeyframeQuery, ...] = ()


@dataclass(frozen=True)
class Hit:
    """A range of frames [start, stop) of a take that a template, or its mirror image, fits at a distance `cost`."""

    take_id: int
    take: str
    start: int
    stop: int
    cost: float
    mirrored: bool = False


@dataclass(frozen=True)
class BatchHits:
    """The hits of each template in a batch of takes.

    Attributes
    ----------
    ids : int64 array (T,)
        The ids of the takes.
    frames : int
        The frames of all of them.
    hits : tuple of Hits
        The hits of each template.
    reading : float
        Seconds in which words were read and coded, and keyframes looked up.
    ranking : tuple of float
        Seconds of each template.
    """

    ids: I64
    frames: int
    hits: tuple[Hits, ...]
    reading: float
    ranking: tuple[float, ...]


@dataclass(frozen=True)
class Ranking:
    """The hits of one template, with the work that they took; seconds are those of all threads added up.

    Attributes
    ----------
    name : str
        The name of the template.
    hits : tuple of Hit
        The hits, the best first.
    frames : int
        The frames of all takes.
    searched : int
        The frames that keyframe queries left, all of them without queries.
    computed : int
        The frames of these in which distances were computed, as no bound excluded a hit.
    bounded : bool
        True where a bound was tried.
    reading : float
        Seconds of the whole pass in which takes were listed, words read and coded, and keyframes looked up.
    ranking : float
        Seconds of this template; of templates that are ranked together, its share by columns.
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
        """The share of the searched frames that a bound excluded; None where no bound was tried."""
        if not self.bounded:
            return None
        return max(0.0, 1 - self.computed / self.searched) if self.searched else 0.0

    @property
    def kept(self) -> float:
        """The share of all frames that keyframe queries left, 1 without queries."""
        return self.searched / self.frames if self.frames else 0.0


def rank_takes(
    store: Store,
    templates: Sequence[RankedTemplate],
    tau: float,
    top: int | None = None,
    where: str | None = None,
    workers: int | None = None,
) -> list[Ranking]:
    """Rank the takes of a store by each of some templates, all of them in one pass over the words.

    Of equal hits, the one in the take whose name comes first is first, and within a take the one that ends first: the
    best 3 are the head of the best 10, whatever takes share a batch and in whatever order they were ingested. Memory
    does not grow with the archive: besides the hits that are kept, each thread holds a batch or two. The hits are the
    same for any number of threads, and for templates together or one by one; how many frames a bound excludes depends
    on the hits that are known when a batch begins.

    Parameters
    ----------
    store : Store
        The store to search.
    templates : sequence of RankedTemplate
        The templates, each with its keyframe queries.
    tau : float
        Distances below it make a hit.
    top : int, optional
        The largest number of hits of a template; all hits unless given.
    where : str, optional
        A SQL filter over the columns of takes; all takes unless given.
    workers : int, optional
        The number of threads; that of the cores unless given.

    Returns
    -------
    list of Ranking
        One for each template, in their order.

    Raises
    ------
    KinedexError
        The filter selects no take, or a query does not fit the features of the store.
    """
    begin = time.perf_counter()
    takes = store.takes(where).sort("take_id")
    if not takes.height:
        raise KinedexError("no take to rank" + (f": the filter `{where}` selects none" if where else " in this store"))
    names = dict(takes.select("take_id", "name").iter_rows())
    batches = list(_batches(takes, store.known))
    best: list[list[tuple[float, str, int, Hit]]] = [[] for _ in templates]
    counts = np.zeros((len(templates), 3), np.int64)
    bounded = np.zeros(len(templates), np.bool_)
    reading, seconds = time.perf_counter() - begin, np.zeros(len(templates))

    # Once `top` hits are known, a hit above the last of them cannot enter any more. The others stay as they are, as a
    # hit excludes overlapping hits of higher cost only.
    bars = [tau] * len(templates)

    def work(item: Item) -> BatchHits:
        return _rank_known(store, templates, *item, top, names)

    items = ((batch, mask, tuple(bars)) for mask, batch in batches)
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
                # hits of equal cost (the same key, or within the tolerance below a threshold) may still enter
                bars[place] = min(tau, (best[place][-1][0] + 2) / KEYS)
    return [
        Ranking(one.name, tuple(entry[3] for entry in kept), count[0], count[1], count[2], tried, reading, own)
        for one, kept, count, tried, own in zip(
            templates, best, counts.tolist(), bounded.tolist(), seconds.tolist(), strict=True
        )
    ]


def partly_known(
    templates: Sequence[RankedTemplate], feature_set: FeatureSet, known: Mapping[int, int]
) -> list[Applicability]:
    """Return what the takes that lack features know of templates and their queries; `known` has their masks by id."""
    queries = (query for one in templates for query in one.queries)
    return applicability(feature_set, known.values(), {one.name: one.template for one in templates}, queries)


def _batches(takes: pl.DataFrame, known: Mapping[int, int]) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Yield batches of takes that know the same features, each with their mask; whole bodies come first."""
    frames = dict(takes.select("take_id", "frames").iter_rows())
    masks = {take_id: known.get(take_id, int(ALL_KNOWN)) for take_id in frames}
    for mask in sorted(set(masks.values()), reverse=True):
        own = [take_id for take_id in frames if masks[take_id] == mask]
        yield from ((mask, batch) for batch in batches_of(own, [frames[take_id] for take_id in own], BATCH_FRAMES))


def _rank_known(
    store: Store,
    templates: Sequence[RankedTemplate],
    take_ids: tuple[int, ...],
    mask: int,
    taus: tuple[float, ...],
    top: int | None,
    names: Mapping[int, str],
) -> BatchHits:
    """Return the hits of each template in takes that know the same features; none of a template not applied."""
    if mask & store.feature_set.every_bit == store.feature_set.every_bit:
        return _rank_batch(store, templates, take_ids, taus, top, names)
    applied = {
        place: replace(one, template=own, queries=_known_queries(one, store.feature_set, mask))
        for place, one in enumerate(templates)
        if (own := restricted_template(one.template, mask)) is not None
    }
    chosen = tuple(taus[place] for place in applied)
    found = _rank_batch(store, list(applied.values()), take_ids, chosen, top, names)
    hits, seconds = [_no_hits()] * len(templates), [0.0] * len(templates)
    for place, these, spent in zip(applied, found.hits, found.ranking, strict=True):
        hits[place], seconds[place] = these, spent
    return replace(found, hits=tuple(hits), ranking=tuple(seconds))


def _known_queries(one: RankedTemplate, feature_set: FeatureSet, mask: int) -> tuple[KeyframeQuery, ...]:
    """Return the queries of a template that are applied to takes with a mask; without any, all frames are ranked."""
    columns = one.template.values(len(feature_set.features))
    margins = [widest_margins(query, columns, feature_set) for query in one.queries]
    return known_queries(one.queries, margins, feature_set, mask)


def _no_hits() -> Hits:
    none = np.empty(0, np.int64)
    return Hits(none, none, none, np.empty(0), 0, 0, bounded=False)


def _order(entry: tuple[float, str, int, Hit]) -> tuple[float, str, int]:
    return entry[:3]


def _rank_batch(
    store: Store,
    templates: Sequence[RankedTemplate],
    take_ids: tuple[int, ...],
    taus: tuple[float, ...],
    top: int | None,
    names: Mapping[int, str],
) -> BatchHits:
    """Return the hits of each template in some takes."""
    begin = time.perf_counter()
    words = stored_words(store, take_ids)
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
    return BatchHits(words.take_ids, len(words.words), every, reading, tuple(seconds))


def _ranges(store: Store, one: RankedTemplate, words: TakeWords, hits: Mapping[KeyframeQuery, TakeRanges]) -> I64:
    """Return the frames, of words laid end to end, that the hits of a template's queries leave, int64 (R, 2)."""
    columns = one.template.values(len(store.feature_set.features))
    return template_ranges(hits, one.queries, columns, store.feature_set, words.offsets)


def _in_threads(work: Callable[[Item], BatchHits], items: Iterable[Item], workers: int) -> Iterator[BatchHits]:
    """Apply the work to every item in threads, with two items a thread in flight; results come in order.

    The next item is drawn after the results before it were consumed, so that it knows their thresholds. The kernels
    release the interpreter's lock: threads use all cores, without a copy of the words.
    """
    source = iter(items)
    with ThreadPoolExecutor(max(1, workers)) as pool:
        waiting: deque[Future[BatchHits]] = deque(pool.submit(work, item) for item in islice(source, 2 * workers))
        try:
            while waiting:
                yield waiting.popleft().result()
                waiting.extend(pool.submit(work, item) for item in islice(source, 1))
        finally:
            for future in waiting:
                future.cancel()


def ranking_table(rankings: Iterable[Ranking], rate_hz: float, run: str = "") -> pa.Table:
    """Return hits as results of the kind `ranked_hits`, in the order of templates and ranks."""
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
