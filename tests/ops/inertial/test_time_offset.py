"""Offsets between the clocks of takes and sensors: correlation of angular speeds, fine search, drift, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial import rotations as r
from kinedex.ops.inertial import time_offset as to
from tests.oracles import inertial as naive
from tests.plain_python import slow_as_python


def turning(times: np.ndarray, seed: int) -> np.ndarray:
    """Orientations (T, 4) of a movement that does not repeat itself, at any times."""
    rng = np.random.default_rng(seed)
    waves = [
        rng.normal(0, 0.5, 3) * np.sin(rng.uniform(1, 9) * times[:, None] + rng.uniform(0, 6, 3)) for _ in range(8)
    ]
    return r.exp(np.sum(waves, axis=0))


def speeds(offset: float, seed: int, seconds: float = 20.0, start: float = 0.0) -> to.Speeds:
    """Speeds of one movement at 40 Hz by a take and 100 Hz by a sensor whose clock is ahead by an offset."""
    take_times = start + np.arange(round(seconds * 40)) / 40.0
    sensor_times = start - 1.0 + np.arange(round((seconds + 3.0) * 100)) / 100.0
    take = r.angular_speed(take_times, turning(take_times, seed))
    sensor = r.angular_speed(sensor_times, turning(sensor_times, seed))
    return to.Speeds(*take, sensor[0] + offset, sensor[1])


@settings(max_examples=8)
@given(st.floats(-30, 30), st.integers(0, 100))
def test_offsets_are_found_whatever_their_sign(offset: float, seed: int) -> None:
    found = to.find_offset([speeds(offset, seed), speeds(offset, seed + 1000)])
    assert not found.refused
    assert found.offset_s == pytest.approx(offset, abs=0.0025)
    assert found.correlation > 0.95 > found.next_best


def test_correlation_agrees_with_one_lag_at_a_time() -> None:
    rng = np.random.default_rng(0)
    take, sensor = rng.normal(size=700), rng.normal(size=900)
    take[:300] *= 0.01
    found = to.correlation(take, sensor)
    np.testing.assert_allclose(found, naive.correlation(take, sensor, 600, 0.1), atol=1e-12)
    assert (found > -1.0).sum() < 450


def test_a_take_with_errors_is_found_by_all_limbs_together() -> None:
    limbs = [speeds(0.7, seed) for seed in range(3)]
    spoilt = limbs[0].take.copy()
    spoilt[200:500] = np.random.default_rng(1).uniform(0, 30, 300)
    spoilt[600] = 4000.0
    spoilt[650:660] = np.nan
    found = to.find_offset([limbs[0]._replace(take=spoilt), *limbs[1:]])
    assert found.offset_s == pytest.approx(0.7, abs=0.005)


def test_stillness_gait_and_other_movements_are_refused() -> None:
    still = speeds(0.0, 1)
    nothing = to.find_offset([still._replace(take=np.zeros_like(still.take))])
    assert "overlap by less than 3 s of movement" in nothing.refused
    assert np.isnan(nothing.offset_s)
    other = to.find_offset([speeds(0.0, 1)._replace(sensor=speeds(0.0, 7).sensor)], longest_s=1.0)
    assert "is it the recording of this take" in other.refused
    times = np.arange(0, 20, 0.01)
    steps = 1.0 + np.sin(2 * np.pi * times)
    gait = to.Speeds(times, steps, times + 0.2, steps)
    assert "`longest_s: <seconds>` excludes far ones" in to.find_offset([gait]).refused
    near = to.find_offset([gait], longest_s=0.5)
    assert not near.refused
    assert near.offset_s == pytest.approx(0.2, abs=0.001)
    unknown = to.find_offset([still._replace(sensor=np.full_like(still.sensor, np.nan))])
    assert unknown.refused == "no limb has angular speeds of take and sensor"
    assert to.find_offset([speeds(0.0, 1, seconds=2.0)]).refused


def fine(offset: float, ppm: float = 0.0, seconds: float = 20.0, wrong: float = 0.0) -> to.FineSearch:
    """A limb at 40 Hz with a perfect sensor at 100 Hz, and a part of the track that is wrong."""
    take_times = np.arange(round(seconds * 40)) / 40.0
    sensor_times = np.arange(-2.0, seconds + 2.0, 0.01) + 0.003
    at_take = turning(take_times, 3)
    count = int(wrong * len(at_take))
    at_take[100 : 100 + count] = r.multiply(at_take[100 : 100 + count], r.exp(np.array([0.0, 2.0, 1.0])))
    clock = sensor_times * (1.0 + 1e-6 * ppm) + offset
    return to.FineSearch(take_times, at_take, clock, turning(sensor_times, 3))


@pytest.mark.parametrize("offset", [0.0834, -0.0621])
def test_the_fine_search_is_right_to_a_tenth_of_a_millisecond(offset: float) -> None:
    limb = fine(offset, seconds=8.0, wrong=0.3)
    assert to.refine_offset([limb], 0.0) == pytest.approx(offset, abs=1e-4)
    assert to.refine_offset([limb._replace(predicted=np.empty((0, 4)))], 0.5) == 0.5
    assert to.refine_offset([limb], 90.0) == 90.0  # nothing overlaps


def test_the_cost_of_an_offset_agrees_with_interpolated_frames() -> None:
    limb = fine(0.01, seconds=2.0, wrong=0.5)
    times = np.delete(limb.sensor_times, slice(250, 270))
    sensor = np.delete(limb.sensor, slice(250, 270), axis=0)
    total, frames = to._clipped_cost(limb.take_times, limb.predicted, times, sensor, 0.004, 0.0, 0.05)
    there, valid = r.interpolate(times, sensor, limb.take_times + 0.004)
    e = np.minimum(r.distance_deg(there[valid], limb.predicted[valid]), 10.0)
    assert frames == valid.sum() < len(valid)
    assert total == pytest.approx((e**2).sum(), rel=1e-9)


@slow_as_python
def test_a_clock_that_drifts_is_followed() -> None:
    limb = fine(0.02, ppm=80.0, seconds=400.0, wrong=0.2)
    offset, ppm = to.find_drift([limb], 0.03)
    assert offset == pytest.approx(0.02, abs=3e-4)
    assert ppm == pytest.approx(80.0, abs=1.5)
    offset, ppm = to.find_drift([fine(0.02, seconds=20.0)], 0.0)
    assert (offset, ppm) == (pytest.approx(0.02, abs=1e-4), 0.0)


def test_speeds_come_from_the_gyroscope_or_from_orientations() -> None:
    times = np.arange(5.0)
    assert to.sensor_speed(times, np.tile([3.0, 0.0, 4.0], (5, 1)), None)[1].tolist() == [5.0] * 5
    assert len(to.sensor_speed(times, None, turning(times, 0))[1]) == 4
    with pytest.raises(ParameterError, match="angular velocities or orientations"):
        to.sensor_speed(times, None, None)


def test_no_limbs_and_a_longest_offset_of_nothing_are_refused() -> None:
    with pytest.raises(ParameterError, match="limbs must be one or more"):
        to.find_offset([])
    with pytest.raises(ParameterError, match="longest_s must be positive"):
        to.find_offset([speeds(0, 1)], longest_s=0.0)
