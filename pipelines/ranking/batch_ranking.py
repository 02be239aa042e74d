"""Rank a batch of takes: in the frames that the index does not exclude, or in all frames."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.ops.distances.costs import I64, encode
from kinedex.ops.errors import StoreError
from kinedex.ops.ranges import TakeRanges, extend_and_unite
from kinedex.ops.ranking.ranking import Hits, rank, rank_together
from kinedex.ops.search.bit_slices import GRANULE
from kinedex.ops.templates.derived_templates import restricted_template
from kinedex.ops.words import TakeWords
from kinedex.pipelines.ranking.candidate_granules import candidate_granules
from kinedex.pipelines.ranking.ranked_hits import RankedTemplate
from kinedex.pipelines.search.bit_slices import SlicedWords, sliced_index, stored_words
from kinedex.pipelines.search.preselection import known_queries, preselect_stored, template_ranges, widest_margins
from kinedex.storage.store.store import Store

MOST_PROMISING = 0.4
"""The largest share of frames, after exclusion by the index, for which these are ranked alone; else all are ranked."""


@dataclass(frozen=True)
class BatchHits:
    """The hits of each template in a batch of takes.

    Attributes
    ----------
    ids : int64 array (T,)
        The ids of the takes.
    frames : int
        The number of frames of all of them.
    hits : tuple of Hits
        The hits of each template.
    reading : float
        Seconds for reading and coding words, and for looking up keyframes.
    ranking : tuple of float
        Seconds for ranking by each template.
    """

    ids: I64
    frames: int
    hits: tuple[Hits, ...]
    reading: float
    ranking: tuple[float, ...]


def rank_batch(
    store: Store,
    templates: Sequence[RankedTemplate],
    take_ids: tuple[int, ...],
    mask: int,
    taus: tuple[float, ...],
    top: int | None,
    names: Mapping[int, str],
) -> BatchHits:
    """Return the hits of each template in takes with the same known features; none for a template not applied."""
    if mask & store.feature_set.every_bit == store.feature_set.every_bit:
        return _rank_frames(store, templates, take_ids, taus, top, names)
    applied = {
        place: replace(one, template=own, queries=_known_queries(one, store.feature_set, mask))
        for place, one in enumerate(templates)
        if (own := restricted_template(one.template, mask)) is not None
    }
    chosen = tuple(taus[place] for place in applied)
    found = _rank_frames(store, list(applied.values()), take_ids, chosen, top, names)
    hits, seconds = [_no_hits()] * len(templates), [0.0] * len(templates)
    for place, these, spent in zip(applied, found.hits, found.ranking, strict=True):
        hits[place], seconds[place] = these, spent
    return replace(found, hits=tuple(hits), ranking=tuple(seconds))


def _known_queries(one: RankedTemplate, feature_set: FeatureSet, mask: int) -> tuple[KeyframeQuery, ...]:
    """Return the queries of a template that apply to takes with a feature mask; without any, all frames are ranked."""
    columns = one.template.values(len(feature_set.features))
    margins = [widest_margins(query, columns, feature_set) for query in one.queries]
    return known_queries(one.queries, margins, feature_set, mask)


def _no_hits() -> Hits:
    none = np.empty(0, np.int64)
    return Hits(none, none, none, np.empty(0), 0, 0, bounded=False)


def _rank_frames(
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


def _rank_promising(
    store: Store,
    templates: Sequence[RankedTemplate],
    take_ids: tuple[int, ...],
    taus: tuple[float, ...],
    top: int | None,
    names: Mapping[int, str],
) -> BatchHits | None:
    """Return the hits in the frames that the index does not exclude; None if it excludes too few."""
    begin = time.perf_counter()
    sliced = sound_index(store)
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
    offsets = offsets_of(store, ids[chosen])
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
    """Return the frames of concatenated words to which a template's queries restrict it, int64 (R, 2)."""
    columns = one.template.values(len(store.feature_set.features))
    return template_ranges(hits, one.queries, columns, store.feature_set, words.offsets)


def _name_order(take_ids: I64, names: Mapping[int, str]) -> I64:
    """Return the position of each take in the order of names, int64 (T,)."""
    by_name = {take_id: place for place, take_id in enumerate(sorted(take_ids.tolist(), key=lambda each: names[each]))}
    return np.array([by_name[take_id] for take_id in take_ids.tolist()], np.int64)


def offsets_of(store: Store, take_ids: I64) -> I64:
    """Return the first frame of each take in the concatenated takes, followed by their total length, int64 (T + 1,)."""
    return np.cumsum([0, *(store.take_frames[take_id] for take_id in take_ids.tolist())]).astype(np.int64)


def sound_index(store: Store) -> SlicedWords | None:
    """Return the memory-mapped index of a store; None if it has none, or a damaged one, as ranking works without it."""
    try:
        return sliced_index(store)
    except StoreError:
        return None
