"""The fitness kernels retrieve the clips in which a search finds hits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.keyframes.fitness import (
    CACHED_BITMAPS,
    TrainingFrames,
    find_bitmaps,
    fitness_of,
    new_workspace,
    retrieve,
    training_frames,
)
from kinedex.ops.keyframes.training_task import Individual
from kinedex.ops.ranges import from_axis
from kinedex.ops.search.gaps import UNBOUNDED
from kinedex.ops.search.inverted_lists import inverted_lists
from kinedex.ops.search.keyframe_search import keyframe_list, search_lists
from kinedex.ops.words import MAX_FEATURES, NO_WORD
from tests.oracles import learning as naive

WORDS = st.one_of(st.integers(0, 15), st.integers(0, 15), st.just(int(NO_WORD)))
LONG = st.lists(WORDS, min_size=1, max_size=12).flatmap(
    lambda poses: st.lists(st.integers(1, 40), min_size=len(poses), max_size=len(poses)).map(
        lambda lengths: [word for word, length in zip(poses, lengths, strict=True) for _ in range(length)]
    )
)


@st.composite
def queries(draw: st.DrawFn) -> Individual:
    count = draw(st.integers(1, 4))
    masks = np.array(draw(st.lists(st.integers(0, 15), min_size=count, max_size=count)), np.uint64)
    values = np.array(draw(st.lists(st.integers(0, 15), min_size=count, max_size=count)), np.uint64) & masks
    lows = draw(st.lists(st.integers(0, 90), min_size=count - 1, max_size=count - 1))
    spans = draw(st.lists(st.sampled_from([0, 1, 3, 20, 64, 150, UNBOUNDED]), min_size=count - 1, max_size=count - 1))
    highs = [low + span for low, span in zip(lows, spans, strict=True)]
    positions = np.arange(count, dtype=np.int64)
    return Individual(masks, values, positions, np.array(lows, np.int64), np.array(highs, np.int64))


def retrieved(frames: TrainingFrames, query: Individual) -> np.ndarray:
    """Return a Boolean per clip: true where the kernels find a hit in it."""
    space = new_workspace(frames, len(query))
    find_bitmaps(frames.on, frames.off, frames.valid, query.masks, query.values, len(query), space)
    retrieve(len(query), query.lows, query.highs, query.lows, query.highs, frames.first, 0, space)
    return space.hit


def by_search(clips: list[np.ndarray], query: Individual) -> list[bool]:
    """The general keyframe search, clip by clip."""
    inverted = inverted_lists(np.concatenate(clips), np.cumsum([0, *map(len, clips)]), 1, MAX_FEATURES)
    lists = [
        keyframe_list(inverted, mask, value)
        for mask, value in zip(query.masks.tolist(), query.values.tolist(), strict=True)
    ]
    takes = set(from_axis(search_lists(lists, query.gaps))[0].tolist())
    return [index in takes for index in range(len(clips))]


@given(st.lists(LONG, min_size=1, max_size=4), queries())
def test_clips_with_a_hit_are_those_of_the_search_and_of_the_definition(
    clips: list[list[int]], query: Individual
) -> None:
    arrays = [np.array(clip, np.uint64) for clip in clips]
    found = retrieved(training_frames(arrays, 4), query).tolist()
    masks, values = query.masks.tolist(), query.values.tolist()
    assert found == [naive.has_hit(clip, masks, values, query.gaps) for clip in clips]
    assert found == by_search(arrays, query)


@pytest.mark.parametrize("frames", [63, 64, 65, 127, 128, 129, 200])
def test_a_gap_may_be_as_long_as_the_clip_and_never_longer(frames: int) -> None:
    words = np.zeros(frames, np.uint64)
    words[0], words[-1] = 1, 2
    masks = values = np.array([1, 2], np.uint64)
    clips = training_frames([words, words[1:], words], 2)
    for low, high, expected in [(frames - 1, frames - 1, True), (frames, frames + 5, False), (0, frames - 2, False)]:
        query = Individual(masks, values, np.array([0, 1]), np.array([low]), np.array([high]))
        assert retrieved(clips, query).tolist() == [expected, False, expected]


@given(st.lists(st.booleans(), min_size=1, max_size=12), st.integers(0, 4095), st.sampled_from([0.5, 1.0, 2.0, 3.0]))
def test_fitness_agrees_with_the_printed_equation(positive: list[bool], hits: int, beta: float) -> None:
    hit = {i for i in range(len(positive)) if hits >> i & 1}
    wanted = {i for i, one in enumerate(positive) if one}
    found = fitness_of(len(hit & wanted), len(hit - wanted), len(wanted), beta)
    assert found == pytest.approx(naive.fitness(hit, wanted, beta)[2])


@given(st.lists(LONG, min_size=1, max_size=3), queries(), st.integers(0, 3))
def test_strict_clips_match_where_features_last(clips: list[list[int]], query: Individual, steady: int) -> None:
    arrays = [np.array(clip, np.uint64) for clip in clips]
    found = retrieved(training_frames(arrays, 4, [steady] * len(clips)), query).tolist()
    for clip, hit in zip(clips, found, strict=True):
        assert hit == naive.has_judged_hit(clip, query.masks.tolist(), query.values.tolist(), query.gaps, steady)
    plain = retrieved(training_frames(arrays, 4), query)
    assert (plain >= np.array(found)).all()
    with pytest.raises(ParameterError, match="steady"):
        training_frames(arrays, 4, [-1] * len(clips))


def test_cached_bitmaps_are_right_after_more_keyframes_than_there_is_room_for() -> None:
    words = np.arange(512, dtype=np.uint64)
    frames = training_frames([words], 9)
    space = new_workspace(frames, 3)
    for value in range(CACHED_BITMAPS + 40):
        values = np.array([7, value, (value + 1) % 512], np.uint64)
        masks = np.full(3, 511, np.uint64)
        find_bitmaps(frames.on, frames.off, frames.valid, masks, values, 3, space)
        for slot, one in zip(space.slots.tolist(), values.tolist(), strict=True):
            lanes = space.bitmaps[slot]
            assert [int(lane).bit_count() for lane in lanes] == [int(one // 64 == i) for i in range(8)]
            assert int(lanes[one // 64]) == 1 << one % 64


def test_what_is_no_query_and_what_are_no_clips() -> None:
    one = np.array([1], np.uint64)
    none = np.empty(0, np.int64)
    with pytest.raises(ParameterError, match="value must be 0 wherever mask is 0"):
        Individual(one, one + np.uint64(1), np.array([0]), none, none)
    with pytest.raises(ParameterError, match="gap"):
        Individual(np.tile(one, 2), np.tile(one, 2), np.array([0, 1]), np.array([3]), np.array([2]))
    with pytest.raises(ParameterError, match="clips"):
        training_frames([one, np.empty(0, np.uint64)], 2)
