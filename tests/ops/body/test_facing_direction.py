"""Bodies face across their hips and shoulders, and a motion can begin at the origin, facing +Z."""

from __future__ import annotations

import math

import numpy as np
import pytest

from kinedex.ops.body.facing_direction import (
    Placement,
    facing_yaw,
    mirrored_names,
    mirrored_positions,
    mirrored_quaternions,
    placement_of,
    start_at_origin,
    turn_about_y,
    turned_quaternions,
)
from kinedex.ops.errors import ParameterError

LEFT, RIGHT = np.array([[1.0, 1.0, 0.0]]), np.array([[-1.0, 1.0, 0.0]])


@pytest.mark.parametrize("yaw", [-3.0, -math.pi / 2, 0.0, 0.4, 2.5])
def test_a_body_that_is_turned_faces_there(yaw: float) -> None:
    assert facing_yaw(turn_about_y(LEFT, yaw), turn_about_y(RIGHT, yaw)) == pytest.approx(yaw)
    np.testing.assert_allclose(turn_about_y(np.array([0.0, 1.0, 1.0]), yaw), [math.sin(yaw), 1.0, math.cos(yaw)])


def test_a_motion_that_starts_at_the_origin_keeps_its_heights_and_its_shape() -> None:
    random = np.random.default_rng(7)
    body = random.normal(size=(5, 4, 3))
    placed = turn_about_y(body, 1.2) + np.array([3.0, 0.0, -2.0])
    np.testing.assert_allclose(start_at_origin(placed, Placement(3.0, -2.0, 1.2)), body, atol=1e-12)


def test_orientations_turn_with_the_body() -> None:
    ahead = turned_quaternions(np.array([[1.0, 0.0, 0.0, 0.0]]), math.pi / 2)
    np.testing.assert_allclose(ahead, [[math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0]])
    mirrored = mirrored_quaternions(ahead)
    np.testing.assert_allclose(mirrored, turned_quaternions(np.array([[1.0, 0.0, 0.0, 0.0]]), -math.pi / 2))


def test_a_pair_that_is_not_known_does_not_count_and_without_any_there_is_no_placement() -> None:
    gap = np.full((1, 3), np.nan)
    found = placement_of(np.array([1.0, 0.9, 2.0]), np.concatenate([gap, LEFT]), np.concatenate([RIGHT, RIGHT]))
    assert found == (1.0, 2.0, 0.0)
    with pytest.raises(ParameterError, match="both hips or both shoulders"):
        placement_of(np.zeros(3), gap, RIGHT)


def test_a_mirror_exchanges_left_and_right_and_twice_it_changes_nothing() -> None:
    names = ["root", "lhip", "rhip", "lefty"]
    assert mirrored_names(names) == ["root", "rhip", "lhip", "lefty"]
    positions = np.random.default_rng(1).normal(size=(3, 4, 3)).astype(np.float32)
    mirrored = mirrored_positions(positions, names)
    np.testing.assert_array_equal(mirrored[:, 1], positions[:, 2] * np.array([-1, 1, 1], np.float32))
    assert mirrored.dtype == np.float32
    np.testing.assert_array_equal(mirrored_positions(mirrored, names), positions)
