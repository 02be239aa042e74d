"""Rank the takes of a store by templates, batch by batch in threads, and keep the best hits of every template."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import KeyframeQuery, mirrored
from kinedex.ops.arrays import I64
from kinedex.ops.distances.costs import encode
from kinedex.ops.errors import KinedexError
from kinedex.ops.ranges import extend_and_unite
from kinedex.ops.ranking.best_hits import Hits, rank, rank_together
from kinedex.ops.ranking.hit_selection import KEYS
from kinedex.ops.search.bit_slices import GRANULE
from kinedex.ops.templates.derived_templates import restricted_template
from kinedex.ops.words import ALL_KNOWN, rearrange
from kinedex.pipelines.engine.executors import batches_of, cores, in_threads
from kinedex.pipelines.keyframes.applicability import Applicability, applicability
from kinedex.pipelines.keyframes.preselected_frames import (
    known_queries,
    preselect_stored,
    template_ranges,
    widest_margins,
)
from kinedex.pipelines.keyframes.slice_search import sound_index, stored_words
from kinedex.pipelines.templates.candidate_granules import candidate_granules, first_thresholds, offsets_of
from kinedex.pipelines.templates.ranked_hits import RankedTemplate, Ranking, as_ranked
from kinedex.storage.snapshot.schemas import hits_table, ranking_schema, sorted_by
from kinedex.storage.store.store import Store

BATCH_FRAMES = 200_000
"""The number of frames that a thread reads and ranks at a time (under two hours); a longer take is its own batch."""

MAX_PROMISING = 0.4
"""The largest fraction of frames left by the index for which only these are ranked; above it, all frames are."""

Found = tuple[list[Hits], float, list[float]]
"""The hits of each template in a batch, the seconds of reading, and those of ranking by each template."""


def rank_takes(
    store: Store,
    templates: Sequence[RankedTemplate],
    tau: float,
    top: int | None = None,
    where: str | None = None,
    workers: int | None = None,
) -> list[Ranking]:
    """Rank the takes of a store by several templates, in one pass over the words.

    Hits of equal cost are ordered by the name of the take, and within a take by their stop. Therefore, the best 3 hits
    are the first of the best 10, whatever takes share a batch and in whatever order they were ingested. Memory does not
    grow with the archive, because each thread holds one or two batches besides the hits that are kept. The hits are the
    same for any number of threads, and for templates together or separately. The number of frames that a bound excludes
    can differ, because it depends on the hits that are known when a batch begins.

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
        The number of threads; by default one per core.

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
    ids, frames = (takes.column(name).to_pylist() for name in ("take_id", "frames"))
    batches = list(_batches(dict(zip(ids, frames, strict=True)), store.known))
    threads = cores() if workers is None else workers
    ranked = _Pass(store, takes, batches, top, threads)
    thresholds = first_thresholds(store, batches, templates, tau, top, threads)
    found = ranked.rank(templates, thresholds, time.perf_counter() - begin)
    unsure = [place for place, one in enumerate(thresholds) if one < tau and not _is_sure(found[place], one, top)]
    again = ranked.rank([templates[place] for place in unsure], [tau] * len(unsure), 0.0) if unsure else []
    for place, one in zip(unsure, again, strict=True):
        found[place] = one
    return found


def _is_sure(ranking: Ranking, threshold: float, top: int | None) -> bool:
    """Return whether the hits below a threshold are certain to be the first ones below any greater threshold."""
    return len(ranking) == top and round(ranking.hits.column("cost")[-1].as_py() * KEYS) + 2 <= round(threshold * KEYS)


