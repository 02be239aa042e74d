"""Read inverted lists from the index of a store, only for the words that queries match."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinedex.catalog.queries.keyframe_query import Keyframe, KeyframeQuery
from kinedex.ops.search.inverted_lists import InvertedLists
from kinedex.ops.words import I64
from kinedex.storage.store.store import Store


def read_lists(store: Store, queries: Sequence[KeyframeQuery], take_ids: I64) -> dict[str, InvertedLists]:
    """Read the inverted lists of all words that the keyframes of queries match.

    Parameters
    ----------
    store : Store
        A store whose index is built.
    queries : sequence of KeyframeQuery
        Queries over feature sets of the store.
    take_ids : int64 array (T,)
        The takes to read, ascending; take_ids[i] has position i in the lists.

    Returns
    -------
    dict of str to InvertedLists
        The lists of each feature set that the queries use.

    Raises
    ------
    StoreError
        If the index is missing or stale; the message gives the command that builds it.
    """
    store.index_path()
    wanted: dict[str, dict[Keyframe, None]] = {}
    for query in queries:
        for keyframe in (keyframe for chain in query.chains for keyframe in chain.keyframes):
            wanted.setdefault(keyframe.set, {})[keyframe] = None
    return {name: _read_set(store, name, list(keyframes), take_ids) for name, keyframes in wanted.items()}


def _read_set(store: Store, feature_set: str, keyframes: Sequence[Keyframe], take_ids: I64) -> InvertedLists:
    """Read the lists of one feature set."""
    poses = " OR ".join(f"(word & {k.mask}::UBIGINT) = {k.value}::UBIGINT" for k in keyframes)
    table = store.sql(
        f"""SELECT word, take_id, start, stop - start AS frames FROM word_runs WHERE feature_set = ?
            AND word IN (SELECT word FROM vocabulary WHERE feature_set = ? AND ({poses}))""",
        [feature_set, feature_set],
    )
    ids = table.column("take_id").to_numpy()
    place = np.searchsorted(take_ids, ids)
    known = place < len(take_ids)
    known[known] = take_ids[place[known]] == ids[known]
    words, starts, frames = (table.column(name).to_numpy()[known] for name in ("word", "start", "frames"))
    return InvertedLists.from_runs(words.astype(np.uint64), place[known], starts, frames)
