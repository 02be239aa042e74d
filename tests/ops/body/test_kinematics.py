"""Chains of nodes: what is left out costs nothing else, and turns are the same whatever path computes them."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.body import kinematics as k
from kinedex.ops.errors import ParameterError


def chain(seed: int = 0) -> tuple[tuple[k.Node, ...], int]:
    """A root with two arms of three joints, all kinds of channels; and how many channels."""
    rng = np.random.default_rng(seed)
    nodes, columns = [], 0
    for i, parent in enumerate([-1, 0, 1, 2, 0, 4, 5]):
        kinds = rng.permutation(7)[: rng.integers(0, 7)]
        steps = tuple(k.Step(int(kind), columns + j) for j, kind in enumerate(kinds))
        columns += len(steps)
        frame = np.eye(3) if i % 2 else k.euler((10.0 * i, 20.0, -30.0), "XYZ")
        nodes.append(k.Node(f"n{i}", parent, frame, *rng.normal(size=(3, 3)), steps))
    return tuple(nodes), columns


def naive(nodes: tuple[k.Node, ...], frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One frame, node by node: positions (nodes, 3) and rotations (nodes, 3, 3)."""
    rotations, ends = [], []
    for node in nodes:
        up, start = (rotations[node.parent], ends[node.parent]) if node.parent >= 0 else (np.eye(3), np.zeros(3))
        own, after = up @ node.frame, node.after.copy()
        start = start + up @ node.before
        for step in node.steps:
            if k.MOVE_X <= step.kind <= k.MOVE_Z:
                along = np.eye(3)[step.kind - k.MOVE_X] * frame[step.column]
                start = start + (own @ along if node.parent >= 0 else along)
        for step in node.steps:
            if step.kind <= k.ROTATE_Z:
                own = own @ k.rotation(step.kind, np.rad2deg(frame[step.column]))
            elif step.kind == k.STRETCH:
                after += node.direction * frame[step.column]
        rotations.append(own)
        ends.append(start + own @ after)
    return np.array(ends), np.array(rotations)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("frames", [1, k.BLOCK, k.BLOCK + 3])
def test_every_kind_of_channel_as_its_definition_says(seed: int, frames: int) -> None:
    nodes, columns = chain(seed)
    channels = np.random.default_rng(seed).normal(size=(frames, columns))
    positions, orientation = k.forward(nodes, channels, oriented=3)
    for t in (0, frames // 2, frames - 1):
        ends, rotations = naive(nodes, channels[t])
        np.testing.assert_allclose(positions[:, :, t], ends, atol=1e-12)
        np.testing.assert_allclose(orientation[:, t], rotations[3].ravel(), atol=1e-12)


def test_nodes_that_nobody_wants_are_left_out_and_the_others_are_the_same() -> None:
    nodes, columns = chain()
    channels = np.random.default_rng(1).normal(size=(10, columns))
    everything, orientation = k.forward(nodes, channels, oriented=4)
    some, same = k.forward(nodes, channels, oriented=4, wanted=[2])
    np.testing.assert_array_equal(same, orientation)
    np.testing.assert_array_equal(some[[0, 1, 2, 4]], everything[[0, 1, 2, 4]])
    assert np.isnan(some[[3, 5, 6]]).all()


def test_angles_of_any_size() -> None:
    nodes, columns = chain()
    channels = np.random.default_rng(1).normal(size=(10, columns))
    far = channels.copy()
    for node in nodes:
        for step in node.steps:
            if step.kind <= k.ROTATE_Z:
                far[:, step.column] += 2 * np.pi * 1e7
    np.testing.assert_allclose(k.forward(nodes, far)[0], k.forward(nodes, channels)[0], atol=1e-6)


def test_no_frames_and_no_channels() -> None:
    nodes, columns = chain()
    assert k.forward(nodes, np.empty((0, columns)))[0].shape == (7, 3, 0)
    still = (k.Node("root", -1, np.eye(3), np.ones(3), np.zeros(3), np.zeros(3), ()),)
    assert k.forward(still, np.empty((2, 0)))[0].tolist() == [[[1.0, 1.0]] * 3]


@pytest.mark.parametrize("index", [-1, 7])
def test_a_node_that_is_not_there_cannot_be_wanted(index: int) -> None:
    nodes, columns = chain()
    with pytest.raises(ParameterError, match="wanted"):
        k.forward(nodes, np.zeros((1, columns)), wanted=[index])


def from_quaternions(q: np.ndarray) -> np.ndarray:
    w, x, y, z = q
    return np.stack([
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ])  # fmt: skip


def test_quaternions_are_the_turns_and_do_not_jump() -> None:
    angles = np.linspace(0, 6 * np.pi, 500)
    rotations = [k.euler((float(a), 0.3 * float(a), -2.0 * float(a)), "ZYX") for a in np.rad2deg(angles)]
    matrices = np.ascontiguousarray(np.array(rotations).reshape(-1, 9).T)
    q = k.quaternions(matrices)
    np.testing.assert_allclose(from_quaternions(q), matrices, atol=1e-12)
    assert q[0, 0] > 0
    assert np.abs(np.diff(q, axis=1)).max() < 0.1


def test_fixed_turns_before_and_after() -> None:
    before, after = k.euler((10, 20, 30), "XYZ"), k.euler((-50, 5, 80), "ZXY")
    rotations = np.array([k.euler((a, 2 * a, 3 * a), "XYZ") for a in range(0, 360, 10)])
    matrices = np.ascontiguousarray(rotations.reshape(-1, 9).T)
    together = np.ascontiguousarray((before @ rotations @ after).reshape(-1, 9).T)
    np.testing.assert_allclose(k.quaternions(matrices, before, after), k.quaternions(together), atol=1e-12)


def test_a_frame_without_a_turn_has_no_quaternion_and_spoils_no_other() -> None:
    matrices = np.ascontiguousarray(np.tile(k.rotation(1, 100.0).ravel(), (4, 1)).T)
    matrices[:, 1] = np.nan
    q = k.quaternions(matrices)
    assert np.isnan(q[:, 1]).all()
    np.testing.assert_array_equal(q[:, 2], q[:, 0])
