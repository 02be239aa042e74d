"""The agreement of words at an alignment, beside a twin that counts bits frame by frame."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.duplicates.alignments import LAG_FRAMES, Alignments, plausible, word_differences
from kinedex.ops.words import NO_WORD

words_of_take = st.lists(st.sampled_from([1, 2, 3, 7, int(NO_WORD)]), min_size=1, max_size=24)


def naive(first: list[int], second: list[int], shift: int, start: int, stop: int, frames: int) -> float:
    """Return the least share of differing bits of the intervals at an alignment."""

    def bits(one: int, two: int) -> int:
        return 8 if (one == int(NO_WORD)) != (two == int(NO_WORD)) else (one ^ two).bit_count()

    low, high = max(0, -shift, start - frames), min(len(second), len(first) - shift, stop + frames)
    length, best, equal = min(frames, high - low), math.inf, False
    for begin in range(low, high - length + 1):
        here = range(begin, begin + length)
        change = sum(bits(second[t], second[min(t + LAG_FRAMES, len(second) - 1)]) for t in here)
        differ = sum(bits(first[t + shift], second[t]) for t in here)
        equal |= length > 0 and not differ
        if change:
            best = min(best, differ / change)
    return 0.0 if equal and math.isinf(best) else best


def at(shift: int, start: int, stop: int, votes: int = 2) -> Alignments:
    """Return an alignment of the first two takes."""
    one, two, three, four, five = (np.array([value]) for value in (1, shift, votes, start, stop))
    return Alignments(np.array([0]), one, two, np.array([False]), three, four, five)


@given(words_of_take, words_of_take, st.integers(-5, 5), st.integers(1, 8))
def test_differences_are_those_of_the_twin(first: list[int], second: list[int], shift: int, frames: int) -> None:
    start = min(len(second) - 1, max(0, -shift))
    words, offsets = np.array([*first, *second], np.uint64), np.array([0, len(first), len(first) + len(second)])
    (found,) = word_differences(words, offsets, None, at(shift, start, start + 1), frames)
    assert found == pytest.approx(naive(first, second, shift, start, start + 1, frames))


def test_a_copy_is_plausible_and_other_motion_is_not() -> None:
    rng = np.random.default_rng(0)
    one, other = (np.repeat(rng.integers(0, 1 << 40, 60).astype(np.uint64), 3) for _ in range(2))
    offsets = np.array([0, 180, 360])
    for second, expected in ((one, True), (other, False)):
        kept = plausible(np.concatenate([one, second]), offsets, None, at(0, 60, 90), 30.0)
        assert kept.tolist() == [expected]
    assert not plausible(np.concatenate([one, one]), offsets, None, at(0, 60, 90, votes=1), 30.0).any()
