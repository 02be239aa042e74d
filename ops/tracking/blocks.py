"""This module computes the normal equations H, g of one frame of a track (thesis, 6.2.2 and 6.4).

The terms are those of body points, of priors, of deviations from the rest pose and of hinge limits. A Gauss–Newton step
x solves H x = −g, where H is the sum of JᵀAJ and g the sum of Jᵀb over all terms; g is half of the gradient of the
cost. Only the lower half of H is filled. The frame tracker and the take tracker both use these terms.

JᵀAJ and Jᵀb of all points of a frame are computed by sums over the subtrees of the nodes. A parameter moves all points
below its node as one rigid body, by a twist: a velocity v at the position o of the root, and an angular velocity ω.
With r = y − o, the point y moves by v − [r]ω, where [r] is the matrix of r × ·. Hence the sums of A, [r]A, [r]A[r]ᵀ, b
and r × b over the points below a node suffice for its parameters. They are accumulated from the leaves to the root, as
in the composite rigid body algorithm of robotics, so that the work per parameter does not depend on the number of
points.
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
from kinedex.ops.copies import copy_row
from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking.observations import PriorTerms, no_priors
from kinedex.ops.tracking.rays import Evidence, point_cost, point_terms


class PriorArrays(NamedTuple):
    """The terms of priors as arrays for compiled functions; see `PriorTerms`.

    Attributes
    ----------
    turn_targets : float64 array (T, K, 3, 3)
        The target rotation of each node.
    turn_weights : float64 array (T, K, 3)
        The weight of each rotation about X, Y and Z of the node.
    tilt_targets : float64 array (T, 3)
        The target of the world's up axis in the frame of the pelvis.
    tilt_weights : float64 array (T,)
        The weight of each tilt.
    place_joints : int64 array (N,)
        The joint of each position term.
    place_directions : float64 array (N, 3)
        The unit vector of each position term.
    place_targets : float64 array (N,)
        The target coordinate of the joint along this vector.
    place_weights : float64 array (N,)
        The weight of each position term.
    place_starts : int64 array (T + 1,)
        The index of the first position term of each frame, and the number of all terms.
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
        The terms; None for no priors.
    frames : int
        The number of frames T.

    Raises
    ------
    ParameterError
        The terms are not those of T frames of the body, or the frames of position terms do not ascend.
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


class TrackProblem(NamedTuple):
    """The terms of a track as arrays for compiled functions: a body, the observations, and priors.

    Parameters
    ----------
    chain : ChainArrays
        The body, with K nodes.
    evidence : Evidence
        The observations of T frames.
    priors : PriorArrays
        The terms of priors.
    """

    chain: ChainArrays
    evidence: Evidence
    priors: PriorArrays

    def window(self, first: int, stop: int) -> TrackProblem:
        """Return the terms of the frames from `first` to `stop` − 1."""
        evidence, priors = self.evidence, self.priors
        return TrackProblem(
            self.chain,
            evidence._replace(
                directions=evidence.directions[first:stop],
                confidence=evidence.confidence[first:stop],
                positions=evidence.positions[first:stop],
                precisions=evidence.precisions[first:stop],
            ),
            priors._replace(
                turn_targets=priors.turn_targets[first:stop],
                turn_weights=priors.turn_weights[first:stop],
                tilt_targets=priors.tilt_targets[first:stop],
                tilt_weights=priors.tilt_weights[first:stop],
                place_starts=priors.place_starts[first : stop + 1],
            ),
        )


@njit(cache=True, nogil=True)
def place_points(nodes: I64, offsets: F64, turned: F64, centres: F64, points: F64) -> None:
    """Compute the points (P, 3) of one frame from its nodes, and write them into `points`.

    Parameters
    ----------
    nodes : int64 array (P,)
        The node that moves each point.
    offsets : float64 array (P, 3)
        The position of each point in the frame of that node.
    turned, centres : float64 array (K, 3, 3), (K, 3)
        The nodes, see `pose_nodes`.
    points : float64 array (P, 3)
        Output: the points in the world.
    """
    for p in range(len(nodes)):
        k = nodes[p]
        for i in range(3):
            points[p, i] = centres[k, i] + (
                turned[k, i, 0] * offsets[p, 0] + turned[k, i, 1] * offsets[p, 1] + turned[k, i, 2] * offsets[p, 2]
            )


