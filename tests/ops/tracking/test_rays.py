"""Rays as a matrix and a vector of each body point."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking.observations import BodyPoints, JointPositions, Rays
from kinedex.ops.tracking.rays import make_evidence, point_cost, point_terms
from tests.ops.tracking.filmed_bodies import BODY, filmed, joint_places, keypoints, moving_poses
from tests.oracles import tracking as oracle


def test_the_worked_example() -> None:
    """(1, 2, 3) against the line through 0 along z."""
    point, n = np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 1.0])
    rays = Rays(np.zeros((1, 3)), np.array([3.0]), n[None, None, None], np.ones((1, 1, 1)))
    evidence = make_evidence(BODY, rays, BodyPoints(np.array([0]), np.zeros((1, 3)), np.array([-1])), sigma_px=1.0)
    units, matrices, vectors = np.zeros((1, 1)), np.zeros((1, 3, 3)), np.zeros((1, 3))
    cost = point_terms(evidence, 0, point[None], np.inf, units, matrices, vectors)
    assert cost == pytest.approx(5.0)  # the square of the length; a depth of 3 m, and f = 3, make units of a metre
    np.testing.assert_allclose(np.cross(point, n) - np.cross(np.zeros(3), n), [2, -1, 0])  # the residual of Eq. 6.3
    np.testing.assert_allclose(vectors[0], [1, 2, 0])  # which is this offset turned by 90° about n
    np.testing.assert_allclose(np.cross(vectors[0], n), [2, -1, 0])
    np.testing.assert_allclose(matrices[0], np.diag([1, 1, 0]))


@pytest.mark.parametrize("width", [np.inf, 3.0])
def test_costs_and_gradients_are_those_of_the_twin(width: float) -> None:
    poses, points = moving_poses(1), keypoints()
    rays = filmed(poses, points, 0.01)
    rays.confidence[0, 1, 2], rays.confidence[0, 2, 3] = 0.05, 0.0
    rays.directions[0, 2, 3] = np.nan
    evidence = make_evidence(BODY, rays, points)
    positions = oracle.body_points(BODY, points, poses.positions[0], poses.rotations[0]) + 0.02
    units, matrices, vectors = np.zeros((4, 15)), np.zeros((15, 3, 3)), np.zeros((15, 3))
    cost = point_terms(evidence, 0, positions, width, units, matrices, vectors)
    rays.directions[0, 2, 3] = [0, 0, 1]
    depths = oracle.ray_depths(rays, 0, positions)
    assert cost == pytest.approx((oracle.ray_residuals(rays, 0, positions, depths, 5.0, width) ** 2).sum(), rel=1e-12)
    assert cost == pytest.approx(point_cost(evidence, 0, positions, width, np.zeros((4, 15)), True), rel=1e-12)
    for p, i in ((0, 0), (2, 1), (3, 2), (14, 1)):
        step = np.zeros_like(positions)
        step[p, i] = 1e-6
        one, two = (point_cost(evidence, 0, positions + sign * step, width, units, False) for sign in (1, -1))
        assert vectors[p, i] == pytest.approx((one - two) / 4e-6, rel=1e-6)


@pytest.mark.parametrize("width", [np.inf, 3.0])
def test_places_are_points_with_a_spread_of_their_own(width: float) -> None:
    positions = joint_places(moving_poses(1))
    observed = JointPositions(positions + 0.03, np.linspace(0.01, 0.05, 24)[None])
    observed.positions[0, 5, 1] = np.nan
    evidence = make_evidence(BODY, observed, None)
    units, matrices, vectors = np.zeros((0, 24)), np.zeros((24, 3, 3)), np.zeros((24, 3))
    cost = point_terms(evidence, 0, positions[0], width, units, matrices, vectors)
    observed.positions[0, 5] = positions[0, 5]
    assert cost == pytest.approx((oracle.place_residuals(observed, 0, positions[0], width) ** 2).sum(), rel=1e-12)
    assert cost == pytest.approx(point_cost(evidence, 0, positions[0], width, units, False), rel=1e-12)
    assert not vectors[5].any()
    step = np.zeros_like(positions[0])
    step[3, 1] = 1e-6
    one, two = (point_cost(evidence, 0, positions[0] + sign * step, width, units, False) for sign in (1, -1))
    assert vectors[3, 1] == pytest.approx((one - two) / 4e-6, rel=1e-6)


def test_what_does_not_fit_is_refused() -> None:
    poses, points = moving_poses(1), keypoints()
    rays = filmed(poses, points)
    with pytest.raises(ParameterError, match="sigma_px must be positive"):
        make_evidence(BODY, rays, points, 0.0)
    with pytest.raises(ParameterError, match="points must be the 15 points that the rays observe, got None"):
        make_evidence(BODY, rays, None)
    with pytest.raises(ParameterError, match="places must be of the 24 joints"):
        make_evidence(BODY, JointPositions(np.zeros((1, 3, 3)), np.ones((1, 3))), None)
    with pytest.raises(ParameterError, match="sigma_m must be positive"):
        make_evidence(BODY, JointPositions(np.zeros((1, 24, 3)), np.zeros((1, 24))), None)
