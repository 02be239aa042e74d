"""Inverted lists: of every word its runs, in order of take and start (thesis, 3.1)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.errors import ParameterError
from kinedex.ops.search.runs import word_runs
from kinedex.ops.words import I64, MOST_FEATURES, NO_WORD, U64, cut

I32 = npt.NDArray[np.int32]

MOST_COUNTED = 18
"""Up to this many features a table with an entry for every possible word (2 MB) fits into the caches, and the runs are
put in their places in one pass; more features than that are sorted."""


class InvertedLists(NamedTuple):
    """The inverted lists of V distinct words, one after the other, R runs in all.

    words: uint64 (V,), ascending. offsets: int64 (V + 1,), the runs of words[v] are offsets[v] to offsets[v + 1].
    take: int32 (R,), the position of the take. start: int32 (R,), the first frame. length: int32 (R,), in frames.
    Within a list the runs are in order of take and start.
    """

    words: U64
    offsets: I64
    take: I32
    start: I32
    length: I32

    @property
    def runs(self) -> I64:
        """The number of runs of every word, int64 (V,)."""
        return np.diff(self.offsets)

    @property
    def frames(self) -> I64:
        """The number of frames of every word, int64 (V,)."""
        ends = np.concatenate([[0], np.cumsum(self.length, dtype=np.int64)])
        return np.diff(ends[self.offsets])


def inverted_lists(words: U64, offsets: I64, first_feature: int, features: int) -> InvertedLists:
    """Cut the words of many takes down to one feature set and make the inverted list of every word of it.

    Parameters
    ----------
    words: uint64 (N,), the whole words of T takes, one take after the other; `NO_WORD` stands for an invalid frame,
        which is in no list.
    offsets: int64 (T + 1,), take i has the words offsets[i] to offsets[i + 1]; no take has 2^31 frames or more.
    first_feature, features: the set, as in `ops.words.cut`.

    Raises
    ------
    ParameterError: the offsets do not fit the words, or there is no such set.
    """
    words = np.ascontiguousarray(words, dtype=np.uint64)
    offsets = np.ascontiguousarray(offsets, dtype=np.int64)
    if len(offsets) == 0 or offsets[0] != 0 or offsets[-1] != len(words) or np.any(np.diff(offsets) < 0):
        raise ParameterError("offsets", f"rising from 0 to {len(words)}, the number of words", offsets[:3])
    if np.any(np.diff(offsets) > np.iinfo(np.int32).max):
        raise ParameterError("offsets", "of takes of less than 2^31 frames", int(np.diff(offsets).max()))
    if not 1 <= first_feature <= MOST_FEATURES or not 1 <= features <= MOST_FEATURES + 1 - first_feature:
        raise ParameterError("feature set", f"within bits 1 to {MOST_FEATURES}", (first_feature, features))
    if features > MOST_COUNTED:
        return _sorted(words, offsets, first_feature, features)
    counts = np.zeros(1 << features, np.int64)
    shift, mask = np.uint64(first_feature - 1), np.uint64((1 << features) - 1)
    _count(words, offsets, shift, mask, counts)
    present = np.flatnonzero(counts)
    ends = np.cumsum(counts)
    total = int(ends[-1])
    take, start, length = (np.empty(total, np.int32) for _ in range(3))
    _place(words, offsets, shift, mask, ends - counts, take, start, length)
    return InvertedLists(present.astype(np.uint64), np.concatenate([[0], ends[present]]), take, start, length)


def _sorted(words: U64, offsets: I64, first_feature: int, features: int) -> InvertedLists:
    runs = word_runs(cut(words, first_feature, features), offsets)
    order = np.argsort(runs.word, kind="stable")
    distinct, firsts = np.unique(runs.word[order], return_index=True)
    return InvertedLists(
        distinct,
        np.concatenate([firsts, [len(order)]]).astype(np.int64),
        runs.take[order].astype(np.int32),
        runs.start[order].astype(np.int32),
        (runs.stop - runs.start)[order].astype(np.int32),
    )


@njit(cache=True, nogil=True)
def _count(words: U64, offsets: I64, shift: np.uint64, mask: np.uint64, counts: I64) -> None:
    for t in range(len(offsets) - 1):
        before = NO_WORD
        for i in range(offsets[t], offsets[t + 1]):
            if words[i] == NO_WORD:
                before = NO_WORD
                continue
            word = (words[i] >> shift) & mask
            if word != before:
                counts[word] += 1
            before = word


@njit(cache=True, nogil=True)
def _place(
    words: U64, offsets: I64, shift: np.uint64, mask: np.uint64, cursor: I64, take: I32, start: I32, length: I32
) -> None:
    # every word's cursor walks through the stretch that its list gets, so the lists come out one after the other
    for t in range(len(offsets) - 1):
        first = offsets[t]
        before = NO_WORD
        begun = first
        for i in range(first, offsets[t + 1] + 1):
            # one step past the take's end stands no word, which ends the last run
            word = NO_WORD
            if i < offsets[t + 1] and words[i] != NO_WORD:
                word = (words[i] >> shift) & mask
            if word == before:
                continue
            if before != NO_WORD:
                place = cursor[before]
                take[place] = t
                start[place] = begun - first
                length[place] = i - begun
                cursor[before] = place + 1
            before = word
            begun = i