@njit(cache=True, nogil=True)
def add_point(
    chain: ChainArrays, buffers: FrameBuffers, node: int, point: F64, matrix: F64, vector: F64, gradient: F64
) -> None:
    """Add JᵀAJ and Jᵀb of one point to H and g of a frame.

    Parameters
    ----------
    chain : ChainArrays
        The body.
    buffers : FrameBuffers
        The arrays of the frame with its nodes; the lower half of H is added to.
    node : int
        The node that moves the point.
    point : float64 array (3,)
        The point in the world.
    matrix : float64 array (3, 3)
        The symmetric matrix A.
    vector : float64 array (3,)
        The vector b.
    gradient : float64 array (parameters,)
        The vector g, to which the term is added.
    """
    columns, hessian = buffers.columns, buffers.hessian
    count = point_jacobian(chain, buffers.turned, buffers.centres, node, point, columns)
    for a in range(count):
        p, u, v, w = int(columns[a, 0]), columns[a, 1], columns[a, 2], columns[a, 3]
        gradient[p] += u * vector[0] + v * vector[1] + w * vector[2]
        x = matrix[0, 0] * u + matrix[0, 1] * v + matrix[0, 2] * w
        y = matrix[1, 0] * u + matrix[1, 1] * v + matrix[1, 2] * w
        z = matrix[2, 0] * u + matrix[2, 1] * v + matrix[2, 2] * w
        for b in range(a + 1):
            hessian[p, int(columns[b, 0])] += x * columns[b, 1] + y * columns[b, 2] + z * columns[b, 3]


@njit(cache=True, nogil=True)
def add_prior_terms(problem: TrackProblem, t: int, rotations: F64, buffers: FrameBuffers, gradient: F64) -> float:
    """Add the terms of priors of one frame to H and g, and return their cost.

    g uses the exact derivative of the logarithm; H approximates it by the identity, so its part is diagonal.

    Parameters
    ----------
    problem : TrackProblem
        The body and the terms.
    t : int
        The frame.
    rotations : float64 array (K, 3, 3)
        Rotation of each node from its parent.
    buffers : FrameBuffers
        The arrays of the frame with its nodes; the lower half of H is added to.
    gradient : float64 array (parameters,)
        g.

    Returns
    -------
    float
        The cost.
    """
    chain, priors, hessian = problem.chain, problem.priors, buffers.hessian
    total = _add_rotation_terms(chain, priors, t, rotations, hessian, gradient)
    if priors.tilt_weights[t] > 0.0:
        total += _add_tilt_term(chain, priors, t, rotations[0], hessian, gradient)
    matrix, vector, point = np.empty((3, 3)), np.empty(3), np.empty(3)
    for n in range(priors.place_starts[t], priors.place_starts[t + 1]):
        node = _place_joint(chain, priors.place_joints[n], buffers, point)
        weight = priors.place_weights[n]
        excess = -priors.place_targets[n]
        for i in range(3):
            excess += priors.place_directions[n, i] * point[i]
        for i in range(3):
            vector[i] = weight * excess * priors.place_directions[n, i]
            for j in range(3):
                matrix[i, j] = weight * priors.place_directions[n, i] * priors.place_directions[n, j]
        add_point(chain, buffers, node, point, matrix, vector, gradient)
        total += weight * excess * excess
    return total


