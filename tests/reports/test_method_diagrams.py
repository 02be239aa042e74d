"""Figures of methods side by side: numbers stand where they can be read, and one value is a point."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.evaluation.metrics import Counts
from kinedex.ops.intervals import TakeSegment
from kinedex.pipelines.evaluation.comparison_results import Threshold
from kinedex.pipelines.evaluation.folds import TestTake
from kinedex.reports.method_diagrams import STRIP_WIDTHS, bare_part, strips, sweeps, width_for_number

SPAN = st.tuples(st.integers(0, 20), st.integers(1, 20)).map(lambda two: (two[0], two[0] + two[1]))


@given(SPAN, st.lists(SPAN, max_size=4))
def test_a_number_stands_in_the_longest_part_that_nothing_covers(
    block: tuple[int, int], later: list[tuple[int, int]]
) -> None:
    covered = {frame for start, stop in later for frame in range(start, stop)}
    bare = [
        (start, stop)
        for start in range(*block)
        for stop in range(start + 1, block[1] + 1)
        if not covered & set(range(start, stop))
    ]
    longest = max((stop - start for start, stop in bare), default=0)
    start, stop = bare_part(block, later)
    assert stop - start == longest
    assert not longest or (start, stop) == next(one for one in bare if one[1] - one[0] == longest)


def test_two_digits_need_more_room_than_one() -> None:
    assert width_for_number(3, 0.02) == 700
    assert width_for_number(12, 0.02) == 1000
    assert width_for_number(3, 1.0) == STRIP_WIDTHS[0]
    assert width_for_number(3, 0.001) is None


def test_numbers_of_blocks_that_lie_on_each_other_do_not() -> None:
    test_take = TestTake("t", "g", (1,), 100, ())
    found = {"m": {"t": tuple(TakeSegment("t", *one) for one in (("a", 0, 50), ("b", 0, 50), ("a", 40, 90)))}}
    under, middle, over = strips("t", "best", test_take, found, {"a": 1, "b": 2}, 30.0, {}).strips[1].blocks
    assert under.room is None
    assert (middle.middle, over.middle) == (20, 65)


def test_a_sweep_of_one_threshold_is_a_point() -> None:
    counts = Counts(5, 10, 8, 1, 2, 1, 2)
    (one,) = sweeps([Threshold("m", 0.1, counts)])
    line = one.plots[0].lines[0]
    assert (line.path, line.point) == ("", (160.0, 75.0))
    assert one.plots[0].description == "frames, τ = 0.1: precision 0.50, recall 0.62, F-measure 0.56"
    (two,) = sweeps([Threshold("m", tau, counts) for tau in (0.1, 0.2)])
    assert two.plots[0].lines[0].path == "M0.0 75.0L320.0 75.0"
    assert two.plots[0].lines[0].point is None
