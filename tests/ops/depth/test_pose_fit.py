"""Poses are fitted to the points of a depth image."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.arrays import F64
from kinedex.ops.depth.cones import ConeBody, pivots_of
from kinedex.ops.depth.image_search import DepthView, depth_view
from kinedex.ops.depth.normal_equations import add_blended_face, add_rigid_face, assemble, make_sums, moving_cones
from kinedex.ops.depth.points import FrameCloud
from kinedex.ops.depth.pose_distance import COMPARED
from kinedex.ops.depth.pose_fit import SIGMA_M, STEPS, Form, PoseFit
from kinedex.ops.errors import ParameterError
from tests.ops.depth.cone_bodies import BODY, HEIGHT, POSE, bone_lengths, random_pose, turned_pose
from tests.ops.depth.filmed_cones import LEVEL, MATRIX, film, standing, tilted, view
from tests.oracles import cone_body
from tests.oracles import pose_fit as oracle
from tests.plain_python import slow_as_python


def error(pose: np.ndarray, other: np.ndarray) -> float:
    """The mean distance of the compared joints in metres."""
    return float(np.linalg.norm((pose - other)[COMPARED], axis=1).mean())


def thinned(cloud: FrameCloud, every: int) -> FrameCloud:
    """A frame with only some of its points."""
    numbers = np.full_like(cloud.numbers, -1)
    pixels = cloud.pixels[::every].copy()
    numbers[pixels[:, 1], pixels[:, 0]] = np.arange(len(pixels))
    (u0, v0), (u1, v1) = pixels.min(axis=0).tolist(), (pixels.max(axis=0) + 1).tolist()
    return cloud._replace(points=cloud.points[::every].copy(), pixels=pixels, numbers=numbers, box=(u0, v0, u1, v1))


def signed(body: ConeBody, pose: np.ndarray, cone: int, s: float, point: np.ndarray) -> float:
    """The distance of a point from a place of an axis, less the radius there, which is held."""
    a, b = cone_body.ends(body, pose)[cone]
    return float(np.linalg.norm(point - a - s * (b - a)))


def fit_pose(
    body: ConeBody, height: float, view: DepthView, pose: F64, cloud: FrameCloud, steps: int = STEPS,
    form: Form = "best",
) -> F64:  # fmt: skip
    """Fit a pose to the points of one frame."""
    fit = PoseFit(body, height, view)
    fit.look(cloud)
    return fit.fit(np.ascontiguousarray(pose, np.float64), steps, SIGMA_M, form)


@pytest.mark.parametrize("cone", range(len(BODY.cone_names)))
def test_rows_are_derivatives_of_the_distance(cone: int) -> None:
    rng = np.random.default_rng(cone)
    pose, s = random_pose(cone, 20), rng.uniform()
    a, b = cone_body.ends(BODY, pose)[cone]
    place, point = a + s * (b - a), pose[int(BODY.joints[cone, 0, 0])] + rng.normal(0, 0.2, 3)
    normal = (point - place) / np.linalg.norm(point - place)
    moving, pivots = moving_cones(BODY), pivots_of(BODY.pivots)
    sums, count = make_sums(len(BODY.pivots), moving), len(BODY.pivots)
    if moving.blends[cone] < 0:
        add_rigid_face(sums.rigid, moving.rigid[cone], *(place - pose[0]), *normal, 1.0, 1.0)
    else:
        add_blended_face(sums.faces, moving.blends[cone], s, *normal, 1.0, 1.0)
    assemble(moving, BODY.joints, pivots, pose, sums)
    row = np.concatenate([sums.right[3 * count :], sums.right[: 3 * count].reshape(-1, 3)[::-1].ravel()])
    expected = np.empty(len(row))
    for i, unit in enumerate(1e-6 * np.eye(len(row))):
        after, before = (
            turned_pose(BODY.pivots, pose, sign * unit[3:].reshape(-1, 3), sign * unit[:3]) for sign in (1, -1)
        )
        expected[i] = -(signed(BODY, after, cone, s, point) - signed(BODY, before, cone, s, point)) / 2e-6
    np.testing.assert_allclose(row, expected, atol=1e-6)
    np.testing.assert_allclose(row, normal @ oracle.moves(BODY, pose, cone, s), atol=1e-12)


@pytest.mark.parametrize("form", ["best", "printed"])
@pytest.mark.parametrize("turn", [LEVEL, tilted(20)], ids=["level", "tilted"])
def test_a_step_solves_the_equations_of_all_rows(form: str, turn: np.ndarray) -> None:
    cloud = thinned(film(POSE, turn), 5)
    start = random_pose(1, 12)
    fit = PoseFit(BODY, HEIGHT, view(turn))
    fit.look(cloud)
    found = fit.fit(start, 1, (0.1, 0.1), form)
    expected = oracle.step(BODY, HEIGHT, MATRIX, turn, start, cloud, 0.1, form)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert error(found, start) > 0.005


@slow_as_python
def test_disturbed_poses_are_found_again() -> None:
    starts = [random_pose(seed, 5) for seed in range(1, 7)]
    found = [fit_pose(BODY, HEIGHT, view(), start, standing()) for start in starts]
    assert np.mean([error(start, POSE) for start in starts]) > 0.04
    assert np.mean([error(pose, POSE) for pose in found]) < 0.010
    for pose in found:
        assert error(pose, POSE) < 0.015
        np.testing.assert_allclose(bone_lengths(pose), bone_lengths(POSE), rtol=0, atol=1e-12)


@slow_as_python
def test_the_printed_form_ends_farther_away() -> None:
    start = random_pose(2, 5)
    found = fit_pose(BODY, HEIGHT, view(), start, standing(), 6, form="printed")
    assert 0.010 < error(found, POSE) < error(start, POSE)


def test_turning_camera_and_up_together_changes_nothing() -> None:
    turn, start = tilted(25), random_pose(3, 5)
    level = fit_pose(BODY, HEIGHT, view(), start, standing(), 3)
    cloud = standing()._replace(points=np.ascontiguousarray(standing().points @ turn.T))
    turned = fit_pose(BODY, HEIGHT, view(turn), start @ turn.T, cloud, 3)
    np.testing.assert_allclose(turned, level @ turn.T, atol=1e-9)


def test_frames_do_not_remember_the_ones_before() -> None:
    start, other = random_pose(2, 5), random_pose(3, 15)
    fit = PoseFit(BODY, HEIGHT, view())
    fit.look(standing())
    first = fit.fit(start)
    out = np.empty_like(start)
    fit.look(thinned(standing(), 3))
    fit.fit(other, out=out)
    fit.look(standing())
    assert fit.fit(start, out=out) is out
    assert out.tobytes() == first.tobytes()


def test_distortion_is_applied_before_the_search() -> None:
    barrel = depth_view(MATRIX, (-0.3, 0.1, 0.001, -0.002))
    start = random_pose(2, 5)
    assert error(fit_pose(BODY, HEIGHT, barrel, start, standing(), 2), start) > 0.001
    none = fit_pose(BODY, HEIGHT, depth_view(MATRIX, np.zeros(5)), start, standing(), 2)
    np.testing.assert_array_equal(none, fit_pose(BODY, HEIGHT, view(), start, standing(), 2))


def test_bad_arguments_are_refused() -> None:
    fit = PoseFit(BODY, HEIGHT, view())
    with pytest.raises(ParameterError, match="call `look` first"):
        fit.fit(POSE)
    empty = standing()._replace(points=np.empty((0, 3)), pixels=np.empty((0, 2), np.int32))
    with pytest.raises(ParameterError, match="cloud must be a frame with points"):
        fit.look(empty)
    with pytest.raises(ParameterError, match="stride must be at least 1, got 0"):
        depth_view(MATRIX, stride=0)
    with pytest.raises(ParameterError, match=r"matrix must be of shape \(3, 3\)"):
        depth_view(np.eye(2))
    with pytest.raises(ParameterError, match=r"turn must be of shape \(3, 3\)"):
        depth_view(MATRIX, turn=np.eye(2))
    with pytest.raises(ParameterError, match="distortion must be of 0, 4, 5 or 8 numbers, got 9"):
        depth_view(MATRIX, np.zeros(9))
