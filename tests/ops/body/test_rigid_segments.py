"""Hidden markers are placed by the pose of their segment, the least squares fit to those that are seen."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kinedex.ops.body.rigid_segments import (
    fit_poses,
    is_spread,
    leverage,
    mean_shape,
    placed_by_segment,
    placed_by_shape,
)
from kinedex.ops.errors import ParameterError

COORDINATES = st.floats(-1, 1)
TEMPLATES = st.integers(3, 6).flatmap(lambda n: arrays(float, (n, 3), elements=COORDINATES))
SEEDS = st.integers(0, 2**32 - 1)


def moved(template: np.ndarray, frames: int, seed: int, far: float = 5.0) -> np.ndarray:
    """A template that turns and travels smoothly, (N, 3, T)."""
    random = np.random.default_rng(seed)
    axis = random.normal(size=3)
    axis /= np.linalg.norm(axis)
    cross = np.cross(np.eye(3), axis)
    angles = random.uniform(0.1, 3) * np.sin(np.linspace(0, random.uniform(1, 7), frames))
    turns = [np.eye(3) + np.sin(a) * cross + (1 - np.cos(a)) * cross @ cross for a in angles]
    shifts = far * np.stack([np.sin(np.linspace(0, k, frames)) for k in random.uniform(0, 4, 3)], axis=1)
    return np.stack([template @ turn.T + shift for turn, shift in zip(turns, shifts, strict=True)], axis=2)


def by_quaternion(template: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The naive twin: one frame, by the largest eigenvector of a 4 × 4 matrix (B. Horn, 1987)."""
    a, b = template - template.mean(axis=0), places - places.mean(axis=0)
    s = sum(np.outer(p, q) for p, q in zip(a, b, strict=True))
    skew = np.array([s[1, 2] - s[2, 1], s[2, 0] - s[0, 2], s[0, 1] - s[1, 0]])
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[0, 1:], matrix[1:, 0] = np.trace(s), skew, skew
    matrix[1:, 1:] = s + s.T - np.trace(s) * np.eye(3)
    w, x, y, z = np.linalg.eigh(matrix)[1][:, -1]
    turn = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    return turn, places.mean(axis=0) - turn @ template.mean(axis=0)


def is_wide(template: np.ndarray) -> bool:
    extents = np.linalg.svd(template - template.mean(axis=0), compute_uv=False)
    return bool(extents[1] > 0.1)


@given(TEMPLATES, SEEDS, st.floats(0, 0.05))
def test_poses_are_those_of_a_naive_twin(template: np.ndarray, seed: int, noise: float) -> None:
    if not is_wide(template):
        return
    places = moved(template, 5, seed)
    places += np.random.default_rng(seed).normal(0, noise * 0.2, places.shape)
    found = fit_poses(template, places)
    for t in range(5):
        turn, shift = by_quaternion(template, places[:, :, t])
        np.testing.assert_allclose(found.rotations[t], turn, atol=1e-6)
        np.testing.assert_allclose(found.shifts[t], shift, atol=1e-6)


@given(TEMPLATES, SEEDS)
def test_a_hidden_marker_of_a_rigid_segment_is_where_it_was(template: np.ndarray, seed: int) -> None:
    if not is_wide(template):
        return
    marker = np.array([0.3, -0.2, 0.4])
    whole = moved(np.vstack([template, marker]), 60, seed)
    hidden, wanted = whole.copy(), np.zeros(60, bool)
    wanted[20:45] = True
    hidden[-1][:, wanted] = np.nan
    found = placed_by_segment(hidden, len(template), wanted, 1e-6)
    np.testing.assert_allclose(found.positions[:, wanted], whole[-1][:, wanted], atol=1e-9)
    assert np.isnan(found.positions[:, ~wanted]).all()
    assert (found.markers[wanted] >= 3).all()
    assert not found.markers[~wanted].any()


