"""The study of features of the root: turns and ways of a person of known motion, and how takes are counted."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.annotation.segments import Segment
from kinedex.ops.words import TakeWords
from studies.root_motion import Person, Takes, other_half, root_bits, scores
from tests.pipelines.labelled import motion

RATE = 30.0
NAMES = ["turns left", "turns right", "ahead", "back", "left", "right"]


def moves(facing: np.ndarray, along: float) -> list[str]:
    """Return the bits that are on in the middle of a walk of 1 m/s, by an angle to the left of where one faces."""
    way = facing + along
    place = np.cumsum(np.stack([np.sin(way), np.cos(way)], axis=1) / RATE, axis=0)
    found = root_bits(place, np.angle(np.exp(1j * facing)), RATE)
    assert found.shape == (len(facing), 6)
    return [name for name, on in zip(NAMES, found[len(facing) // 2].tolist(), strict=True) if on]


@pytest.mark.parametrize("heading", [0.0, 2.0, -3.0])
def test_bits_of_the_root_follow_turns_and_ways(heading: float) -> None:
    still = np.full(120, heading)
    assert moves(still, 0.0) == ["ahead"]
    assert moves(still, np.pi) == ["back"]
    assert moves(still, np.pi / 2) == ["left"]
    assert moves(still, -np.pi / 2) == ["right"]
    turning = heading + np.linspace(0.0, 2.0, 120)
    assert moves(turning, 0.0) == ["turns left", "ahead"]
    assert moves(turning[::-1].copy(), 0.0) == ["turns right", "ahead"]
    assert not root_bits(np.zeros((1, 2)), np.zeros(1), RATE).any()


def test_a_person_finds_the_takes_of_a_class_and_takes_are_counted() -> None:
    contents = ["walk", "walk", "kick", "kick", "walk", "kick"]
    own = [np.concatenate([motion("rest"), motion(one), motion("rest")]) for one in contents]
    offsets = np.cumsum([0, *map(len, own)])
    words = TakeWords(np.arange(6), offsets, np.concatenate(own))
    takes = Takes(words, 40, contents, ["a", "a", "a", "b", "b", "b"])
    found = Person(takes, "walk", frozenset("a"), 0).result()
    assert [bool(one) for one in found] == [True, True, False, False, True, False]
    assert scores(takes, "walk", found, [3, 4, 5]) == (1.0, 1.0, 1.0)
    something = [Segment(0, 5, 0, 0.0, 0)]
    assert scores(takes, "walk", [something] * 6, range(6)) == pytest.approx((2 / 3, 0.5, 1.0))
    assert scores(takes, "walk", [[]] * 6, range(6))[1:] == (0.0, 0.0)
    assert len(other_half("abcde")) == 3
