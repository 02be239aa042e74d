"""Offsets by least squares on whitened errors: smooth noise, wrong frames, drift, and what is not determined."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.inertial import rotations as r
from kinedex.ops.inertial import whitened_offset as wo
from kinedex.ops.inertial.sensor_model import smooth_noise
from kinedex.ops.inertial.time_offset import FineSearch, refine_offset
from tests.ops.inertial.test_time_offset import fine
from tests.oracles import inertial as naive


def noisy(offset: float, seed: int, ppm: float = 0.0, seconds: float = 8.0, wrong: float = 0.0) -> FineSearch:
    """A limb whose track has smooth noise of 2°, whose heading is off by 1° and whose mount by 2°."""
    limb = fine(offset, ppm, seconds, wrong)
    noise = np.radians(2.0) / np.sqrt(3.0) * smooth_noise(len(limb.predicted), 40.0, 0.5, np.random.default_rng(seed))
    turned = r.multiply(r.exp(np.radians([0.0, 0.0, 1.0])), limb.predicted)
    return limb._replace(predicted=r.multiply(turned, r.exp(noise + np.radians([2.0, 0.0, 0.0]))))


def test_smooth_noise_does_not_move_the_clock() -> None:
    errors = []
    for seed in range(4):
        limbs = [noisy(0.0041, seed, wrong=0.2), noisy(0.0041, seed + 50)]
        first = refine_offset(limbs, 0.0)
        found, ppm = wo.whitened_offset(limbs, first)
        assert ppm == 0.0
        errors.append((1000 * abs(first - 0.0041), 1000 * abs(found - 0.0041)))
    before, after = np.max(errors, axis=0)
    assert after < 0.15 < before


def test_a_drift_is_found_with_the_offset() -> None:
    limb = noisy(0.002, 1, ppm=60.0, seconds=60.0)
    offset, ppm = wo.whitened_offset([limb], 0.004, 0.0, True)
    assert offset == pytest.approx(0.002, abs=2e-4)
    assert ppm == pytest.approx(60.0, abs=4.0)


def test_the_first_offset_stays_where_nothing_determines_a_better_one() -> None:
    limb = noisy(0.0, 0)
    assert wo.whitened_offset([], 0.3, 5.0) == (0.3, 5.0)
    assert wo.whitened_offset([limb], 90.0) == (90.0, 0.0)  # nothing overlaps
    still = FineSearch(limb.take_times, *(np.tile(one[:1], (len(one), 1)) for one in (limb.predicted,)), *limb[2:])
    still = still._replace(sensor=np.tile(limb.sensor[:1], (len(limb.sensor), 1)))
    assert wo.whitened_offset([still], 0.3) == (0.3, 0.0)
    sparse = limb._replace(take_times=limb.take_times[::50], predicted=limb.predicted[::50])
    assert wo.whitened_offset([sparse._replace(take_times=sparse.take_times[:5])], 0.0) == (0.0, 0.0)
    alone, _ = wo.whitened_offset([limb], 0.003)
    beside, _ = wo.whitened_offset([limb, still], 0.003)
    assert beside == pytest.approx(alone, abs=5e-4)


def test_long_takes_are_compared_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    limb = noisy(0.0041, 3, seconds=60.0)
    monkeypatch.setattr(wo, "MAX_FRAMES", 1000)
    monkeypatch.setattr(wo, "BLOCK", 100)
    assert len(wo._blocks(limb).take_times) == 1000
    assert wo.whitened_offset([limb], 0.0)[0] == pytest.approx(0.0041, abs=5e-4)


def test_the_steps_agree_with_one_matrix_of_all_frames() -> None:
    limbs = [noisy(0.004, 1, seconds=3.0), noisy(0.004, 2, seconds=4.0, wrong=0.2)]
    rows = [wo._rows(limb, 0.001, 20.0, True) for limb in limbs]
    kept = [one for one in rows if one is not None]
    solutions = wo._solve(kept, 2)
    assert solutions is not None
    model = wo._noise_model(kept)
    wanted = naive.whitened_steps([tuple(one) for one in kept], 2, model, wo.WEIGHTINGS, wo.OUTLIER)
    np.testing.assert_allclose(np.concatenate([solutions[0], solutions[1][2:]]), wanted, rtol=1e-4, atol=1e-6)


def test_frames_follow_each_other_until_a_gap() -> None:
    times = np.array([0.0, 0.1, 0.2, 0.4, 0.5, 0.9])
    assert wo._follows(times).tolist() == [0, 1, 2, 0, 1, 0]
    assert wo._follows(times[:1]).tolist() == [0]
