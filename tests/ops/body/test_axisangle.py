"""Rotation vectors: their matrices, and the joints that they move, against quaternions one by one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.body import axisangle
from kinedex.ops.errors import ParameterError
from tests.oracles import axisangle as oracle


@given(vector=st.tuples(*(st.floats(-10, 10) for _ in range(3))), exponent=st.integers(-12, 0), seed=st.integers(0, 99))
def test_a_rotation_vector_turns_as_its_quaternion_does(
    vector: tuple[float, float, float], exponent: int, seed: int
) -> None:
    turn = np.array(vector) * 10.0**exponent
    point = np.random.default_rng(seed).normal(size=3)
    matrix = axisangle.matrices(turn[None])[0]
    np.testing.assert_allclose(matrix @ point, oracle.rotate(turn, point), atol=1e-12)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)


@given(seed=st.integers(0, 10_000), frames=st.integers(1, 5), joints=st.integers(1, 9))
def test_joints_are_where_their_parents_turns_bring_them(seed: int, frames: int, joints: int) -> None:
    random = np.random.default_rng(seed)
    rest, rotations, places = (random.normal(size=shape) for shape in ((joints, 3), (frames, joints, 3), (frames, 3)))
    parents = [-1, *(int(random.integers(0, j)) for j in range(1, joints))]
    positions, root = axisangle.forward(rest, parents, rotations, places)
    for t in range(frames):
        np.testing.assert_allclose(positions[:, :, t], oracle.pose(rest, parents, rotations[t], places[t]), atol=1e-12)
        for axis in np.eye(3):
            np.testing.assert_allclose(
                root[:, t].reshape(3, 3) @ axis, oracle.rotate(rotations[t, 0], axis), atol=1e-12
            )


def test_a_long_take_has_no_seams(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(0)
    arguments = (random.normal(size=(3, 3)), [-1, 0, 1], random.normal(size=(50, 3, 3)), random.normal(size=(50, 3)))
    whole = axisangle.forward(*arguments)
    monkeypatch.setattr(axisangle, "_BLOCK_FRAMES", 7)
    for found, expected in zip(axisangle.forward(*arguments), whole, strict=True):
        np.testing.assert_array_equal(found, expected)


def test_what_does_not_go_together_is_refused() -> None:
    with pytest.raises(ParameterError, match="rest, turns and places must be of shapes"):
        axisangle.forward(np.zeros((2, 3)), [-1, 0], np.zeros((4, 3, 3)), np.zeros((4, 3)))
    for parents in ([0, 0], [-1, 1], [-1, -1], [-1]):
        with pytest.raises(ParameterError, match="parents must be"):
            axisangle.forward(np.zeros((2, 3)), parents, np.zeros((4, 2, 3)), np.zeros((4, 3)))