@njit(cache=True, nogil=True)
def _place_joint(chain: ChainArrays, joint: int, buffers: FrameBuffers, point: F64) -> int:
    """Write a joint's position in the world into the last array, and return the node that moves the joint."""
    k = chain.joint_nodes[joint]
    for i in range(3):
        point[i] = buffers.centres[k, i]
        for a in range(3):
            point[i] += buffers.turned[k, i, a] * chain.joint_offsets[joint, a]
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
def _add_rotation_terms(
    chain: ChainArrays, priors: PriorArrays, t: int, rotations: F64, hessian: F64, gradient: F64
) -> float:
    total, d = 0.0, 0
    for k in range(len(chain.parents)):
        first = d
        while d < len(chain.axis_nodes) and chain.axis_nodes[d] == k:
            d += 1
        if d == first or _weightless(priors.turn_weights[t, k]):
            continue
        vector = _turn_from(priors.turn_targets[t, k], rotations[k])
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
    """Add w ‖Rᵀe_y − t‖² of the pelvis; the derivative of Rᵀe_y by a rotation about e_d is (Rᵀe_y) × e_d."""
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
def prior_cost(problem: TrackProblem, t: int, rotations: F64, buffers: FrameBuffers) -> float:
    """Return the cost of the terms of priors of one frame; see `add_prior_terms`."""
    chain, priors = problem.chain, problem.priors
    total, d = 0.0, 0
    for k in range(len(chain.parents)):
        first = d
        while d < len(chain.axis_nodes) and chain.axis_nodes[d] == k:
            d += 1
        if d == first or _weightless(priors.turn_weights[t, k]):
            continue
        vector = _turn_from(priors.turn_targets[t, k], rotations[k])
        for a in range(first, d):
            i = chain.axis_directions[a]
            total += priors.turn_weights[t, k, i] * vector[i] * vector[i]
    if priors.tilt_weights[t] > 0.0:
        for i in range(3):
            total += priors.tilt_weights[t] * (rotations[0, 1, i] - priors.tilt_targets[t, i]) ** 2
    point = np.empty(3)
    for n in range(priors.place_starts[t], priors.place_starts[t + 1]):
        _place_joint(chain, priors.place_joints[n], buffers, point)
        excess = -priors.place_targets[n]
        for i in range(3):
            excess += priors.place_directions[n, i] * point[i]
        total += priors.place_weights[n] * excess * excess
    return total


class FrameBuffers(NamedTuple):
    """Preallocated arrays for H and g of one frame.

    Attributes
    ----------
    turned, centres : float64 array (K, 3, 3), (K, 3)
        The nodes.
    points : float64 array (P, 3)
        The points of the evidence.
    matrices, vectors : float64 array (P, 3, 3), (P, 3)
        A and b of each point.
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
def frame_buffers(chain: ChainArrays, evidence: Evidence) -> FrameBuffers:
    """Allocate the arrays of one frame."""
    nodes, points, size = len(chain.parents), len(evidence.nodes), PLACES + len(chain.axis_nodes)
    return FrameBuffers(
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
    problem: TrackProblem,
    t: int,
    place: F64,
    rotations: F64,
    width: float,
    units: F64,
    buffers: FrameBuffers,
    gradient: F64,
) -> float:
    """Compute H, into `buffers.hessian`, and g of one frame, and return its cost.

    Parameters
    ----------
    problem : TrackProblem
        The terms of the track.
    t : int
        The frame.
    place, rotations : float64 array (3,), (K, 3, 3)
        The pose of the frame.
    width : float
        The width c of the robust loss; infinite for least squares.
    units : float64 array (V, P)
        Output: the squares of the factors of residuals, see `rays.point_terms`.
    buffers : FrameBuffers
        The preallocated arrays of the frame.
    gradient : float64 array (parameters,)
        Output: the vector g.

    Returns
    -------
    float
        The sum of the costs of observations, of the rest pose, of hinges, and of priors.
    """
    chain, evidence = problem.chain, problem.evidence
    pose_nodes(chain, place, rotations, buffers.turned, buffers.centres)
    place_points(evidence.nodes, evidence.offsets, buffers.turned, buffers.centres, buffers.points)
    cost = point_terms(evidence, t, buffers.points, width, units, buffers.matrices, buffers.vectors)
    buffers.hessian[:] = 0.0
    gradient[:] = 0.0
    add_points(chain, evidence.nodes, buffers, gradient)
    cost += add_rest_terms(chain, rotations, buffers.hessian, gradient)
    return cost + add_prior_terms(problem, t, rotations, buffers, gradient)


@njit(cache=True, nogil=True)
def frame_cost(
    problem: TrackProblem, t: int, place: F64, rotations: F64, width: float, units: F64, buffers: FrameBuffers
) -> float:
    """Return the cost of one frame, with fixed factors `units` of residuals; see `frame_terms`."""
    chain, evidence = problem.chain, problem.evidence
    pose_nodes(chain, place, rotations, buffers.turned, buffers.centres)
    place_points(evidence.nodes, evidence.offsets, buffers.turned, buffers.centres, buffers.points)
    cost = point_cost(evidence, t, buffers.points, width, units, np.bool_(False)) + rest_cost(chain, rotations)
    return cost + prior_cost(problem, t, rotations, buffers)


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
        The width c of the robust loss; infinite for least squares.

    Returns
    -------
    float64 array (T,)
        The costs Σ conf² ρ(r).
    """
    costs = np.empty(len(poses.positions))
    _observation_costs(body.arrays, evidence, poses.positions, poses.rotations, width, costs)
    return costs


