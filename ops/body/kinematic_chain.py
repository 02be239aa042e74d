"""This module computes the points of a kinematic chain for a pose, and their derivatives (thesis, Section 6.2.1).

A pose consists of the position of the first node and a rotation R_k of every node. With G_k = G_parent · R_k and the
centre c_k = c_parent + G_parent · o_k, a point q in the frame of node k is at y = c_k + G_k · q. A step x of the
parameters adds x₁..₃ to the position, and sets R_k ← R_k · exp(Σ x_d ê_d) with a sum over the axes of the node. These
twists are linearised at each pose, so that no gimbal lock occurs. The derivative of y with respect to the rotation
about axis e_d of node k, or of its ancestor k, is (G_k e_d) × (y − c_k); with respect to a coordinate of the position
it is the unit vector of that coordinate.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.copies import copy_table
from kinedex.ops.errors import ParameterError

PLACES = 3
"""The number of parameters of the first node's position; the joint angles follow them, axis by axis."""


@dataclass(frozen=True)
class Axis:
    """An axis about which a node rotates, one parameter of the chain.

    Attributes
    ----------
    node : int
        The node.
    direction : int
        0, 1 or 2 for X, Y or Z of the node's frame.
    sign : float
        −1 for a rotation about the opposite direction.
    pull : float
        Standard deviation in radians of the prior of the angle, whose mean is the rest pose; infinite for no prior.
    hinge : tuple of (float, float)
        Smallest and largest angle in radians; infinite for no limit.
    """

    node: int
    direction: int
    sign: float = 1.0
    pull: float = np.inf
    hinge: tuple[float, float] = (-np.inf, np.inf)


@dataclass(frozen=True)
class JointRest:
    """The position of a joint in the frame of the node that moves it.

    Attributes
    ----------
    node : int
        The node that moves the joint.
    start : int
        The joint at the other end of the bone, from which `along` points. If `along` is None and the position is not
        measured, the joint coincides with this one.
    along : tuple of float, optional
        Unit vector of the bone at rest, which is multiplied by the bone's length.
    measured : bool
        True for a position that is measured in the frame of the node.
    """

    node: int
    start: int
    along: tuple[float, float, float] | None = None
    measured: bool = False


@dataclass(frozen=True, eq=False)
class KinematicChain:
    """The nodes and joints of a body, without bone lengths.

    Attributes
    ----------
    name : str
        The name of the chain.
    nodes : tuple of str
        K nodes, parents first.
    parents : tuple of int
        The parent of each node, −1 for the first.
    centres : tuple of int
        The joint that each node rotates about.
    axes : tuple of Axis
        The axes of all nodes, node by node.
    joints : tuple of str
        J joints.
    rest : tuple of JointRest
        The position of each joint at rest.

    Raises
    ------
    ParameterError
        A parent comes after its child, or the centre of a node is not moved by the node's parent.
    """

    name: str
    nodes: tuple[str, ...]
    parents: tuple[int, ...]
    centres: tuple[int, ...]
    axes: tuple[Axis, ...]
    joints: tuple[str, ...]
    rest: tuple[JointRest, ...]

    def __post_init__(self) -> None:
        for k, (node, parent, centre) in enumerate(zip(self.nodes, self.parents, self.centres, strict=True)):
            if (k == 0) != (parent < 0) or parent >= k:
                raise ParameterError(f"parent of node '{node}'", "a node before it; only the first has none", parent)
            if self.rest[centre].node != max(parent, 0):
                mover, above = self.nodes[self.rest[centre].node], self.nodes[max(parent, 0)]
                raise ParameterError(f"centre of node '{node}'", f"a joint that node '{above}' moves", mover)

    @property
    def parameters(self) -> int:
        """Return the number of parameters of a pose."""
        return PLACES + len(self.axes)

    def joint(self, name: str) -> int:
        """Return the index of a joint."""
        return self.joints.index(name)

    def axes_of(self, node: int) -> list[Axis]:
        """Return the axes of a node."""
        return [axis for axis in self.axes if axis.node == node]


