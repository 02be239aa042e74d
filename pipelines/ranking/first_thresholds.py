"""Estimate from the index a threshold below which a template is likely to have enough hits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinedex.ops.distances.costs import I64, encode
from kinedex.ops.ranking.hit_selection import KEYS
from kinedex.ops.ranking.ranking import rank
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.pipelines.ranking.batch_ranking import offsets_of, sound_index
from kinedex.pipelines.ranking.batch_threads import in_threads
from kinedex.pipelines.ranking.candidate_granules import CandidateGranules, candidate_granules, joined_batches
from kinedex.pipelines.ranking.ranked_hits import RankedTemplate
from kinedex.pipelines.search.bit_slices import SlicedWords
from kinedex.storage.store.store import Store

WORTH_FRAMES = 500_000
"""The number of frames from which on it pays to search the index for a low threshold first."""

SAMPLED = 6
"""The number of granules that are searched for each requested hit, as several of them belong to one hit."""


def first_thresholds(
    store: Store,
    batches: Sequence[tuple[int, tuple[int, ...]]],
    templates: Sequence[RankedTemplate],
    tau: float,
    top: int | None,
    workers: int,
) -> list[float]:
    """Return for each template a threshold below which enough hits are likely.

    It is the cost of the last of the best hits in the granules of the index with the lowest bounds, or `tau` if
    computing it does not pay. Hits below a lower threshold are the first of the hits below tau: they come in the order
    of their costs, and only a better hit excludes another. If they are enough, they are the result.

    Parameters
    ----------
    store : Store
        The store of the takes.
    batches : sequence of (int, tuple of int)
        Masks of known features, and ids of takes.
    templates : sequence of RankedTemplate
        The templates.
    tau : float
        The greatest threshold.
    top : int or None
        The largest number of hits of a template.
    workers : int
        The number of threads.
    """
    frames = sum(store.take_frames[take_id] for _, batch in batches for take_id in batch)
    sliced = sound_index(store)
    asked = any(one.queries for one in templates)
    if top is None or sliced is None or asked or frames < WORTH_FRAMES:
        return [tau] * len(templates)
    every, sampled = store.feature_set.every_bit, SAMPLED * top
    ids = [np.array(batch, np.int64) for mask, batch in batches if mask & every == every]
    plain = [one.template for one in templates]

    def lowest(batch: I64) -> list[CandidateGranules]:
        found = candidate_granules(sliced, batch, plain, [tau] * len(plain))
        return [one.lowest(sampled) for one in found]

    parts = list(in_threads(lowest, ids, workers))
    bars = []
    for place, template in enumerate(plain):
        own = joined_batches([one[place] for one in parts], ids).lowest(sampled)
        bars.append(_threshold_of(store, sliced, template, own, tau, top))
    return bars


def _threshold_of(
    store: Store, sliced: SlicedWords, template: QuantisedTemplate, sample: CandidateGranules, tau: float, top: int
) -> float:
    """Return the cost of the last of the best hits in some granules, whose `takes` are ids; tau if they are too few."""
    ids = np.unique(sample.takes)
    if not len(ids):
        return tau
    offsets = offsets_of(store, ids)
    ranges = sample.ranges(len(template), ids, offsets)
    words = sliced.words(ids, ranges)
    hits = rank(template, words, tau, top, ranges, encode(words.words, ranges))
    return min(tau, (round(float(hits.costs[-1]) * KEYS) + 2) / KEYS) if len(hits) == top else tau