@njit(cache=True, nogil=True)
def _observation_costs(
    chain: ChainArrays, evidence: Evidence, positions: F64, rotations: F64, width: float, costs: F64
) -> None:
    buffers = frame_buffers(chain, evidence)
    units = np.empty(evidence.confidence.shape[1:])
    for t in range(len(positions)):
        pose_nodes(chain, positions[t], rotations[t], buffers.turned, buffers.centres)
        place_points(evidence.nodes, evidence.offsets, buffers.turned, buffers.centres, buffers.points)
        costs[t] = point_cost(evidence, t, buffers.points, width, units, np.bool_(True))


@njit(cache=True, nogil=True)
def add_points(chain: ChainArrays, nodes: I64, buffers: FrameBuffers, gradient: F64) -> None:
    """Add JᵀAJ and Jᵀb of all points to H and g of a frame.

    Parameters
    ----------
    chain : ChainArrays
        The body.
    nodes : int64 array (P,)
        The node that moves each point.
    buffers : FrameBuffers
        The arrays of the frame, with its nodes, and with the position, A and b of each point. The terms are added to
        the lower half of H.
    gradient : float64 array (parameters,)
        g.
    """
    turned, centres, hessian = buffers.turned, buffers.centres, buffers.hessian
    forces, mixed, moments, wrenches = _sums(
        chain, centres[0], nodes, buffers.points, buffers.matrices, buffers.vectors
    )
    for i in range(PLACES):
        gradient[i] += wrenches[0, i]
        for j in range(i + 1):
            hessian[i, j] += forces[0, i, j]
    count = len(chain.axis_nodes)
    twists = np.empty((count, 6))
    for d in range(count):
        k, e, sign = chain.axis_nodes[d], chain.axis_directions[d], chain.axis_signs[d]
        p, q, r = sign * turned[k, 0, e], sign * turned[k, 1, e], sign * turned[k, 2, e]
        x, y, z = centres[k, 0] - centres[0, 0], centres[k, 1] - centres[0, 1], centres[k, 2] - centres[0, 2]
        u, v, w = y * r - z * q, z * p - x * r, x * q - y * p
        copy_row(twists[d], (p, q, r, u, v, w))
        row = PLACES + d
        gradient[row] += (
            u * wrenches[k, 0] + v * wrenches[k, 1] + w * wrenches[k, 2]
            + p * wrenches[k, 3] + q * wrenches[k, 4] + r * wrenches[k, 5]
        )  # fmt: skip
        force, moment, cross = forces[k], moments[k], mixed[k]
        a = force[0, 0] * u + force[0, 1] * v + force[0, 2] * w + cross[0, 0] * p + cross[1, 0] * q + cross[2, 0] * r
        b = force[1, 0] * u + force[1, 1] * v + force[1, 2] * w + cross[0, 1] * p + cross[1, 1] * q + cross[2, 1] * r
        c = force[2, 0] * u + force[2, 1] * v + force[2, 2] * w + cross[0, 2] * p + cross[1, 2] * q + cross[2, 2] * r
        f = moment[0, 0] * p + moment[0, 1] * q + moment[0, 2] * r + cross[0, 0] * u + cross[0, 1] * v + cross[0, 2] * w
        g = moment[1, 0] * p + moment[1, 1] * q + moment[1, 2] * r + cross[1, 0] * u + cross[1, 1] * v + cross[1, 2] * w
        h = moment[2, 0] * p + moment[2, 1] * q + moment[2, 2] * r + cross[2, 0] * u + cross[2, 1] * v + cross[2, 2] * w
        hessian[row, 0] += a
        hessian[row, 1] += b
        hessian[row, 2] += c
        for other in range(d + 1):
            if chain.turned[k, other]:
                o = twists[other]
                hessian[row, PLACES + other] += f * o[0] + g * o[1] + h * o[2] + a * o[3] + b * o[4] + c * o[5]


