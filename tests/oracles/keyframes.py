"""Naive twins of keyframe search: enumeration of hits, sets of frames, and Algorithm 1 as printed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise, product
from math import inf

Match = Sequence[bool]
"""A predicate that is true for the frames of one take that meet a keyframe."""


def all_hits(matches: Sequence[Match], gaps: Sequence[tuple[int, float]]) -> list[tuple[int, ...]]:
    """Every hit (n_1, ..., n_K) of one take, 0-based, straight from conditions (3.2) and (3.3)."""
    frames = [[n for n, met in enumerate(match) if met] for match in matches]
    return [
        hit
        for hit in product(*frames)
        if all(
            low <= later - earlier <= high for (earlier, later), (low, high) in zip(pairwise(hit), gaps, strict=True)
        )
    ]


def covered(ranges: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    """The union of closed ranges as half-open ones, from the set of their frames: touching ones unite."""
    frames = sorted({frame for start, end in ranges for frame in range(start, end + 1)})
    union: list[tuple[int, int]] = []
    for frame in frames:
        if union and union[-1][1] == frame:
            union[-1] = (union[-1][0], frame + 1)
        else:
            union.append((frame, frame + 1))
    return union


def ranges_by_enumeration(matches: Sequence[Match], gaps: Sequence[tuple[int, float]]) -> list[tuple[int, int]]:
    """The union of the ranges of all hits of one take, half-open."""
    return covered((hit[0], hit[-1]) for hit in all_hits(matches, gaps))


def ranges_by_sets(matches: Sequence[Match], gaps: Sequence[tuple[int, float]]) -> list[tuple[int, int]]:
    """The same for takes too long to enumerate, by the sets of frames that each first frame leads to.

    A set is a Python integer with bit n for frame n.
    """
    length = len(matches[0])
    sets = [sum(1 << n for n, met in enumerate(match) if met) for match in matches]
    found = []
    for first in range(length):
        reached = sets[0] & (1 << first)
        for later, (low, high) in zip(sets[1:], gaps, strict=True):
            moved = 0
            for gap in range(low, int(min(high, length)) + 1):
                moved |= reached << gap
            reached = moved & later
        if reached:
            found.append((first, reached.bit_length() - 1))
    return covered(found)


Segment = tuple[float, float]
"""A closed segment [s : t], 1-based, either end possibly infinite."""


def algorithm_1(
    lists: Sequence[Sequence[tuple[int, int]]], distances: Sequence[int], stiffness: Sequence[float]
) -> list[tuple[tuple[int, ...], tuple[int, int]]]:
    """The printed recursion: its matches (p_1, ..., p_K) with their ranges R(M), in the order found.

    Everything counts from 1 and both ends of a segment belong to it, as in the paper. R(M) is found as the
    text states: its end is that of the intersection in the last list, its start comes from backtracking to the
    first.
    """
    count = len(lists)
    gaps = [_gap(d, s) for d, s in zip(distances, stiffness, strict=True)]
    pointers = [1] * count
    found: list[tuple[tuple[int, ...], tuple[int, int]]] = []

    def segment(k: int) -> tuple[int, int] | None:
        return lists[k][pointers[k] - 1] if pointers[k] <= len(lists[k]) else None

    def intersect(one: tuple[int, int] | None, other: Segment) -> tuple[int, int] | None:
        if one is None or one[1] < other[0] or other[1] < one[0]:
            return None
        return int(max(one[0], other[0])), int(min(one[1], other[1]))

    def admissible(k: int, one: tuple[int, int]) -> Segment:
        return one[0] + gaps[k][0], one[1] + gaps[k][1]

    def relevant_range(intersections: list[tuple[int, int]]) -> tuple[int, int]:
        back = intersections[-1]
        for k in range(count - 2, -1, -1):
            low, high = gaps[k]
            narrowed = intersect(intersections[k], (back[0] - high, back[1] - low))
            assert narrowed is not None
            back = narrowed
        return back[0], intersections[-1][1]

    def recurse(k: int, admitted: Segment, before: list[tuple[int, int]]) -> None:
        while pointers[k] <= len(lists[k]) and lists[k][pointers[k] - 1][1] < admitted[0]:
            pointers[k] += 1
        incremented = False
        intersection = intersect(segment(k), admitted)
        while intersection is not None:
            here = [*before, intersection]
            if k == count - 1:
                found.append((tuple(pointers), relevant_range(here)))
            else:
                recurse(k + 1, admissible(k, intersection), here)
            pointers[k] += 1
            incremented = True
            intersection = intersect(segment(k), admitted)
        if incremented:
            pointers[k] -= 1

    for p in range(1, len(lists[0]) + 1):
        pointers[0] = p
        start = lists[0][p - 1]
        if count == 1:
            found.append(((p,), start))
        else:
            recurse(1, admissible(0, start), [start])
    return found


def _gap(distance: int, stiffness: float) -> tuple[int, float]:
    """[ceil(sigma d), floor(d / sigma)], by counting frames instead of rounding."""
    if stiffness == 0:
        return 0, inf
    low = 0
    while low < stiffness * distance - 1e-9:
        low += 1
    high = low
    while (high + 1) * stiffness <= distance + 1e-9:
        high += 1
    return low, high
