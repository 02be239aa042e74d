"""Tests of the confusion of classes: every label of either side is counted exactly once."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.evaluation.confusion import EXTRA, LACKING, NOTHING, Confusion, confusion, confusions
from kinedex.ops.intervals import TakeSegment
from tests.oracles import confusion as oracle

Spans = list[tuple[str, int, int]]
FRAMES = 12
NAMES = ("a", "b", NOTHING, EXTRA)
"""Classes may be called like what is no class."""


def of(mine: Spans, true: Spans, names: tuple[str, ...], frames: int) -> Confusion:
    manual, automatic = ([TakeSegment("t", *one) for one in side] for side in (true, mine))
    return confusion([(frames, manual, automatic)], names)


def table(found: Confusion) -> dict[tuple[str, str], float]:
    names = (*found.classes, "-", "+")
    return {
        (names[i], names[j]): value
        for i, row in enumerate(found.frames.tolist())
        for j, value in enumerate(row)
        if value
    }


@st.composite
def spans(draw: st.DrawFn) -> Spans:
    bounds = st.tuples(st.integers(0, FRAMES), st.integers(0, FRAMES)).filter(lambda two: two[0] < two[1])
    return [(label, *ends) for label, ends in draw(st.lists(st.tuples(st.sampled_from(NAMES), bounds), max_size=7))]


@settings(deadline=None)
@given(spans(), spans())
def test_it_is_what_frame_by_frame_gives(mine: Spans, true: Spans) -> None:
    found = of(mine, true, NAMES, FRAMES)
    assert table(found) == pytest.approx(
        {pair: float(value) for pair, value in oracle.confusion(mine, true, FRAMES).items()}
    )
    for index, name in enumerate(NAMES):
        in_row, in_column = (
            {frame for label, start, stop in side if label == name for frame in range(start, stop)}
            for side in (true, mine)
        )
        assert found.frames[index].sum() == pytest.approx(len(in_row))
        assert found.frames[:, index].sum() == pytest.approx(len(in_column))


def test_frames_are_confused_as_they_are_labelled() -> None:
    #       0 1 2 3 4 5 6 7 8 9
    # true  a a a a b b b . . .
    # mine  a a b b b . . . c c
    found = of([("a", 0, 2), ("b", 2, 5), ("c", 8, 10)], [("a", 0, 4), ("b", 4, 7)], ("a", "b", "c"), 10)
    assert (found.rows[-2:], found.columns[-2:]) == ((NOTHING, EXTRA), (NOTHING, LACKING))
    assert table(found) == {
        ("a", "a"): 2, ("a", "b"): 2, ("b", "b"): 1, ("b", "-"): 2, ("-", "c"): 2, ("-", "-"): 1,
    }  # fmt: skip


def test_a_second_wrong_label_is_none_of_a_frame_that_nobody_labelled() -> None:
    found = of([("a", 0, 4), ("b", 0, 4)], [("a", 0, 4)], ("a", "b"), 10)
    assert table(found) == {("a", "a"): 4, ("+", "b"): 4, ("-", "-"): 6}
    assert [(one.label, one.taken_for, one.frames, one.share) for one in confusions(found, 8)] == [(EXTRA, "b", 4, 1)]


def test_a_frame_of_two_classes_is_confused_in_parts() -> None:
    found = of([("b", 0, 4), ("c", 2, 4)], [("a", 0, 4)], ("a", "b", "c"), 4)
    assert table(found) == {("a", "b"): 3, ("a", "c"): 1, ("+", "b"): 1, ("+", "c"): 1}
    found = of([("a", 0, 4)], [("a", 0, 4), ("b", 0, 4)], ("a", "b"), 4)
    assert table(found) == {("a", "a"): 4, ("b", "+"): 4}


def test_a_class_called_like_nothing_is_a_class() -> None:
    found = of([(NOTHING, 0, 4)], [(NOTHING, 0, 2), ("a", 2, 4)], ("a", NOTHING), 6)
    assert table(found) == {(NOTHING, NOTHING): 2, ("a", NOTHING): 2, ("-", "-"): 2}
