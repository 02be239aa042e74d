"""The pass of a ranking over the takes of a store: batch by batch through threads, the best hits of every template."""

from __future__ import annotations

import heapq
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import islice
from typing import TypeVar

import numpy as np
import polars as pl
import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.ops.distances.costs import I64, encode
from kinedex.ops.errors import KinedexError, StoreError
from kinedex.ops.ranges import TakeRanges, extend_and_unite
from kinedex.ops.ranking.hit_selection import KEYS
from kinedex.ops.ranking.ranking import Hits, rank, rank_together
from kinedex.ops.search.bit_slices import GRANULE
from kinedex.ops.templates.derived_templates import restricted_template
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import ALL_KNOWN, TakeWords
from kinedex.pipelines.engine.executors import batches_of, cores
from kinedex.pipelines.ranking.candidate_granules import CandidateGranules, candidate_granules, joined_batches
from kinedex.pipelines.search.bit_slices import SlicedWords, sliced_index, stored_words
from kinedex.pipelines.search.not_applied import Applicability, applicability
from kinedex.pipelines.search.preselection import known_queries, preselect_stored, template_ranges, widest_margins
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store

BATCH_FRAMES = 200_000
"""A thread reads and ranks so many analysis frames (under two hours) at a time; a longer take is a batch of its own."""

WORTH_FRAMES = 500_000
"""From so many frames on, a first look at the index for a low threshold saves more than it takes."""

SAMPLED = 6
"""So many granules are looked at for each hit that is asked for: several of them belong to one hit."""

MOST_PROMISING = 0.4
"""All frames are ranked together if the index leaves a greater share of them."""

Asked = TypeVar("Asked")
Found = TypeVar("Found")

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
    ranked = _Pass(store, names, list(_batches(takes, store.known)), top, cores() if workers is None else workers)
    bars = ranked.first_thresholds(templates, tau)
    found = ranked.rank(templates, bars, time.perf_counter() - begin)
    unsure = [place for place, bar in enumerate(bars) if bar < tau and not _is_sure(found[place], bar, top)]
    again = ranked.rank([templates[place] for place in unsure], [tau] * len(unsure), 0.0) if unsure else []
    for place, one in zip(unsure, again, strict=True):
        found[place] = one
    return found


def _is_sure(ranking: Ranking, bar: float, top: int | None) -> bool:
    """Return whether a ranking below a threshold has the hits that one below any greater threshold begins with."""
    return len(ranking.hits) == top and round(ranking.hits[-1].cost * KEYS) + 2 <= round(bar * KEYS)


@dataclass(frozen=True)
class _Pass:
    """A pass over some takes, for any templates.

    Attributes
    ----------
    store : Store
        The store.
    names : mapping of int to str
        The name of each take by its id.
    batches : list of (int, tuple of int)
        Masks of known features, and ids of takes.
    top : int, optional
        The largest number of hits of a template.
    workers : int
        The number of threads.
    """

    store: Store
    names: Mapping[int, str]
    batches: list[tuple[int, tuple[int, ...]]]
    top: int | None
    workers: int

    def first_thresholds(self, templates: Sequence[RankedTemplate], tau: float) -> list[float]:
        """Return a threshold for each template below which there are likely to be hits enough.

        It is the cost of the last of the best hits in those granules of the index whose bounds are lowest; `tau` where
        this would take longer than it saves. Hits below a lower threshold are the first ones below tau: they come in
        the order of their costs, and only a better one excludes one. If they are enough, they are the answer.
        """
        frames = sum(self.store.take_frames[take_id] for _, batch in self.batches for take_id in batch)
        sliced = _sound_index(self.store)
        asked = any(one.queries for one in templates)
        if self.top is None or sliced is None or asked or frames < WORTH_FRAMES:
            return [tau] * len(templates)
        every, top = self.store.feature_set.every_bit, self.top
        ids = [np.array(batch, np.int64) for mask, batch in self.batches if mask & every == every]
        plain = [one.template for one in templates]

        def lowest(batch: I64) -> list[CandidateGranules]:
            found = candidate_granules(sliced, batch, plain, [tau] * len(plain))
            return [one.lowest(SAMPLED * top) for one in found]

        parts = list(_in_threads(lowest, ids, self.workers))
        bars = []
        for place, template in enumerate(plain):
            own = joined_batches([one[place] for one in parts], ids).lowest(SAMPLED * top)
            bars.append(self._threshold_of(sliced, template, own, tau))
        return bars

    def _threshold_of(
        self, sliced: SlicedWords, template: QuantisedTemplate, sample: CandidateGranules, tau: float
    ) -> float:
        """Return the cost of the last of the best hits in some granules, whose takes are ids; tau if they are few."""
        ids = np.unique(sample.takes)
        if not len(ids):
            return tau
        offsets = _offsets(self.store, ids)
        ranges = sample.ranges(len(template), ids, offsets)
        words = sliced.words(ids, ranges)
        hits = rank(template, words, tau, self.top, ranges, encode(words.words, ranges))
        return min(tau, (round(float(hits.costs[-1]) * KEYS) + 2) / KEYS) if len(hits) == self.top else tau

    def rank(self, templates: Sequence[RankedTemplate], first: Sequence[float], reading: float) -> list[Ranking]:
        """Rank the takes by templates, each below a threshold; `reading` seconds were spent before."""
        top, names = self.top, self.names
        best: list[list[tuple[float, str, int, Hit]]] = [[] for _ in templates]
        counts = np.zeros((len(templates), 3), np.int64)
        bounded = np.zeros(len(templates), np.bool_)
        seconds = np.zeros(len(templates))

        # Once `top` hits are known, a hit above the last of them cannot enter any more. The others stay as they are, as
        # a hit excludes overlapping hits of higher cost only.
        bars = list(first)

        def work(item: Item) -> BatchHits:
            return _rank_known(self.store, templates, *item, top, names)

        items = ((batch, mask, tuple(bars)) for mask, batch in self.batches)
        for found in _in_threads(work, items, self.workers):
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
                    bars[place] = min(bars[place], (best[place][-1][0] + 2) / KEYS)
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
    if (few := _rank_promising(store, templates, take_ids, taus, top, names)) is not None:
        return few
    words = stored_words(store, take_ids)
    coded = encode(words.words)
    queries = dict.fromkeys(query for one in templates for query in one.queries)
    hits = preselect_stored(store, words, list(queries))
    order = _name_order(words.take_ids, names)
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


