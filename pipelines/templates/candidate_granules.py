"""Find the frames that may contain hits, by the coarse copy of the index, so that most takes need not be read.

A granule is a block of `GRANULE` consecutive frames of a take.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.ops.distances.costs import encode
from kinedex.ops.distances.pruning import granule_bounds, granule_words
from kinedex.ops.ranges import extend_and_unite
from kinedex.ops.ranking.best_hits import rank
from kinedex.ops.ranking.hit_selection import KEYS
from kinedex.ops.search.bit_slices import GRANULE, GRANULES
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import I64
from kinedex.pipelines.engine.executors import in_threads
from kinedex.pipelines.keyframes.slice_search import SlicedWords, sound_index
from kinedex.pipelines.templates.ranked_hits import RankedTemplate
from kinedex.storage.store.store import Store

WORTH_FRAMES = 500_000
"""The number of frames above which a search of the index for a low threshold saves time."""

SAMPLED = 6
"""The number of granules that are searched for each requested hit, as several of them belong to one hit."""


@dataclass(frozen=True)
class CandidateGranules:
    """The granules (blocks of frames) of takes in which warping paths with costs below a threshold may end.

    Parameters
    ----------
    takes : int64 array (G,)
        The index of the take of each granule, ascending.
    granules : int64 array (G,)
        The number of each granule in its take, ascending within a take.
    bounds : float32 array (G,)
        A lower bound of the costs of paths that end in the granule.
    """

    takes: I64
    granules: I64
    bounds: npt.NDArray[np.float32]

    def lowest(self, count: int) -> CandidateGranules:
        """Return the `count` granules with the lowest bounds, and all others with the same bound as the last."""
        if len(self.bounds) <= count:
            return self
        kept = self.bounds <= np.partition(self.bounds, count - 1)[count - 1]
        return CandidateGranules(self.takes[kept], self.granules[kept], self.bounds[kept])

    def ranges(self, columns: int, takes: I64, offsets: I64) -> I64:
        """Return the frames that determine the hits in these granules: all frames of paths, and one more on each side.

        Parameters
        ----------
        columns : int
            The number of columns N of the template; a path begins at most 2 (N − 1) frames before its end.
        takes : int64 array (T,)
            The indices of takes, ascending, including those of all granules.
        offsets : int64 array (T + 1,)
            The first frame of each of these takes in their concatenated words, followed by the total length.
        """
        place = np.searchsorted(takes, self.takes)
        starts = offsets[place] + GRANULE * self.granules
        stops = np.minimum(starts + GRANULE, offsets[place + 1])
        kept = starts < stops
        return extend_and_unite(np.stack([starts[kept], stops[kept]], axis=1), offsets, 2 * (columns - 1) + 1, 1)


def candidate_granules(
    sliced: SlicedWords, take_ids: I64, templates: Sequence[QuantisedTemplate], thresholds: Sequence[float]
) -> list[CandidateGranules]:
    """Return the granules in which templates may have hits below thresholds, for takes with all features known.

    Parameters
    ----------
    sliced : SlicedWords
        The index of a store.
    take_ids : int64 array (T,)
        The takes, ascending.
    templates : sequence of QuantisedTemplate
        The templates.
    thresholds : sequence of float
        The threshold of each template.

    Returns
    -------
    list of CandidateGranules
        One for each template, with indices into the takes.
    """
    chosen = sliced.select(take_ids)
    found: list[list[tuple[I64, I64, npt.NDArray[np.float32]]]] = [[] for _ in templates]
    for shard in chosen.shards:
        for first, stop in _runs(np.flatnonzero(shard.positions >= 0)):
            words = granule_words(shard.slices, first, stop)
            edges = GRANULES * (shard.slices.first[first : stop + 1] - shard.slices.first[first])
            places = shard.positions[first:stop]
            for own, template, threshold in zip(found, templates, thresholds, strict=True):
                bounds = granule_bounds(template, words, edges)
                low = np.flatnonzero(bounds < threshold)
                take = np.searchsorted(edges, low, side="right") - 1
                own.append((places[take], low - edges[take], bounds[low]))
    return [_joined(own) for own in found]


def _runs(takes: I64) -> Iterator[tuple[int, int]]:
    """Yield the half-open ranges of consecutive integers in an ascending array."""
    if len(takes):
        breaks = np.flatnonzero(np.diff(takes) > 1)
        begins = takes[np.concatenate(([0], breaks + 1))].tolist()
        ends = (takes[np.concatenate((breaks, [len(takes) - 1]))] + 1).tolist()
        yield from zip(begins, ends, strict=True)


def _joined(parts: Sequence[tuple[I64, I64, npt.NDArray[np.float32]]]) -> CandidateGranules:
    """Join the granules of several shards, in the order of the takes."""
    takes = np.concatenate([np.empty(0, np.int64), *(one for one, _, _ in parts)])
    granules = np.concatenate([np.empty(0, np.int64), *(one for _, one, _ in parts)])
    bounds = np.concatenate([np.empty(0, np.float32), *(one for _, _, one in parts)])
    order = np.argsort(takes, kind="stable")
    return CandidateGranules(takes[order], granules[order], bounds[order])


def joined_batches(parts: Sequence[CandidateGranules], ids: Sequence[I64]) -> CandidateGranules:
    """Join the granules of several batches of takes, with take ids in place of indices.

    Parameters
    ----------
    parts : sequence of CandidateGranules
        One for each batch.
    ids : sequence of int64 array
        The ids of the takes of each batch.
    """
    return _joined([(own[one.takes], one.granules, one.bounds) for one, own in zip(parts, ids, strict=True)])


def first_thresholds(
    store: Store,
    batches: Sequence[tuple[int, tuple[int, ...]]],
    templates: Sequence[RankedTemplate],
    tau: float,
    top: int | None,
    workers: int,
) -> list[float]:
    """Return for each template a threshold below which enough hits are likely.

    The threshold is the cost of the last of the best hits in the granules with the lowest bounds, or `tau` if computing
    this does not pay. The hits below a lower threshold are the first of the hits below `tau`, because hits are ordered
    by cost and only a better hit excludes another. If there are enough such hits, they are the result.

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
    thresholds = []
    for place, template in enumerate(plain):
        own = joined_batches([one[place] for one in parts], ids).lowest(sampled)
        thresholds.append(_threshold_of(store, sliced, template, own, tau, top))
    return thresholds


def _threshold_of(
    store: Store, sliced: SlicedWords, template: QuantisedTemplate, sample: CandidateGranules, tau: float, top: int
) -> float:
    """Return a threshold just above the cost of the `top`-th best hit in some granules; tau if they hold fewer."""
    ids = np.unique(sample.takes)
    if not len(ids):
        return tau
    offsets = offsets_of(store, ids)
    ranges = sample.ranges(len(template), ids, offsets)
    words = sliced.words(ids, ranges)
    hits = rank(template, words, tau, top, ranges, encode(words.words, ranges))
    return min(tau, (round(float(hits.costs[-1]) * KEYS) + 2) / KEYS) if len(hits) == top else tau


def offsets_of(store: Store, take_ids: I64) -> I64:
    """Return the first frame of each take in the concatenated takes, followed by their total length, int64 (T + 1,)."""
    return np.cumsum([0, *(store.take_frames[take_id] for take_id in take_ids.tolist())]).astype(np.int64)
