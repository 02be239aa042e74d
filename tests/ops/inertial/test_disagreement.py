"""Errors between a take and a sensor: degrees, swing and twist, runs above τ."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial import disagreement as d
from kinedex.ops.inertial import rotations as r
from tests.ops.inertial.test_rotations import some
from tests.oracles import inertial as naive

AXIS = np.array([0.2, -1.0, 0.4])
ALL = np.ones(640, bool)


def figure_7_14() -> tuple[np.ndarray, np.ndarray]:
    """The streams of the demonstration of Section 7.7: a sensor, and a track with two errors."""
    t = np.arange(640.0)
    sensor = r.exp(np.stack([0.9 * np.sin(t / 60), 0.7 * np.sin(t / 43 + 1), 1.1 * np.sin(t / 77 + 2)], axis=1))
    track = sensor.copy()
    for axis, start, top, degrees in (((1.0, 2, 0), 50, 200, 70.0), ((0.0, -1, 1), 400, 600, 100.0)):
        frames = np.arange(start, top + 1)
        ramp = math.radians(degrees) * (frames - start) / (top - start)
        track[frames] = r.multiply(sensor[frames], r.exp(ramp[:, None] * np.array(axis) / np.linalg.norm(axis)))
    return sensor, track


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_error_swing_and_twist_agree_with_matrices_and_make_the_error(seed: int) -> None:
    sensor, track, (world, mount) = some(3, seed), some(3, seed + 1), some(2, seed + 2)
    found = d.frame_errors(sensor, track, world, mount, AXIS)
    for k in range(3):
        wanted = naive.error(sensor[k], track[k], world, mount, AXIS)
        assert [column[k] for column in found] == pytest.approx(wanted, abs=2e-4)
    half = np.radians(np.stack(found) / 2)
    np.testing.assert_allclose(np.cos(half[0]), np.cos(half[1]) * np.cos(half[2]), atol=1e-14)


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1))
def test_errors_do_not_change_when_both_worlds_turn(seed: int) -> None:
    sensor, track, (world, mount, one, other) = some(5, seed), some(5, seed + 1), some(4, seed + 2)
    turned = r.multiply(r.multiply(one, world), r.conjugate(other))
    before = d.frame_errors(sensor, track, world, mount, AXIS)
    after = d.frame_errors(r.multiply(other, sensor), r.multiply(one, track), turned, mount, AXIS)
    np.testing.assert_allclose(after, before, atol=1e-10)


def test_with_wrong_offsets_tracking_errors_cannot_be_seen() -> None:
    sensor, track = figure_7_14()
    one = np.array([1.0, 0, 0, 0])
    clean = np.ones(640, bool)
    clean[51:201] = clean[401:601] = False
    curve = lambda left, right: r.distance_deg(sensor, r.multiply(r.multiply(left, track), right))  # noqa: E731
    left, right = r.exp(np.radians([60.0, -80.0, 0.0])), r.exp(np.radians([0.0, 50.0, 70.0]))
    assert curve(one, one)[[0, 200, 300, 500, 600]] == pytest.approx([0, 70, 0, 50, 100], abs=1e-6)
    np.testing.assert_allclose(curve(left, one)[clean], 100.0, atol=1e-9)
    assert curve(left, one)[200] == pytest.approx(146.9, abs=0.05)
    clean[[50, 400]] = False  # the first frames of the ramps
    both = curve(left, right)[clean]
    assert (both.min(), both.max(), both.std()) == pytest.approx((63.8, 135.4, 20.5), abs=0.05)


def test_runs_are_grown_closed_and_dropped_in_this_order() -> None:
    e = np.array([0, 50, 30, 0, 60, 0, 0, 0, 70, 70, 20, 46, 0, 30], float)
    valid = np.ones(14, bool)
    starts = lambda **rules: [run[:2] for run in d.wrong_runs(e, valid, 10.0, d.RunRules(**rules))]  # noqa: E731
    assert starts() == [(1, 2), (4, 5), (8, 10), (11, 12)]
    assert starts(low_deg=25.0) == [(1, 3), (4, 5), (8, 10), (11, 12)]
    assert starts(low_deg=15.0) == [(1, 3), (4, 5), (8, 12)]
    assert starts(gap_s=0.2) == [(1, 5), (8, 12)]
    assert starts(low_deg=25.0, gap_s=0.1) == [(1, 5), (8, 12)]
    assert starts(low_deg=25.0, gap_s=0.1, min_s=0.5) == []
    assert starts(min_s=0.2) == [(8, 10)]
    valid[9] = False
    assert starts() == [(1, 2), (4, 5), (8, 9), (11, 12)]
    first = d.wrong_runs(e, valid, 10.0, d.RunRules(gap_s=0.1, low_deg=15.0))
    assert first[-1] == (8, 12, 70.0, pytest.approx((70 + 20 + 46) / 3))


@settings(max_examples=40)
@given(
    st.lists(st.tuples(st.sampled_from([0.0, 30.0, 50.0, math.nan]), st.booleans()), min_size=1, max_size=30),
    st.sampled_from([None, 20.0]),
    st.integers(0, 3),
    st.integers(0, 3),
)
def test_runs_agree_with_frame_by_frame(
    frames: list[tuple[float, bool]], low: float | None, gap: int, least: int
) -> None:
    degrees, valid = (np.array(column) for column in zip(*frames, strict=True))
    rules = d.RunRules(45.0, low, gap / 25.0, least / 25.0)
    counted = (valid & np.isfinite(degrees)).tolist()
    wanted = naive.wrong_runs(degrees.tolist(), counted, 45.0, low, gap, least)
    assert [run[:2] for run in d.wrong_runs(degrees, valid, 25.0, rules)] == wanted


def test_jumps_are_runs_of_their_own() -> None:
    degrees = np.array([1.0, np.nan, 3.0, 4.0])
    found = d.jump_runs(degrees, np.array([False, True, True, False]))
    assert found == [(1, 3, 3.0, 3.0)]
    assert np.isnan(d.jump_runs(degrees, np.array([False, True, False, False]))[0][2:]).all()


def test_auto_threshold_follows_the_noise_and_not_the_errors() -> None:
    rng = np.random.default_rng(0)
    quiet, noisy = np.abs(rng.normal(0, 2, 4000)), np.abs(rng.normal(15, 6, 4000))
    noisy[:1000] = 120.0
    assert d.auto_tau([(quiet, np.ones(4000, bool))]) == 15.0
    assert 35 < d.auto_tau([(noisy, np.ones(4000, bool))]) < 60
    noisy[:3900] = np.nan
    assert d.auto_tau([(noisy, np.ones(4000, bool))]) > 15
    assert d.auto_tau([]) == 15.0


def test_a_limb_of_which_only_the_axis_is_known_is_judged_by_its_swing() -> None:
    rng = np.random.default_rng(3)
    sensor, world = some(200, 4), some(1, 5)[0]
    along = np.array([0.6, 0.0, 0.8])
    directions = r.rotate(r.multiply(world, sensor), along)
    directions[:60] = r.rotate(r.exp(rng.normal(size=(60, 3))), directions[:60])
    directions[60] = np.nan
    found = d.mount_direction(sensor, directions, world)
    assert np.degrees(np.arccos(found @ along)) < 0.5
    e = d.direction_errors(sensor, directions, world, along)
    assert np.nanmax(e[61:]) < 1e-5
    assert np.isnan(e[60])
    np.testing.assert_allclose(d.mount_direction(sensor[61:], directions[61:], world), along, atol=1e-12)
    with pytest.raises(ParameterError, match="known together in some frame"):
        d.mount_direction(sensor, directions * np.nan, world)


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        ({"tau_deg": -1.0}, "tau_deg must be 0 or more"),
        ({"low_deg": 50.0}, r"low_deg must be from 0 to τ \(45\)"),
        ({"gap_s": math.nan}, "gap_s must be 0 or more"),
        ({"min_s": -0.1}, "min_s must be 0 or more"),
    ],
)
def test_rules_out_of_their_domain_are_refused(rules: dict[str, float], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        d.RunRules(**rules)


def test_wrong_shapes_and_an_axis_without_direction_are_refused() -> None:
    one = np.array([1.0, 0, 0, 0])
    with pytest.raises(ParameterError, match="both of shape"):
        d.frame_errors(some(3), some(4), one, one, AXIS)
    with pytest.raises(ParameterError, match="axis must be a vector that is not 0"):
        d.frame_errors(some(3), some(3), one, one, np.zeros(3))
