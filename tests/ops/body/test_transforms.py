"""Rotations of quaternions, arcs between them, and trees of transforms, against plain loops."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.body import axisangle
from kinedex.ops.body.kinematics import rotation
from kinedex.ops.body.transforms import global_transforms, rotations, slerp, without_scale
from kinedex.ops.errors import ParameterError

RANDOM = np.random.default_rng(5)


def unit(count: int) -> np.ndarray:
    """Random unit quaternions."""
    numbers = RANDOM.normal(size=(count, 4))
    return numbers / np.linalg.norm(numbers, axis=1, keepdims=True)


def test_a_quaternion_turns_as_its_axis_and_angle_do() -> None:
    vectors = RANDOM.normal(size=(50, 3))
    angle = np.linalg.norm(vectors, axis=1, keepdims=True)
    quaternions = np.concatenate([np.cos(angle / 2), np.sin(angle / 2) * vectors / angle], axis=1)
    expected = axisangle.matrices(vectors)
    np.testing.assert_allclose(rotations(quaternions), expected, atol=1e-12)
    np.testing.assert_allclose(rotations(-3.0 * quaternions), expected, atol=1e-12)
    np.testing.assert_array_equal(rotations(np.zeros((2, 4))), [np.eye(3)] * 2)
    assert rotations(np.ones((2, 5, 4))).shape == (2, 5, 3, 3)


def test_arcs_are_short_and_of_constant_speed() -> None:
    first, second = unit(40), unit(40)
    for share in (0.0, 0.25, 1.0):
        between = slerp(first, second, np.full(40, share))
        np.testing.assert_allclose(np.linalg.norm(between, axis=1), 1.0, atol=1e-12)
        whole = 2 * np.arccos(np.clip(np.abs((first * second).sum(axis=1)), 0, 1))
        part = 2 * np.arccos(np.clip(np.abs((first * between).sum(axis=1)), 0, 1))
        np.testing.assert_allclose(part, share * whole, atol=1e-6)
    near = first + 1e-12
    np.testing.assert_allclose(slerp(first, near, np.full(40, 0.5)), first, atol=1e-9)
    np.testing.assert_allclose(slerp(first, -first, np.full(40, 0.5)), first, atol=1e-9)


def test_transforms_of_a_tree_are_products_along_the_way_from_the_root() -> None:
    parents = [-1, 0, 1, 1, -1, 4]
    linear, offsets = RANDOM.normal(size=(6, 7, 3, 3)), RANDOM.normal(size=(6, 7, 3))
    whole, positions = global_transforms(parents, linear, offsets)
    for node in range(6):
        for t in range(7):
            matrix, place, at = np.eye(3), np.zeros(3), node
            while at >= 0:
                place = linear[at, t] @ place + offsets[at, t] if at != node else offsets[node, t].copy()
                matrix = linear[at, t] @ matrix
                at = parents[at]
            np.testing.assert_allclose(whole[node, t], matrix, atol=1e-12)
            np.testing.assert_allclose(positions[node, t], place, atol=1e-12)


def test_wrong_trees_are_refused() -> None:
    linear, offsets = np.zeros((2, 1, 3, 3)), np.zeros((2, 1, 3))
    with pytest.raises(ParameterError, match="parents must be indices of earlier nodes"):
        global_transforms([1, -1], linear, offsets)
    with pytest.raises(ParameterError, match="of shapes"):
        global_transforms([-1, 0], linear, offsets[:1])


def test_a_scale_is_taken_off() -> None:
    turn = rotation(0, 20.0) @ rotation(1, -70.0)
    matrices = np.array([turn, 0.01 * turn, turn * [2.0, 2.0, 2.0], np.zeros((3, 3)), np.full((3, 3), np.nan)])
    found = without_scale(matrices)
    for matrix in found[:3]:
        np.testing.assert_allclose(matrix, turn, atol=1e-12)
    np.testing.assert_array_equal(found[3:], [np.eye(3)] * 2)
