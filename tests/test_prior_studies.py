"""The studies of tracking: filters of points, the fit of points, and the figures of the tables."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.simulation.recording import Setup
from kinedex.ops.tracking.observations import Rays
from studies.camera_set import CHAIN, LIMBS, MEASURED, NEVER, filmed, without_failures
from studies.filters import butterworth, kalman_smoother, one_euro, savitzky_golay, without_gaps
from studies.point_fit import fitted_points
from studies.prior_archive import Clip
from studies.prior_choice import joined, line
from studies.priors import FLOOR, WITH, aims, mean, per_take, table
from studies.tracked_rows import CHAIN_ROW, POINT_FIT, WITHOUT, Tracked, point_rows
from tests.bodies import STANDING

RATE_HZ = 30.0
T = np.arange(200) / RATE_HZ


def _points(values: np.ndarray) -> np.ndarray:
    return np.repeat(values[:, None, None], 3, axis=2)


def test_gaps_are_filled_linearly_and_ends_are_held() -> None:
    points = _points(np.array([np.nan, 1.0, np.nan, 3.0, np.nan]))
    assert without_gaps(points)[:, 0, 0].tolist() == [1, 1, 2, 3, 3]


def test_butterworth_keeps_constants_and_halves_its_cutoff() -> None:
    assert butterworth(np.full(50, 2.5), 6.0, RATE_HZ) == pytest.approx(2.5)
    for frequency, gain in ((0.5, 1.0), (6.0, 0.5), (14.0, 0.0)):
        wave = np.sin(2 * np.pi * frequency * T)
        middle = slice(50, 150)
        kept = butterworth(wave, 6.0, RATE_HZ)[middle] @ wave[middle] / (wave[middle] @ wave[middle])
        assert kept == pytest.approx(gain, abs=0.02)


def test_savitzky_golay_keeps_cubics_to_the_ends() -> None:
    cubic = 1.0 - 2.0 * T + 3.0 * T**2 - 0.5 * T**3
    assert savitzky_golay(cubic, 11, 3) == pytest.approx(cubic, abs=1e-9)


def test_one_euro_lags_less_the_faster_a_point_moves() -> None:
    still, moving = _points(np.zeros(200)), _points(T)
    assert (one_euro(still, 1.0, 0.7, RATE_HZ) == 0).all()
    lags = [
        np.abs(one_euro(speed * moving, 1.0, 0.7, RATE_HZ) - speed * moving)[-1].max() / speed for speed in (1.0, 4.0)
    ]
    assert lags[1] < lags[0]


def test_the_smoother_predicts_through_gaps() -> None:
    moving = _points(2.0 * T)
    gappy = moving.copy()
    gappy[80:95] = np.nan
    assert kalman_smoother(gappy, RATE_HZ, 0.02, 15.0) == pytest.approx(moving, abs=5e-3)


def test_the_fit_of_points_finds_points_from_exact_rays() -> None:
    centres = np.array([[4.0, 2, 0], [0, 2, 4], [-4, 2, 0], [0, 2, -4]])
    true = np.stack([_points(0.3 * T)[:, 0], _points(0.3 * T)[:, 0] + [0.0, 0.4, 0.0]], axis=1)[:20]
    ways = true[:, None] - centres[None, :, None]
    rays = Rays(centres, np.full(4, 1000.0), ways / np.linalg.norm(ways, axis=3, keepdims=True), np.ones((20, 4, 2)))
    start = true + np.random.default_rng(0).normal(0, 0.02, true.shape)
    start[5] = np.nan
    found = fitted_points(rays, start, [(0, 1)], RATE_HZ)
    assert np.linalg.norm(found - true, axis=2).max() < 0.005


def test_filmed_takes_have_errors_in_and_outside_failures_in_every_table() -> None:

    truth = np.repeat(np.array([STANDING[joint] for joint in CHAIN.joints], float)[None], 60, axis=0)
    one = filmed("squat1Reps", truth, RATE_HZ, 4)
    assert one.errors_mm(truth) == pytest.approx(0.0)
    assert one.failing.any()
    rows = {name: {one.name: track} for name, track in point_rows(one).items()}
    assert all(np.isfinite(tracks[one.name].errors_mm).all() for tracks in rows.values())
    assert mean(rows[POINT_FIT], [one], False) < 60
    for name, error in ((CHAIN_ROW, 3.0), (WITHOUT, 2.0), (WITH, 1.0), (FLOOR, 0.4)):
        rows[name] = {one.name: Tracked(np.full(60, error), 0.1)}
    assert any(line.startswith("| + restart | 2.0 | 0.0 | 2 | 2.0 | 2.0 | nan |") for line in table(rows, [one], {}))
    assert any("0.50" in line for line in aims(rows, [one]))
    assert any("62%" in line for line in aims(rows, [one]))
    assert any(line.startswith("| squat1Reps | 60 | 2.0, 2.0 | 1.0, 1.0 |") for line in per_take(rows, [one]))


def test_without_failures_keypoints_are_near_those_of_a_detector_that_never_fails() -> None:
    truth = np.repeat(np.array([STANDING[joint] for joint in CHAIN.joints], float)[None], 60, axis=0)
    one, calm = filmed("squat1Reps", truth, RATE_HZ, 4), filmed("squat1Reps", truth, RATE_HZ, 4, Setup(failures=NEVER))
    found = without_failures(one)
    assert np.array_equal(found.pixels[~one.failing], calm.pixels[~one.failing])
    apart = np.linalg.norm(found.pixels - calm.pixels, axis=-1)[one.failing]
    assert np.median(apart) < 15  # noise of two draws, 4 px an axis each
    assert not calm.failing.any()


def test_limbs_and_measured_joints_are_those_of_the_design() -> None:
    assert len(MEASURED) == 12
    assert [len(part) for part in (*LIMBS.arms, *LIMBS.legs)] == [2, 2, 4, 4]


def test_clips_are_joined_onto_the_one_before_and_faded() -> None:

    standing = np.array([STANDING[joint] for joint in CHAIN.joints], float)
    still = np.repeat(standing[None], 30, axis=0)
    turned = still @ np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]).T + [3.0, 0.0, 2.0]
    words = np.zeros(30, np.uint64)
    take = joined([Clip("a", "bd", "walk", words, still), Clip("b", "bd", "walk", words, turned)])
    assert take == pytest.approx(np.repeat(standing[None], 50, axis=0), abs=1e-9)


def test_a_choice_reports_takes_that_got_worse() -> None:
    one = filmed("bd_walk", np.repeat(np.array([[STANDING[j] for j in CHAIN.joints]], float), 60, axis=0), RATE_HZ, 4)
    row = line("guard", {one.name: np.full(60, 3.0)}, {one.name: np.full(60, 1.0)}, [one])
    assert row == ["guard", "3.00", "3", "3.00", "3.00", "1", "+2.0 (bd_walk)"]
