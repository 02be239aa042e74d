"""Mounts and inertial worlds of sensors, with wrong frames, refusals, shared worlds, several takes and drift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial import rotations as r
from kinedex.ops.inertial.hand_eye import Options, Stream, StreamFit, calibrate
from kinedex.ops.inertial.rotations import Z_TO_Y
from tests.ops.inertial.test_disagreement import figure_7_14
from tests.ops.inertial.test_rotations import some
from tests.oracles import inertial as naive
from tests.plain_python import slow_as_python

UP = np.array([0.0, 0.0, 1.0])
WORLD = naive.product(naive.exp_deg((0, 0, 30)), naive.exp_deg((-90, 0, 0)))
MOUNT = naive.exp_deg((10, -20, 40))
FREE = Options(vertical_known=False)


def worked_example() -> tuple[np.ndarray, np.ndarray]:
    """Sensor and track of five frames."""
    track = np.stack([naive.exp_deg(v) for v in ((0, 0, 0), (90, 0, 0), (0, 60, 0), (0, 0, -120), (45, 45, 0))])
    sensor = [naive.product(naive.product(naive.inverse(WORLD), q), MOUNT) for q in track]
    return np.stack(sensor), track


def movement(count: int, seed: int) -> np.ndarray:
    """A smooth movement (count, 4) about all axes, at 40 Hz."""
    rng = np.random.default_rng(seed)
    t = np.arange(count)[:, None] / 40.0
    waves = [rng.normal(0, 0.6, 3) * np.sin((1.9 + 1.3 * k) * t + rng.uniform(0, 6, 3)) for k in range(4)]
    return r.exp(np.sum(waves, axis=0))


def hinge(axis: tuple[float, float, float], count: int, seed: int) -> np.ndarray:
    """A movement about one axis, ±60°, with 1° of noise about each axis."""
    rng = np.random.default_rng(seed)
    swing = np.radians(60.0) * np.sin(np.arange(count) / 11.0)
    return r.multiply(r.exp(swing[:, None] * np.array(axis)), r.exp(np.radians(rng.normal(0, 1, (count, 3)))))


def worn(track: np.ndarray, world: np.ndarray, mount: np.ndarray, limb: str = "lshank", take: str = "walk") -> Stream:
    """The stream of a perfect sensor on a limb."""
    sensor = r.multiply(r.conjugate(world), r.multiply(track, mount))
    return Stream(limb, take, np.arange(len(track)) / 40.0, sensor, track, np.ones(len(track), bool))


def upright_world(degrees: float) -> np.ndarray:
    return r.multiply(Z_TO_Y, r.exp(np.radians(degrees) * UP))


def with_error(stream: Stream, share: float, degrees: float, axis: tuple[float, float, float]) -> Stream:
    """The same stream where one part of the track drifts away."""
    count = int(share * len(stream.track))
    start = (len(stream.track) - count) // 3
    ramp = np.linspace(0, np.radians(degrees), count)[:, None] * np.array(axis) / np.linalg.norm(axis)
    track = stream.track.copy()
    track[start : start + count] = r.multiply(track[start : start + count], r.exp(ramp))
    return replace(stream, track=track)


def off(fit: StreamFit, world: np.ndarray, mount: np.ndarray) -> tuple[float, float]:
    return float(r.distance_deg(fit.q_global, world)), float(r.distance_deg(fit.q_mount, mount))


def test_the_worked_example_is_found_by_the_printed_way_and_by_ours() -> None:
    sensor, track = worked_example()
    assert sensor.round(4).tolist() == [
        [0.6644, 0.7182, -0.1951, -0.0681],
        [0.0059, 0.8457, -0.3502, -0.4025],
        [0.4253, 0.8726, 0.1590, 0.1800],
        [0.5012, 0.3002, 0.4778, -0.6561],
        [0.2080, 0.9753, -0.0331, -0.0666],
    ]
    world, mount = naive.park_martin(sensor, track, [(s, t) for s in range(5) for t in range(s)])
    np.testing.assert_allclose(world, naive.matrix(WORLD), atol=1e-12)
    np.testing.assert_allclose(mount, naive.matrix(MOUNT), atol=1e-12)
    (fit,) = calibrate([Stream("lshank", "example", np.arange(5.0), sensor, track, np.ones(5, bool))], FREE)
    assert max(off(fit, WORLD, MOUNT)) < 1e-12
    assert fit.observability == pytest.approx(0.2258, abs=5e-5)
    assert (fit.refused, fit.frames, fit.inliers) == ("", 5, 1.0)
    assert fit.tilt_deg == pytest.approx(30.0)
    assert "30.0° off gravity's" in fit.warning


def test_a_wrong_frame_of_the_worked_example_is_seen_whole() -> None:
    sensor, track = worked_example()
    track[3] = naive.product(track[3], naive.exp_deg((0, 50, 0)))
    found = [naive.error(sensor[k], track[k], WORLD, MOUNT, UP)[0] for k in range(5)]
    assert found == pytest.approx([0, 0, 0, 50, 0], abs=1e-5)


def test_the_printed_way_mirrors_or_fails_where_turns_share_a_plane() -> None:
    rng = np.random.default_rng(0)
    mirrored = 0
    for _ in range(200):
        beta = rng.normal(size=(3, 3)) * [1.0, 1.0, 0.02]
        alpha = beta + rng.normal(0, 0.05, (3, 3))
        m = beta.T @ alpha
        values, vectors = np.linalg.eigh(m.T @ m)
        mirrored += np.linalg.det(vectors @ np.diag(values**-0.5) @ vectors.T @ m.T) < 0
    assert 0.28 < mirrored / 200 < 0.48
    beta = rng.normal(size=(5, 3)) * [1.0, 1.0, 0.0]
    assert np.linalg.matrix_rank(beta.T @ beta) == 2  # so that its −1/2 does not exist


@slow_as_python
def test_figure_7_14_is_calibrated_from_its_own_wrong_stream() -> None:
    sensor, track = figure_7_14()
    (fit,) = calibrate([Stream("limb", "figure", np.arange(640.0), sensor, track, np.ones(640, bool))], FREE)
    e = r.distance_deg(r.multiply(fit.q_global, sensor), r.multiply(track, fit.q_mount))
    assert e[[0, 200, 300, 500, 599]] == pytest.approx([0, 70, 0, 50, 99.5], abs=0.5)


@slow_as_python
@pytest.mark.parametrize(("share", "most"), [(0.2, 0.2), (0.4, 0.3), (0.6, 0.6), (0.7, 0.8)])
@pytest.mark.parametrize("options", [FREE, Options()])
def test_one_long_error_hardly_moves_the_fit(share: float, most: float, options: Options) -> None:
    for seed in range(3):
        world, mount = upright_world(50.0 * seed), some(1, seed)[0]
        stream = with_error(worn(movement(2400, seed), world, mount), share, 120.0, (1.0, 0.5 * seed, -1.0))
        (fit,) = calibrate([stream], options)
        assert max(off(fit, world, mount)) < most
        assert 0.85 * (1 - share) < fit.inliers < 1.3 * (1 - share)


@settings(max_examples=5)
@given(st.integers(0, 2**32 - 1))
def test_any_world_and_mount_are_found_exactly(seed: int) -> None:
    world, mount = some(2, seed)
    (fit,) = calibrate([worn(movement(60, seed % 1000), world, mount)], FREE)
    assert max(off(fit, world, mount)) < 1e-8  # a motion that hardly turns about a second axis


def test_the_same_seed_gives_the_same_bytes() -> None:
    stream = with_error(worn(movement(80, 2), upright_world(10), MOUNT), 0.3, 90.0, (1.0, 0.0, 0.0))
    first, second = (calibrate([stream], Options(seed=4))[0] for _ in range(2))
    assert first.q_mount.tobytes() == second.q_mount.tobytes()
    assert first.q_global.tobytes() == second.q_global.tobytes()


def test_invalid_and_unknown_frames_are_left_out() -> None:
    stream = worn(movement(90, 3), upright_world(-70), MOUNT)
    sensor, track, valid = stream.sensor.copy(), stream.track.copy(), stream.valid.copy()
    sensor[:10], track[10:20], valid[20:30] = np.nan, np.nan, False
    track[20:30] = some(10)
    (fit,) = calibrate([replace(stream, sensor=sensor, track=track, valid=valid)])
    assert fit.frames == 60
    assert max(off(fit, upright_world(-70), MOUNT)) < 1e-9
    with pytest.raises(ParameterError, match="walk: lshank must be known by take and sensor together"):
        calibrate([replace(stream, valid=np.zeros(90, bool))])


def test_turns_about_one_axis_are_refused_unless_the_vertical_settles_them() -> None:
    level, upright = hinge((1.0, 0, 0), 200, 0), r.exp(np.sin(np.arange(200) / 11.0)[:, None] * np.array([0, 1.0, 0]))
    exact = r.exp(np.sin(np.arange(200) / 11.0)[:, None] * np.array([1.0, 0, 0]))
    world = upright_world(20)
    (fit,) = calibrate([worn(exact, world, MOUNT)], FREE)
    assert fit.refused == (
        "lshank: turns about one axis only, the mount cannot be found; "
        "use a take with other movements, `from: actor`, or `vertical: known`"
    )
    for options in (FREE, Options()):
        (fit,) = calibrate([worn(upright, world, MOUNT)], options)
        assert fit.refused == (
            "lshank: turns about the vertical only, the mount cannot be found; "
            "use a take with other movements, or `from: actor`"
        )
        assert fit.observability < 1e-6
    (fit,) = calibrate([with_error(worn(level, world, MOUNT), 0.2, 90.0, (0.3, 1.0, 0.2))])
    assert not fit.refused
    assert off(fit, world, MOUNT)[0] < 0.6
    assert off(fit, world, MOUNT)[1] < 0.6


def test_a_limb_at_rest_takes_the_world_of_one_that_moves() -> None:
    world, mounts = upright_world(100), some(2, 9)
    still = np.tile(some(1, 8), (80, 1))
    streams = [worn(movement(80, 5), world, mounts[0], "lshank"), worn(still, world, mounts[1], "torso")]
    shank, torso = calibrate(streams)
    assert max(off(shank, world, mounts[0])) < 1e-9
    assert max(off(torso, world, mounts[1])) < 1e-9
    assert torso.refused == torso.warning == ""
    assert torso.observability < 1e-6
    alone = calibrate(streams, Options(shared=False))
    assert not alone[0].refused
    assert alone[1].refused.startswith("torso: turns about the vertical only")


@slow_as_python
def test_takes_of_one_wearing_share_mounts_and_may_have_worlds_of_their_own() -> None:
    worlds = [upright_world(10), upright_world(-120), upright_world(77)]
    streams = [
        with_error(worn(movement(300, 20 + k), world, MOUNT, take=f"take{k}"), 0.3, 100.0, (1.0, k, 0.0))
        for k, world in enumerate(worlds)
    ]
    fits = calibrate(streams, Options(shared=False))
    for fit, world in zip(fits, worlds, strict=True):
        assert max(off(fit, world, MOUNT)) < 0.7
        np.testing.assert_array_equal(fit.q_mount, fits[0].q_mount)
    together = calibrate([worn(movement(200, k), worlds[0], MOUNT, take=f"take{k}") for k in range(2)])
    assert all(max(off(fit, worlds[0], MOUNT)) < 1e-9 for fit in together)


def test_a_mount_from_another_take_is_held() -> None:
    still = np.tile(some(1, 8), (60, 1))
    world, other = upright_world(-33), upright_world(60)
    (fit,) = calibrate([worn(still, world, MOUNT)], Options(shared=False), mounts={"lshank": MOUNT})
    np.testing.assert_array_equal(fit.q_mount, MOUNT)
    assert off(fit, world, MOUNT)[0] < 1e-9
    assert not fit.refused
    stream = worn(movement(60, 1), world, MOUNT)
    (fit,) = calibrate([stream], mounts={"lshank": MOUNT}, world=other)
    np.testing.assert_array_equal(fit.q_global, other)
    assert fit.inliers == 0.0
    assert np.isnan(fit.median_deg)


@slow_as_python
def test_drift_of_the_heading_is_taken_out_and_kept() -> None:
    stream = worn(movement(2400, 6), upright_world(40), MOUNT)
    drift = np.interp(stream.times, [0, 25, 60], [0.0, 6.0, -3.0])
    turned = r.multiply(r.exp(np.radians(-drift)[:, None] * UP), stream.sensor)
    broken = with_error(replace(stream, sensor=turned), 0.25, 90.0, (1.0, 1.0, 0.0))
    (before,), (after,) = (calibrate([broken], Options(drift=on)) for on in (False, True))
    assert after.median_deg < 0.2 < 1.0 < before.median_deg
    assert np.std(after.drift.at(stream.times) - drift) < 0.6
    np.testing.assert_allclose(
        r.distance_deg(after.drift.uncorrected(stream.times, after.drift.corrected(stream.times, turned)), turned),
        0.0,
        atol=1e-9,
    )


def test_what_cannot_be_calibrated_is_an_error() -> None:
    with pytest.raises(ParameterError, match="streams must be one or more"):
        calibrate([])
    stream = worn(movement(20, 1), WORLD, MOUNT)
    with pytest.raises(ParameterError, match="world must be None where every stream"):
        calibrate([stream], Options(shared=False), world=WORLD)
    with pytest.raises(ParameterError, match="sensor, track and valid must be of shapes"):
        replace(stream, valid=np.ones(3, bool))
