"""This module fits a kinematic chain to joints: bone lengths, analytic initial poses, and Levenberg's method."""

from __future__ import annotations

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, Bool
from kinedex.ops.body.kinematic_chain import (
    PLACES,
    ChainArrays,
    ChainBody,
    KinematicChain,
    Poses,
    add_rest_terms,
    point_jacobian,
    pose_joints,
    pose_nodes,
    rest_cost,
    rotation_of,
    take_step,
    vector_of,
)
from kinedex.ops.copies import copy_row, copy_table
from kinedex.ops.errors import ParameterError

POINT_M = 0.01
"""Standard deviation of a joint's position, in metres."""

MAX_STEPS = 25
"""Maximum number of steps of Levenberg's method in a frame, rejected ones included."""

# the initial damping, and its factors after an accepted and a rejected step
_DAMPING, _EASED, _RAISED = 1e-3, 0.2, 10.0
_DIAGONAL = 1e-6  # is added to the diagonal of the normal equations
_BENT = 0.12  # weight of the pelvis's X axis against the normal of the leg's plane, which a straight leg does not have
_CHEST = 0.084  # weight of the chest's axis against the normal of the arm's plane


def measured_body(chain: KinematicChain, positions: F64) -> ChainBody:
    """Return the body of an actor, with the medians of the bone lengths over frames.

    Parameters
    ----------
    chain : KinematicChain
        The chain; its first node rotates about the root.
    positions : float64 array (J, 3, T)
        The joints of the chain in metres, Y up; NaN if a joint is not seen.

    Raises
    ------
    ParameterError
        A joint is seen in no frame together with the joint at the other end of its bone.
    """
    offsets = np.zeros((len(chain.joints), 3))
    pelvis = _pelvis(chain, positions)
    with np.errstate(invalid="ignore"):
        for j, rest in enumerate(chain.rest):
            bone = positions[j] - positions[rest.start]
            if rest.measured:
                bone = np.einsum("tba,bt->at", pelvis, positions[j] - positions[chain.centres[rest.node]])
            seen = np.isfinite(bone).all(axis=0)
            if not seen.any():
                raise ParameterError(f"positions of {chain.joints[j]}", "finite in a frame at least", "none")
            if rest.measured:
                offsets[j] = np.median(bone[:, seen], axis=1)
            elif rest.along is not None:
                offsets[j] = np.array(rest.along) * np.median(np.sqrt((bone[:, seen] ** 2).sum(axis=0)))
    for j, rest in enumerate(chain.rest):
        if rest.along is None and not rest.measured and rest.start != j:
            offsets[j] = offsets[rest.start]
    return ChainBody(chain, offsets)


def fit_poses(
    body: ChainBody, positions: F64, sigma_m: float = POINT_M, steps: int = MAX_STEPS, tolerance: float = 1e-4
) -> Poses:
    """Fit the poses of a body to joints, each frame independently.

    The method starts from `start_poses` and minimises a sum of squares. Its terms are the distances to the joints
    divided by sigma, the deviations of angles from the rest pose, and the excess of angles over the limits of hinges.

    Parameters
    ----------
    body : ChainBody
        The body.
    positions : float64 array (J, 3, T)
        The joints in metres, Y up. A joint that is NaN has no term; its position follows from the other joints.
    sigma_m : float, optional
        Standard deviation of a joint's position, in metres.
    steps : int, optional
        The maximum number of steps in a frame.
    tolerance : float, optional
        The fit of a frame ends if a step decreases the sum by no more than this fraction.

    Returns
    -------
    Poses
        T poses; a frame without any joint has the rest pose, with the pelvis of `start_poses`.
    """
    joints = len(body.chain.joints)
    if positions.ndim != 3 or positions.shape[:2] != (joints, 3):
        raise ParameterError("positions", f"of shape ({joints}, 3, T)", positions.shape)
    if not (np.isfinite(sigma_m) and sigma_m > 0):
        raise ParameterError("sigma_m", "positive and finite", sigma_m)
    poses = start_poses(body, positions)
    points = np.ascontiguousarray(np.moveaxis(positions, 2, 0), np.float64)
    _fit(body.arrays, points, 1.0 / sigma_m**2, steps, tolerance, poses.positions, poses.rotations)
    return poses


def start_poses(body: ChainBody, positions: F64) -> Poses:
    """Return initial poses from the directions of the bones; a fit from other poses may end in another local minimum.

    Parameters
    ----------
    body : ChainBody
        A body with the nodes of the shipped chain.
    positions : float64 array (J, 3, T)
        The joints in metres, Y up. If a direction is not known, the node has the orientation of its parent.

    Returns
    -------
    Poses
        T poses. If the pelvis is not seen in a frame, it is copied from the last frame before in which it is seen, or
        else from the first frame in which it is seen.
    """
    chain = body.chain
    at = {name: positions[j].T for j, name in enumerate(chain.joints)}
    turned = _world_turns(chain, positions, at)
    frames = positions.shape[2]
    rotations = np.empty((frames, len(chain.nodes), 3, 3))
    for k, parent in enumerate(chain.parents):
        world = turned[chain.nodes[k]]
        local = world if parent < 0 else np.einsum("tba,tbc->tac", turned[chain.nodes[parent]], world)
        free = np.zeros(3, np.bool_)
        free[[axis.direction for axis in chain.axes_of(k)]] = True
        rotations[:, k] = local
        if not free.all():
            _restrict(rotations, k, free)
    return Poses(_held(at["root"]), rotations)


