"""Inverted lists give the keyframe lists that runs in order of time give."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.search.keyframes import keyframe_list
from kinedex.ops.search.postings import make_postings
from kinedex.ops.search.runs import word_runs
from kinedex.ops.search.segments import to_axis


@given(st.lists(st.lists(st.integers(0, 7), max_size=30), max_size=4), st.integers(0, 7), st.integers(0, 7))
def test_a_keyframe_list_is_the_union_of_the_lists_of_its_words(takes: list[list[int]], mask: int, value: int) -> None:
    words = np.array([word for take in takes for word in take], np.uint64)
    runs = word_runs(words, np.cumsum([0, *map(len, takes)]))
    starts, stops = to_axis(runs.take, runs.start), to_axis(runs.take, runs.stop)
    postings = make_postings(runs.word, starts, stops)
    assert postings.words.tolist() == sorted(set(words.tolist()))
    assert len(postings.offsets) == len(postings.words) + 1
    value &= mask
    found, expected = postings.keyframe(mask, value), keyframe_list(starts, stops, runs.word, mask, value)
    assert found.starts.tolist() == expected.starts.tolist()
    assert found.stops.tolist() == expected.stops.tolist()
    assert postings.runs(mask, value) == sum(int(word) & mask == value for word in runs.word)
    again = make_postings(np.repeat(postings.words, np.diff(postings.offsets)), postings.starts, postings.stops)
    assert again.starts is postings.starts


def test_a_keyframe_that_asks_for_bits_it_masks_is_refused() -> None:
    none = np.zeros(0, np.int64)
    with pytest.raises(ParameterError):
        make_postings(none.astype(np.uint64), none, none).keyframe(2, 3)
    with pytest.raises(ParameterError):
        make_postings(none.astype(np.uint64), none, np.ones(1, np.int64))
