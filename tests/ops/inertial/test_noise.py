"""Errors of sensors: their sizes, their order, and that a seed repeats them."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial.rotations import distance_deg, exp
from kinedex.ops.inertial.sensor_model import (
    ChannelErrors,
    Clock,
    Grade,
    SensorMotion,
    field_in_sensor,
    gyroscope_rates,
    magnetic_field,
    measured,
    random_clock,
    random_mount,
    seeded_generator,
    smooth_noise,
    soft_tissue,
    specific_force,
    with_errors,
)

pytest.importorskip("scipy")
RATE = 100.0
MANY = 40_000


def still(count: int = MANY) -> SensorMotion:
    return SensorMotion(RATE, np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)), np.zeros((count, 3)))


def test_a_grade_without_errors_reads_what_is() -> None:
    t = np.arange(300) / RATE
    q = exp(np.stack([np.sin(t), np.cos(2 * t), t], axis=1))
    motion = SensorMotion(RATE, q, np.ones((300, 3)))
    read = measured(motion, Grade(), magnetic_field(), seeded_generator(0, "a"))
    np.testing.assert_array_equal(read.acc, specific_force(q, motion.acceleration))
    np.testing.assert_array_equal(read.gyr, gyroscope_rates(q, RATE))
    np.testing.assert_array_equal(read.mag, field_in_sensor(q, magnetic_field()))
    assert not read.clipped.any()
    assert not read.lost.any()


def test_white_noise_has_its_density() -> None:
    read, _ = with_errors(np.zeros((MANY, 3)), ChannelErrors(density=0.003), RATE, seeded_generator(1))
    assert read.std() == pytest.approx(0.003 * np.sqrt(RATE / 2), rel=0.02)
    spectrum = np.square(np.abs(np.fft.rfft(read[:, 0]))).mean() * 2 / (RATE * MANY)
    assert np.sqrt(spectrum) == pytest.approx(0.003, rel=0.02), "units per √Hz, one-sided"


def test_bias_walks_by_the_root_of_time() -> None:
    ends = [
        with_errors(np.zeros((2500, 3)), ChannelErrors(walk=0.01), RATE, seeded_generator(k))[0][-1] for k in range(200)
    ]
    assert np.std(ends) == pytest.approx(0.01 * np.sqrt(25.0), rel=0.1)
    starts = [
        with_errors(np.zeros((1, 3)), ChannelErrors(bias=0.2), RATE, seeded_generator(k))[0][0] for k in range(400)
    ]
    assert np.std(starts) == pytest.approx(0.2, rel=0.1)


def test_readings_beyond_the_range_are_clipped_and_flagged_and_all_are_rounded() -> None:
    values = np.array([[0.0, 19.9, 0.0], [0.0, 25.0, -30.0], [0.234, 0.0, 0.0]])
    read, over = with_errors(values, ChannelErrors(range=20.0, resolution=0.1), RATE, seeded_generator(0))
    np.testing.assert_allclose(read, [[0.0, 19.9, 0.0], [0.0, 20.0, -20.0], [0.2, 0.0, 0.0]], atol=1e-12)
    assert over.tolist() == [False, True, False]


def test_scales_and_axes_are_constant() -> None:
    values = np.random.default_rng(0).standard_normal((50, 3))
    read, _ = with_errors(values, ChannelErrors(scale=0.01, axis_deg=0.5), RATE, seeded_generator(4))
    mixed = np.linalg.lstsq(values, read, rcond=None)[0]
    np.testing.assert_allclose(values @ mixed, read, atol=1e-12)
    assert 0.001 < np.abs(mixed - np.eye(3)).max() < 0.06


def test_soft_tissue_turns_smoothly_by_its_angle() -> None:
    rotations = soft_tissue(MANY, RATE, 2.0, seeded_generator(2))
    angle = distance_deg(rotations, np.array([1.0, 0, 0, 0]))
    assert np.sqrt(np.mean(angle**2)) == pytest.approx(2.0, rel=0.1)
    power = np.square(np.abs(np.fft.rfft(smooth_noise(MANY, RATE, 3.0, seeded_generator(3))[:, 0])))
    above = np.fft.rfftfreq(MANY, 1 / RATE) > 6.0
    assert power[above].sum() < 0.02 * power.sum()


def test_gaps_and_magnets_come_as_often_as_they_should() -> None:
    grade = Grade(gaps_per_minute=6.0, gap_s=0.5, magnets_per_minute=3.0, magnet_ut=80.0, magnet_s=2.0)
    read = measured(still(), grade, magnetic_field(), seeded_generator(5))
    assert np.isnan(read.acc[read.lost]).all()
    assert np.isfinite(read.gyr[~read.lost]).all()
    share = 6.0 / 60.0 * 0.25  # gaps a second, times their mean length
    assert read.lost.mean() == pytest.approx(share, rel=0.5)
    apart = np.linalg.norm(read.mag[~read.lost] - magnetic_field(), axis=1)
    assert 70.0 < apart.max() < 200.0, "two may pass at a time"
    assert 0.02 < (apart > 20.0).mean() < 0.3


def test_a_seed_repeats_every_number_and_names_change_them() -> None:
    grade = Grade(acc=ChannelErrors(density=0.1), gaps_per_minute=9.0, gap_s=0.2, soft_tissue_deg=2.0)
    first, again, other = (
        measured(still(500), grade, magnetic_field(), seeded_generator(7, "take", sensor)) for sensor in ("a", "a", "b")
    )
    assert first.acc.tobytes() == again.acc.tobytes()
    assert first.acc.tobytes() != other.acc.tobytes()
    noisy = measured(still(500), Grade(acc=grade.acc), magnetic_field(), seeded_generator(7, "take", "a"))
    np.testing.assert_allclose((noisy.acc - [0, 0, 9.81])[~first.lost].std(), 0.1 * np.sqrt(50), rtol=0.1)
    with pytest.raises(ParameterError, match="at least 0"):
        seeded_generator(-1)


def test_clocks_go_there_and_back() -> None:
    clock = random_clock(Grade(clock_offset_s=2.0, clock_ppm=30.0), seeded_generator(3))
    assert abs(clock.offset_s) <= 2.0
    t = np.linspace(0, 600, 7)
    np.testing.assert_allclose(clock.to_take(clock.of_take(t)), t, atol=1e-9)
    assert Clock(0.5, 100.0).of_take(np.array([100.0]))[0] == pytest.approx(100.51)
    assert np.linalg.norm(random_mount(seeded_generator(1))) == pytest.approx(1.0)
