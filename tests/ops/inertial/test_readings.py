"""Readings of a sensor against each other: a unit or a direction that is wrong shows, rests and holes are found."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.inertial.readings import (
    bridge,
    compare_with_gravity,
    compare_with_orientation,
    rests,
    typical_length,
)
from kinedex.ops.inertial.rotations import conjugate, distance_deg, exp, log, multiply, rotate

RATE_HZ = 100.0
TIMES = np.arange(300) / RATE_HZ
Q = exp(np.stack([np.sin(2 * TIMES), 0.7 * np.sin(3 * TIMES + 1), TIMES], axis=1))
ACC = rotate(conjugate(Q), np.array([0.0, 0.0, 9.81]))
STEPS = log(multiply(conjugate(Q[:-1]), Q[1:])) * RATE_HZ
GYR = np.vstack([STEPS[:1], 0.5 * (STEPS[:-1] + STEPS[1:]), STEPS[-1:]])


def test_right_readings_agree_with_orientations_and_gravity() -> None:
    for correlation, ratio, turning in (compare_with_orientation(TIMES, GYR, Q), compare_with_gravity(TIMES, ACC, GYR)):
        assert correlation == pytest.approx(1, abs=0.02)
        assert ratio == pytest.approx(1, abs=0.05)
        assert 0.5 < turning < 5


def test_degrees_and_conjugates_show() -> None:
    for compare, other in ((compare_with_orientation, Q), (compare_with_gravity, None)):
        first = (TIMES, np.degrees(GYR), other) if other is not None else (TIMES, ACC, np.degrees(GYR))
        assert compare(*first)[1] == pytest.approx(57.3, rel=0.1)
    assert compare_with_orientation(TIMES, GYR, conjugate(Q))[0] < 0


def test_too_few_samples_show_nothing() -> None:
    assert np.isnan(compare_with_orientation(TIMES[:5], GYR[:5], Q[:5])).all()
    assert np.isnan(compare_with_gravity(TIMES[:5], ACC[:5], GYR[:5])).all()
    assert np.isnan(typical_length(np.full((3, 3), np.nan)))
    assert rests(TIMES, RATE_HZ, None, None) == []


def test_rests_are_found() -> None:
    acc, gyr = ACC.copy(), GYR.copy()
    acc[100:280], gyr[100:280] = ACC[100], 0
    ((start, stop),) = rests(TIMES, RATE_HZ, acc, gyr)
    assert start == pytest.approx(1.25, abs=0.26)
    assert stop == pytest.approx(2.55, abs=0.26)


def test_short_holes_are_bridged_and_long_ones_and_ends_stay() -> None:
    acc, q = ACC.copy(), Q.copy()
    for values in (acc, q):
        values[:2] = values[50:54] = values[100:120] = np.nan
    for found, known in ((bridge(TIMES, acc, 0.05), ACC), (bridge(TIMES, q, 0.05), Q)):
        missing = np.isnan(found).all(axis=1)
        assert missing.sum() == 22
        assert missing[:2].all()
        assert missing[100:120].all()
        np.testing.assert_allclose(found[50:54], known[50:54], atol=0.02)
    assert distance_deg(bridge(TIMES, q, 0.05)[50:54], Q[50:54]).max() < 0.2
    assert bridge(TIMES, ACC, 0.05) is ACC