@given(SEEDS)
def test_noise_of_markers_moves_a_hidden_one_by_little_more(seed: int) -> None:
    template = np.array([[0.1, 0, 0], [0, 0.12, 0], [-0.1, 0, 0.02], [0, -0.1, 0.05], [0.05, 0.05, 0.1]])
    whole = moved(template, 80, seed)
    noisy = whole + np.random.default_rng(seed).normal(0, 0.002, whole.shape)
    wanted = (np.arange(80) >= 30) & (np.arange(80) < 60)
    noisy[0][:, wanted] = np.nan
    found = placed_by_segment(noisy, 0, wanted, 0.02)
    away = np.linalg.norm(found.positions - whole[0], axis=0)[wanted]
    assert np.sqrt(np.mean(away**2)) < 0.014


def test_markers_on_a_line_and_fewer_than_three_determine_no_pose() -> None:
    line = np.outer([0.0, 0.1, 0.3, 0.4], [1.0, 2.0, 3.0])
    for template in (line, line + 1e-4 * np.eye(4, 3), np.eye(3)[:2]):
        assert not is_spread(template)
        with pytest.raises(ParameterError, match="do not lie on a line"):
            fit_poses(template, np.repeat(template[:, :, None], 2, axis=2))
    whole = moved(np.vstack([line, [0.3, 0.1, -0.2]]), 60, 1)
    wanted = np.arange(60) > 40
    whole[-1][:, wanted] = np.nan
    assert not placed_by_segment(whole, 4, wanted, 1.0).markers.any()


def test_a_marker_that_moves_against_its_segment_is_not_placed() -> None:
    template = np.array([[0.1, 0, 0], [0, 0.12, 0], [-0.1, 0, 0.02], [0.3, 0, 0.0]])
    whole = moved(template, 60, 3)
    whole[3] += 0.1 * np.sin(np.arange(60) / 3)
    wanted = np.arange(60) > 40
    whole[3][:, wanted] = np.nan
    assert not placed_by_segment(whole, 3, wanted, 0.02).markers.any()
    assert placed_by_segment(whole, 3, wanted, 1.0).markers[wanted].all()


def test_which_markers_are_seen_may_change_within_a_gap() -> None:
    template = np.array([[0.1, 0, 0], [0, 0.12, 0], [-0.1, 0, 0.02], [0, -0.1, 0.05], [0.05, 0.05, 0.1]])
    whole = moved(template, 90, 5)
    hidden, wanted = whole.copy(), np.zeros(90, bool)
    wanted[30:70] = True
    hidden[0][:, wanted] = np.nan
    hidden[1, :, 40:50] = np.nan
    hidden[[2, 3], :, 55:60] = np.nan
    found = placed_by_segment(hidden, 0, wanted, 1e-6)
    assert set(found.markers[30:40]) == {4} or set(found.markers[30:40]) == {3}
    assert set(found.markers[40:50]) == {3}
    assert set(found.markers[55:60]) == {0}  # two markers are seen
    placed = found.markers > 0
    np.testing.assert_allclose(found.positions[:, placed], whole[0][:, placed], atol=1e-9)


@given(TEMPLATES, SEEDS)
def test_the_mean_shape_of_a_rigid_segment_has_its_distances(template: np.ndarray, seed: int) -> None:
    if not is_wide(template):
        return
    shape = mean_shape(moved(template, 7, seed))
    for a in range(len(template)):
        away = np.linalg.norm(template - template[a], axis=1)
        np.testing.assert_allclose(np.linalg.norm(shape - shape[a], axis=1), away, atol=1e-9)


def test_absurd_numbers_place_nothing() -> None:
    whole = np.full((4, 3, 30), 1e300) * np.random.default_rng(0).normal(size=(4, 3, 30))
    wanted = np.arange(30) > 20
    whole[3][:, wanted] = np.nan
    assert not placed_by_segment(whole, 3, wanted, np.inf).markers.any()
    near = moved(np.array([[0.1, 0, 0], [0, 0.12, 0], [-0.1, 0, 0.02], [0.3, 0, 0.0]]), 30, 1)
    near[0, :, 25], near[1, :, 26] = 1e300, np.inf
    near[3][:, wanted] = np.nan
    assert placed_by_segment(near, 3, wanted, 1.0).markers[wanted].tolist() == [3, 3, 3, 3, 0, 0, 3, 3, 3]


