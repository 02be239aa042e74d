"""The kinematic chain: worked examples, its twin with finite differences, and fits to joints."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.body import kinematic_chain as chains
from kinedex.ops.body.kinematic_chain import ChainBody, Poses, forward
from kinedex.ops.body.pose_fit import fit_poses, measured_body, start_poses
from kinedex.ops.errors import ParameterError
from tests.oracles import kinematic_chain as oracle

CHAIN = load_kinematic_chain()
LENGTHS = {
    "belly": 0.12, "chest": 0.12, "neck": 0.14, "head": 0.1, "headtop": 0.16, "shoulder": 0.18, "elbow": 0.28,
    "wrist": 0.25, "fingers": 0.12, "knee": 0.42, "ankle": 0.42, "toes": 0.15,
}  # fmt: skip


def example_body() -> ChainBody:
    """The body of the worked example (priors.md, section 10)."""
    offsets = np.zeros((24, 3))
    for j, (name, rest) in enumerate(zip(CHAIN.joints, CHAIN.rest, strict=True)):
        if rest.along is not None:
            offsets[j] = np.array(rest.along) * LENGTHS[name if name in LENGTHS else name[1:]]
    offsets[CHAIN.joint("lhip")], offsets[CHAIN.joint("rhip")] = (0.1, -0.08, 0), (-0.1, -0.08, 0)
    for name in ("lclavicle", "rclavicle"):
        offsets[CHAIN.joint(name)] = offsets[CHAIN.joint("neck")]
    return ChainBody(CHAIN, offsets)


BODY = example_body()


def random_poses(seed: int, frames: int, size: float = 0.5) -> Poses:
    """Poses that every node's axes allow, with hinges that bend their way."""
    random = np.random.default_rng(seed)
    rotations = np.tile(np.eye(3), (frames, len(CHAIN.nodes), 1, 1))
    for t in range(frames):
        vectors = np.zeros((len(CHAIN.nodes), 3))
        for axis in CHAIN.axes:
            turn = random.normal(0, size)
            vectors[axis.node, axis.direction] = axis.sign * (abs(turn) if np.isfinite(axis.hinge[1]) else turn)
        vectors[0, :] = [0.3, random.uniform(-3, 3), -0.2]
        rotations[t] = [oracle.exp(vector) for vector in vectors]
    return Poses(random.normal(0, 1, (frames, 3)), rotations)


def test_the_shipped_chain_has_twenty_nodes_and_48_parameters() -> None:
    assert (len(CHAIN.nodes), CHAIN.parameters, len(CHAIN.joints)) == (20, 48, 24)


def test_the_worked_example() -> None:
    rotations = np.tile(np.eye(3), (1, 20, 1, 1))
    for node, vector in {
        "pelvis": (0, 90, 0), "lknee": (90, 0, 0), "lshoulder": (0, 0, -90), "lelbow": (0, -90, 0),
    }.items():  # fmt: skip
        rotations[0, CHAIN.nodes.index(node)] = oracle.exp(np.deg2rad(vector))
    positions, _ = forward(BODY, Poses(np.array([[0.0, 1.0, 0.0]]), rotations))
    for joint, place in {
        "lknee": (0, 0.5, -0.1), "lankle": (-0.42, 0.5, -0.1), "ltoes": (-0.4725, 0.35945, -0.1),
        "lelbow": (0, 1.1, -0.18), "lwrist": (0.25, 1.1, -0.18), "rwrist": (0, 1.38, 0.71), "headtop": (0, 1.64, 0),
    }.items():  # fmt: skip
        np.testing.assert_allclose(positions[CHAIN.joint(joint), :, 0], place, atol=1e-12)


@settings(max_examples=5)
@given(seed=st.integers(0, 2**32 - 1))
def test_joints_steps_and_derivatives_are_those_of_the_twin(seed: int) -> None:
    poses = random_poses(seed, 1)
    place, rotations = poses.positions[0], poses.rotations[0]
    positions, turned = forward(BODY, poses)
    np.testing.assert_allclose(positions[:, :, 0], oracle.joints(BODY, place, rotations), atol=1e-12)
    step = np.random.default_rng(seed).normal(0, 0.4, CHAIN.parameters)
    new_place, new_turns = np.empty(3), np.empty((20, 3, 3))
    chains.take_step(BODY.arrays, place, rotations, step, new_place, new_turns)
    expected = oracle.stepped(BODY, place, rotations, step)
    np.testing.assert_allclose(new_place, expected[0])
    np.testing.assert_allclose(new_turns, expected[1], atol=1e-12)
    centres, columns = np.empty((20, 3)), np.empty((CHAIN.parameters, 4))
    chains.pose_nodes(BODY.arrays, place, rotations, np.empty((20, 3, 3)), centres)
    for joint in ("ltoes", "rfingers", "headtop", "rhip"):
        j = CHAIN.joint(joint)
        count = chains.point_jacobian(BODY.arrays, turned[0], centres, CHAIN.rest[j].node, positions[j, :, 0], columns)
        found = np.zeros((CHAIN.parameters, 3))
        found[columns[:count, 0].astype(int)] = columns[:count, 1:]
        for d in range(CHAIN.parameters):
            small = 1e-6 * np.eye(CHAIN.parameters)[d]
            ahead, behind = (
                oracle.joints(BODY, *oracle.stepped(BODY, place, rotations, sign * small))[j] for sign in (1, -1)
            )
            np.testing.assert_allclose(found[d], (ahead - behind) / 2e-6, atol=1e-8)


