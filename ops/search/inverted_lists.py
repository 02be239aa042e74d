"""This module makes inverted lists: the list of a word holds its runs, in order of take and start (thesis, 3.3)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.errors import ParameterError
from kinedex.ops.search.runs import word_runs
from kinedex.ops.words import I64, MAX_FEATURES, NO_WORD, U64, cut

I32 = npt.NDArray[np.int32]

MAX_COUNTED = 18
"""Maximum number of features for which a table with an entry for every possible word (2 MB) fits into the caches, so
that runs are placed by counting in one pass. With more features the runs are sorted.
"""


class InvertedLists(NamedTuple):
    """The concatenated inverted lists of V distinct words, with R runs in total.

    Parameters
    ----------
    words : uint64 array (V,)
        The distinct words, ascending.
    offsets : int64 array (V + 1,)
        The runs of words[v] are offsets[v] to offsets[v + 1] - 1.
    take : int32 array (R,)
        The position of the take of each run. Within a list the runs are in order of take and start.
    start : int32 array (R,)
        The first frame of each run.
    length : int32 array (R,)
        The number of frames of each run.
    """

    words: U64
    offsets: I64
    take: I32
    start: I32
    length: I32

    @classmethod
    def from_runs(cls, word: U64, take: I64 | I32, start: I64 | I32, length: I64 | I32) -> InvertedLists:
        """Sort runs, given in any order, into inverted lists.

        Parameters
        ----------
        word : uint64 array (R,)
            The word of each run.
        take, start, length : int array (R,)
            The position of the take, the first frame and the number of frames of each run.
        """
        order = np.lexsort((start, take, word))
        distinct, counts = np.unique(word, return_counts=True)
        offsets = np.zeros(len(distinct) + 1, np.int64)
        np.cumsum(counts, out=offsets[1:])
        return cls(distinct, offsets, *(column[order].astype(np.int32) for column in (take, start, length)))

    @property
    def runs(self) -> I64:
        """Return the number of runs of each word, int64 (V,)."""
        return np.diff(self.offsets)

    @property
    def frames(self) -> I64:
        """Return the number of frames of each word, int64 (V,)."""
        ends = np.concatenate([[0], np.cumsum(self.length, dtype=np.int64)])
        return np.diff(ends[self.offsets])

    def matching(self, mask: int, value: int) -> I64:
        """Return the indices of the words that a keyframe matches: ``word & mask == value``.

        Raises
        ------
        ParameterError
            If the value has bits outside its mask, which no word could match.
        """
        if value & ~mask or mask < 0 or mask >= 2**64:
            raise ParameterError("value", f"within the bits of the mask {mask:#x}", value)
        return np.flatnonzero((self.words & np.uint64(mask)) == np.uint64(value))


def inverted_lists(words: U64, offsets: I64, first_feature: int, features: int) -> InvertedLists:
    """Reduce the words of many takes to one feature set, and make the inverted list of each of its words.

    Parameters
    ----------
    words : uint64 array (N,)
        The concatenated whole words of T takes; `NO_WORD` for an invalid frame, which is in no list.
    offsets : int64 array (T + 1,)
        Take i has the words offsets[i] to offsets[i + 1] - 1. Takes must have fewer than 2**31 frames.
    first_feature : int
        The number of the set's lowest feature, from 1.
    features : int
        The number of features of the set, as in `ops.words.cut`.

    Returns
    -------
    InvertedLists

    Raises
    ------
    ParameterError
        If the offsets do not fit the words, or there is no such set.
    """
    words = np.ascontiguousarray(words, dtype=np.uint64)
    offsets = np.ascontiguousarray(offsets, dtype=np.int64)
    if len(offsets) == 0 or offsets[0] != 0 or offsets[-1] != len(words) or np.any(np.diff(offsets) < 0):
        raise ParameterError("offsets", f"rising from 0 to {len(words)}, the number of words", offsets[:3])
    if np.any(np.diff(offsets) > np.iinfo(np.int32).max):
        raise ParameterError("offsets", "of takes of less than 2^31 frames", int(np.diff(offsets).max()))
    if not 1 <= first_feature <= MAX_FEATURES or not 1 <= features <= MAX_FEATURES + 1 - first_feature:
        raise ParameterError("feature set", f"within bits 1 to {MAX_FEATURES}", (first_feature, features))
    if features > MAX_COUNTED:
        runs = word_runs(cut(words, first_feature, features), offsets)
        return InvertedLists.from_runs(runs.word, runs.take, runs.start, runs.stop - runs.start)
    counts = np.zeros(1 << features, np.int64)
    shift, mask = np.uint64(first_feature - 1), np.uint64((1 << features) - 1)
    _count(words, offsets, shift, mask, counts)
    present = np.flatnonzero(counts)
    ends = np.cumsum(counts)
    total = int(ends[-1])
    take, start, length = (np.empty(total, np.int32) for _ in range(3))
    _place(words, offsets, shift, mask, ends - counts, take, start, length)
    return InvertedLists(present.astype(np.uint64), np.concatenate([[0], ends[present]]), take, start, length)


@njit(cache=True, nogil=True)
def _count(words: U64, offsets: I64, shift: np.uint64, mask: np.uint64, counts: I64) -> None:
    """Count the runs of each word."""
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
    """Write each run to its list; cursor[w] is the index of the next run of word w."""
    for t in range(len(offsets) - 1):
        first = offsets[t]
        before = NO_WORD
        begun = first
        for i in range(first, offsets[t + 1] + 1):
            # one step past the end of the take ends the last run
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
