"""This module computes a frame's H and g: body points, priors, pulls to rest and hinges (thesis, 6.2.2 and 6.4).

H and g are those of a Gauss–Newton step x, which solves H x = −g: H sums JᵀAJ, and g sums Jᵀb over the terms: half of
the derivatives of the cost. Only the lower half of H is filled. Both trackers use these terms.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.kinematic_chain import (
    PLACES,
    ChainArrays,
    ChainBody,
    Poses,
    add_rest_terms,
    log_derivative,
    point_jacobian,
    pose_nodes,
    rest_cost,
    vector_of,
)
from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking.prior_terms import PriorTerms, no_priors
from kinedex.ops.tracking.rays import Evidence, point_cost, point_terms
from kinedex.ops.tracking.subtree_sums import add_points


class PriorArrays(NamedTuple):
    """The terms of priors as arrays for compiled functions; see `PriorTerms`.

    Attributes
    ----------
    turn_targets : float64 array (T, K, 3, 3)
        The rotation that each node is pulled to.
    turn_weights : float64 array (T, K, 3)
        Weight about X, Y and Z of the node.
    tilt_targets : float64 array (T, 3)
        The target of the up axis in the frame of the pelvis.
    tilt_weights : float64 array (T,)
        Weight of each tilt.
    place_joints : int64 array (N,)
        Joint of each place term.
    place_directions : float64 array (N, 3)
        Its unit vector.
    place_targets : float64 array (N,)
        Its target along this vector.
    place_weights : float64 array (N,)
        Its weight.
    place_starts : int64 array (T + 1,)
        The index of the first place term of each frame, and the total number.
    """

    turn_targets: F64
    turn_weights: F64
    tilt_targets: F64
    tilt_weights: F64
    place_joints: I64
    place_directions: F64
    place_targets: F64
    place_weights: F64
    place_starts: I64


def prior_arrays(body: ChainBody, priors: PriorTerms | None, frames: int) -> PriorArrays:
    """Return the terms of priors as arrays for compiled functions.

    Parameters
    ----------
    body : ChainBody
        The body.
    priors : PriorTerms or None
        The terms; None for none.
    frames : int
        T, the number of frames.

    Raises
    ------
    ParameterError
        The terms are not those of T frames of the body, or the place terms' frames do not ascend.
    """
    nodes = len(body.chain.nodes)
    terms = no_priors(frames, nodes) if priors is None else priors
    if terms.turn_targets.shape != (frames, nodes, 3, 3):
        raise ParameterError("priors", f"terms of {frames} frames and {nodes} nodes", terms.turn_targets.shape[:2])
    at = terms.place_frames
    if len(at) and not (at[0] >= 0 and at[-1] < frames and (np.diff(at) >= 0).all()):
        raise ParameterError("place_frames", f"ascending, from 0 to {frames - 1}", at.tolist()[:8])
    return PriorArrays(
        np.ascontiguousarray(terms.turn_targets, np.float64),
        np.ascontiguousarray(terms.turn_weights, np.float64),
        np.ascontiguousarray(terms.tilt_targets, np.float64),
        np.ascontiguousarray(terms.tilt_weights, np.float64),
        np.ascontiguousarray(terms.place_joints, np.int64),
        np.ascontiguousarray(terms.place_directions, np.float64),
        np.ascontiguousarray(terms.place_targets, np.float64),
        np.ascontiguousarray(terms.place_weights, np.float64),
        np.searchsorted(at, np.arange(frames + 1)).astype(np.int64),
    )


@njit(cache=True, nogil=True)
def place_points(nodes: I64, offsets: F64, turned: F64, centres: F64, points: F64) -> None:
    """Compute the points (P, 3) of one frame from its nodes, and write them into `points`.

    Parameters
    ----------
    nodes : int64 array (P,)
        The node that moves each point.
    offsets : float64 array (P, 3)
        Its place in the frame of that node.
    turned, centres : float64 array (K, 3, 3), (K, 3)
        The nodes, see `pose_nodes`.
    points : float64 array (P, 3)
        Out: the points in the world.
    """
    for p in range(len(nodes)):
        k = nodes[p]
        for i in range(3):
            points[p, i] = centres[k, i] + (
                turned[k, i, 0] * offsets[p, 0] + turned[k, i, 1] * offsets[p, 1] + turned[k, i, 2] * offsets[p, 2]
            )


@njit(cache=True, nogil=True)
def add_point(
    chain: ChainArrays, turned: F64, centres: F64, node: int, point: F64, matrix: F64, vector: F64, columns: F64,
    hessian: F64, gradient: F64,
) -> None:  # fmt: skip
    """Add JᵀAJ and Jᵀb of one point to H and g of a frame.

    Parameters
    ----------
    chain : ChainArrays
        The body.
    turned, centres : float64 array (K, 3, 3), (K, 3)
        The nodes, see `pose_nodes`.
    node : int
        The node that moves the point.
    point : float64 array (3,)
        The point in the world.
    matrix : float64 array (3, 3)
        A, symmetric.
    vector : float64 array (3,)
        b.
    columns : float64 array (parameters, 4)
        Work memory for the Jacobian, see `point_jacobian`.
    hessian : float64 array (parameters, parameters)
        H, of which the lower half is added to.
    gradient : float64 array (parameters,)
        g.
    """
    count = point_jacobian(chain, turned, centres, node, point, columns)
    for a in range(count):
        p, u, v, w = int(columns[a, 0]), columns[a, 1], columns[a, 2], columns[a, 3]
        gradient[p] += u * vector[0] + v * vector[1] + w * vector[2]
        x = matrix[0, 0] * u + matrix[0, 1] * v + matrix[0, 2] * w
        y = matrix[1, 0] * u + matrix[1, 1] * v + matrix[1, 2] * w
        z = matrix[2, 0] * u + matrix[2, 1] * v + matrix[2, 2] * w
        for b in range(a + 1):
            hessian[p, int(columns[b, 0])] += x * columns[b, 1] + y * columns[b, 2] + z * columns[b, 3]


@njit(cache=True, nogil=True)
def add_prior_terms(
    chain: ChainArrays, priors: PriorArrays, t: int, turns: F64, turned: F64, centres: F64, columns: F64,
    hessian: F64, gradient: F64,
) -> float:  # fmt: skip
    """Add the terms of priors of one frame to H and g, and return their cost.

    g uses the exact derivative of the logarithm; H approximates it by the identity, so its part is diagonal.

    Parameters
    ----------
    chain : ChainArrays
        The body.
    priors : PriorArrays
        The terms.
    t : int
        The frame.
    turns : float64 array (K, 3, 3)
        Rotation of each node from its parent.
    turned, centres : float64 array (K, 3, 3), (K, 3)
        The nodes, see `pose_nodes`.
    columns : float64 array (parameters, 4)
        Work memory for a Jacobian.
    hessian : float64 array (parameters, parameters)
        H, of which the lower half is added to.
    gradient : float64 array (parameters,)
        g.

    Returns
    -------
    float
        The cost.
    """
    total = _add_turn_terms(chain, priors, t, turns, hessian, gradient)
    if priors.tilt_weights[t] > 0.0:
        total += _add_tilt_term(chain, priors, t, turns[0], hessian, gradient)
    matrix, vector, point = np.empty((3, 3)), np.empty(3), np.empty(3)
    for n in range(priors.place_starts[t], priors.place_starts[t + 1]):
        node, weight = _place_joint(chain, priors.place_joints[n], turned, centres, point), priors.place_weights[n]
        excess = -priors.place_targets[n]
        for i in range(3):
            excess += priors.place_directions[n, i] * point[i]
        for i in range(3):
            vector[i] = weight * excess * priors.place_directions[n, i]
            for j in range(3):
                matrix[i, j] = weight * priors.place_directions[n, i] * priors.place_directions[n, j]
        add_point(chain, turned, centres, node, point, matrix, vector, columns, hessian, gradient)
        total += weight * excess * excess
    return total


@njit(cache=True, nogil=True)
def _place_joint(chain: ChainArrays, joint: int, turned: F64, centres: F64, point: F64) -> int:
    """Write a joint's position in the world into the last array, and return the node that moves the joint."""
    k = chain.joint_nodes[joint]
    for i in range(3):
        point[i] = centres[k, i]
        for a in range(3):
            point[i] += turned[k, i, a] * chain.joint_offsets[joint, a]
    return k


