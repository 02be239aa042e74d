"""Numbers of intervals of words, against a twin that looks at one frame and one feature at a time."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.maps import interval_numbers as numbers_module
from kinedex.ops.maps.interval_numbers import interval_numbers, standardised
from kinedex.ops.words import NO_WORD

FEATURES = 11


def numbers_of(words: list[int | None], features: int) -> list[float]:
    """Return the numbers of one interval, frame by frame; None is an invalid frame."""
    shares, changes = [], []
    valid = [word for word in words if word is not None]
    for bit in range(features):
        on = [word >> bit & 1 for word in valid]
        shares.append(sum(on) / len(on) if on else math.nan)
        pairs = [
            (one >> bit & 1, other >> bit & 1)
            for one, other in pairwise(words)
            if one is not None and other is not None
        ]
        rate = sum(one != other for one, other in pairs) / len(pairs) if pairs else 0.0
        changes.append(math.sqrt(rate) if on else math.nan)
    return shares + changes


word = st.one_of(st.none(), st.integers(0, (1 << FEATURES) - 1))


@given(st.lists(st.lists(word, max_size=9), min_size=1, max_size=6), st.integers(1, 12))
def test_numbers_are_those_of_a_look_at_every_frame(takes: list[list[int | None]], block: int) -> None:
    words = np.array([NO_WORD if one is None else one for take in takes for one in take], np.uint64)
    bounds = np.concatenate([[0], np.cumsum([len(take) for take in takes])]).astype(np.int64)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(numbers_module, "_FRAMES", block)
        found = interval_numbers(words, bounds, FEATURES)
    np.testing.assert_allclose(found, [numbers_of(take, FEATURES) for take in takes], rtol=1e-12)


def test_unknown_features_have_no_numbers_and_stand_in_the_middle() -> None:
    words, bounds = np.array([3, 3, 0, 1], np.uint64), np.array([0, 2, 4])
    found = interval_numbers(words, bounds, 2, np.array([1, 3], np.uint64))
    assert np.isnan(found).tolist() == [[False, True, False, True], [False] * 4]
    assert standardised(found)[:, 1].tolist() == [0, 0]
    assert standardised(np.array([[1.0], [5.0]])).tolist() == [[-1], [1]]


def test_bounds_must_cover_the_words() -> None:
    with pytest.raises(ParameterError, match="ascending from 0 to 3"):
        interval_numbers(np.zeros(3, np.uint64), np.array([0, 2]), 4)