@dataclass(frozen=True)
class _Pass:
    """A pass over takes, with which any templates can be ranked.

    Parameters
    ----------
    store : Store
        The store of the takes.
    takes : pyarrow.Table
        The rows of the T takes, sorted by take_id.
    batches : list of (int, tuple of int)
        Masks of known features, and ids of takes that are ranked together.
    top : int, optional
        The largest number of hits of a template; None keeps all.
    workers : int
        The number of threads.
    """

    store: Store
    takes: pa.Table
    batches: list[tuple[int, tuple[int, ...]]]
    top: int | None
    workers: int

    @cached_property
    def ids(self) -> I64:
        """The ids of the takes, int64 (T,), ascending."""
        ids: I64 = self.takes.column("take_id").to_numpy().astype(np.int64)
        return ids

    @cached_property
    def order(self) -> I64:
        """The rank of each take among hits of equal cost, by its name, int64 (T,)."""
        names = self.takes.column("name").to_pylist()
        rank_of = {name: place for place, name in enumerate(sorted(names))}
        return np.array([rank_of[name] for name in names], np.int64)

    def rank(self, templates: Sequence[RankedTemplate], first: Sequence[float], reading: float) -> list[Ranking]:
        """Rank the takes by templates.

        Parameters
        ----------
        templates : sequence of RankedTemplate
            The templates.
        first : sequence of float
            The threshold of each template with which the ranking begins.
        reading : float
            The seconds that were spent on reading before, to be added to those of the ranking.
        """
        best = [Hits.none() for _ in templates]
        seconds = np.zeros(len(templates))
        # Once `top` hits are known, a hit above the last of them cannot enter. The others do not change, because
        # a hit excludes only overlapping hits of higher cost.
        thresholds = list(first)

        def work(item: tuple[tuple[int, ...], int, list[float]]) -> Found:
            return self._rank_batch(templates, *item)

        items = ((batch, mask, list(thresholds)) for mask, batch in self.batches)
        for found, spent, each in in_threads(work, items, self.workers):
            reading += spent
            seconds += each
            for place, hits in enumerate(found):
                best[place] = best[place].merged(hits, self.order, self.top)
                if len(best[place]) == self.top:
                    # hits of equal cost (the same key, or within the tolerance below a threshold) may still enter
                    thresholds[place] = min(thresholds[place], (round(float(best[place].costs[-1]) * KEYS) + 2) / KEYS)
        takes, frames = self.takes.select(["take_id", "name"]), sum(self.takes.column("frames").to_pylist())
        values = [column.to_pylist() for column in takes.columns]  # `Table.take` would load `pyarrow.compute`
        rankings = []
        for one, hits, own in zip(templates, best, seconds.tolist(), strict=True):
            count, indices = len(hits), hits.takes.tolist()
            chosen = [[own_values[index] for index in indices] for own_values in values]
            table = hits_table(
                ranking_schema(), pa.table(chosen, schema=takes.schema), hits.starts, hits.stops, self.store.rate_hz,
                template=pa.repeat(one.name, count), rank=np.arange(1, count + 1), cost=hits.costs,
                mirrored=pa.repeat(False, count),
            )  # fmt: skip
            searched, computed = hits.frames, int(hits.computed)
            rankings.append(Ranking(one.name, table, frames, searched, computed, hits.bounded, reading, own))
        return rankings

    def _rank_batch(
        self, templates: Sequence[RankedTemplate], take_ids: tuple[int, ...], mask: int, taus: Sequence[float]
    ) -> Found:
        """Rank takes with the same known features; a template that does not apply to them has no hits."""
        features = self.store.feature_set
        if mask & features.every_bit == features.every_bit:
            return self._rank_frames(templates, take_ids, taus)
        applied = {
            place: replace(one, template=own, queries=_queries_of(one, features, mask))
            for place, one in enumerate(templates)
            if (own := restricted_template(one.template, mask)) is not None
        }
        found, reading, spent = self._rank_frames(list(applied.values()), take_ids, [taus[place] for place in applied])
        hits, seconds = [Hits.none()] * len(templates), [0.0] * len(templates)
        for place, these, own_seconds in zip(applied, found, spent, strict=True):
            hits[place], seconds[place] = these, own_seconds
        return hits, reading, seconds

    def _rank_frames(
        self, templates: Sequence[RankedTemplate], take_ids: tuple[int, ...], taus: Sequence[float]
    ) -> Found:
        """Rank takes within the hits of the queries of each template, and in all frames without queries."""
        begin = time.perf_counter()
        if (few := self._rank_promising(templates, take_ids, taus)) is not None:
            return few
        words = stored_words(self.store, take_ids)
        coded, places = encode(words.words), np.searchsorted(self.ids, words.take_ids)
        queries = dict.fromkeys(query for one in templates for query in one.queries)
        hits, features = preselect_stored(self.store, words, list(queries)), self.store.feature_set
        ranges = {
            place: template_ranges(
                hits, one.queries, one.template.values(len(features.features)), features, words.offsets
            )
            for place, one in enumerate(templates)
            if one.queries
        }
        reading = time.perf_counter() - begin
        seconds = [0.0] * len(templates)
        begin, order = time.perf_counter(), self.order[places]
        free = [place for place, one in enumerate(templates) if not one.queries]
        found = rank_together(
            [templates[place].template for place in free], words, np.array([taus[place] for place in free]), self.top,
            coded, order,
        )  # fmt: skip
        ranked = dict(zip(free, found, strict=True))
        columns = sum(len(templates[place].template) for place in free)
        spent = time.perf_counter() - begin
        for place in free:
            seconds[place] = spent * len(templates[place].template) / columns
        for place, own in ranges.items():
            begin = time.perf_counter()
            ranked[place] = rank(templates[place].template, words, taus[place], self.top, own, coded, order=order)
            seconds[place] = time.perf_counter() - begin
        every = (ranked[place] for place in range(len(templates)))
        return [replace(one, takes=places[one.takes]) for one in every], reading, seconds

    def _rank_promising(
        self, templates: Sequence[RankedTemplate], take_ids: tuple[int, ...], taus: Sequence[float]
    ) -> Found | None:
        """Rank takes in the frames that the index does not exclude; None if it excludes too few or cannot be used."""
        begin = time.perf_counter()
        sliced = sound_index(self.store)
        frames = sum(self.store.take_frames[take_id] for take_id in take_ids)
        if sliced is None or not templates or any(one.queries for one in templates):
            return None
        ids = np.array(sorted(take_ids), np.int64)
        low = candidate_granules(sliced, ids, [one.template for one in templates], taus)
        if max(len(one.granules) for one in low) * GRANULE > MAX_PROMISING * frames:
            return None
        chosen = np.unique(np.concatenate([one.takes for one in low]))
        hits, seconds = [Hits.none(frames, bounded=True)] * len(templates), [0.0] * len(templates)
        if not len(chosen):
            return hits, time.perf_counter() - begin, seconds
        offsets = offsets_of(self.store, ids[chosen])
        ranges = [own.ranges(len(one.template), chosen, offsets) for one, own in zip(templates, low, strict=True)]
        every = extend_and_unite(np.concatenate(ranges), offsets)
        words = sliced.words(ids[chosen], every)
        coded, places = encode(words.words, every), np.searchsorted(self.ids, words.take_ids)
        order, reading = self.order[places], time.perf_counter() - begin
        for place, (one, own) in enumerate(zip(templates, ranges, strict=True)):
            begin = time.perf_counter()
            if len(own):
                found = rank(one.template, words, taus[place], self.top, own, coded, order=order)
                computed = found.computed if found.bounded else int((own[:, 1] - own[:, 0]).sum())
                hits[place] = replace(found, takes=places[found.takes], frames=frames, computed=computed, bounded=True)
            seconds[place] = time.perf_counter() - begin
        return hits, reading, seconds


