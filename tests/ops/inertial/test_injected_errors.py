"""Errors that are put into limbs: their kinds, sizes and times, and what simulated annotators mark."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.inertial.injected_errors import (
    DRIFT_DEG,
    KINDS,
    SUBTLE_DEG,
    TWIST_DEG,
    annotate,
    as_other_side,
    error_times,
    inject,
    labelled_runs,
    own_threshold,
)
from kinedex.ops.inertial.rotations import conjugate, distance_deg, exp, multiply, rotate
from kinedex.ops.inertial.sensor_model import seeded_generator

pytest.importorskip("scipy")
RATE = 40.0
AXIS = np.array([0.0, 1.0, 0.0])


def motion(frames: int = 4000) -> np.ndarray:
    t = np.arange(frames) / RATE
    return exp(np.stack([1.2 * np.sin(1.3 * t), 0.9 * np.sin(2.1 * t + 1), 1.5 * np.sin(0.7 * t + 2)], axis=1))


def test_errors_come_and_last_as_drawn() -> None:
    runs = error_times(40_000, RATE, seeded_generator(1))
    seconds = np.array(runs) / RATE
    assert 0.5 <= seconds[0, 0] <= 2.5
    lengths, between = seconds[:-1, 1] - seconds[:-1, 0], seconds[1:, 0] - seconds[:-1, 1]
    assert ((lengths > 0.45) & (lengths < 3.05)).all()
    assert ((between > 1.95) & (between < 6.05)).all()
    assert 120 < len(runs) < 250


def test_every_kind_is_as_large_as_it_says() -> None:
    truth = motion(20_000)
    other = multiply(truth, exp(np.array([0.0, 0.0, 1.5])))
    broken, errors = inject(truth, RATE, AXIS, seeded_generator(2), other)
    off = distance_deg(truth, broken)
    inside = np.zeros(len(truth), bool)
    for one in errors:
        inside[one.start : one.stop] = True
        own = off[one.start : one.stop]
        if one.kind in ("drift", "subtle", "twist"):
            low, high = {"drift": DRIFT_DEG, "subtle": SUBTLE_DEG, "twist": TWIST_DEG}[one.kind]
            assert low <= one.degrees <= high
            assert own.max() == pytest.approx(one.degrees, abs=1e-6)
        if one.kind == "drift":
            np.testing.assert_allclose(own, np.linspace(0, one.degrees, len(own)), atol=1e-6)
        if one.kind == "twist":
            turn = multiply(conjugate(truth[one.start : one.stop]), broken[one.start : one.stop])
            np.testing.assert_allclose(rotate(turn, AXIS), np.tile(AXIS, (len(own), 1)), atol=1e-9)
        if one.kind == "freeze":
            assert distance_deg(broken[one.start], broken[one.start : one.stop]).max() < 1e-6
        if one.kind == "swap":
            np.testing.assert_array_equal(broken[one.start : one.stop], other[one.start : one.stop])
    assert (broken[~inside] == truth[~inside]).all()
    counts = {kind: sum(one.kind == kind for one in errors) for kind in KINDS}
    assert min(counts.values()) >= 0.1 * len(errors), "all five are equally likely"
    assert all(one.kind != "swap" for one in inject(truth, RATE, AXIS, seeded_generator(2))[1])


def test_unknown_frames_stay_unknown() -> None:
    truth = motion(2000)
    truth[100:300] = np.nan
    broken, _ = inject(truth, RATE, AXIS, seeded_generator(3), motion(2000))
    assert np.isnan(broken[100:300]).all()
    assert np.isfinite(broken[300:]).all()


def test_the_other_side_joins_the_long_axes() -> None:
    other, theirs = motion(10), np.array([-1.0, 0.0, 0.0])
    for mine in (np.array([1.0, 0.0, 0.0]), AXIS, theirs):
        np.testing.assert_allclose(rotate(as_other_side(other, theirs, mine), mine), rotate(other, theirs), atol=1e-9)


def test_annotators_see_what_is_above_their_threshold() -> None:
    truth = motion(8000)
    broken, _ = inject(truth, RATE, AXIS, seeded_generator(5))
    exact = labelled_runs(truth, broken, 20.0)
    off = distance_deg(truth, broken)
    assert all(off[start:stop].min() >= 20.0 for start, stop in exact)
    assert (off >= 20.0).sum() == sum(stop - start for start, stop in exact)
    runs = annotate(truth, broken, RATE, 20.0, seeded_generator(6))
    assert 0.8 * len(exact) <= len(runs) <= len(exact)
    assert runs != exact
    near = [min(abs(start - other) for other, _ in exact) for start, _ in runs]
    assert np.median(near) <= 0.3 * RATE
    assert 15.0 <= own_threshold(seeded_generator(1, "a")) <= 30.0
    assert annotate(truth, broken, RATE, 20.0, seeded_generator(6)) == runs