def _world_turns(chain: KinematicChain, positions: F64, at: dict[str, F64]) -> dict[str, F64]:
    """Return the world rotations (T, 3, 3) of all nodes, from the directions of the bones."""
    pelvis = _held(_pelvis(chain, positions))
    found = {"pelvis": pelvis}
    hips, shoulders = _unit(at["lhip"] - at["rhip"]), _unit(at["lshoulder"] - at["rshoulder"])
    for node, above, low, high, share in (
        ("spine0", "pelvis", "root", "belly", 1 / 3),
        ("spine1", "spine0", "belly", "chest", 2 / 3),
        ("spine2", "spine1", "chest", "neck", 1.0),
    ):
        across = share * shoulders + (1.0 - share) * hips
        found[node] = _frame(1, at[high] - at[low], 0, across, found[above])
    chest = found["spine2"]
    found["neck"] = _frame(1, at["head"] - at["neck"], 0, shoulders, chest)
    found["head"] = _frame(1, at["headtop"] - at["head"], 0, shoulders, found["neck"])
    for side, sign in (("l", 1.0), ("r", -1.0)):
        thigh, shank = _unit(at[f"{side}knee"] - at[f"{side}hip"]), _unit(at[f"{side}ankle"] - at[f"{side}knee"])
        x = pelvis[:, :, 0]
        beside = x - np.einsum("ta,ta->t", x, thigh)[:, None] * thigh
        hip = _frame(1, -thigh, 0, np.cross(thigh, shank) + _BENT * beside, pelvis)
        knee = _frame(1, -shank, 0, hip[:, :, 0], hip)
        clavicle = _frame(0, sign * (at[f"{side}shoulder"] - at["neck"]), 1, chest[:, :, 1], chest)
        upper = _unit(at[f"{side}elbow"] - at[f"{side}shoulder"])
        fore = _unit(at[f"{side}wrist"] - at[f"{side}elbow"])
        up = -sign * np.cross(upper, fore) + _CHEST * (chest[:, :, 1] + sign * chest[:, :, 0])
        shoulder = _frame(0, sign * upper, 1, up, clavicle)
        elbow = _frame(0, sign * fore, 1, shoulder[:, :, 1], shoulder)
        found |= {f"{side}hip": hip, f"{side}knee": knee, f"{side}ankle": knee, f"{side}clavicle": clavicle}
        found |= {f"{side}shoulder": shoulder, f"{side}elbow": elbow, f"{side}wrist": elbow}
    return found


