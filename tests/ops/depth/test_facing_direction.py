"""Centre and viewing direction of a cloud: as numpy computes them, and on planes whose direction is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.depth.facing_direction import facing_from_points, point_centre, symmetric_eigenvectors

FORWARD = np.array([0.0, 0.0, 1.0])


def mean_shift(points: np.ndarray) -> np.ndarray:
    sample = points[:: max(len(points) // 700, 1)]
    centre = np.median(sample, axis=0)
    for _ in range(8):
        weights = np.exp(-((sample - centre) ** 2).sum(axis=1) / (2 * 0.25**2))
        before, centre = centre, weights @ sample / weights.sum()
        if np.abs(centre - before).max() < 1e-3:
            break
    return centre


def plane_direction(points: np.ndarray, centre: np.ndarray, facing: np.ndarray) -> np.ndarray:
    around = points[np.linalg.norm(points - centre, axis=1) < 0.15]
    if len(around) < 20:
        return facing
    values, vectors = np.linalg.eigh(np.cov(around.T, bias=True))
    normal = vectors[:, 0] * np.sign(vectors[2, 0]) * (1, 0, 1)
    if np.linalg.norm(normal) < 0.5:
        return facing
    trust = np.clip((values[1] / values[2] - 0.3) / 0.4, 0, 1) * np.clip(1 - values[0] / values[1] / 0.4, 0, 1)
    turned = facing + 0.7 * trust * (normal / np.linalg.norm(normal) - facing)
    return turned / np.linalg.norm(turned)


def upright_plane(degrees: float, n: int = 3000) -> np.ndarray:
    """Points of a plane that faces an angle to the right of the camera."""
    random, angle = np.random.default_rng(0), np.radians(degrees)
    across, up = random.uniform(-0.3, 0.3, (2, n))
    return np.stack([across * np.cos(angle), up, -3 - across * np.sin(angle)], axis=1)


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), n=st.sampled_from([1, 2, 30, 699, 700, 1399, 1400, 3001]))
def test_centre_and_direction_are_those_of_numpy(seed: int, n: int) -> None:
    random = np.random.default_rng(seed)
    points = random.normal(0, 1, (n, 3)) @ random.normal(0, 0.2, (3, 3)) + (0, 0, -3)
    centre = point_centre(points)
    np.testing.assert_allclose(centre, mean_shift(points), atol=1e-12)
    angle = random.uniform(-3, 3)
    facing = np.array([np.sin(angle), 0, np.cos(angle)])
    found = facing_from_points(points, centre, facing)
    np.testing.assert_allclose(found, plane_direction(points, centre, facing), atol=1e-9)


@pytest.mark.parametrize("degrees", [-40, 0, 25])
def test_the_direction_approaches_that_of_a_plane(degrees: float) -> None:
    points, facing = upright_plane(degrees), FORWARD
    for _ in range(20):
        facing = facing_from_points(points, np.array([0.0, 0, -3]), facing)
    np.testing.assert_allclose(np.degrees(np.arctan2(facing[0], facing[2])), degrees, atol=0.5)


def test_few_points_or_a_flat_plane_leave_the_direction() -> None:
    centre, before = np.array([0.0, 0, -3]), np.array([0.6, 0, 0.8])
    few = upright_plane(30, 19) * (0.1, 0.1, 1) + (0, 0, 0)
    np.testing.assert_array_equal(facing_from_points(few, centre, before), before)
    lying = upright_plane(0)[:, [0, 2, 1]] + (0, 3, -3)
    np.testing.assert_array_equal(facing_from_points(lying, centre, before), before)
    assert np.isnan(point_centre(np.zeros((0, 3)))).all()


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), rank=st.integers(0, 3))
def test_eigenvectors_are_those_of_the_matrix(seed: int, rank: int) -> None:
    half = np.random.default_rng(seed).normal(size=(3, rank))
    matrix = half @ half.T
    values, vectors = symmetric_eigenvectors(matrix)
    np.testing.assert_allclose(values, np.linalg.eigvalsh(matrix), atol=1e-12)
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(vectors @ np.diag(values) @ vectors.T, matrix, atol=1e-12)