def _name_order(take_ids: I64, names: Mapping[int, str]) -> I64:
    """Return the place of each take in the order of names."""
    by_name = {take_id: place for place, take_id in enumerate(sorted(take_ids.tolist(), key=lambda each: names[each]))}
    return np.array([by_name[take_id] for take_id in take_ids.tolist()], np.int64)


def _offsets(store: Store, take_ids: I64) -> I64:
    """Return the first frame of each take where they are laid end to end, and the end."""
    return np.cumsum([0, *(store.take_frames[take_id] for take_id in take_ids.tolist())]).astype(np.int64)


def _sound_index(store: Store) -> SlicedWords | None:
    """Return the mapped index of a store; None where it has none, or a damaged one, which nothing here needs."""
    try:
        return sliced_index(store)
    except StoreError:
        return None


def _rank_promising(
    store: Store,
    templates: Sequence[RankedTemplate],
    take_ids: tuple[int, ...],
    taus: tuple[float, ...],
    top: int | None,
    names: Mapping[int, str],
) -> BatchHits | None:
    """Return the hits in those frames that the index does not exclude; None where it excludes too few."""
    begin = time.perf_counter()
    sliced = _sound_index(store)
    frames = sum(store.take_frames[take_id] for take_id in take_ids)
    if sliced is None or not templates or any(one.queries for one in templates):
        return None
    ids = np.array(sorted(take_ids), np.int64)
    low = candidate_granules(sliced, ids, [one.template for one in templates], taus)
    if max(len(one.granules) for one in low) * GRANULE > MOST_PROMISING * frames:
        return None
    chosen = np.unique(np.concatenate([one.takes for one in low]))
    hits, seconds = [replace(_no_hits(), frames=frames, bounded=True)] * len(templates), [0.0] * len(templates)
    if not len(chosen):
        return BatchHits(ids[chosen], frames, tuple(hits), time.perf_counter() - begin, tuple(seconds))
    offsets = _offsets(store, ids[chosen])
    ranges = [own.ranges(len(one.template), chosen, offsets) for one, own in zip(templates, low, strict=True)]
    every = extend_and_unite(np.concatenate(ranges), offsets)
    words = sliced.words(ids[chosen], every)
    coded, order = encode(words.words, every), _name_order(words.take_ids, names)
    reading = time.perf_counter() - begin
    for place, (one, own) in enumerate(zip(templates, ranges, strict=True)):
        begin = time.perf_counter()
        if len(own):
            ranked = rank(one.template, words, taus[place], top, own, coded, order=order)
            computed = ranked.computed if ranked.bounded else int((own[:, 1] - own[:, 0]).sum())
            hits[place] = replace(ranked, frames=frames, computed=computed, bounded=True)
        seconds[place] = time.perf_counter() - begin
    return BatchHits(words.take_ids, frames, tuple(hits), reading, tuple(seconds))


def _ranges(store: Store, one: RankedTemplate, words: TakeWords, hits: Mapping[KeyframeQuery, TakeRanges]) -> I64:
    """Return the frames, of words laid end to end, that the hits of a template's queries leave, int64 (R, 2)."""
    columns = one.template.values(len(store.feature_set.features))
    return template_ranges(hits, one.queries, columns, store.feature_set, words.offsets)


def _in_threads(work: Callable[[Asked], Found], items: Iterable[Asked], workers: int) -> Iterator[Found]:
    """Apply the work to every item in threads, with two items a thread in flight; results come in order.

    The next item is drawn after the results before it were consumed, so that it knows their thresholds. The kernels
    release the interpreter's lock: threads use all cores, without a copy of the words.
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