class ChainArrays(NamedTuple):
    """A chain with bone lengths as arrays, for compiled functions.

    Attributes
    ----------
    parents : int64 array (K,)
        Parent of each node.
    node_offsets : float64 array (K, 3)
        Centre of each node in the frame of its parent, from the parent's centre.
    joint_nodes : int64 array (J,)
        Node that moves each joint.
    joint_offsets : float64 array (J, 3)
        Position of each joint in the frame of that node, from the node's centre.
    axis_nodes, axis_directions : int64 array (D,)
        Node and direction of each axis.
    axis_signs : float64 array (D,)
        1 or −1.
    pulls : float64 array (D,)
        1/σ² of the prior of each angle.
    hinges : float64 array (D, 2)
        Smallest and largest angle.
    turned : bool array (K, D)
        True if an axis rotates a node, since it belongs to the node or to one of the node's ancestors.
    """

    parents: I64
    node_offsets: F64
    joint_nodes: I64
    joint_offsets: F64
    axis_nodes: I64
    axis_directions: I64
    axis_signs: F64
    pulls: F64
    hinges: F64
    turned: Bool


@dataclass(frozen=True, eq=False)
class ChainBody:
    """A kinematic chain with the bone lengths of one person.

    Attributes
    ----------
    chain : KinematicChain
        The chain.
    offsets : float64 array (J, 3)
        Position of each joint in the frame of the node that moves the joint, in metres.
    """

    chain: KinematicChain
    offsets: F64

    def __post_init__(self) -> None:
        if self.offsets.shape != (len(self.chain.joints), 3) or not np.isfinite(self.offsets).all():
            raise ParameterError("offsets", f"{len(self.chain.joints)} finite places", self.offsets)

    @cached_property
    def arrays(self) -> ChainArrays:
        """Return the chain and its bone lengths as arrays for compiled functions."""
        chain = self.chain
        turned = np.zeros((len(chain.nodes), len(chain.axes)), np.bool_)
        for k, parent in enumerate(chain.parents):
            turned[k] = [axis.node == k for axis in chain.axes]
            if parent >= 0:
                turned[k] |= turned[parent]
        node_offsets = self.offsets[list(chain.centres)]
        node_offsets[0] = 0.0  # the place of the first node is a parameter
        return ChainArrays(
            np.array(chain.parents, np.int64),
            node_offsets,
            np.array([rest.node for rest in chain.rest], np.int64),
            np.ascontiguousarray(self.offsets),
            np.array([axis.node for axis in chain.axes], np.int64),
            np.array([axis.direction for axis in chain.axes], np.int64),
            np.array([axis.sign for axis in chain.axes]),
            np.array([axis.pull**-2.0 for axis in chain.axes]),
            np.array([axis.hinge for axis in chain.axes]),
            turned,
        )


class Poses(NamedTuple):
    """Poses of a chain over time.

    Attributes
    ----------
    positions : float64 array (T, 3)
        Position of the first node in metres.
    rotations : float64 array (T, K, 3, 3)
        Rotation of each node from its parent.
    """

    positions: F64
    rotations: F64


def forward(body: ChainBody, poses: Poses) -> tuple[F64, F64]:
    """Compute the joint positions of a body from its poses.

    Parameters
    ----------
    body : ChainBody
        The body.
    poses : Poses
        The poses of the body in T frames.

    Returns
    -------
    positions : float64 array (J, 3, T)
        Joints in metres.
    turned : float64 array (T, K, 3, 3)
        World rotation G of each node.
    """
    frames, nodes = poses.rotations.shape[:2]
    if poses.positions.shape != (frames, 3) or poses.rotations.shape[1:] != (len(body.chain.nodes), 3, 3):
        shapes = (poses.positions.shape, poses.rotations.shape)
        raise ParameterError("poses", f"of shapes (T, 3) and (T, {len(body.chain.nodes)}, 3, 3)", shapes)
    positions = np.empty((len(body.chain.joints), 3, frames))
    turned = np.empty((frames, nodes, 3, 3))
    _forward(
        body.arrays, np.ascontiguousarray(poses.positions), np.ascontiguousarray(poses.rotations), positions, turned
    )
    return positions, turned