@njit(cache=True, nogil=True)
def _turn_from(target: F64, turn: F64) -> F64:
    """Return log(MᵀR) of a target rotation M and a rotation R."""
    between = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            between[i, j] = target[0, i] * turn[0, j] + target[1, i] * turn[1, j] + target[2, i] * turn[2, j]
    return vector_of(between)


@njit(cache=True, nogil=True)
def _weightless(weights: F64) -> bool:
    return weights[0] <= 0.0 and weights[1] <= 0.0 and weights[2] <= 0.0


@njit(cache=True, nogil=True)
def _add_turn_terms(chain: ChainArrays, priors: PriorArrays, t: int, turns: F64, hessian: F64, gradient: F64) -> float:
    total, d = 0.0, 0
    for k in range(len(chain.parents)):
        first = d
        while d < len(chain.axis_nodes) and chain.axis_nodes[d] == k:
            d += 1
        if d == first or _weightless(priors.turn_weights[t, k]):
            continue
        vector = _turn_from(priors.turn_targets[t, k], turns[k])
        derivative = log_derivative(vector)
        for a in range(first, d):
            i = chain.axis_directions[a]
            slope = priors.turn_weights[t, k, i] * vector[i]
            total += slope * vector[i]
            hessian[PLACES + a, PLACES + a] += priors.turn_weights[t, k, i]
            for b in range(first, d):
                gradient[PLACES + b] += slope * chain.axis_signs[b] * derivative[i, chain.axis_directions[b]]
    return total


