"""The nearest example of an interval is the clip that it repeats, in step with it."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.arrays import U64
from kinedex.ops.errors import ParameterError
from kinedex.ops.templates.nearest_clip import nearest_clips
from kinedex.ops.words import NO_WORD

RANDOM = np.random.default_rng(3)
ONE, OTHER = (RANDOM.integers(0, 1 << 40, 12, dtype=np.uint64) for _ in range(2))


def words(*parts: U64) -> U64:
    return np.concatenate(parts)


def test_the_clip_that_an_interval_repeats_is_found_with_its_frames() -> None:
    slow = np.repeat(OTHER, 2)
    (found,) = nearest_clips([ONE, OTHER], [slow], 40)
    assert (found.clip, found.cost) == (1, 0.0)
    assert found.frames.tolist() == np.repeat(np.arange(12), 2).tolist()


def test_a_clip_that_fits_twice_is_repeated_and_held_between() -> None:
    rest = np.full(5, OTHER[0])
    (found,) = nearest_clips([ONE], [words(rest, ONE, rest, ONE)], 40)
    assert found.frames[5:17].tolist() == list(range(12))
    assert found.frames[22:].tolist() == list(range(12))
    assert found.frames[17:22].tolist() == [11] * 5
    assert found.frames[:5].tolist() == [0] * 5


def test_an_interval_shorter_than_half_a_clip_is_warped_as_a_whole() -> None:
    short, invalid = ONE[::4].copy(), np.full(3, NO_WORD)
    first, second = nearest_clips([OTHER, ONE], [short, invalid], 40)
    assert first.clip == 1
    assert np.isinf(first.cost)
    assert len(first.frames) == len(second.frames) == 3
    assert np.all(np.diff(first.frames) >= 0)


def test_without_a_clip_there_is_nothing_to_compare() -> None:
    assert nearest_clips([ONE], [], 40) == []
    with pytest.raises(ParameterError, match="at least one clip"):
        nearest_clips([], [ONE], 40)
