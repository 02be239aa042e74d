"""Words that stay in memory as bit slices, for any number of queries: of an archive, or of a batch of takes.

Slices take 5 bytes a frame. They are made from words in some 20 ns a frame, faster than they could be handed from one
process to another, so that worker processes slice the takes of their own batch; threads share one copy, since the
kernels let go of Python's lock.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from catalog.features import FeatureSet
from catalog.queries import KeyframeQuery, WordPattern, word_pattern
from ops.search.bitslices import BitSlices, slice_runs, slice_words
from ops.search.keyframes import Segments
from ops.search.preselection import TakeRanges, ranges_of_takes, unite
from ops.search.slicesearch import search_slices
from ops.words import I64, U64, TakeWords
from storage.store import Store


@dataclass(frozen=True)
class ResidentWords:
    """The words of T takes, ready to be searched. take_ids: int64 (T,), ascending; take_ids[i] has index i."""

    take_ids: I64
    slices: BitSlices
    feature_set: FeatureSet

    def pattern(self, pattern: WordPattern) -> Segments:
        """The union of all hit relevant ranges of a chain of keyframes, on the axis of positions."""
        return search_slices(self.slices, pattern.masks, pattern.values, pattern.gaps)

    def search(self, query: KeyframeQuery) -> TakeRanges:
        """The union of all hit relevant ranges of a query and its alternatives, take by take."""
        found = [self.pattern(word_pattern(chain, self.feature_set)) for chain in query.chains]
        ranges = [ranges_of_takes(segments, len(self.take_ids)) for segments in found]
        return ranges[0] if len(ranges) == 1 else unite(ranges)


def resident_words(words: TakeWords, feature_set: FeatureSet) -> ResidentWords:
    """Slice words in memory."""
    return ResidentWords(
        words.take_ids, slice_words(words.words, words.offsets, len(feature_set.features)), feature_set
    )


def resident_store(store: Store) -> ResidentWords:
    """Read all lists from the index of a store, once, and keep them as slices.

    Raises
    ------
    StoreError: the index is missing or stale; the message says how to build it.
    """
    store.index_path()
    takes = store.takes().sort("take_id")
    take_ids = takes["take_id"].to_numpy().astype(np.int64)
    frames = takes["frames"].to_numpy().astype(np.int64)
    runs: list[list[I64]] = [[], [], []]
    words: list[U64] = []
    for name, word_set in store.feature_set.sets.items():
        table = store.sql("SELECT take_id, start, stop, word FROM word_runs WHERE feature_set = ?", [name])
        for column, parts in zip(("take_id", "start", "stop"), runs, strict=True):
            parts.append(table.column(column).to_numpy().astype(np.int64))
        words.append(table.column("word").to_numpy().astype(np.uint64) << np.uint64(word_set.first - 1))
    ids, starts, stops = (np.concatenate(parts) for parts in runs)
    features = len(store.feature_set.features)
    slices = slice_runs(np.searchsorted(take_ids, ids), starts, stops, np.concatenate(words), frames, features)
    return ResidentWords(take_ids, slices, store.feature_set)
