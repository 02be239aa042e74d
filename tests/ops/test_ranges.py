"""Ranges of frames: checked, extended and united, divided by take."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.ranges import TakeRanges, checked_ranges, extend_and_unite


def ranges(*takes: list[tuple[int, int]]) -> TakeRanges:
    pairs = [pair for take in takes for pair in take]
    offsets = np.cumsum([0, *(len(take) for take in takes)])
    return TakeRanges(offsets.astype(np.int64), np.array(pairs, np.int64).reshape(-1, 2))


def listed(found: TakeRanges) -> list[list[tuple[int, int]]]:
    return [[tuple(own) for own in found.take(i).tolist()] for i in range(len(found))]


def extended(of_takes: TakeRanges, left: int, right: int, lengths: list[int]) -> list[list[tuple[int, int]]]:
    offsets = np.cumsum([0, *lengths])
    found = extend_and_unite(of_takes.end_to_end(offsets), offsets, left, right)
    return listed(TakeRanges.by_take(found, offsets))


def test_ascending_ranges_are_kept_without_the_empty_ones() -> None:
    assert checked_ranges([[0, 3], [3, 3], [3, 5]], 5).tolist() == [[0, 3], [3, 5]]
    assert checked_ranges(None, 4).tolist() == [[0, 4]]
    assert checked_ranges(None, 0).shape == (0, 2)


@pytest.mark.parametrize("wrong", [[[0, 4]], [[-1, 2]], [[2, 1]], [[0, 2], [1, 3]]])
def test_ranges_that_are_not_ascending_within_the_frames_are_refused(wrong: list[list[int]]) -> None:
    with pytest.raises(ParameterError, match="ranges must be ascending ranges within 3 frames"):
        checked_ranges(wrong, 3)


def test_margins_stay_inside_the_take_and_join_what_they_meet() -> None:
    found = extended(ranges([(3, 5), (9, 12)], [], [(0, 4), (20, 22)]), 2, 3, [13, 7, 40])
    assert found == [[(1, 13)], [], [(0, 7), (18, 25)]]


def test_margins_that_touch_join() -> None:
    assert extended(ranges([(2, 4), (8, 9)]), 2, 2, [30]) == [[(0, 11)]]
    assert extended(ranges([(2, 4), (9, 10)]), 2, 2, [30]) == [[(0, 6), (7, 12)]]


def test_ranges_of_several_queries_are_united_take_by_take() -> None:
    one, other = ranges([(1, 3)], [(5, 8)], []), ranges([(3, 4), (9, 10)], [(0, 4)], [(2, 3)])
    assert listed(TakeRanges.united([one, other])) == [[(1, 4), (9, 10)], [(0, 4), (5, 8)], [(2, 3)]]
    assert TakeRanges.united([one]) is one
    for wrong in ([], [one, ranges([])]):
        with pytest.raises(ParameterError):
            TakeRanges.united(wrong)


def test_margins_and_ranges_out_of_their_domain_are_refused() -> None:
    one, offsets = np.array([[0, 2]]), np.array([0, 3])
    for wrong in ((-1, 0), (0, -1)):
        with pytest.raises(ParameterError, match="margins"):
            extend_and_unite(one, offsets, *wrong)
    with pytest.raises(ParameterError, match="ranges"):
        extend_and_unite(one + 3, offsets)


hits_of_a_take = st.lists(st.tuples(st.integers(0, 5), st.integers(1, 5)), max_size=4)


def laid_down(steps: list[tuple[int, int]]) -> tuple[list[tuple[int, int]], int]:
    """Hits that are apart, and a length of their take."""
    edges = np.cumsum([value for gap, length in steps for value in (gap + 1, length)]).tolist()
    hits = list(zip(edges[::2], edges[1::2], strict=True))
    return hits, (hits[-1][1] + 2 if hits else 3)


def merged(frames: set[int], offsets: list[int]) -> list[list[int]]:
    """Ranges of neighbouring frames, none of which reaches into another take."""
    starts = sorted(frame for frame in frames if frame - 1 not in frames or frame in offsets)
    return [
        [start, next(n for n in range(start + 1, offsets[-1] + 1) if n not in frames or n in offsets)]
        for start in starts
    ]


@given(st.lists(st.lists(hits_of_a_take, min_size=2, max_size=2), min_size=1, max_size=3), st.integers(0, 4))
def test_ranges_around_hits_stay_within_their_takes(takes: list[list[list[tuple[int, int]]]], margin: int):
    drawn = [[laid_down(steps) for steps in take] for take in takes]
    offsets = np.cumsum([0, *(max(length for _, length in take) for take in drawn)])
    found, expected = [], set[int]()
    for query in range(2):
        hits = [take[query][0] for take in drawn]
        starts, stops = (np.array([hit[side] for own in hits for hit in own], np.int64) for side in (0, 1))
        positions = np.cumsum([0, *map(len, hits)])
        own = TakeRanges(positions, np.stack([starts, stops], axis=1))
        found.append(extend_and_unite(own.end_to_end(offsets), offsets, margin, 2))
        frames = {
            frame
            for own, (begin, end) in zip(hits, pairwise(offsets.tolist()), strict=True)
            for start, stop in own
            for frame in range(max(begin + start - margin, begin), min(begin + stop + 2, end))
        }
        assert found[-1].tolist() == merged(frames, offsets.tolist())
        expected |= frames
    assert extend_and_unite(np.concatenate(found), offsets).tolist() == merged(expected, offsets.tolist())