def _queries_of(one: RankedTemplate, features: FeatureSet, mask: int) -> tuple[KeyframeQuery, ...]:
    """Return the queries of a template that apply to takes with a feature mask; without any, all frames are ranked."""
    columns = one.template.values(len(features.features))
    margins = [widest_margins(query, columns, features) for query in one.queries]
    return known_queries(one.queries, margins, features, mask)


def _batches(frames: Mapping[int, int], known: Mapping[int, int]) -> Iterator[tuple[int, tuple[int, ...]]]:
    """Yield batches of takes with the same known features, each with its mask; takes with all features come first.

    `frames` maps take_id to the length of the take.
    """
    masks = {take_id: known.get(take_id, int(ALL_KNOWN)) for take_id in frames}
    for mask in sorted(set(masks.values()), reverse=True):
        own = [take_id for take_id in frames if masks[take_id] == mask]
        yield from ((mask, batch) for batch in batches_of(own, [frames[take_id] for take_id in own], BATCH_FRAMES))


def partly_known(
    templates: Sequence[RankedTemplate], feature_set: FeatureSet, known: Mapping[int, int]
) -> list[Applicability]:
    """Return how templates and queries apply to takes that lack features; `known` has their masks by take_id."""
    queries = (query for one in templates for query in one.queries)
    return applicability(feature_set, known.values(), {one.name: one.template for one in templates}, queries)


