"""Inverted lists against the runs of the naive twin, sorted by word."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.search.inverted_lists import MAX_COUNTED, InvertedLists, inverted_lists
from kinedex.ops.words import NO_WORD, cut
from tests.oracles import runs as naive

WORDS = st.sampled_from([0, 1, 2, 3, 2**13, 2**25, 2**39 | 5, 2**62, int(NO_WORD)])
TAKES = st.lists(st.lists(WORDS, max_size=12), max_size=5)
SETS = st.sampled_from([(1, 14), (15, 12), (27, 14), (3, 1), (1, MAX_COUNTED), (2, MAX_COUNTED + 1), (1, 63)])


def lists_of(takes: list[list[int]], first: int, count: int) -> InvertedLists:
    words = np.array([word for take in takes for word in take], dtype=np.uint64)
    return inverted_lists(words, np.cumsum([0, *map(len, takes)]), first, count)


@given(TAKES, SETS)
def test_lists_are_the_runs_in_order_of_word_take_and_start(takes: list[list[int]], which: tuple[int, int]) -> None:
    found = lists_of(takes, *which)
    words = np.repeat(found.words, found.runs).tolist()
    stops = (found.start + found.length).tolist()
    runs = naive.word_runs([cut(np.array(take, np.uint64), *which).tolist() for take in takes])
    expected = sorted((word, take, start, stop) for take, start, stop, word in runs)
    assert list(zip(words, found.take.tolist(), found.start.tolist(), stops, strict=True)) == expected


@given(TAKES, SETS)
def test_the_frames_of_all_words_are_the_valid_frames(takes: list[list[int]], which: tuple[int, int]) -> None:
    found = lists_of(takes, *which)
    seen = [word for take in takes for word in cut(np.array(take, np.uint64), *which).tolist() if word != NO_WORD]
    assert dict(zip(found.words.tolist(), found.frames.tolist(), strict=True)) == {w: seen.count(w) for w in seen}


def test_an_invalid_frame_ends_a_run_and_is_in_none() -> None:
    found = lists_of([[5, 5, int(NO_WORD), 5]], 1, 14)
    assert (found.words.tolist(), found.start.tolist(), found.length.tolist()) == ([5], [0, 3], [2, 1])


@given(TAKES, SETS, st.randoms())
def test_runs_in_any_order_are_sorted_into_the_same_lists(
    takes: list[list[int]], which: tuple[int, int], random: Random
) -> None:
    found = lists_of(takes, *which)
    order = list(range(len(found.take)))
    random.shuffle(order)
    columns = (np.repeat(found.words, found.runs), found.take, found.start, found.length)
    again = InvertedLists.from_runs(*(column[np.array(order, np.int64)] for column in columns))
    for one, other in zip(again, found, strict=True):
        np.testing.assert_array_equal(one, other)
        assert one.dtype == other.dtype


def test_a_keyframe_stands_for_the_words_that_match_it() -> None:
    lists = lists_of([[0, 1, 2, 3, 7, 2]], 1, 3)
    assert lists.words[lists.matching(0b10, 0b10)].tolist() == [2, 3, 7]
    assert lists.words[lists.matching(0, 0)].tolist() == [0, 1, 2, 3, 7]
    with pytest.raises(ParameterError, match="within the bits of the mask"):
        lists.matching(2, 3)


@pytest.mark.parametrize(
    ("offsets", "which", "message"),
    [([0, 3], (1, 14), "rising from 0 to 2"), ([], (1, 14), "rising"), ([0, 2], (50, 20), "within bits 1 to 63")],
)
def test_what_does_not_fit_is_refused(offsets: list[int], which: tuple[int, int], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        inverted_lists(np.zeros(2, np.uint64), np.array(offsets, np.int64), *which)
