"""Evidence of segments, against plain loops over frames."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.annotation.confidence import PRIORS
from kinedex.ops.annotation.decoding import STANDING_OUT
from kinedex.ops.annotation.evidence import evidence_of
from kinedex.ops.annotation.segments import Segment
from tests.oracles import evidence as oracle

NAMES = ("lead", "margin", "cost", "pace", "haste", "fixed", "support", "others", "covered")
FIXED = (0.5, 0.75)
spans = st.lists(st.tuples(st.integers(0, 20), st.integers(1, 20), st.integers(0, 1)), max_size=6)


@given(spans, spans)
@settings(max_examples=40, deadline=None)
def test_evidence_of_segments(first: list[tuple[int, int, int]], second: list[tuple[int, int, int]]) -> None:
    every = [sorted((start, start + length, label) for start, length, label in own) for own in (first, second)]
    takes = [[Segment(start, stop, label, 0.04, label, 0.5, 1.5) for start, stop, label in own] for own in every]
    found = evidence_of(NAMES, takes, np.array([0, 40, 80]), [7, 10], FIXED).tolist()
    for own in every:
        strengths = [FIXED[label] * 0.8 * math.sqrt(stop - start) for start, stop, label in own]
        for place, (start, stop, label) in enumerate(own):
            frames = stop - start
            alone = min(0.5 / -math.expm1(-1.5 / frames / STANDING_OUT), 1.0)
            pace = math.log(frames / (7, 10)[label])
            support = strengths[place] - oracle.strongest_rival(own, strengths, place)
            shared = oracle.others(own, own[place]), oracle.covered(own, 40)
            expected = [math.sqrt(1.5 / frames * alone), 0.5, 0.2, pace, abs(pace), FIXED[label], support, *shared]
            assert found.pop(0) == pytest.approx(expected)
    assert not found


def test_takes_without_segments_have_no_evidence() -> None:
    assert evidence_of(NAMES, [[], []], np.array([0, 40, 80]), [7], [0.5]).shape == (0, len(NAMES))


def test_a_segment_in_which_no_path_ends_has_evidence_too() -> None:
    (row,) = evidence_of(("cost",), [[Segment(0, 5, 0, math.nan, 0)]], np.array([0, 9]), [5], [0.5])
    assert np.isfinite(row).all()


def test_priors_name_evidence_that_there_is() -> None:
    for prior in PRIORS.values():
        found = evidence_of(prior.evidence, [[Segment(0, 5, 0, 0.1, 0, 0.5, 1.0)]], np.array([0, 9]), [5], [0.5])
        assert found.shape == (1, len(prior.centres)) == (1, len(prior.scales)) == (1, len(prior.slopes))
