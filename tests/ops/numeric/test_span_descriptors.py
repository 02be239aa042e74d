"""A descriptor from sums is that of the frames of the span."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.arrays import F64
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.errors import ParameterError
from kinedex.ops.numeric.channels import Channels, channels
from kinedex.ops.numeric.span_descriptors import SpanSums
from tests.ops.numeric.motions import RATE_HZ, in_a_row

FOUND = channels(in_a_row(["raise left", "walk", "bow"], [30, 25, 35]), JOINTS, RATE_HZ)
SUMS = SpanSums(FOUND, RATE_HZ)


def described(found: Channels, start: int, stop: int) -> F64:
    """Describe a span frame by frame."""
    first, last = (start + 3, stop - 3) if stop - start >= 12 else (start, stop)
    frames = slice(first, last)
    numbers = np.concatenate([found.pose[frames], np.log(found.speeds[frames] + 0.05), found.root[frames]], axis=1)
    turn = found.yaw[last - 1] - found.yaw[first]
    way = found.root[frames][:, [0, 2]].sum(axis=0) / RATE_HZ
    return np.concatenate(
        [numbers.mean(axis=0), numbers.std(axis=0), [turn, abs(turn)], way, [np.log((stop - start) / RATE_HZ)]]
    )


@settings(max_examples=50, deadline=None)
@given(st.tuples(st.integers(0, 90), st.integers(0, 90)).filter(lambda pair: pair[0] < pair[1]))
def test_a_span_is_described_by_its_frames(span: tuple[int, int]) -> None:
    start, stop = span
    found = SUMS.describe(np.array([start]), np.array([stop]))[0]
    np.testing.assert_allclose(found, described(FOUND, start, stop), atol=1e-6)


@pytest.mark.parametrize(("start", "stop"), [(5, 5), (-1, 4), (80, 91)])
def test_spans_outside_of_the_take_are_refused(start: int, stop: int) -> None:
    with pytest.raises(ParameterError, match="frames of 0 to 90"):
        SUMS.describe(np.array([start]), np.array([stop]))
