"""How far motions reach out of the hits of their keyframe queries: margins by formula, or learned from clips."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Literal

import numpy as np

from kinedex.catalog.queries.keyframe_query import Gap
from kinedex.ops.keyframes.fitness import Bool
from kinedex.ops.keyframes.individuals import Individual
from kinedex.ops.search.bit_slice_search import search_slices
from kinedex.ops.search.bit_slices import slice_words
from kinedex.ops.search.preselection import template_margins
from kinedex.ops.search.segments import from_axis
from kinedex.ops.words import I64, U64, TakeWords

Margins = Literal["learned", "shared", "formula", "wider"]

ALONE = 3
"""A query that shares its margins keeps one part in so many of those that it would have alone."""


def hit_ranges(words: TakeWords, query: Individual, features: int) -> tuple[I64, I64]:
    """Search takes, and return the index of the take, int64 (n,), and the frames, int64 (n, 2), of each hit range."""
    slices = slice_words(words.words, words.offsets, features)
    return from_axis(search_slices(slices, query.masks.tolist(), query.values.tolist(), query.gaps))


def clips_hit(clips: Sequence[U64], queries: Sequence[Individual], features: int) -> Bool:
    """Tell for each clip whether any of these queries has a hit in it, bool (T,)."""
    hit = np.zeros(len(clips), np.bool_)
    words = as_takes(clips)
    for query in queries:
        hit[hit_ranges(words, query, features)[0]] = True
    return hit


def as_takes(clips: Sequence[U64]) -> TakeWords:
    """Clips as words of takes, numbered from 0."""
    offsets = np.concatenate([[0], np.cumsum([len(words) for words in clips])]).astype(np.int64)
    return TakeWords(np.arange(len(clips)), offsets, np.concatenate(clips))


def margins_of(
    queries: Sequence[Individual], clips: Sequence[U64], features: int, columns: int, policy: Margins
) -> list[tuple[int, int]]:
    """How many frames before and after a hit of each query the motion may reach.

    Parameters
    ----------
    queries: of one class. clips: its training clips. features: number of features. columns: of its template.
    policy: "formula": from the template's columns and the softest gap (`ops.search.preselection.template_margins`).
        "learned": as far as clips reach out of their hits, so that each that is hit is covered whole; the formula may
        be shorter, but then it cuts a clip. "shared": the same of all queries together; what one of them covers, the
        others need not, but for a third of their margins. "wider": the larger of "learned" and "formula", on each side.
    """
    formula = [_by_formula(query, columns) for query in queries]
    if policy == "formula":
        return formula
    takes = as_takes(clips)
    reached = [Reach(takes, query, features) for query in queries]
    learned = [reach.farthest() for reach in reached]
    if policy == "shared":
        return _shared(reached, learned)
    if policy == "wider":
        pairs = zip(learned, formula, strict=True)
        return [(max(one[0], other[0]), max(one[1], other[1])) for one, other in pairs]
    return learned


def _by_formula(query: Individual, columns: int) -> tuple[int, int]:
    stiffness = min((Gap(low, high).nominal_stiffness for low, high in query.gaps), default=0.0)
    return template_margins(int(query.positions[0]), int(query.positions[-1]), columns, stiffness)


class Reach:
    """The hits of one query in clips that follow each other on one axis of frames."""

    def __init__(self, takes: TakeWords, query: Individual, features: int) -> None:
        clips, ranges = hit_ranges(takes, query, features)
        self.begins, self.ends = takes.offsets[clips], takes.offsets[clips + 1]
        self.starts, self.stops = self.begins + ranges[:, 0], self.begins + ranges[:, 1]
        self.frames = len(takes.words)

    def farthest(self) -> tuple[int, int]:
        """The margins by which each clip that is hit is covered whole, what lies between its hits as well."""
        first = np.diff(self.begins, prepend=-1) != 0
        last = np.diff(self.ends, append=-1) != 0
        left = int((self.starts - self.begins)[first].max(initial=0))
        right = int((self.ends - self.stops)[last].max(initial=0))
        between = int((self.starts[1:] - self.stops[:-1])[~first[1:]].max(initial=0))
        lacking = max(0, between - left - right)
        return left + lacking // 2, right + lacking - lacking // 2

    def covered(self, left: int, right: int) -> Bool:
        """The frames within hits that are extended by margins, in their own clips; bool (frames,)."""
        change = np.zeros(self.frames + 1, np.int64)
        np.add.at(change, np.maximum(self.starts - left, self.begins), 1)
        np.add.at(change, np.minimum(self.stops + right, self.ends), -1)
        covered: Bool = np.cumsum(change[:-1]) > 0
        return covered


def _shared(reached: Sequence[Reach], learned: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Shorten margins frame by frame as long as no frame of a clip is lost, always the longest that can be shortened.

    None becomes shorter than an `ALONE`-th: a motion of somebody else may be found by one of the queries only.
    """
    margins = [list(pair) for pair in learned]
    wanted = _covered_by(reached, margins)
    sides = set(product(range(len(margins)), (0, 1)))
    while sides:
        query, end = max(sorted(sides), key=lambda side: margins[side[0]][side[1]])
        margins[query][end] -= 1
        least = -(-learned[query][end] // ALONE)
        if margins[query][end] < least or not (_covered_by(reached, margins) >= wanted).all():
            # the others only become shorter, so it stays as it is
            margins[query][end] += 1
            sides.discard((query, end))
    return [(left, right) for left, right in margins]


def _covered_by(reached: Sequence[Reach], margins: Sequence[Sequence[int]]) -> Bool:
    covered: Bool = np.any([reach.covered(*pair) for reach, pair in zip(reached, margins, strict=True)], axis=0)
    return covered