@njit(cache=True, nogil=True)
def _sums(
    chain: ChainArrays, origin: F64, nodes: I64, points: F64, matrices: F64, vectors: F64
) -> tuple[F64, F64, F64, F64]:
    """Return the sums of A, [r]A, [r]A[r]ᵀ (K, 3, 3), and of b and r × b (K, 6), over all points below each node."""
    count = len(chain.parents)
    forces, mixed, moments = np.zeros((count, 3, 3)), np.zeros((count, 3, 3)), np.zeros((count, 3, 3))
    wrenches = np.zeros((count, 6))
    for p in range(len(nodes)):
        k, a, b = nodes[p], matrices[p], vectors[p]
        if a[0, 0] + a[1, 1] + a[2, 2] <= 0.0:
            continue
        x, y, z = points[p, 0] - origin[0], points[p, 1] - origin[1], points[p, 2] - origin[2]
        wrench, force, cross, moment = wrenches[k], forces[k], mixed[k], moments[k]
        wrench[0] += b[0]
        wrench[1] += b[1]
        wrench[2] += b[2]
        wrench[3] += y * b[2] - z * b[1]
        wrench[4] += z * b[0] - x * b[2]
        wrench[5] += x * b[1] - y * b[0]
        for j in range(3):
            force[0, j] += a[0, j]
            force[1, j] += a[1, j]
            force[2, j] += a[2, j]
            cross[0, j] += y * a[2, j] - z * a[1, j]
            cross[1, j] += z * a[0, j] - x * a[2, j]
            cross[2, j] += x * a[1, j] - y * a[0, j]
        for i in range(3):
            u, v = (i + 1) % 3, (i + 2) % 3
            one = y if i == 0 else (z if i == 1 else x)  # component of r for the first index
            two = z if i == 0 else (x if i == 1 else y)  # component of r for the second index
            s = one * a[v, 0] - two * a[u, 0]
            t = one * a[v, 1] - two * a[u, 1]
            w = one * a[v, 2] - two * a[u, 2]
            moment[i, 0] += y * w - z * t
            moment[i, 1] += z * s - x * w
            moment[i, 2] += x * t - y * s
    for k in range(count - 1, 0, -1):
        parent = chain.parents[k]
        for i in range(3):
            wrenches[parent, i] += wrenches[k, i]
            wrenches[parent, 3 + i] += wrenches[k, 3 + i]
            for j in range(3):
                forces[parent, i, j] += forces[k, i, j]
                mixed[parent, i, j] += mixed[k, i, j]
                moments[parent, i, j] += moments[k, i, j]
    return forces, mixed, moments, wrenches
