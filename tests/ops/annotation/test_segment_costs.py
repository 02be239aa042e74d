"""Distances of segments."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.annotation.decoding import least_costs
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import NO_WORD, U64

WORDS = st.lists(st.sampled_from([*range(8), int(NO_WORD)]), min_size=4, max_size=40)
COLUMNS = st.lists(st.tuples(st.integers(0, 7), st.integers(0, 7)), min_size=1, max_size=5)


def quantised(columns: list[tuple[int, int]]) -> QuantisedTemplate:
    mask, value = np.array(columns, np.uint64).T
    return QuantisedTemplate(mask.copy(), mask & value)


def taken(words: list[int]) -> U64:
    return np.array(words, np.uint64)


@settings(deadline=None, max_examples=80)
@given(st.lists(COLUMNS, min_size=1, max_size=3), WORDS, st.data())
def test_they_are_the_least_of_the_curves_in_their_frames(
    columns: list[list[tuple[int, int]]], words: list[int], data: st.DataObject
) -> None:
    templates, length = [quantised(one) for one in columns], len(words)
    ranges = []
    for _ in templates:
        middle = data.draw(st.integers(1, length - 1))
        ranges.append(np.array([[0, middle], [middle, length]]))  # two takes, laid end to end
    segments = []
    for index, own in enumerate(ranges):
        for first, end in own.tolist():
            start = data.draw(st.integers(first, end - 1))
            segments.append((index, start, data.draw(st.integers(start + 1, end))))
    segments = data.draw(st.permutations(segments))
    found = least_costs(templates, taken(words), ranges, *np.array(segments).T)
    for (index, start, stop), cost in zip(segments, found.tolist(), strict=True):
        curve = distance_curves([templates[index]], taken(words), ranges[index])[0]
        assert cost == curve[start:stop].min()


def test_of_no_segments_there_is_none() -> None:
    nothing = np.zeros(0, np.int64)
    assert len(least_costs([quantised([(1, 1)])], taken([1]), [np.array([[0, 1]])], nothing, nothing, nothing)) == 0
