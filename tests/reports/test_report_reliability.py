"""The reliability diagram of the report: which segments are right, and where its bars are."""

from __future__ import annotations

from dataclasses import replace

import pytest

from kinedex.ops.intervals import TakeSegment
from kinedex.reports.annotation_page import annotation_page
from kinedex.reports.reliability import SIDE, reliability_diagram
from tests.pipelines.study import study


def test_bars_are_as_high_as_shares_of_right_segments() -> None:
    data = study()
    take = data.takes[0].name
    manual = (TakeSegment(take, "walk", 0, 10), TakeSegment(take, "walk", 10, 20), TakeSegment(take, "kick", 20, 40))
    automatic = (
        TakeSegment(take, "walk", 2, 22, 0.1, "walk", 0.9),  # two manual ones cover most of it
        TakeSegment(take, "kick", 35, 50, 0.1, "kick", 0.95),  # a third of its frames
        TakeSegment(take, "kick", 22, 30, 0.1, "kick", 0.3),
        TakeSegment(take, "kick", 22, 30, 0.1, "kick", None),
    )
    figure = reliability_diagram(replace(data, automatic=automatic, manual=manual))
    assert figure is not None
    assert (figure.segments, figure.right, figure.auroc) == (3, 2, 0.0)
    low, high = figure.bars
    assert (low.bucket.low, low.bucket.share, low.height) == (0.2, 1.0, SIDE)
    assert (high.bucket.count, high.bucket.share, high.y) == (2, 0.5, SIDE / 2)
    assert high.says == pytest.approx((SIDE * 0.925, SIDE * 0.075))


def test_without_ground_truth_there_is_no_diagram() -> None:
    data = study()
    assert reliability_diagram(replace(data, manual=())) is None
    assert 'id="reliability"' not in annotation_page(replace(data, manual=()))


def test_a_page_with_ground_truth_has_the_diagram() -> None:
    data = study()
    sure = tuple(replace(one, confidence=0.7) for one in data.automatic)
    assert 'id="reliability"' in annotation_page(replace(data, automatic=sure))
