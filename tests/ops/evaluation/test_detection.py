"""Segments judged by overlap."""

from __future__ import annotations

import math
from dataclasses import replace
from operator import attrgetter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.evaluation.detection import (
    average_precision,
    bootstrap,
    boundary_errors,
    overlap,
)
from kinedex.ops.evaluation.metrics import Counts
from kinedex.ops.intervals import TakeSegment
from tests.oracles import detection as oracle

RANGES = st.tuples(st.sampled_from("ab"), st.integers(0, 12), st.integers(1, 8)).map(
    lambda s: (s[0], s[1], s[1] + s[2])
)
FOUND = st.lists(st.tuples(RANGES, st.sampled_from([0.1, 0.5, 0.9])).map(lambda s: (*s[0], s[1])), max_size=7)


def found_at(take: str, start: int, stop: int, confidence: float) -> TakeSegment:
    return TakeSegment(take, "walk", start, stop, confidence=confidence)


def known_at(take: str, start: int, stop: int) -> TakeSegment:
    return TakeSegment(take, "walk", start, stop)


@given(FOUND, st.lists(RANGES, max_size=5, unique=True), st.sampled_from([0.1, 0.3, 0.5, 0.7, 1.0]))
def test_average_precision_is_that_of_the_naive_twin(
    found: list[tuple[str, int, int, float]], known: list[tuple[str, int, int]], threshold: float
) -> None:
    ours = average_precision([found_at(*one) for one in found], [known_at(*one) for one in known], threshold)
    assert ours == pytest.approx(oracle.average_precision(found, known, threshold), nan_ok=True)


def test_a_second_segment_on_the_same_motion_is_wrong() -> None:
    known = [known_at("take", 0, 10)]
    twice = [found_at("take", 0, 10, 0.9), found_at("take", 1, 10, 0.8)]
    assert average_precision(twice, known, 0.5) == 1.0
    assert average_precision(twice[::-1], known, 0.5) == 1.0
    assert average_precision([replace(twice[0], start=9), twice[1]], known, 0.5) == 0.5


def test_nothing_to_find_has_no_precision() -> None:
    assert math.isnan(average_precision([found_at("take", 0, 1, 1.0)], [], 0.5))
    assert average_precision([], [known_at("take", 0, 1)], 0.5) == 0.0


def test_overlap_is_intersection_over_union() -> None:
    assert overlap((0, 10), (5, 15)) == pytest.approx(1 / 3)
    assert overlap((0, 5), (5, 10)) == 0.0


def test_boundaries_are_compared_with_the_segment_that_overlaps_most() -> None:
    found = [found_at("take", 2, 11, 1.0), found_at("take", 11, 30, 1.0), found_at("other", 0, 10, 1.0)]
    errors = boundary_errors(found, [known_at("take", 0, 10), known_at("take", 50, 60)])
    assert errors.tolist() == [[2, 1]]
    assert boundary_errors([], [known_at("take", 0, 10)]).shape == (0, 2)


F1 = attrgetter("f1")


def test_the_interval_of_takes_that_are_alike_is_narrow_and_of_unlike_ones_wide() -> None:
    good, bad = Counts(10, 10, 10, 1, 1, 1, 1), Counts(0, 10, 10, 0, 1, 0, 1)
    assert bootstrap(F1, [good] * 5) == (1.0, 1.0)
    low, high = bootstrap(F1, [good] * 5 + [bad] * 5)
    assert 0.1 < low < 0.5 < high < 0.9
    assert bootstrap(F1, [good, bad]) == bootstrap(F1, [good, bad])
    assert all(math.isnan(edge) for edge in bootstrap(F1, []))


def test_what_makes_no_sense_is_refused() -> None:
    with pytest.raises(ParameterError, match="threshold must be"):
        average_precision([], [], 0.0)
    with pytest.raises(ParameterError, match="known must be"):
        average_precision([], [known_at("take", 3, 3)], 0.5)
    with pytest.raises(ParameterError, match="draws must be"):
        bootstrap(F1, [Counts()], draws=0)
