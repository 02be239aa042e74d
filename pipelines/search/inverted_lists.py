"""Inverted lists, by which a search explains itself: of an index, just the words asked for; or of words in memory."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.queries import Keyframe, KeyframeQuery
from kinedex.ops.ranges import TakeRanges
from kinedex.ops.search.keyframes import search, survivors
from kinedex.ops.search.postings import Postings, make_postings
from kinedex.ops.search.preselection import ranges_of_takes
from kinedex.ops.search.runs import word_runs
from kinedex.ops.search.segments import Segments, to_axis
from kinedex.ops.words import I64, TakeWords, cut
from kinedex.storage.store.store import Store


class RunLists:
    """Inverted lists; every keyframe's own is made once.

    takes: number of takes T, whose indices the positions hold. postings: feature set → its lists, at least those of the
    words that the queries ask for.
    """

    def __init__(self, takes: int, postings: Mapping[str, Postings]) -> None:
        self.takes = takes
        self.postings = dict(postings)
        self._lists: dict[Keyframe, Segments] = {}

    def keyframe(self, keyframe: Keyframe) -> Segments:
        """The inverted list of one keyframe."""
        if keyframe not in self._lists:
            self._lists[keyframe] = self.postings[keyframe.set].keyframe(keyframe.mask, keyframe.value)
        return self._lists[keyframe]

    def chain(self, chain: KeyframeQuery) -> Segments:
        """The union of all hit relevant ranges of one chain of keyframes."""
        return search([self.keyframe(keyframe) for keyframe in chain.keyframes], chain.bounds)

    def survivors(self, chain: KeyframeQuery) -> list[Segments]:
        """Of the list of each keyframe of a chain, the frames from which the rest of it can be completed."""
        return survivors([self.keyframe(keyframe) for keyframe in chain.keyframes], chain.bounds)

    def search(self, query: KeyframeQuery) -> TakeRanges:
        """The union of all hit relevant ranges of a query and its alternatives, take by take."""
        return TakeRanges.united([ranges_of_takes(self.chain(chain), self.takes) for chain in query.chains])


def lists_of_words(words: TakeWords, feature_set: FeatureSet, sets: Iterable[str]) -> RunLists:
    """The inverted lists of words in memory; take i of the words has index i."""
    postings = {}
    for name in sets:
        word_set = feature_set.word_set(name)
        found = word_runs(cut(words.words, word_set.first, word_set.count), words.offsets)
        starts, stops = to_axis(found.take, found.start), to_axis(found.take, found.stop)
        postings[name] = make_postings(found.word, starts, stops)
    return RunLists(len(words), postings)


def lists_of_store(store: Store, queries: Sequence[KeyframeQuery], take_ids: I64) -> RunLists:
    """Read from the index of a store the lists of the words that queries ask for, in these takes only.

    Parameters
    ----------
    take_ids: int64 (T,), ascending; take_ids[i] has index i.

    Raises
    ------
    StoreError: the index is missing or stale; the message says how to build it.
    """
    store.index_path()
    wanted: dict[str, dict[Keyframe, None]] = {}
    for query in queries:
        for keyframe in (keyframe for chain in query.chains for keyframe in chain.keyframes):
            store.feature_set.word_set(keyframe.set)
            wanted.setdefault(keyframe.set, {})[keyframe] = None
    return RunLists(len(take_ids), {name: _read(store, name, list(of), take_ids) for name, of in wanted.items()})


def _read(store: Store, feature_set: str, keyframes: Sequence[Keyframe], take_ids: I64) -> Postings:
    poses = " OR ".join(f"(word & {k.mask}::UBIGINT) = {k.value}::UBIGINT" for k in keyframes)
    table = store.sql(
        f"""SELECT word, take_id, start, stop FROM word_runs WHERE feature_set = ?
            AND word IN (SELECT word FROM vocabulary WHERE feature_set = ? AND ({poses}))""",
        [feature_set, feature_set],
    )
    ids = table.column("take_id").to_numpy()
    index = np.searchsorted(take_ids, ids)
    known = index < len(take_ids)
    known[known] = take_ids[index[known]] == ids[known]
    return make_postings(
        table.column("word").to_numpy().astype(np.uint64)[known],
        to_axis(index[known], table.column("start").to_numpy()[known]),
        to_axis(index[known], table.column("stop").to_numpy()[known]),
    )
