"""The usual postures that motions stand out from."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.annotation.background import background, log_likelihoods
from kinedex.ops.errors import ParameterError
from kinedex.ops.words import NO_WORD, bits, pack
from tests.oracles.decoding import likelihood

FEATURES = 4
WORDS = st.lists(st.integers(0, 2**FEATURES - 1), min_size=1, max_size=30)
POSTURES = st.lists(st.tuples(*[st.floats(0.0, 1.0)] * FEATURES), min_size=1, max_size=4)


def test_without_a_split_it_is_the_share_of_valid_frames() -> None:
    words = np.array([0b001, 0b011, NO_WORD], np.uint64)
    assert background([words, words[:1]], 2, splits=0).tolist() == [[1.0, 1 / 3]]
    assert background([], 2).tolist() == [[0.5, 0.5]]
    assert background([np.array([NO_WORD])], 2).tolist() == [[0.5, 0.5]]


def test_standing_and_lying_are_two_postures() -> None:
    random = np.random.default_rng(0)
    standing = random.random((300, 8)) < np.array([0.95] * 4 + [0.05] * 4)
    lying = random.random((200, 8)) < np.array([0.05] * 4 + [0.95] * 4)
    words = pack(np.concatenate([standing, lying]).astype(np.uint8))
    found = background([words], 8, splits=1)
    upright = found[np.argmax(found[:, 0])], found[np.argmin(found[:, 0])]
    for posture, frames in zip(upright, (standing, lying), strict=True):
        assert posture == pytest.approx(frames.mean(axis=0), abs=0.02)


def test_there_are_no_more_postures_than_words() -> None:
    assert len(background([np.array([1, 1, 1], np.uint64)], 2)) == 1
    assert len(background([np.array([1, 2, 2], np.uint64)], 2)) == 2
    assert len(background([np.array([0, 1, 2, 3], np.uint64)], 2)) == 4


@settings(deadline=None, max_examples=60)
@given(WORDS, st.randoms())
def test_the_order_of_frames_does_not_matter(words: list[int], random: object) -> None:
    shuffled = list(words)
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    found = [background([np.array(one, np.uint64)], FEATURES) for one in (words, shuffled)]
    assert np.array_equal(*found)
    assert np.all((found[0] >= 0) & (found[0] <= 1))


@settings(deadline=None, max_examples=60)
@given(WORDS, POSTURES)
def test_likelihoods_are_the_mean_over_the_postures(words: list[int], postures: list[tuple[float, ...]]) -> None:
    taken = np.array(words, np.uint64)
    found = log_likelihoods(taken, np.array(postures), 0.05)
    for word, value in zip(bits(taken, FEATURES).tolist(), found.tolist(), strict=True):
        expected = sum(likelihood(word, one, 0.05) for one in postures) / len(postures)
        assert value == pytest.approx(math.log(expected), abs=1e-9)


def test_splits_are_checked() -> None:
    with pytest.raises(ParameterError, match="splits must be"):
        background([], 2, splits=-1)
