"""Clips are drawn evenly: each actor has its share, and short and long clips are among them."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.templates.templates import evenly_drawn
from tests.oracles import templates as naive

CLIPS = st.lists(st.tuples(st.integers(1, 9), st.sampled_from(["ann", "bob", "cid"])), min_size=1, max_size=40)


@given(CLIPS, st.integers(1, 50))
def test_drawing_equals_the_naive_twin(clips: list[tuple[int, str]], count: int):
    lengths, actors = [length for length, _ in clips], [actor for _, actor in clips]
    drawn = evenly_drawn(lengths, actors, count).tolist()
    assert drawn == naive.evenly_drawn(lengths, actors, count)
    assert drawn == sorted(set(drawn))
    assert len(drawn) == min(count, len(clips))


@given(CLIPS, st.integers(1, 40))
def test_every_actor_has_its_share_of_the_drawn_clips(clips: list[tuple[int, str]], count: int):
    lengths, actors = [length for length, _ in clips], [actor for _, actor in clips]
    drawn = evenly_drawn(lengths, actors, count)
    share, own = len(drawn) / len(clips), Counter(actors[place] for place in drawn)
    for actor, clips_of in Counter(actors).items():
        assert abs(own[actor] - share * clips_of) <= 1


def test_of_one_actor_clips_of_all_lengths_are_drawn():
    assert evenly_drawn([50, 10, 40, 20, 30, 60], ["ann"] * 6, 3).tolist() == [2, 3, 5]


def test_wrong_input_is_refused_in_words():
    with pytest.raises(ParameterError, match="actors must be as many as the 2 clips"):
        evenly_drawn([1, 2], ["ann"], 1)
    with pytest.raises(ParameterError, match="count must be at least 1"):
        evenly_drawn([1, 2], ["ann", "bob"], 0)
