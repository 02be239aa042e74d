"""The takes that the parameters of method best are chosen on: clips laid end to end, and changed."""

from __future__ import annotations

import numpy as np

from kinedex.ops.words import NO_WORD, bits
from studies.decoding import HABITS, Clip, LaidOut, amid, laid_out, paced, with_habits


def take() -> LaidOut:
    clips = [Clip("anna", label, np.full(length, word, np.uint64)) for label, length, word in CLIPS]
    (found,) = laid_out(clips, 1, 9, 9)
    return found


CLIPS = [("hop", 14, 1), ("kick", 7, 2), ("kick", 21, 2)]


def labels(one: LaidOut) -> list[str]:
    """Of each frame."""
    found = ["none"] * len(one.words)
    for label, start, stop in one.truth:
        found[start:stop] = [label] * (stop - start)
    return found


def test_every_frame_of_clips_laid_end_to_end_has_the_label_of_its_clip() -> None:
    found = take()
    assert sorted(stop - start for _, start, stop in found.truth) == [7, 14, 21]
    assert [{"hop": 1, "kick": 2}[label] for label in labels(found)] == found.words.tolist()


def test_no_class_has_more_clips_than_asked_for() -> None:
    clips = [Clip("anna", "hop", np.zeros(3, np.uint64)) for _ in range(5)]
    assert [len(one.truth) for one in laid_out(clips, 2, most=3, a_take=2)] == [2, 1, 2, 1]


def test_another_pace_keeps_labels_with_their_frames() -> None:
    for pace, frames in ((1.4, 30), (1 / 1.4, 59)):
        found = paced(take(), pace)
        assert abs(len(found.words) - frames) <= 3
        assert [{"hop": 1, "kick": 2}[label] for label in labels(found)] == found.words.tolist()


def test_habits_hold_in_all_valid_frames() -> None:
    random = np.random.default_rng(0)
    words = random.integers(0, 2**20, 200).astype(np.uint64)
    words[50] = NO_WORD
    found = with_habits(LaidOut(words, ()), random, 20)
    assert found.words[50] == NO_WORD
    valid = np.arange(len(words)) != 50
    steady = np.ptp(bits(found.words[valid], 20).astype(int), axis=0) == 0
    assert steady.sum() == HABITS
    assert np.array_equal(bits(found.words[valid], 20)[:, ~steady], bits(words[valid], 20)[:, ~steady])


def test_what_lies_between_the_clips_has_no_label() -> None:
    others = np.full(1000, 7, np.uint64)
    found = amid(take(), others, 30.0, np.random.default_rng(0))
    assert [{"hop": 1, "kick": 2, "none": 7}[label] for label in labels(found)] == found.words.tolist()
    assert labels(found)[0] == "none"
    assert 3 * 45 <= labels(found).count("none") <= 3 * 150
