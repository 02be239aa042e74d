"""The counting of bits."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.bits import count_bits


@given(st.integers(0, 2**64 - 1))
def test_bits_are_counted_as_python_counts_them(word: int) -> None:
    assert count_bits(np.uint64(word)) == word.bit_count()