@settings(max_examples=5)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_gradient_of_the_rest_terms_is_exact(seed: int) -> None:
    poses = random_poses(seed, 1, 1.2)
    place, rotations = poses.positions[0], poses.rotations[0]
    nowhere = np.full((24, 3), np.nan)

    def cost(step: np.ndarray) -> float:
        return float((oracle.residuals(BODY, *oracle.stepped(BODY, place, rotations, step), nowhere) ** 2).sum())

    gradient, hessian = np.zeros(CHAIN.parameters), np.zeros((CHAIN.parameters, CHAIN.parameters))
    chains.add_rest_terms(BODY.arrays, rotations, hessian, gradient)
    np.testing.assert_allclose(chains.rest_cost(BODY.arrays, rotations), cost(np.zeros(CHAIN.parameters)), rtol=1e-9)
    for d in range(3, CHAIN.parameters):
        small = 1e-6 * np.eye(CHAIN.parameters)[d]
        np.testing.assert_allclose(2 * gradient[d], (cost(small) - cost(-small)) / 2e-6, rtol=1e-4, atol=1e-3)


def test_logarithm_and_exponential_undo_each_other_up_to_half_a_turn() -> None:
    for vector in ([0, 0, 0], [1e-9, 0, 0], [0.3, -0.2, 0.9], [3.1, 0, 0], [0, -2.2, 2.2], [0, 0, -3.14159]):
        rotation = chains.rotation_of(np.array(vector, float))
        np.testing.assert_allclose(rotation, oracle.exp(np.array(vector, float)), atol=1e-12)
        np.testing.assert_allclose(chains.vector_of(rotation), vector, atol=1e-7)


def test_the_fit_finds_the_minimum_of_the_twin() -> None:
    positions, _ = forward(BODY, random_poses(4, 1, 0.3))
    positions += np.random.default_rng(4).normal(0, 0.01, positions.shape)
    positions[CHAIN.joint("lfingers")] = np.nan
    points = positions[:, :, 0]
    found = fit_poses(BODY, positions, steps=60, tolerance=0.0)
    at = found.positions[0], found.rotations[0]

    def terms(step: np.ndarray) -> np.ndarray:
        return oracle.residuals(BODY, *oracle.stepped(BODY, *at, step), points)

    jacobian = oracle.derivatives(terms, CHAIN.parameters)
    step = np.linalg.solve(jacobian.T @ jacobian, jacobian.T @ terms(np.zeros(CHAIN.parameters)))
    np.testing.assert_allclose(step, 0, atol=1e-5)  # where Gauss and Newton of the twin stay


def test_a_body_is_measured_and_its_poses_are_found_again() -> None:
    poses = random_poses(1, 8, 0.3)
    positions, _ = forward(BODY, poses)
    measured = measured_body(CHAIN, positions)
    np.testing.assert_allclose(measured.offsets, BODY.offsets, atol=2e-4)
    again, _ = forward(measured, fit_poses(measured, positions))
    assert np.sqrt(((again - positions) ** 2).sum(axis=1)).max() < 0.02
    started, _ = forward(measured, start_poses(measured, positions))
    assert np.median(np.sqrt(((started - positions) ** 2).sum(axis=1))) < 1e-3


def test_turned_and_moved_joints_give_turned_and_moved_poses() -> None:
    positions, _ = forward(BODY, random_poses(3, 2, 0.3))
    turn = oracle.exp(np.array([0, 1.1, 0]))
    moved = np.einsum("ab,jbt->jat", turn, positions) + np.array([1.0, 0, -2])[:, None]
    first, second = (forward(BODY, fit_poses(BODY, one))[0] for one in (positions, moved))
    expected = np.einsum("ab,jbt->jat", turn, first) + np.array([1.0, 0, -2])[:, None]
    np.testing.assert_allclose(second, expected, atol=1e-6)


def test_frames_without_joints_and_bones_without_length_are_fitted() -> None:
    positions, _ = forward(BODY, random_poses(5, 4, 0.3))
    positions[:, :, 1] = np.nan
    positions[CHAIN.joint("belly")] = positions[CHAIN.joint("root")]
    body = measured_body(CHAIN, positions)
    poses = fit_poses(body, positions)
    assert np.isfinite(poses.rotations).all()
    np.testing.assert_allclose(np.linalg.det(poses.rotations), 1.0, atol=1e-9)
    found, _ = forward(body, poses)
    assert np.nanmean(np.sqrt(((found - positions) ** 2).sum(axis=1))) < 0.02


def test_what_cannot_be_fitted_is_refused() -> None:
    positions, _ = forward(BODY, random_poses(5, 4))
    with pytest.raises(ParameterError, match=r"positions must be of shape \(24, 3, T\)"):
        fit_poses(BODY, positions[:3])
    with pytest.raises(ParameterError, match="sigma_m must be positive"):
        fit_poses(BODY, positions, sigma_m=0.0)
    positions[CHAIN.joint("lknee")] = np.nan
    with pytest.raises(ParameterError, match="positions of lknee must be finite in a frame at least"):
        measured_body(CHAIN, positions)
    with pytest.raises(ParameterError, match="poses must be of shapes"):
        forward(BODY, Poses(np.zeros((2, 3)), np.zeros((3, 20, 3, 3))))
