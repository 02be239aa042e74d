"""The floor is found by tilted cameras, and walls, ceilings and tables are none."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from kinedex.ops.body.axisangle import matrices
from kinedex.ops.depth.floor import WITHIN_M, admissible_planes, find_floor, upright_rotation
from kinedex.ops.errors import ParameterError
from tests.oracles.floor import largest_plane

UP = np.array([0.0, 1.0, 0.0])


def room(turn: np.ndarray, height: float = 1.2, ceiling: float = 1.3, size: tuple[int, int] = (64, 48)) -> np.ndarray:
    """Return what a camera sees that is turned in a room with a floor, a ceiling, a wall and a table, with noise."""
    u, v = np.meshgrid(np.linspace(-0.6, 0.6, size[0]), np.linspace(0.5, -0.5, size[1]))
    rays = np.stack([u, v, -np.ones_like(u)], axis=-1).reshape(-1, 3)
    world = rays @ turn.T
    with np.errstate(divide="ignore"):
        hits = [np.where(world[:, 1] < 0, -height / world[:, 1], np.inf)]
        hits.append(np.where(world[:, 1] > 0, ceiling / world[:, 1], np.inf))
        hits.append(np.where(world[:, 2] < 0, -4.0 / world[:, 2], np.inf))
        table = np.where(world[:, 1] < 0, -(height - 0.7) / world[:, 1], np.inf)
    at = world * table[:, None]
    hits.append(np.where((np.abs(at[:, 0] - 0.5) < 0.4) & (np.abs(at[:, 2] + 2) < 0.3), table, np.inf))
    z = np.min(hits, axis=0)
    noise = 1 + np.random.default_rng(1).normal(0, 0.001, len(z))
    return np.where(np.isfinite(z), z, np.nan)[:, None] * rays * noise[:, None]


@pytest.mark.parametrize("pitch", [-35.0, -10.0, 0.0])
@pytest.mark.parametrize("roll", [-20.0, 0.0, 8.0])
def test_tilted_cameras_find_the_floor(pitch: float, roll: float) -> None:
    turn = matrices(np.radians([[pitch, 0, 0]]))[0] @ matrices(np.radians([[0, 0, roll]]))[0]
    up = turn.T @ UP
    for given_up in (None, 9.81 * up):
        found = find_floor(room(turn), given_up)
        assert found is not None
        assert np.degrees(np.arccos(found.normal @ up)) < 0.3
        assert found.height == pytest.approx(-1.2, abs=0.01)
        level = room(turn) @ upright_rotation(found.normal).T
        assert np.sort(level[np.abs(level[:, 1] + 1.2) < 0.02, 1]).mean() == pytest.approx(-1.2, abs=0.005)


def test_the_same_seed_finds_the_same_floor_and_an_accelerometer_refutes_a_ramp() -> None:
    points = room(np.eye(3))
    one, other = find_floor(points, seed=4), find_floor(points, seed=4)
    assert one is not None
    assert other is not None
    assert one.normal.tolist() == other.normal.tolist()
    assert one.share == other.share
    tilted = matrices(np.radians([[0, 0, 15]]))[0] @ UP
    assert find_floor(points, tilted) is None


def test_a_room_without_a_visible_floor_has_none() -> None:
    points = room(np.eye(3))
    assert find_floor(points[points[:, 1] > -0.3]) is None
    wall = room(np.eye(3), height=5.0, ceiling=5.0)
    assert find_floor(wall) is None
    assert find_floor(np.full((100, 3), np.nan)) is None
    assert find_floor(np.random.default_rng(0).uniform(-1, 1, (5000, 3))) is None


def test_the_plane_is_the_largest_of_those_that_plain_loops_try() -> None:
    points = room(matrices(np.radians([[-15, 0, 0]]))[0], size=(16, 12))
    points = points[np.isfinite(points).all(axis=1)]
    expected = largest_plane(points, [0.0, 1.0, 0.0], 45.0, seed=3)
    assert expected is not None
    normals, heights = admissible_planes(points, UP, float(np.cos(np.radians(45))), 3)
    counts = (np.abs(points @ normals.T - heights) <= WITHIN_M).sum(axis=0)
    assert len(normals) == 300
    assert counts.max() == expected[0]
    assert normals[counts.argmax()] == pytest.approx(expected[1][0], abs=1e-9)


@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(lambda x: np.linalg.norm(x) > 0.01))
@example([1e-05, -1.0, 0.0])
def test_the_upright_turn_is_the_shortest_rotation_to_y(direction: list[float]) -> None:
    turn = upright_rotation(direction)
    up = np.array(direction) / np.linalg.norm(direction)
    assert turn @ up == pytest.approx(UP, abs=1e-9)
    assert turn @ turn.T == pytest.approx(np.eye(3), abs=1e-9)
    assert np.linalg.det(turn) == pytest.approx(1)
    assert np.trace(turn) == pytest.approx(1 + 2 * up[1], abs=1e-6)  # its angle is that between up and Y


def test_straight_down_is_turned_too_and_nothing_is_refused() -> None:
    assert upright_rotation([0, -2, 0]).tolist() == [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
    with pytest.raises(ParameterError, match="up must be a direction"):
        upright_rotation([0, 0, 0])
    with pytest.raises(ParameterError, match="points must be of shape"):
        find_floor(np.zeros(3))