@njit(cache=True, nogil=True)
def _forward(chain: ChainArrays, places: F64, rotations: F64, positions: F64, turned: F64) -> None:
    centres, joints = np.empty((len(chain.parents), 3)), np.empty((len(chain.joint_nodes), 3))
    for t in range(len(places)):
        pose_nodes(chain, places[t], rotations[t], turned[t], centres)
        pose_joints(chain, turned[t], centres, joints)
        copy_table(positions[:, :, t], joints)


@njit(cache=True, nogil=True)
def pose_nodes(chain: ChainArrays, place: F64, rotations: F64, turned: F64, centres: F64) -> None:
    """Compute world rotations (K, 3, 3) and centres (K, 3) of a frame's nodes; write them into the last two arrays."""
    for k in range(len(chain.parents)):
        parent = chain.parents[k]
        for i in range(3):
            if parent < 0:
                centres[k, i] = place[i]
                for j in range(3):
                    turned[k, i, j] = rotations[k, i, j]
            else:
                centres[k, i] = centres[parent, i]
                for j in range(3):
                    centres[k, i] += turned[parent, i, j] * chain.node_offsets[k, j]
                    turned[k, i, j] = (
                        turned[parent, i, 0] * rotations[k, 0, j]
                        + turned[parent, i, 1] * rotations[k, 1, j]
                        + turned[parent, i, 2] * rotations[k, 2, j]
                    )


@njit(cache=True, nogil=True)
def pose_joints(chain: ChainArrays, turned: F64, centres: F64, joints: F64) -> None:
    """Compute the joints (J, 3) of one frame from its nodes, and write them into `joints`."""
    for j in range(len(chain.joint_nodes)):
        k = chain.joint_nodes[j]
        for i in range(3):
            joints[j, i] = centres[k, i]
            for a in range(3):
                joints[j, i] += turned[k, i, a] * chain.joint_offsets[j, a]


@njit(cache=True, nogil=True)
def point_jacobian(chain: ChainArrays, turned: F64, centres: F64, node: int, point: F64, columns: F64) -> int:
    """Compute the derivatives of a point that moves with a node, in one frame.

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
    columns : float64 array (parameters, 4)
        Output: the index of a parameter, and the derivative of the point with respect to this parameter.

    Returns
    -------
    int
        The number of parameters that move the point, the rows of `columns` that are filled.
    """
    for i in range(3):
        columns[i, 0], columns[i, 1], columns[i, 2], columns[i, 3] = i, 0.0, 0.0, 0.0
        columns[i, 1 + i] = 1.0
    count = PLACES
    for d in range(len(chain.axis_nodes)):
        if not chain.turned[node, d]:
            continue
        k, e, sign = chain.axis_nodes[d], chain.axis_directions[d], chain.axis_signs[d]
        x, y, z = sign * turned[k, 0, e], sign * turned[k, 1, e], sign * turned[k, 2, e]
        p, q, r = point[0] - centres[k, 0], point[1] - centres[k, 1], point[2] - centres[k, 2]
        columns[count, 0] = PLACES + d
        columns[count, 1] = y * r - z * q
        columns[count, 2] = z * p - x * r
        columns[count, 3] = x * q - y * p
        count += 1
    return count


