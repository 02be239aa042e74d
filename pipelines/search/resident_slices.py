"""Words that stay in memory as bit slices, for any number of queries: those of a published index, or of a batch.

The slices of an index are files that every process maps read-only: however many processes and threads search, memory
holds them once, and of them what has been looked at. Slices of words at hand are made in some 20 ns a frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.queries import KeyframeQuery, WordPattern, word_pattern
from kinedex.ops.ranges import TakeRanges
from kinedex.ops.search.bit_slice_search import search_slices
from kinedex.ops.search.bit_slices import BitSlices, slice_words
from kinedex.ops.search.preselection import ranges_of_takes
from kinedex.ops.search.segments import Segments, from_axis
from kinedex.ops.words import I64, TakeWords
from kinedex.storage.index.generations import current_generation, missing_index, read_generation
from kinedex.storage.index.slice_files import ShardSlices, open_slices
from kinedex.storage.store.store import Store

PIECE_BLOCKS = 32_768
"""Blocks of 64 frames (19 hours in all) that one thread searches at a time: a fraction of a millisecond a query."""

WORTH_BLOCKS = 131_072
"""Blocks, counted once for every chain of keyframes, from which on threads gain more than it takes to start them."""

_JOINED_BLOCKS = 256
"""Takes that nobody asks for are searched and left out where they lie between others and have fewer blocks."""


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
        return TakeRanges.united([ranges_of_takes(segments, len(self.take_ids)) for segments in found])


@dataclass(frozen=True)
class Shard:
    """A shard of a published index. places: int64, the index of each of its takes among those that are searched; −1
    for a take that is not."""

    slices: BitSlices
    places: I64


@dataclass(frozen=True)
class SharedWords:
    """The words of T takes of a published index, in memory that all processes share.

    take_ids: int64 (T,), ascending; take_ids[i] has index i.
    """

    take_ids: I64
    shards: tuple[Shard, ...]
    feature_set: FeatureSet

    def of(self, take_ids: I64) -> SharedWords:
        """Only these takes, int64, ascending: the others' slices are not looked at.

        Raises
        ------
        KeyError: a take that is not there.
        """
        places = np.full(len(self.take_ids) + 1, -1)  # the last for places that are none
        at = np.searchsorted(self.take_ids, take_ids)
        known = at < len(self.take_ids)
        known[known] = self.take_ids[at[known]] == take_ids[known]
        if not known.all():
            raise KeyError(int(take_ids[~known][0]))
        places[at] = np.arange(len(take_ids))
        return SharedWords(
            take_ids, tuple(replace(shard, places=places[shard.places]) for shard in self.shards), self.feature_set
        )

    def search(self, queries: Sequence[KeyframeQuery], threads: int = 1) -> list[TakeRanges]:
        """For each query the union of all hit relevant ranges of it and its alternatives, take by take.

        Parameters
        ----------
        threads: how many may be used; what is found does not depend on it.
        """
        patterns = [[word_pattern(chain, self.feature_set) for chain in query.chains] for query in queries]
        flat = [pattern for chains in patterns for pattern in chains]
        tasks = [(piece, pattern) for pattern in flat for piece in self.pieces]
        found = iter(self._all(tasks, threads))
        ranges = [[self._ranges([next(found) for _ in self.pieces]) for _ in chains] for chains in patterns]
        return [TakeRanges.united(one) for one in ranges]

    @cached_property
    def pieces(self) -> list[tuple[int, int, int]]:
        """What is searched at once: the number of a shard and a range of its takes, none with too many blocks."""
        return [
            (number, begin, end)
            for number, shard in enumerate(self.shards)
            for begin, end in _stretches(shard.slices.first, shard.places)
        ]

    @cached_property
    def blocks(self) -> int:
        """The blocks of all pieces."""
        return sum(int(self.shards[number].slices.first[[begin, end]] @ [-1, 1]) for number, begin, end in self.pieces)

    def _all(self, tasks: Sequence[tuple[tuple[int, int, int], WordPattern]], threads: int) -> Iterable[Segments]:
        if threads == 1 or len(tasks) < 2 or self.blocks * (len(tasks) // len(self.pieces)) < WORTH_BLOCKS:
            return map(self._piece, tasks)
        many = -(-len(tasks) // (4 * threads))
        with ThreadPoolExecutor(threads) as pool:
            batches = [tasks[start : start + many] for start in range(0, len(tasks), many)]
            return [one for batch in pool.map(lambda batch: list(map(self._piece, batch)), batches) for one in batch]

    def _piece(self, task: tuple[tuple[int, int, int], WordPattern]) -> Segments:
        (number, begin, end), pattern = task
        return search_slices(
            self.shards[number].slices, pattern.masks, pattern.values, pattern.gaps, takes=(begin, end)
        )

    def _ranges(self, found: Sequence[Segments]) -> TakeRanges:
        """The ranges of a chain of keyframes from what was found in each piece."""
        columns: list[tuple[I64, I64, I64]] = []
        for (number, _, _), segments in zip(self.pieces, found, strict=True):
            if len(segments):
                take, starts, stops = from_axis(segments)
                columns.append((self.shards[number].places[take], starts, stops))
        nothing = (np.empty(0, np.int64),) * 3
        place, starts, stops = (np.concatenate(column) for column in zip(nothing, *columns, strict=True))
        kept = place >= 0
        if not kept.all():
            place, starts, stops = place[kept], starts[kept], stops[kept]
        if (place[1:] < place[:-1]).any():
            # the takes of several shards interleave; no take is in two
            order = np.argsort(place, kind="stable")
            place, starts, stops = place[order], starts[order], stops[order]
        offsets = np.searchsorted(place, np.arange(len(self.take_ids) + 1)).astype(np.int64)
        return TakeRanges(offsets, np.stack([starts, stops], axis=1))


def _stretches(first: I64, places: I64) -> Iterable[tuple[int, int]]:
    """Ranges of takes that hold all takes with a place."""
    wanted = np.flatnonzero(places >= 0)
    if not len(wanted):
        return
    gaps = first[wanted[1:]] - first[wanted[:-1] + 1]
    breaks = np.flatnonzero(gaps >= _JOINED_BLOCKS)
    begins = wanted[np.concatenate([[0], breaks + 1])].tolist()
    ends = (wanted[np.concatenate([breaks, [len(wanted) - 1]])] + 1).tolist()
    for begin, end in zip(begins, ends, strict=True):
        while first[end] - first[begin] > PIECE_BLOCKS:
            middle = max(begin + 1, int(np.searchsorted(first, first[begin] + PIECE_BLOCKS, side="right")) - 1)
            yield begin, middle
            begin = middle
        if begin < end:
            yield begin, end


def resident_words(words: TakeWords, feature_set: FeatureSet) -> ResidentWords:
    """Slice words in memory."""
    return ResidentWords(
        words.take_ids, slice_words(words.words, words.offsets, len(feature_set.features)), feature_set
    )


def resident_store(store: Store) -> SharedWords:
    """Map the words of the index of a store: nothing of them is read before it is searched.

    Raises
    ------
    StoreError: the index is missing, stale or damaged; the message says how to build it.
    """
    shared = indexed_words(store)
    if shared is None:
        raise missing_index(store.path, store.manifest)
    return shared


_opened: WeakKeyDictionary[Store, SharedWords] = WeakKeyDictionary()
"""What an open store has mapped before: it keeps showing one version."""


def indexed_words(store: Store) -> SharedWords | None:
    """The same; None where the index is missing or stale."""
    if store not in _opened:
        while (generation := current_generation(store.path, store.manifest)) is not None:
            says = read_generation(generation)
            # a build puts a newer generation in its place, or somebody removes the index: look again
            with suppress(FileNotFoundError):
                if says is not None:
                    _opened[store] = _shared(store, open_slices(generation, says))
                    break
    return _opened.get(store)


def _shared(store: Store, found: Sequence[ShardSlices]) -> SharedWords:
    take_ids = np.sort(np.concatenate([np.empty(0, np.int64), *(shard.take_ids[shard.live] for shard in found)]))
    shards = tuple(
        Shard(shard.slices, np.where(shard.live, np.searchsorted(take_ids, shard.take_ids), -1)) for shard in found
    )
    return SharedWords(take_ids, shards, store.feature_set)