@given(TEMPLATES, SEEDS, st.floats(0, 0.02))
def test_a_shape_of_a_static_trial_places_a_marker_as_a_naive_twin_does(
    template: np.ndarray, seed: int, noise: float
) -> None:
    if not is_wide(template):
        return
    marker = np.array([0.3, -0.2, 0.4])
    motion = moved(np.vstack([template, marker]), 6, seed)
    motion[:-1] += np.random.default_rng(seed).normal(0, noise, motion[:-1].shape)
    motion[-1] = np.nan
    shape = np.vstack([template, marker])
    found = placed_by_shape(motion, len(template), np.ones(6, bool), shape, 10.0)
    for t in range(6):
        turn, shift = by_quaternion(template, motion[:-1, :, t])
        np.testing.assert_allclose(found.positions[:, t], turn @ marker + shift, atol=1e-6)
    assert (found.markers == len(template)).all()
    assert np.isfinite(found.errors).all()


def test_a_marker_that_has_left_its_place_since_the_static_trial_does_not_count() -> None:
    template = np.array([[0.1, 0, 0], [0, 0.12, 0], [-0.1, 0, 0.02], [0, -0.1, 0.05], [0.05, 0.05, 0.1]])
    marker = np.array([0.1, -0.1, 0.1])
    motion = moved(np.vstack([template, marker]), 30, 4)
    truth = motion[-1].copy()
    motion[-1] = np.nan
    shape = np.vstack([template, marker])
    shape[1] += 0.1  # fixed anew
    wanted = np.arange(30) >= 10
    found = placed_by_shape(motion, 5, wanted, shape, 0.02)
    np.testing.assert_allclose(found.positions[:, wanted], truth[:, wanted], atol=1e-9)
    assert set(found.markers[wanted]) == {4}
    assert not found.markers[~wanted].any()
    assert not placed_by_shape(motion, 5, wanted, 1.4 * shape, 0.02).markers.any()  # of another person
    shape[3:5] = np.nan  # three are left, one of which has moved
    assert not placed_by_shape(motion, 5, wanted, shape, 0.02).markers.any()


def test_a_marker_that_is_seen_beside_its_place_keeps_the_difference_in_a_gap() -> None:
    template = np.array([[0.1, 0, 0], [0, 0.12, 0], [-0.1, 0, 0.02], [0, -0.1, 0.05]])
    motion = moved(np.vstack([template, [0.1, -0.1, 0.1]]), 40, 6)
    shape = np.vstack([template, [0.1, -0.09, 0.1]])
    truth, wanted = motion[-1].copy(), (np.arange(40) >= 10) & (np.arange(40) < 30)
    motion[-1][:, wanted] = np.nan
    found = placed_by_shape(motion, 4, wanted, shape, 0.02)
    np.testing.assert_allclose(found.positions[:, wanted], truth[:, wanted], atol=1e-9)


@given(SEEDS)
def test_the_leverage_of_a_place_is_the_error_that_noise_of_the_markers_gives_it(seed: int) -> None:
    random = np.random.default_rng(seed)
    template, place = random.normal(size=(4, 3)), 2 * random.normal(size=3)
    if np.linalg.svd(template - template.mean(axis=0), compute_uv=False)[1] < 0.7:
        return
    noisy = template[:, :, None] + random.normal(0, 1e-3, (4, 3, 4000))
    poses = fit_poses(template, noisy)
    away = poses.rotations @ place + poses.shifts - place
    error = np.sqrt((away**2).sum(axis=1).mean())
    assert error == pytest.approx(1e-3 * np.sqrt(3) * leverage(template, place), rel=0.1)