@njit(cache=True, nogil=True)
def take_step(chain: ChainArrays, place: F64, rotations: F64, step: F64, new_place: F64, new_turns: F64) -> None:
    """Move the pose of one frame by a step of its parameters; write the result into the last two arrays."""
    for i in range(3):
        new_place[i] = place[i] + step[i]
    vector = np.zeros(3)
    d = 0
    for k in range(len(chain.parents)):
        vector[:] = 0.0
        while d < len(chain.axis_nodes) and chain.axis_nodes[d] == k:
            vector[chain.axis_directions[d]] = chain.axis_signs[d] * step[PLACES + d]
            d += 1
        x, y, z = vector[0], vector[1], vector[2]
        a, b = _rodrigues(x * x + y * y + z * z)
        for i in range(3):  # a row r becomes r + a r × v + b (r × v) × v
            p, q, r = rotations[k, i, 0], rotations[k, i, 1], rotations[k, i, 2]
            u, v, w = q * z - r * y, r * x - p * z, p * y - q * x
            new_turns[k, i, 0] = p + a * u + b * (v * z - w * y)
            new_turns[k, i, 1] = q + a * v + b * (w * x - u * z)
            new_turns[k, i, 2] = r + a * w + b * (u * y - v * x)


@njit(cache=True, nogil=True)
def _rodrigues(square: float) -> tuple[float, float]:
    """Return sin θ / θ and (1 − cos θ) / θ² from θ², by their series where θ is small."""
    if square < 0.03:
        return (
            1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0))),
            0.5 - square / 24.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0 * (1.0 - square / 90.0))),
        )
    angle = np.sqrt(square)
    return np.sin(angle) / angle, 2.0 * np.sin(0.5 * angle) ** 2 / square


@njit(cache=True, nogil=True)
def rotation_of(vector: F64) -> F64:
    """Return the rotation (3, 3) of a rotation vector: Rodrigues' formula."""
    x, y, z = vector
    a, b = _rodrigues(x * x + y * y + z * z)
    return np.array([
        [1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
        [b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x],
        [b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)],
    ])  # fmt: skip


@njit(cache=True, nogil=True)
def vector_of(rotation: F64) -> F64:
    """Return the rotation vector, of length π at most, of a rotation matrix (3, 3)."""
    return np.array(log_of(rotation))


@njit(cache=True, nogil=True)
def log_of(rotation: F64) -> tuple[float, float, float]:
    """Return the rotation vector x, y, z of `vector_of`, computed from the largest component of the quaternion."""
    m = rotation
    squares = (
        1 + m[0, 0] + m[1, 1] + m[2, 2], 1 + m[0, 0] - m[1, 1] - m[2, 2],
        1 - m[0, 0] + m[1, 1] - m[2, 2], 1 - m[0, 0] - m[1, 1] + m[2, 2],
    )  # fmt: skip
    a, b, c = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    d, e, f = m[1, 0] + m[0, 1], m[0, 2] + m[2, 0], m[2, 1] + m[1, 2]
    if squares[0] >= max(squares[1], max(squares[2], squares[3])):
        w, x, y, z = squares[0], a, b, c
    elif squares[1] >= max(squares[2], squares[3]):
        w, x, y, z = a, squares[1], d, e
    elif squares[2] >= squares[3]:
        w, x, y, z = b, d, squares[2], f
    else:
        w, x, y, z = c, e, f, squares[3]
    sine = np.sqrt(x * x + y * y + z * z)
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    ratio = 2.0 * np.arctan2(sine, w) / sine if sine > 0.0 else 0.0
    return ratio * x, ratio * y, ratio * z


