"""Runs of words and features, against their naive twins."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.search.runs import feature_runs, word_runs
from kinedex.ops.words import NO_WORD
from tests.oracles import runs as naive

# few distinct words, so that runs are long enough to be runs
WORDS = st.sampled_from([0, 1, 2, 3, 2**13, 2**39 | 5, int(NO_WORD)])
TAKES = st.lists(st.lists(WORDS, max_size=12), max_size=5)


def laid_end_to_end(takes: list[list[int]]) -> tuple[np.ndarray, np.ndarray]:
    words = np.array([word for take in takes for word in take], dtype=np.uint64)
    return words, np.cumsum([0, *map(len, takes)]).astype(np.int64)


@given(TAKES)
def test_word_runs_are_those_of_the_naive_twin(takes: list[list[int]]) -> None:
    found = word_runs(*laid_end_to_end(takes))
    assert list(zip(*(column.tolist() for column in found), strict=True)) == naive.word_runs(takes)


@given(TAKES, st.sampled_from([1, 14, 40, 63]))
def test_feature_runs_are_those_of_the_naive_twin(takes: list[list[int]], features: int) -> None:
    found = feature_runs(*laid_end_to_end(takes), features)
    assert list(zip(*(column.tolist() for column in found), strict=True)) == naive.feature_runs(takes, features)


def test_a_run_does_not_cross_into_the_next_take() -> None:
    found = word_runs(*laid_end_to_end([[7, 7], [7], [], [7, 8]]))
    assert found.take.tolist() == [0, 1, 3, 3]
    assert found.start.tolist() == [0, 0, 0, 1]
    assert found.stop.tolist() == [2, 1, 1, 2]
    assert found.word.tolist() == [7, 7, 7, 8]


def test_a_feature_that_stays_on_is_one_run_whatever_the_others_do() -> None:
    found = feature_runs(*laid_end_to_end([[0b01, 0b11, 0b01, 0b11]]), 2)
    assert found.feature.tolist() == [1, 2, 2]
    assert found.start.tolist() == [0, 1, 3]
    assert found.stop.tolist() == [4, 2, 4]


def test_an_invalid_frame_cuts_a_run_and_is_in_none() -> None:
    invalid = int(NO_WORD)
    words = laid_end_to_end([[invalid, 7, 7, invalid, 7], [invalid]])
    found = word_runs(*words)
    assert found.take.tolist() == [0, 0]
    assert found.start.tolist() == [1, 4]
    assert found.stop.tolist() == [3, 5]
    assert feature_runs(*words, 1).start.tolist() == [1, 4]


@pytest.mark.parametrize("takes", [[], [[]], [[], []]])
def test_no_frames_have_no_runs(takes: list[list[int]]) -> None:
    words, offsets = laid_end_to_end(takes)
    assert all(len(column) == 0 for column in (*word_runs(words, offsets), *feature_runs(words, offsets, 40)))


@pytest.mark.parametrize("offsets", [[], [1, 3], [0, 2], [0, 2, 1, 3], [[0, 3]]])
def test_offsets_must_fit_the_words(offsets: list[int]) -> None:
    words = np.zeros(3, np.uint64)
    with pytest.raises(ParameterError, match="offsets must be"):
        word_runs(words, np.array(offsets, np.int64))
    with pytest.raises(ParameterError, match="offsets must be"):
        feature_runs(words, np.array(offsets, np.int64), 40)


def test_features_must_fit_a_word() -> None:
    with pytest.raises(ParameterError, match="features must be from 1 to 63, got 64"):
        feature_runs(np.zeros(1, np.uint64), np.array([0, 1]), 64)
