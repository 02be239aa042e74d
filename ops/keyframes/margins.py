"""Learn margins from clips: the frames around hits of keyframe queries into which motions may extend."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Literal

import numpy as np

from kinedex.ops.arrays import I64, U64, Bool
from kinedex.ops.keyframes.training_task import Individual
from kinedex.ops.ranges import from_axis
from kinedex.ops.search.bit_slice_search import search_slices
from kinedex.ops.search.bit_slices import slice_words
from kinedex.ops.words import TakeWords

Margins = Literal["learned", "shared"]

ALONE = 3
"""With shared margins, each margin keeps at least a fraction of 1 / `ALONE` of the margin of the query alone."""


def hit_ranges(words: TakeWords, query: Individual, features: int) -> tuple[I64, I64]:
    """Search takes; return for each hit range the index of its take, int64 (n,), and its frames, int64 (n, 2)."""
    slices = slice_words(words.words, words.offsets, features)
    return from_axis(search_slices(slices, query.masks.tolist(), query.values.tolist(), query.gaps))


def clips_hit(clips: Sequence[U64], queries: Sequence[Individual], features: int) -> Bool:
    """Return for each clip whether any of the queries has a hit in it, bool (T,)."""
    hit = np.zeros(len(clips), np.bool_)
    words = as_takes(clips)
    for query in queries:
        hit[hit_ranges(words, query, features)[0]] = True
    return hit


def as_takes(clips: Sequence[U64]) -> TakeWords:
    """Return clips as words of takes that are numbered from 0."""
    offsets = np.concatenate([[0], np.cumsum([len(words) for words in clips])]).astype(np.int64)
    return TakeWords(np.arange(len(clips)), offsets, np.concatenate(clips))


def margins_of(
    queries: Sequence[Individual], clips: Sequence[U64], features: int, policy: Margins
) -> list[tuple[int, int]]:
    """Return the margins of each query: frames before and after a hit into which the motion may extend.

    Parameters
    ----------
    queries : sequence of Individual
        The queries of one class.
    clips : sequence of uint64 arrays (L,)
        The training clips of the class.
    features : int
        The number of features.
    policy : {"learned", "shared"}
        With "learned", margins are as wide as clips extend beyond the hits of each query, so that each clip with a hit
        is covered. With "shared", margins are shortened, at most to a third, as long as other queries cover the frames.

    Returns
    -------
    list of (int, int)
        Frames before and after a hit, for each query.
    """
    takes = as_takes(clips)
    reached = [HitReach(takes, query, features) for query in queries]
    learned = [reach.farthest() for reach in reached]
    return _shared(reached, learned) if policy == "shared" else learned


class HitReach:
    """The hits of one query in concatenated clips."""

    def __init__(self, takes: TakeWords, query: Individual, features: int) -> None:
        clips, ranges = hit_ranges(takes, query, features)
        self.begins, self.ends = takes.offsets[clips], takes.offsets[clips + 1]
        self.starts, self.stops = self.begins + ranges[:, 0], self.begins + ranges[:, 1]
        self.frames = len(takes.words)

    def farthest(self) -> tuple[int, int]:
        """Return the margins that cover each clip with a hit completely, including frames between its hits."""
        first = np.diff(self.begins, prepend=-1) != 0
        last = np.diff(self.ends, append=-1) != 0
        left = int((self.starts - self.begins)[first].max(initial=0))
        right = int((self.ends - self.stops)[last].max(initial=0))
        between = int((self.starts[1:] - self.stops[:-1])[~first[1:]].max(initial=0))
        lacking = max(0, between - left - right)
        return left + lacking // 2, right + lacking - lacking // 2

    def covered(self, left: int, right: int) -> Bool:
        """Return the frames in hits extended by margins, limited to the clip of each hit; bool (frames,)."""
        change = np.zeros(self.frames + 1, np.int64)
        np.add.at(change, np.maximum(self.starts - left, self.begins), 1)
        np.add.at(change, np.minimum(self.stops + right, self.ends), -1)
        covered: Bool = np.cumsum(change[:-1]) > 0
        return covered


def _shared(reached: Sequence[HitReach], learned: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Shorten margins frame by frame, the longest first, as long as every frame that was covered remains covered.

    No margin becomes shorter than 1 / `ALONE` of its length, because a motion of another person may be found by only
    one of the queries.
    """
    margins = [list(pair) for pair in learned]
    wanted = _covered_by(reached, margins)
    sides = set(product(range(len(margins)), (0, 1)))
    while sides:
        query, end = max(sorted(sides), key=lambda side: margins[side[0]][side[1]])
        margins[query][end] -= 1
        least = -(-learned[query][end] // ALONE)
        if margins[query][end] < least or not (_covered_by(reached, margins) >= wanted).all():
            # The others only become shorter, so this margin cannot be shortened later.
            margins[query][end] += 1
            sides.discard((query, end))
    return [(left, right) for left, right in margins]


def _covered_by(reached: Sequence[HitReach], margins: Sequence[Sequence[int]]) -> Bool:
    covered: Bool = np.any([reach.covered(*pair) for reach, pair in zip(reached, margins, strict=True)], axis=0)
    return covered
