"""Tests of the warnings about training clips."""

from __future__ import annotations

from kinedex.ops.templates.clip_checks import clip_remarks, far_clips


def test_nothing_is_said_of_clips_that_are_alike():
    assert clip_remarks("abcde", [30, 35, 28, 40, 31], [0.1, 0.12, 0.11, 0.1, 0.09]) == ()


def test_one_and_two_clips_are_few():
    assert clip_remarks(["a"], [30], [0.0]) == ("one clip only, which then is the template",)
    (message,) = clip_remarks(["a", "b"], [30, 31], [0.1, 0.1])
    assert message.startswith("2 clips only")


def test_lengths_beyond_what_a_distance_curve_can_stretch_are_named():
    (message,) = clip_remarks("abcd", [30, 30, 61, 14], [0.1] * 4)
    assert message == "clips of very different length, the median being 30 frames: c (61 frames), d (14 frames)"
    assert clip_remarks("abcd", [30, 30, 60, 15], [0.1] * 4) == ()


def test_a_lonely_clip_must_stand_out_in_every_way():
    assert far_clips([0.1, 0.1, 0.1, 0.1, 0.3]) == [4]
    assert far_clips([0.1, 0.1, 0.3]) == []  # of three, any could be meant
    assert far_clips([0.01, 0.01, 0.01, 0.01, 0.03]) == []  # three times the others, and still alike
    assert far_clips([0.2, 0.2, 0.2, 0.2, 0.28]) == []  # less than half as much again
    assert far_clips([0.1, 0.15, 0.05, 0.2, 0.25, 0.3]) == []  # within what the class varies