def mirrored_template(one: RankedTemplate, feature_set: FeatureSet) -> RankedTemplate:
    """Return a template, with its queries, for the same motion on the other side of the body.

    Raises
    ------
    KinedexError
        The feature set defines no pairs of left and right.
    """
    if not feature_set.mirror:
        raise KinedexError(
            f"feature set '{feature_set.name}' does not define which features are left and right, so a template "
            "cannot be mirrored; add `mirror: [[1, 2], …]`, pairs of feature numbers, to its file"
        )
    order, weights = feature_set.mirror_order, one.template.feature_weights
    template = replace(
        one.template,
        mask=rearrange(one.template.mask, order),
        value=rearrange(one.template.value, order),
        feature_weights=None if weights is None else weights[order],
    )
    return RankedTemplate(one.name, template, tuple(mirrored(query, feature_set) for query in one.queries))


def rank_both_sides(
    store: Store,
    templates: Sequence[RankedTemplate],
    tau: float,
    top: int | None = None,
    where: str | None = None,
    workers: int | None = None,
) -> list[Ranking]:
    """Rank the takes of a store by templates and by their mirror images, with one list of hits for each template.

    If a hit of the template and a hit of its image overlap, the better hit is kept; if both are equal, that of the
    template. The best 3 hits are the first of the best 10, as in `rank_takes`.

    Parameters
    ----------
    store : Store
        The store to search.
    templates : sequence of RankedTemplate
        The templates, each with its keyframe queries.
    tau, top, where, workers : float, int, str, int
        As in `rank_takes`.

    Returns
    -------
    list of Ranking
        One for each template, in their order. Hits of an image are `mirrored`; frames searched and computed are the
        means of both.

    Raises
    ------
    KinedexError
        The feature set defines no pairs of left and right, or `rank_takes` raises an error.
    """
    found: dict[int, Ranking] = {}
    # a motion of both sides of the body is in both lists, and counts once
    asked = None if top is None else top + top // 2
    while len(found) < len(templates):
        left = [place for place in range(len(templates)) if place not in found]
        pairs = [
            one for place in left for one in (templates[place], mirrored_template(templates[place], store.feature_set))
        ]
        ranked = rank_takes(store, pairs, tau, asked, where, workers)
        for i, place in enumerate(left):
            merged, whole = _merged(ranked[2 * i], ranked[2 * i + 1], asked)
            if top is None or whole or len(merged) >= top:
                found[place] = replace(merged, hits=merged.hits.slice(0, top))
        asked = None if asked is None else 2 * asked
    return [found[place] for place in range(len(templates))]


def _merged(own: Ranking, image: Ranking, asked: int | None) -> tuple[Ranking, bool]:
    """Return the hits that are certain to be the best of both lists, and whether these are all hits."""
    table = pa.concat_tables([own.hits, image.hits])
    sides = np.repeat([False, True], [len(own), len(image)])
    columns = [table.column(name).to_pylist() for name in ("cost", "take", "stop", "start")]
    # by cost, take and stop, with the template's own hits before those of its image
    keys = [(round(cost * KEYS), take, stop, side) for cost, take, stop, side in zip(*columns[:3], sides, strict=True)]
    # A list that was limited to this number of hits may have more beyond its last one.
    ends = [keys[last] for one, last in ((own, len(own) - 1), (image, len(keys) - 1)) if len(one) == asked]
    kept: list[int] = []
    in_take: dict[str, list[tuple[int, int]]] = {}
    for place in sorted(range(len(keys)), key=keys.__getitem__):
        if ends and keys[place] > min(ends):
            break
        start, (_, take, stop, _) = columns[3][place], keys[place]
        others = in_take.setdefault(take, [])
        if not any(start < other_stop and other_start < stop for other_start, other_stop in others):
            others.append((start, stop))
            kept.append(place)
    table = table.set_column(table.num_columns - 1, "mirrored", pa.array(sides))
    ranking = replace(
        own,
        hits=as_ranked(table.take(np.array(kept, np.int64))),
        searched=(own.searched + image.searched) // 2,
        computed=(own.computed + image.computed) // 2,
        bounded=own.bounded or image.bounded,
        ranking=own.ranking + image.ranking,
    )
    return ranking, not ends
