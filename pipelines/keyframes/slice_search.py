"""Search keyframe queries in bit slices of the takes of a store, or of words in memory.

The slices of an index are files that every process maps read-only, so that they are in memory only once for all
processes and threads. Slicing words in memory takes about 20 ns per frame.
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
from kinedex.catalog.queries.keyframe_query import KeyframeQuery, WordPattern, restricted_query, word_pattern
from kinedex.ops.errors import StoreError
from kinedex.ops.ranges import TakeRanges, from_axis
from kinedex.ops.search.bit_slice_search import search_slices
from kinedex.ops.search.bit_slices import BitSlices, slice_words, unsliced_words
from kinedex.ops.words import ALL_KNOWN, I64, U64, TakeWords
from kinedex.storage.index.generations import current_generation, missing_index, read_generation
from kinedex.storage.index.slice_files import ShardSlices, open_slices
from kinedex.storage.store.store import Store

PIECE_BLOCKS = 32_768
"""The number of blocks of 64 frames (19 hours in all) that a thread searches at a time, in less than 1 ms per query."""

WORTH_BLOCKS = 131_072
"""The number of blocks times the number of keyframe chains above which threads save more time than they cost."""

_JOINED_BLOCKS = 256
"""The largest number of blocks of unrequested takes between requested ones that are searched and then discarded."""


@dataclass(frozen=True)
class Shard:
    """The bit slices of some takes.

    Parameters
    ----------
    slices : BitSlices
        The slices of S takes.
    positions : int64 array (S,)
        The index of each take among those that are searched; -1 for a take that is not searched.
    """

    slices: BitSlices
    positions: I64


@dataclass(frozen=True)
class SlicedWords:
    """The words of T takes as bit slices, ready for searching.

    Parameters
    ----------
    take_ids : int64 array (T,)
        The takes, ascending; take_ids[i] has index i.
    shards : tuple of Shard
        The slices of the shards of a published index, or of one shard in memory.
    feature_set : FeatureSet
        The features of the words.
    known : uint64 array (T,), optional
        The mask of the known features of each take; None if all features are known in all takes.
    """

    take_ids: I64
    shards: tuple[Shard, ...]
    feature_set: FeatureSet
    known: U64 | None = None

    def select(self, take_ids: I64) -> SlicedWords:
        """Return the slices of some takes, without copying; the slices of the others are not read.

        Parameters
        ----------
        take_ids : int64 array
            The takes, ascending.

        Raises
        ------
        KeyError
            If a take is missing.
        """
        places = np.full(len(self.take_ids) + 1, -1)  # the last entry is for takes that are not found
        at = np.searchsorted(self.take_ids, take_ids)
        known = at < len(self.take_ids)
        known[known] = self.take_ids[at[known]] == take_ids[known]
        if not known.all():
            raise KeyError(int(take_ids[~known][0]))
        places[at] = np.arange(len(take_ids))
        shards = tuple(replace(shard, positions=places[shard.positions]) for shard in self.shards)
        masks = None if self.known is None else self.known[at]
        if masks is not None and (masks == ALL_KNOWN).all():
            masks = None
        return SlicedWords(take_ids, shards, self.feature_set, masks)

    def words(self, take_ids: I64, ranges: I64 | None = None) -> TakeWords:
        """Return the words of takes, concatenated.

        Parameters
        ----------
        take_ids : int64 array
            The takes, ascending.
        ranges : int64 array (R, 2), optional
            Half-open ranges of the concatenated words, ascending and disjoint; all other words are undefined. None for
            all words.

        Raises
        ------
        KeyError
            If a take is missing.
        """
        chosen = self.select(take_ids)
        held = [(shard, np.flatnonzero(shard.positions >= 0)) for shard in chosen.shards]
        frames = np.zeros(len(take_ids), np.int64)
        for shard, own in held:
            frames[shard.positions[own]] = shard.slices.frames[own]
        offsets = np.concatenate(([0], np.cumsum(frames)))
        words = np.empty(int(offsets[-1]), np.uint64)
        for shard, own in held:
            unsliced_words(shard.slices, own, offsets[shard.positions[own]], words, ranges)
        return TakeWords(take_ids, offsets, words, chosen.known)

    def search(self, queries: Sequence[KeyframeQuery], threads: int = 1) -> list[TakeRanges]:
        """Return the union of all hit ranges of each query and its alternatives, take by take.

        Takes that lack features are searched by their known features (`restricted_query`), and have no range for a
        query that does not apply to them.

        Parameters
        ----------
        queries : sequence of KeyframeQuery
            Queries over the feature set of the words.
        threads : int
            The number of threads that may be used; the ranges do not depend on it.

        Returns
        -------
        list of TakeRanges
            The ranges of each query, in T takes.
        """
        if self.known is not None:
            return self._search_by_mask(self.known, queries, threads)
        patterns = [[word_pattern(chain, self.feature_set) for chain in query.chains] for query in queries]
        flat = [pattern for chains in patterns for pattern in chains]
        tasks = [(piece, pattern) for pattern in flat for piece in self.pieces]
        found = iter(self._search_tasks(tasks, threads))
        ranges = [[self._ranges([next(found) for _ in self.pieces]) for _ in chains] for chains in patterns]
        return [TakeRanges.united(one) for one in ranges]

    def _search_by_mask(self, known: U64, queries: Sequence[KeyframeQuery], threads: int) -> list[TakeRanges]:
        """Search the takes of each feature mask separately."""
        parts: list[list[tuple[I64, TakeRanges]]] = [[] for _ in queries]
        for mask in np.unique(known).tolist():
            places = np.flatnonzero(known == np.uint64(mask))
            asked = [restricted_query(query, self.feature_set, mask) for query in queries]
            own = replace(self, known=None).select(self.take_ids[places])
            found = iter(own.search([query for query in asked if query is not None], threads))
            for query, part in zip(asked, parts, strict=True):
                if query is not None:
                    part.append((places, next(found)))
        return [TakeRanges.placed(part, len(self.take_ids)) for part in parts]

    @cached_property
    def pieces(self) -> list[tuple[int, int, int]]:
        """The units of search: the number of a shard and a range of its takes, limited in size."""
        return [
            (number, begin, end)
            for number, shard in enumerate(self.shards)
            for begin, end in _take_ranges(shard.slices.first, shard.positions)
        ]

    @cached_property
    def blocks(self) -> int:
        """The number of blocks of all pieces."""
        return sum(int(self.shards[number].slices.first[[begin, end]] @ [-1, 1]) for number, begin, end in self.pieces)

    def _search_tasks(self, tasks: Sequence[tuple[tuple[int, int, int], WordPattern]], threads: int) -> Iterable[I64]:
        if threads == 1 or len(tasks) < 2 or self.blocks * (len(tasks) // len(self.pieces)) < WORTH_BLOCKS:
            return map(self._search_piece, tasks)
        many = -(-len(tasks) // (4 * threads))
        batches = [tasks[start : start + many] for start in range(0, len(tasks), many)]
        with ThreadPoolExecutor(threads) as pool:
            found = pool.map(lambda batch: list(map(self._search_piece, batch)), batches)
            return [one for batch in found for one in batch]

    def _search_piece(self, task: tuple[tuple[int, int, int], WordPattern]) -> I64:
        (number, begin, end), pattern = task
        slices = self.shards[number].slices
        return search_slices(slices, pattern.masks, pattern.values, pattern.gaps, takes=(begin, end))

    def _ranges(self, found: Sequence[I64]) -> TakeRanges:
        """Return the ranges of a chain of keyframes from the segments found in each piece."""
        place, ranges = [np.empty(0, np.int64)], [np.empty((0, 2), np.int64)]
        for (number, _, _), segments in zip(self.pieces, found, strict=True):
            if len(segments):
                take, frames = from_axis(segments)
                place.append(self.shards[number].positions[take])
                ranges.append(frames)
        places, united = np.concatenate(place), np.concatenate(ranges)
        wanted = places >= 0
        if not wanted.all():
            places, united = places[wanted], united[wanted]
        if (places[1:] < places[:-1]).any():
            # the takes of several shards interleave; each take is in one shard
            order = np.argsort(places, kind="stable")
            places, united = places[order], united[order]
        return TakeRanges(np.searchsorted(places, np.arange(len(self.take_ids) + 1)).astype(np.int64), united)


def _take_ranges(first: I64, places: I64) -> Iterable[tuple[int, int]]:
    """Yield ranges of takes of a shard that cover all requested takes, with few blocks of others between them."""
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


def sliced_words(words: TakeWords, feature_set: FeatureSet) -> SlicedWords:
    """Return words in memory as bit slices."""
    slices = slice_words(words.words, words.offsets, len(feature_set.features))
    return SlicedWords(words.take_ids, (Shard(slices, np.arange(len(words))),), feature_set, words.known)


def sliced_store(store: Store) -> SlicedWords:
    """Map the bit slices in the index of a store, after verifying their checksums.

    Raises
    ------
    StoreError
        If the index is missing, stale or damaged; the message gives the command that builds it.
    """
    sliced = sliced_index(store)
    if sliced is None:
        raise missing_index(store.path, store.manifest)
    return sliced


def stored_words(store: Store, take_ids: Sequence[int]) -> TakeWords:
    """Return the words of takes like `Store.words`, from the index of the store if it is valid.

    The slices of an index are memory-mapped and hold a word in five bytes. Reading words from slices is therefore a few
    milliseconds per hour of motion faster than reading and decoding Parquet files.

    Parameters
    ----------
    store : Store
        The store.
    take_ids : sequence of int
        The takes to read.

    Raises
    ------
    StoreError
        No live take has one of the ids, or a part cannot be read.
    """
    sliced = sound_index(store)
    asked = np.unique(np.array(list(take_ids), np.int64))
    if sliced is None or not np.isin(asked, sliced.take_ids, assume_unique=True).all():
        return store.words(take_ids)
    return sliced.words(asked)


_mapped: WeakKeyDictionary[Store, SlicedWords] = WeakKeyDictionary()
"""The mapped slices of open stores; an open store always shows the same version."""


def sliced_index(store: Store) -> SlicedWords | None:
    """Map the bit slices in the index of a store; return None if the index is missing or stale."""
    if store not in _mapped:
        while (generation := current_generation(store.path, store.manifest)) is not None:
            described = read_generation(generation)
            # a newer generation may replace it, or a user may delete the index, in the meantime: look again
            with suppress(FileNotFoundError):
                if described is not None:
                    _mapped[store] = _live_takes(store, open_slices(store.checked, generation, described))
                    break
    return _mapped.get(store)


def sound_index(store: Store) -> SlicedWords | None:
    """Map the bit slices of a store like `sliced_index`; return None also if they are damaged."""
    try:
        return sliced_index(store)
    except StoreError:
        return None


def _live_takes(store: Store, found: Sequence[ShardSlices]) -> SlicedWords:
    """Return the slices of an index without the takes that have been dropped or replaced."""
    take_ids = np.sort(np.concatenate([np.empty(0, np.int64), *(shard.take_ids[shard.live] for shard in found)]))
    shards = tuple(
        Shard(shard.slices, np.where(shard.live, np.searchsorted(take_ids, shard.take_ids), -1)) for shard in found
    )
    known = None
    if store.known:
        known = np.array([store.known.get(take_id, ALL_KNOWN) for take_id in take_ids.tolist()], np.uint64)
    return SlicedWords(take_ids, shards, store.feature_set, known)
