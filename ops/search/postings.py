"""Inverted lists: the runs of one feature set, word by word, and keyframe lists from them (thesis, 3.1 and 3.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinedex.ops.errors import ParameterError
from kinedex.ops.search.segments import Segments, join_runs
from kinedex.ops.words import I64, U64


@dataclass(frozen=True)
class Postings:
    """The runs of V words of a feature set, one word after the other: all of its words, or those that were asked for.

    words: uint64 (V,), ascending. offsets: int64 (V + 1,), word i has the runs offsets[i] .. offsets[i + 1]. starts,
    stops: int64 (R,), the runs' positions on the axis (`ops.search.segments.to_axis`), in ascending order within each
    word.
    """

    words: U64
    offsets: I64
    starts: I64
    stops: I64

    def matching(self, mask: int, value: int) -> I64:
        """Which words a keyframe stands for: the indices i with words[i] & mask == value.

        Raises
        ------
        ParameterError: a value with bits outside its mask, which no word could match.
        """
        if value & ~mask or mask < 0 or mask >= 2**64:
            raise ParameterError("value", f"within the bits of the mask {mask:#x}", value)
        return np.flatnonzero((self.words & np.uint64(mask)) == np.uint64(value))

    def runs(self, mask: int, value: int) -> int:
        """How many runs the words of a keyframe have together, before any are united."""
        chosen = self.matching(mask, value)
        return int((self.offsets[chosen + 1] - self.offsets[chosen]).sum())

    def keyframe(self, mask: int, value: int) -> Segments:
        """The inverted list of a keyframe: the union of the lists of its words (thesis, Eq. 3.4 to 3.6)."""
        chosen = self.matching(mask, value)
        counts = self.offsets[chosen + 1] - self.offsets[chosen]
        before = np.cumsum(counts) - counts
        at = np.repeat(self.offsets[chosen] - before, counts) + np.arange(counts.sum())
        return join_runs(self.starts[at], self.stops[at])


def make_postings(words: U64, starts: I64, stops: I64) -> Postings:
    """Sort runs by word.

    Parameters
    ----------
    words: uint64 (R,), the word of each run. starts, stops: int64 (R,), positions. In any order; runs that already lie
        word by word, each word's in order of position, are not sorted again.
    """
    if not (len(words) == len(starts) == len(stops)):
        raise ParameterError("runs", "as many words as starts and stops", (len(words), len(starts), len(stops)))
    same = words[1:] == words[:-1]
    if ((words[1:] < words[:-1]) | (same & (starts[1:] < starts[:-1]))).any():
        order = np.lexsort((starts, words))
        words, starts, stops = words[order], starts[order], stops[order]
        same = words[1:] == words[:-1]
    first = np.concatenate([np.zeros(min(len(words), 1), np.int64), np.flatnonzero(~same) + 1])
    return Postings(words[first], np.append(first, len(words)), starts, stops)
