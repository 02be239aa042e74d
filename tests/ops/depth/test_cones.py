"""The surface of a body: distances of points, and samples that face the camera."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.arrays import F64
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.depth.cones import COLUMNS, ConeBody, body_distance, place_cones, place_samples, seen_side
from kinedex.ops.errors import ParameterError
from tests.ops.depth.cone_bodies import BODY, HEIGHT, POSE, one_cone, random_pose
from tests.oracles import cone_body as oracle


def body_samples(body: ConeBody, pose: F64, height: float | None = None) -> F64:
    """Return the samples C_χ of the surface, on the side towards the camera (thesis, 8.4.1)."""
    cones = body.cones(body.height_m if height is None else height)
    placed = np.empty((len(cones.radii), COLUMNS))
    place_cones(cones, np.ascontiguousarray(pose, np.float64), placed)
    samples, offsets = np.empty((len(body.sample_cones), 3)), np.empty((len(body.sample_cones), 3))
    place_samples(body.samples, placed, samples, offsets)
    return samples


def test_the_worked_example_of_one_cone() -> None:
    pose = np.zeros((24, 3))
    pose[0], pose[1] = (0, 0, -2), (0, 0.4, -2)
    found = body_distance(one_cone((0.05, 0.03)), pose, np.array([[0.1, 0.2, -2.0]]))
    assert (found.cone[0], found.s[0]) == (0, 0.5)
    assert found.d[0] == pytest.approx(0.06)
    np.testing.assert_allclose(found.normals[0], [1, 0, 0], atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_distances_are_those_of_the_nearest_cone(seed: int) -> None:
    pose = random_pose(seed, 30)
    rng = np.random.default_rng(seed)
    points = np.concatenate(
        [pose[rng.integers(24, size=200)] + rng.normal(0, 0.1, (200, 3)), rng.normal(0, 3, (20, 3))]
    )
    found = body_distance(BODY, pose, points, HEIGHT)
    for i, point in enumerate(points):
        d, cone, s, normal = oracle.distance(BODY, pose, point, HEIGHT)
        assert found.cone[i] == cone
        assert (found.d[i], found.s[i]) == (pytest.approx(d, abs=1e-12), pytest.approx(s, abs=1e-12))
        np.testing.assert_allclose(found.normals[i], normal, atol=1e-10)


def test_the_first_one_of_equally_near_cones_counts() -> None:
    pose = POSE.copy()
    left = [k for k, name in enumerate(JOINTS) if name.startswith("l")]
    pose[[JOINTS.index("r" + JOINTS[k][1:]) for k in left]] = POSE[left]
    points = pose[[JOINTS.index("lknee"), JOINTS.index("lwrist")]] + (0, 0, 0.1)
    assert all(BODY.cone_names[cone].startswith("left") for cone in body_distance(BODY, pose, points).cone)


@pytest.mark.parametrize("seed", range(2))
def test_samples_lie_on_their_cones_towards_the_camera(seed: int) -> None:
    pose = random_pose(seed, 30)
    samples = body_samples(BODY, pose, HEIGHT)
    assert samples.shape == (160, 3)
    np.testing.assert_allclose(samples, oracle.samples(BODY, pose, HEIGHT), atol=1e-12)
    assert body_distance(BODY, pose, samples, HEIGHT).d.max() < 1e-9


def test_a_cone_without_length_is_a_ball() -> None:
    pose = np.tile([0.0, 0.0, -2.0], (24, 1))
    body = one_cone((0.05, 0.03))
    found = body_distance(body, pose, np.array([[0.0, 0.0, -1.0], [0.0, 0.0, -2.0]]))
    np.testing.assert_allclose(found.d, [0.95, -0.05])
    np.testing.assert_allclose(found.s, 0)
    np.testing.assert_allclose(found.normals, [[0, 0, 1], [0, 0, 0]])
    np.testing.assert_allclose(body_samples(body, pose), [[0, 0, -1.96]])


def test_a_point_behind_a_cone_lies_behind_the_side_that_a_camera_sees() -> None:
    pose, placed = np.zeros((24, 3)), np.empty((1, COLUMNS))
    pose[0], pose[1] = (0, -0.2, -2), (0, 0.2, -2)
    place_cones(one_cone((0.05, 0.05)).cones(1.7), pose, placed)
    np.testing.assert_allclose(seen_side(placed[0], 0.5, 0.0, 0.0, -1.94), [0, 0, 1, 0.01], atol=1e-12)
    np.testing.assert_allclose(seen_side(placed[0], 0.5, 0.0, 0.0, -2.05), [0, 0, 1, -0.10], atol=1e-12)
    np.testing.assert_allclose(seen_side(placed[0], 0.5, 0.06, 0.0, -2.01), [0.9864, 0, -0.1644, 0.0108], atol=1e-4)
    assert seen_side(placed[0], 0.5, 0.0, 0.0, -2.0) == (0, 0, 0, 0)


def test_a_body_without_height_is_refused() -> None:
    with pytest.raises(ParameterError, match="height must be positive and finite, in metres, got nan"):
        BODY.cones(float("nan"))
