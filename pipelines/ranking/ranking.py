"""Rank the takes of a store in one pass, batch by batch in threads, and keep the best hits of every template."""

from __future__ import annotations

import heapq
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import KinedexError
from kinedex.ops.ranking.hit_selection import KEYS
from kinedex.ops.words import ALL_KNOWN
from kinedex.pipelines.engine.executors import batches_of, cores
from kinedex.pipelines.ranking.batch_ranking import BatchHits, rank_batch
from kinedex.pipelines.ranking.batch_threads import in_threads
from kinedex.pipelines.ranking.first_thresholds import first_thresholds
from kinedex.pipelines.ranking.ranked_hits import Hit, RankedTemplate, Ranking
from kinedex.pipelines.search.not_applied import Applicability, applicability
from kinedex.storage.snapshot.schemas import sorted_by
from kinedex.storage.store.store import Store

BATCH_FRAMES = 200_000
"""The number of frames that a thread reads and ranks at a time (under two hours); a longer take is its own batch."""

Item = tuple[tuple[int, ...], int, tuple[float, ...]]
"""The ids of takes with the same known features, their feature mask, and the threshold of every template."""


def rank_takes(
    store: Store,
    templates: Sequence[RankedTemplate],
    tau: float,
    top: int | None = None,
    where: str | None = None,
    workers: int | None = None,
) -> list[Ranking]:
    """Rank the takes of a store by several templates, in one pass over the words.

    Hits of equal cost are ordered by name of the take, and within a take by their stop: the best 3 are the first of the
    best 10, whatever takes share a batch and in whatever order they were ingested. Memory does not grow with the
    archive: besides the hits that are kept, each thread holds one or two batches. The hits are the same for any number
    of threads, and for templates together or separately; the number of frames that a bound excludes depends on the hits
    that are known when a batch begins.

    Parameters
    ----------
    store : Store
        The store to search.
    templates : sequence of RankedTemplate
        The templates, each with its keyframe queries.
    tau : float
        The threshold below which a distance is a hit.
    top : int, optional
        The largest number of hits of a template; by default all hits.
    where : str, optional
        A SQL filter over the columns of takes; by default all takes.
    workers : int, optional
        The number of threads; by default that of the cores.

    Returns
    -------
    list of Ranking
        One for each template, in their order.

    Raises
    ------
    KinedexError
        The filter selects no take, or a query does not match the features of the store.
    """
    begin = time.perf_counter()
    takes = sorted_by(store.takes_table(where), "take_id")
    if not takes.num_rows:
        raise KinedexError("no take to rank" + (f": the filter `{where}` selects none" if where else " in this store"))
    ids, names, frames = (takes.column(name).to_pylist() for name in ("take_id", "name", "frames"))
    batches = list(_batches(dict(zip(ids, frames, strict=True)), store.known))
    threads = cores() if workers is None else workers
    ranked = _Pass(store, dict(zip(ids, names, strict=True)), batches, top, threads)
    bars = first_thresholds(store, batches, templates, tau, top, threads)
    found = ranked.rank(templates, bars, time.perf_counter() - begin)
    unsure = [place for place, bar in enumerate(bars) if bar < tau and not _is_sure(found[place], bar, top)]
    again = ranked.rank([templates[place] for place in unsure], [tau] * len(unsure), 0.0) if unsure else []
    for place, one in zip(unsure, again, strict=True):
        found[place] = one
    return found


def _is_sure(ranking: Ranking, bar: float, top: int | None) -> bool:
    """Return whether the hits below a threshold are certain to be the first ones below any greater threshold."""
    return len(ranking.hits) == top and round(ranking.hits[-1].cost * KEYS) + 2 <= round(bar * KEYS)


@dataclass(frozen=True)
class _Pass:
    """A ranking pass over takes, with which any templates can be ranked.

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

    def rank(self, templates: Sequence[RankedTemplate], first: Sequence[float], reading: float) -> list[Ranking]:
        """Rank the takes by templates; `first` has a threshold for each, `reading` the seconds spent before."""
        top, names = self.top, self.names
        best: list[list[tuple[float, str, int, Hit]]] = [[] for _ in templates]
        counts = np.zeros((len(templates), 3), np.int64)
        bounded = np.zeros(len(templates), np.bool_)
        seconds = np.zeros(len(templates))

        # Once `top` hits are known, a hit above the last of them cannot enter. The others do not change, because
        # a hit excludes only overlapping hits of higher cost.
        bars = list(first)

        def work(item: Item) -> BatchHits:
            return rank_batch(self.store, templates, *item, top, names)

        items = ((batch, mask, tuple(bars)) for mask, batch in self.batches)
        for found in in_threads(work, items, self.workers):
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
    """Return how templates and queries apply to takes that lack features; `known` has their masks by take_id."""
    queries = (query for one in templates for query in one.queries)
    return applicability(feature_set, known.values(), {one.name: one.template for one in templates}, queries)


def _batches(frames: Mapping[int, int], known: Mapping[int, int]) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Yield batches of takes with the same known features, each with its mask; takes with all features come first.

    `frames` maps take_id to the length of the take.
    """
    masks = {take_id: known.get(take_id, int(ALL_KNOWN)) for take_id in frames}
    for mask in sorted(set(masks.values()), reverse=True):
        own = [take_id for take_id in frames if masks[take_id] == mask]
        yield from ((mask, batch) for batch in batches_of(own, [frames[take_id] for take_id in own], BATCH_FRAMES))


def _order(entry: tuple[float, str, int, Hit]) -> tuple[float, str, int]:
    return entry[:3]