@njit(cache=True, nogil=True)
def _add_tilt_term(chain: ChainArrays, priors: PriorArrays, t: int, turn: F64, hessian: F64, gradient: F64) -> float:
    """Add w ‖Rᵀe_y − t‖² of the pelvis, whose derivative by a rotation about e_d is (Rᵀe_y) × e_d."""
    weight = priors.tilt_weights[t]
    up = turn[1]  # the row of R is Rᵀe_y
    excess = up - priors.tilt_targets[t]
    columns = np.zeros((3, 3))
    columns[0, 1], columns[0, 2] = up[2], -up[1]
    columns[1, 0], columns[1, 2] = -up[2], up[0]
    columns[2, 0], columns[2, 1] = up[1], -up[0]
    for a in range(len(chain.axis_nodes)):
        if chain.axis_nodes[a] != 0:
            break
        one, sign = columns[chain.axis_directions[a]], chain.axis_signs[a] * weight
        gradient[PLACES + a] += sign * (one[0] * excess[0] + one[1] * excess[1] + one[2] * excess[2])
        for b in range(a + 1):
            other = columns[chain.axis_directions[b]]
            product = one[0] * other[0] + one[1] * other[1] + one[2] * other[2]
            hessian[PLACES + a, PLACES + b] += sign * chain.axis_signs[b] * product
    return weight * (excess[0] ** 2 + excess[1] ** 2 + excess[2] ** 2)


@njit(cache=True, nogil=True)
def prior_cost(chain: ChainArrays, priors: PriorArrays, t: int, turns: F64, turned: F64, centres: F64) -> float:
    """Return the cost of the terms of priors of one frame; see `add_prior_terms`."""
    total, d = 0.0, 0
    for k in range(len(chain.parents)):
        first = d
        while d < len(chain.axis_nodes) and chain.axis_nodes[d] == k:
            d += 1
        if d == first or _weightless(priors.turn_weights[t, k]):
            continue
        vector = _turn_from(priors.turn_targets[t, k], turns[k])
        for a in range(first, d):
            i = chain.axis_directions[a]
            total += priors.turn_weights[t, k, i] * vector[i] * vector[i]
    if priors.tilt_weights[t] > 0.0:
        for i in range(3):
            total += priors.tilt_weights[t] * (turns[0, 1, i] - priors.tilt_targets[t, i]) ** 2
    point = np.empty(3)
    for n in range(priors.place_starts[t], priors.place_starts[t + 1]):
        _place_joint(chain, priors.place_joints[n], turned, centres, point)
        excess = -priors.place_targets[n]
        for i in range(3):
            excess += priors.place_directions[n, i] * point[i]
        total += priors.place_weights[n] * excess * excess
    return total


class FrameRoom(NamedTuple):
    """Preallocated arrays for H and g of one frame.

    Attributes
    ----------
    turned, centres : float64 array (K, 3, 3), (K, 3)
        The nodes.
    points : float64 array (P, 3)
        The points of the evidence.
    matrices, vectors : float64 array (P, 3, 3), (P, 3)
        A and b of each.
    columns : float64 array (parameters, 4)
        The Jacobian of a point.
    hessian : float64 array (parameters, parameters)
        H.
    """

    turned: F64
    centres: F64
    points: F64
    matrices: F64
    vectors: F64
    columns: F64
    hessian: F64


