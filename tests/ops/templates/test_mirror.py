"""Bits in another order."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.words import NO_WORD, bits, pack, rearrange


@given(st.data())
def test_bits_go_where_the_order_says_and_come_back(data: st.DataObject):
    features = data.draw(st.integers(1, 63))
    order = np.array(data.draw(st.permutations(range(features))))
    words = np.array(data.draw(st.lists(st.integers(0, (1 << features) - 1), max_size=8)), np.uint64)
    moved = rearrange(words, order)
    assert moved.tolist() == pack(bits(words, features)[:, order]).tolist()
    assert rearrange(moved, np.argsort(order)).tolist() == words.tolist()


def test_an_invalid_frame_stays_invalid():
    assert rearrange(np.array([1, NO_WORD], np.uint64), np.array([1, 0])).tolist() == [2, int(NO_WORD)]


@pytest.mark.parametrize("order", [[0, 0], [1, 2], list(range(64))])
def test_an_order_that_loses_bits_is_refused(order: list[int]):
    with pytest.raises(ParameterError, match="order must be a permutation"):
        rearrange(np.zeros(1, np.uint64), np.array(order))