def _pelvis(chain: KinematicChain, positions: F64) -> F64:
    """Return the axes (T, 3, 3) of the pelvis: X from the right to the left hip, Y from their middle to the root.

    If the root is the middle of the hips, Y points to the middle of the shoulders. Unknown axes are NaN.
    """
    root, left, right, lshoulder, rshoulder = (
        positions[chain.joint(name)].T for name in ("root", "lhip", "rhip", "lshoulder", "rshoulder")
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        x = _unit(left - right)
        middle = 0.5 * (left + right)
        up, trunk = root - middle, 0.5 * (lshoulder + rshoulder) - middle
        across = np.sqrt(np.einsum("ta,ta->t", left - right, left - right))
        beside = up - np.einsum("ta,ta->t", up, x)[:, None] * x
        low = np.sqrt(np.einsum("ta,ta->t", beside, beside)) < 1e-3 * across
        up = np.where(low[:, None], trunk, up)
        y = _unit(up - np.einsum("ta,ta->t", up, x)[:, None] * x)
        return np.stack([x, y, np.cross(x, y)], axis=2)


def _held(rows: F64) -> F64:
    """Return rows with each row that is not finite replaced by the last finite row, or at the start by the first."""
    seen = np.isfinite(rows.reshape(len(rows), -1).sum(axis=1))
    if not seen.any():
        raise ParameterError("positions of the root and the hips", "finite in a frame at least", "none")
    last = np.maximum.accumulate(np.where(seen, np.arange(len(rows)), -1))
    return rows[np.where(last < 0, np.argmax(seen), last)]


def _unit(vectors: F64) -> F64:
    """Return vectors (T, 3) normalised to length 1; NaN for the zero vector."""
    with np.errstate(invalid="ignore", divide="ignore"):
        lengths = np.sqrt(np.einsum("ta,ta->t", vectors, vectors))
        return vectors / np.where(lengths > 1e-9, lengths, np.nan)[:, None]


def _frame(first: int, exact: F64, second: int, near: F64, above: F64) -> F64:
    """Return frames (T, 3, 3) with one axis along `exact`, and another as close to `near` as possible.

    An axis that is not known is taken from the frame `above`.
    """
    one = _unit(exact)
    one = np.where(np.isfinite(one.sum(axis=1, keepdims=True)), one, above[:, :, first])
    other = _unit(near - np.einsum("ta,ta->t", near, one)[:, None] * one)
    for axis in (second, 3 - first - second):  # the second axis is used where the first lies along the exact axis
        own = above[:, :, axis] if axis == second else np.cross(above[:, :, axis], one) * (1 if first == 0 else -1)
        spare = _unit(own - np.einsum("ta,ta->t", own, one)[:, None] * one)
        other = np.where(np.isfinite(other.sum(axis=1, keepdims=True)), other, spare)
    x, y = (one, other) if first == 0 else (other, one)
    return np.stack([x, y, np.cross(x, y)], axis=2)


@njit(cache=True, nogil=True)
def _restrict(rotations: F64, node: int, free: Bool) -> None:
    """Restrict the rotation vectors of a node to the components about its axes."""
    for t in range(len(rotations)):
        vector = vector_of(rotations[t, node])
        for i in range(3):
            if not free[i]:
                vector[i] = 0.0
        copy_table(rotations[t, node], rotation_of(vector))


@njit(cache=True, nogil=True)
def _fit(
    chain: ChainArrays, points: F64, weight: float, steps: int, tolerance: float, positions: F64, rotations: F64
) -> None:
    size, nodes = PLACES + len(chain.axis_nodes), len(chain.parents)
    hessian, damped, gradient, step = np.empty((size, size)), np.empty((size, size)), np.empty(size), np.empty(size)
    place, turn = np.empty(3), np.empty((nodes, 3, 3))
    turned, centres = np.empty((nodes, 3, 3)), np.empty((nodes, 3))
    joints = np.empty((len(chain.joint_nodes), 3))
    for t in range(len(points)):
        cost = _cost(chain, positions[t], rotations[t], points[t], weight, turned, centres, joints)
        damping, fresh = _DAMPING, True
        for _ in range(steps):
            if fresh:
                pose_nodes(chain, positions[t], rotations[t], turned, centres)
                pose_joints(chain, turned, centres, joints)
                hessian[:], gradient[:] = 0.0, 0.0
                _add_points(chain, turned, centres, joints, points[t], weight, hessian, gradient)
                add_rest_terms(chain, rotations[t], hessian, gradient)
            copy_table(damped, hessian)
            for i in range(size):
                damped[i, i] += damping * hessian[i, i] + _DIAGONAL
            solve_step(damped, gradient, step)
            take_step(chain, positions[t], rotations[t], step, place, turn)
            new = _cost(chain, place, turn, points[t], weight, turned, centres, joints)
            fresh = new < cost
            if not fresh:
                damping *= _RAISED
                continue
            copy_row(positions[t], place)
            for node in range(nodes):
                copy_table(rotations[t, node], turn[node])
            damping *= _EASED
            done = cost - new <= tolerance * cost
            cost = new
            if done:
                break


@njit(cache=True, nogil=True)
def _cost(
    chain: ChainArrays, place: F64, rotations: F64, points: F64, weight: float, turned: F64, centres: F64, joints: F64
) -> float:
    pose_nodes(chain, place, rotations, turned, centres)
    pose_joints(chain, turned, centres, joints)
    total = rest_cost(chain, rotations)
    for j in range(len(joints)):
        square = 0.0
        for i in range(3):
            square += (joints[j, i] - points[j, i]) ** 2
        if square == square:
            total += weight * square
    return total


@njit(cache=True, nogil=True)
def _add_points(
    chain: ChainArrays, turned: F64, centres: F64, joints: F64, points: F64, weight: float, hessian: F64, gradient: F64
) -> None:
    """Add the squared distances of joints to their points to the lower half of H, and to g."""
    columns = np.empty((len(gradient), 4))
    for j in range(len(joints)):
        x, y, z = joints[j, 0] - points[j, 0], joints[j, 1] - points[j, 1], joints[j, 2] - points[j, 2]
        if np.isnan(x + y + z):
            continue
        count = point_jacobian(chain, turned, centres, chain.joint_nodes[j], joints[j], columns)
        for a in range(count):
            p, u, v, w = int(columns[a, 0]), columns[a, 1], columns[a, 2], columns[a, 3]
            gradient[p] += weight * (u * x + v * y + w * z)
            for b in range(a + 1):
                q = int(columns[b, 0])
                hessian[p, q] += weight * (u * columns[b, 1] + v * columns[b, 2] + w * columns[b, 3])


@njit(cache=True, nogil=True)
def solve_step(matrix: F64, gradient: F64, step: F64) -> None:
    """Solve matrix · step = −gradient by Cholesky decomposition, overwriting the lower half of the matrix."""
    size = len(gradient)
    for i in range(size):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = np.sqrt(max(total, 1e-300)) if i == j else total / matrix[j, j]
    for i in range(size):
        total = -gradient[i]
        for k in range(i):
            total -= matrix[i, k] * step[k]
        step[i] = total / matrix[i, i]
    for i in range(size - 1, -1, -1):
        total = step[i]
        for k in range(i + 1, size):
            total -= matrix[k, i] * step[k]
        step[i] = total / matrix[i, i]