@njit(cache=True, nogil=True)
def frame_room(chain: ChainArrays, evidence: Evidence) -> FrameRoom:
    """Allocate the arrays of one frame."""
    nodes, points, size = len(chain.parents), len(evidence.nodes), PLACES + len(chain.axis_nodes)
    return FrameRoom(
        np.empty((nodes, 3, 3)),
        np.empty((nodes, 3)),
        np.empty((points, 3)),
        np.empty((points, 3, 3)),
        np.empty((points, 3)),
        np.empty((size, 4)),
        np.empty((size, size)),
    )


@njit(cache=True, nogil=True)
def frame_terms(
    chain: ChainArrays, evidence: Evidence, priors: PriorArrays, t: int, place: F64, turns: F64, width: float,
    units: F64, room: FrameRoom, gradient: F64,
) -> float:  # fmt: skip
    """Compute H, into `room.hessian`, and g of one frame, and return its cost.

    Parameters
    ----------
    chain : ChainArrays
        The body.
    evidence : Evidence
        The observations.
    priors : PriorArrays
        The terms of priors.
    t : int
        The frame.
    place, turns : float64 array (3,), (K, 3, 3)
        Its pose.
    width : float
        c of the loss; infinite for squares.
    units : float64 array (V, P)
        Out: the squares of the factors of residuals, see `rays.point_terms`.
    room : FrameRoom
        The preallocated arrays of the frame.
    gradient : float64 array (parameters,)
        Out: g.

    Returns
    -------
    float
        The cost: of observations, pulls to rest, hinges, and priors.
    """
    pose_nodes(chain, place, turns, room.turned, room.centres)
    place_points(evidence.nodes, evidence.offsets, room.turned, room.centres, room.points)
    cost = point_terms(evidence, t, room.points, width, units, room.matrices, room.vectors)
    room.hessian[:] = 0.0
    gradient[:] = 0.0
    add_points(
        chain, room.turned, room.centres, evidence.nodes, room.points, room.matrices, room.vectors,
        room.hessian, gradient,
    )  # fmt: skip
    cost += add_rest_terms(chain, turns, room.hessian, gradient)
    return cost + add_prior_terms(
        chain, priors, t, turns, room.turned, room.centres, room.columns, room.hessian, gradient
    )


@njit(cache=True, nogil=True)
def frame_cost(
    chain: ChainArrays, evidence: Evidence, priors: PriorArrays, t: int, place: F64, turns: F64, width: float,
    units: F64, room: FrameRoom,
) -> float:  # fmt: skip
    """Return the cost of one frame, with fixed factors `units` of residuals; see `frame_terms`."""
    pose_nodes(chain, place, turns, room.turned, room.centres)
    place_points(evidence.nodes, evidence.offsets, room.turned, room.centres, room.points)
    cost = point_cost(evidence, t, room.points, width, units, np.bool_(False)) + rest_cost(chain, turns)
    return cost + prior_cost(chain, priors, t, turns, room.turned, room.centres)


def observation_costs(body: ChainBody, evidence: Evidence, poses: Poses, width: float) -> F64:
    """Return the cost of the observations of each frame.

    Parameters
    ----------
    body : ChainBody
        The body.
    evidence : Evidence
        The observations.
    poses : Poses
        T poses.
    width : float
        c of the loss; infinite for squares.

    Returns
    -------
    float64 array (T,)
        Σ conf² ρ(r).
    """
    costs = np.empty(len(poses.places))
    _observation_costs(body.arrays, evidence, poses.places, poses.turns, width, costs)
    return costs


@njit(cache=True, nogil=True)
def _observation_costs(
    chain: ChainArrays, evidence: Evidence, places: F64, turns: F64, width: float, costs: F64
) -> None:
    room = frame_room(chain, evidence)
    units = np.empty(evidence.confidence.shape[1:])
    for t in range(len(places)):
        pose_nodes(chain, places[t], turns[t], room.turned, room.centres)
        place_points(evidence.nodes, evidence.offsets, room.turned, room.centres, room.points)
        costs[t] = point_cost(evidence, t, room.points, width, units, np.bool_(True))