@njit(cache=True, nogil=True)
def log_derivative(vector: F64) -> F64:
    """Return the inverse right Jacobian (3, 3): the derivative of log(R exp(x)) at x = 0, for log R = vector."""
    x, y, z = vector
    square = x * x + y * y + z * z
    angle = np.sqrt(square)
    # (1 − (θ/2) cot (θ/2)) / θ², which is 1/12 where θ is small
    b = 1.0 / 12.0 + square / 720.0 if angle < 1e-3 else (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / square
    return np.array([
        [1.0 - b * (y * y + z * z), b * x * y - 0.5 * z, b * x * z + 0.5 * y],
        [b * x * y + 0.5 * z, 1.0 - b * (x * x + z * z), b * y * z - 0.5 * x],
        [b * x * z - 0.5 * y, b * y * z + 0.5 * x, 1.0 - b * (x * x + y * y)],
    ])  # fmt: skip


@njit(cache=True, nogil=True)
def log_gradients(
    vector: tuple[float, float, float], pull: tuple[float, float, float]
) -> tuple[float, float, float, float, float, float]:
    """Return Jᵀq and J q for a vector q, a gradient with respect to log R, with the matrix J of `log_derivative`.

    The results are q ∓ ½ v × q + b v × (v × q) for v = log R. Jᵀq is the gradient with respect to a rotation that is
    multiplied to R from the right; −J q is the gradient with respect to a rotation of the frame that R is relative to.
    """
    x, y, z = vector
    p, q, r = pull
    square = x * x + y * y + z * z
    angle = np.sqrt(square)
    b = 1.0 / 12.0 + square / 720.0 if angle < 1e-3 else (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / square
    u, v, w = y * r - z * q, z * p - x * r, x * q - y * p
    p, q, r = p + b * (y * w - z * v), q + b * (z * u - x * w), r + b * (x * v - y * u)
    return p - 0.5 * u, q - 0.5 * v, r - 0.5 * w, p + 0.5 * u, q + 0.5 * v, r + 0.5 * w


HINGE_RAD = 0.05
"""Standard deviation of a rotation beyond the limits of a hinge, in radians."""


@njit(cache=True, nogil=True)
def rest_cost(chain: ChainArrays, rotations: F64) -> float:
    """Return the sum of the squared deviations of angles from the rest pose and beyond hinge limits in one frame."""
    total, d = 0.0, 0
    for k in range(len(chain.parents)):
        if d >= len(chain.axis_nodes) or chain.axis_nodes[d] != k:
            continue
        vector = log_of(rotations[k])
        while d < len(chain.axis_nodes) and chain.axis_nodes[d] == k:
            turn = chain.axis_signs[d] * vector[chain.axis_directions[d]]
            excess = turn - min(max(turn, chain.hinges[d, 0]), chain.hinges[d, 1])
            total += chain.pulls[d] * turn * turn + (excess / HINGE_RAD) ** 2
            d += 1
    return total


@njit(cache=True, nogil=True)
def add_rest_terms(chain: ChainArrays, rotations: F64, hessian: F64, gradient: F64) -> float:
    """Add the terms of `rest_cost` to the normal equations H, g of one frame, and return the cost.

    g is half of the cost's gradient, with the exact derivative of the logarithm. In H this derivative is approximated
    by the identity, so that the added terms are diagonal.
    """
    total, d = 0.0, 0
    slopes = np.empty(3)
    for k in range(len(chain.parents)):
        first = d
        slopes[:] = 0.0
        while d < len(chain.axis_nodes) and chain.axis_nodes[d] == k:
            if d == first:
                vector = log_of(rotations[k])
            sign = chain.axis_signs[d]
            turn = sign * vector[chain.axis_directions[d]]
            excess = turn - min(max(turn, chain.hinges[d, 0]), chain.hinges[d, 1])
            total += chain.pulls[d] * turn * turn + (excess / HINGE_RAD) ** 2
            slopes[chain.axis_directions[d]] = sign * (chain.pulls[d] * turn + excess / HINGE_RAD**2)
            hessian[PLACES + d, PLACES + d] += chain.pulls[d] + (HINGE_RAD**-2.0 if excess != 0.0 else 0.0)
            d += 1
        if d > first:
            found = log_gradients(vector, (slopes[0], slopes[1], slopes[2]))
            for b in range(first, d):
                gradient[PLACES + b] += chain.axis_signs[b] * found[chain.axis_directions[b]]
    return total
