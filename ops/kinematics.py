"""Forward kinematics: joint angles of a chain of nodes to positions in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from ops.errors import ParameterError

F64 = npt.NDArray[np.float64]
I32 = npt.NDArray[np.int32]

ROTATE_X, ROTATE_Y, ROTATE_Z, MOVE_X, MOVE_Y, MOVE_Z, STRETCH = range(7)
"""What a channel does to its node: turn about an axis, move along one, or lengthen the bone."""

BLOCK = 128  # frames worked on together: the matrices of a whole body then stay in the second-level cache


@dataclass(frozen=True)
class Step:
    """One channel of a node: what it does, and its column in the channel matrix."""

    kind: int
    column: int


@dataclass(frozen=True)
class Node:
    """One node of a chain.

    parent: index of the node before it, −1 for the root. frame: (3, 3) the node's axes in its parent's.
    before, after: (3,) offsets in metres, before (in the parent's axes) and after the node's own rotation.
    direction: (3,) unit vector that a STRETCH channel lengthens `after` along.
    steps: in the order in which the rotation matrices are multiplied, leftmost first.
    """

    name: str
    parent: int
    frame: F64
    before: F64
    after: F64
    direction: F64
    steps: tuple[Step, ...]


def rotation(axis: int, degrees: float) -> F64:
    """The (3, 3) matrix of a turn about X (0), Y (1) or Z (2)."""
    angle = np.deg2rad(degrees)
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def euler(degrees: tuple[float, float, float], order: str) -> F64:
    """The matrix of three turns, the first listed axis first: order "XYZ" is Rz · Ry · Rx (features.md)."""
    matrix = np.eye(3)
    for axis, angle in zip(order, degrees, strict=True):
        matrix = rotation("XYZ".index(axis), angle) @ matrix
    return matrix


def forward(nodes: tuple[Node, ...], channels: F64, oriented: int = 0) -> tuple[F64, F64]:
    """Positions of all nodes and the orientation of one of them, the root's where nothing else is said.

    Parameters
    ----------
    nodes: parents before children.
    channels: float64 (T, C); rotations in radians, moves and stretches in metres.
    oriented: index of the node whose orientation is wanted.

    Returns
    -------
    positions: float64 (nodes, 3, T), metres. orientation: float64 (9, T), the node's rotation matrix, row by row.

    Raises
    ------
    ParameterError: a parent stands after its child, or a step or `oriented` names what is not there.
    """
    if not 0 <= oriented < len(nodes):
        raise ParameterError("oriented", f"the index of one of {len(nodes)} nodes", oriented)
    for i, node in enumerate(nodes):
        if not -1 <= node.parent < i:
            raise ParameterError(f"parent of '{node.name}'", "a node before it", node.parent)
        for step in node.steps:
            if not 0 <= step.column < channels.shape[1]:
                raise ParameterError(f"channel of '{node.name}'", f"below {channels.shape[1]}", step.column)
    by_channel = np.ascontiguousarray(channels.T, dtype=np.float64)
    counts = np.cumsum([0, *(len(node.steps) for node in nodes)]).astype(np.int32)
    kinds = np.array([step.kind for node in nodes for step in node.steps], dtype=np.int32)
    columns = np.array([step.column for node in nodes for step in node.steps], dtype=np.int32)
    parents = np.array([node.parent for node in nodes], dtype=np.int32)
    frames = np.stack([node.frame.ravel() for node in nodes])
    plain = np.array([np.array_equal(node.frame, np.eye(3)) for node in nodes])
    offsets = np.stack([np.concatenate([node.before, node.after, node.direction]) for node in nodes])
    positions = np.empty((len(nodes), 3, channels.shape[0]))
    orientation = np.empty((9, channels.shape[0]))
    _forward(
        by_channel, np.sin(by_channel), np.cos(by_channel), parents, counts, kinds, columns,
        frames, plain, offsets, oriented, positions, orientation,
    )  # fmt: skip
    return positions, orientation


@njit(cache=True)
def _forward(
    channels: F64, sines: F64, cosines: F64, parents: I32, counts: I32, kinds: I32, columns: I32,
    frames: F64, plain: npt.NDArray[np.bool_], offsets: F64, oriented: int, positions: F64, orientation: F64,
) -> None:  # fmt: skip
    total = channels.shape[1]
    nodes = len(parents)
    h = np.empty((nodes, 9, BLOCK))  # rotation of every node, row by row
    move = np.zeros((3, BLOCK))
    stretch = np.zeros(BLOCK)
    for start in range(0, total, BLOCK):
        size = min(BLOCK, total - start)
        for node in range(nodes):
            parent = parents[node]
            own = h[node]
            for k in range(9):
                row, column = k // 3, k % 3
                if parent < 0:
                    for t in range(size):
                        own[k, t] = frames[node, k]
                elif plain[node]:
                    for t in range(size):
                        own[k, t] = h[parent, k, t]
                else:
                    f0, f1, f2 = frames[node, column], frames[node, 3 + column], frames[node, 6 + column]
                    a, b, c = h[parent, 3 * row], h[parent, 3 * row + 1], h[parent, 3 * row + 2]
                    for t in range(size):
                        own[k, t] = a[t] * f0 + b[t] * f1 + c[t] * f2
            move[:, :size] = 0.0
            stretch[:size] = 0.0
            moves = False
            for step in range(counts[node], counts[node + 1]):
                kind, column = kinds[step], columns[step]
                if kind >= MOVE_X:
                    for t in range(size):
                        if kind == STRETCH:
                            stretch[t] += channels[column, start + t]
                        else:
                            move[kind - MOVE_X, t] += channels[column, start + t]
                    moves = moves or kind != STRETCH
            # Where the node starts: the parent's end, the fixed offset, and what its own channels move it by.
            out = positions[node]
            for axis in range(3):
                for t in range(size):
                    x = 0.0
                    if parent >= 0:
                        x = (
                            positions[parent, axis, start + t]
                            + h[parent, 3 * axis, t] * offsets[node, 0]
                            + h[parent, 3 * axis + 1, t] * offsets[node, 1]
                            + h[parent, 3 * axis + 2, t] * offsets[node, 2]
                        )
                    else:
                        x = offsets[node, axis]
                    if moves:
                        if parent >= 0:
                            x += (
                                own[3 * axis, t] * move[0, t]
                                + own[3 * axis + 1, t] * move[1, t]
                                + own[3 * axis + 2, t] * move[2, t]
                            )
                        else:
                            x += move[axis, t]
                    out[axis, start + t] = x
            for step in range(counts[node], counts[node + 1]):
                kind, column = kinds[step], columns[step]
                if kind <= ROTATE_Z:
                    i, j = (kind + 1) % 3, (kind + 2) % 3
                    sine, cosine = sines[column], cosines[column]
                    for row in range(3):
                        a, b = own[3 * row + i], own[3 * row + j]
                        for t in range(size):
                            s, c = sine[start + t], cosine[start + t]
                            p, q = a[t], b[t]
                            a[t] = p * c + q * s
                            b[t] = q * c - p * s
            for axis in range(3):
                for t in range(size):
                    x = offsets[node, 3] + stretch[t] * offsets[node, 6]
                    y = offsets[node, 4] + stretch[t] * offsets[node, 7]
                    z = offsets[node, 5] + stretch[t] * offsets[node, 8]
                    out[axis, start + t] += own[3 * axis, t] * x + own[3 * axis + 1, t] * y + own[3 * axis + 2, t] * z
        for k in range(9):
            for t in range(size):
                orientation[k, start + t] = h[oriented, k, t]


def frames_along(across: F64, up: F64) -> F64:
    """Rotation matrices (9, T), row by row, whose X axis lies along `across` and whose Y axis is nearest to `up`.

    Parameters
    ----------
    across, up: float64 (3, T), of any length. Where one is zero or both lie on one line, the matrix is NaN.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        x = across / np.linalg.norm(across, axis=0)
        z = np.cross(x, up / np.linalg.norm(up, axis=0), axis=0)
        length = np.linalg.norm(z, axis=0)
        z = z / np.where(length > 1e-9, length, 0.0)
    matrices: F64 = np.stack([x, np.cross(z, x, axis=0), z], axis=1)  # columns are the axes
    return np.ascontiguousarray(matrices.reshape(9, -1))


def quaternions(matrices: F64) -> F64:
    """Unit quaternions (4, T) w x y z of rotation matrices (9, T), without jumps of sign.

    The largest component is found first, so that no division comes near zero.
    """
    m = matrices.reshape(3, 3, -1)
    xx, yy, zz = m[0, 0], m[1, 1], m[2, 2]
    squares = np.stack([1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz])
    largest = np.argmax(squares, axis=0)
    wx, wy, wz = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    xy, xz, yz = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]
    candidates = np.stack([
        np.stack([squares[0], wx, wy, wz]),
        np.stack([wx, squares[1], xy, xz]),
        np.stack([wy, xy, squares[2], yz]),
        np.stack([wz, xz, yz, squares[3]]),
    ])  # fmt: skip
    q = np.take_along_axis(candidates, largest[None, None, :], axis=0)[0]
    q = q / np.linalg.norm(q, axis=0)
    if q.shape[1]:
        q[:, 0] *= 1.0 if q[0, 0] >= 0 else -1.0
        flips = np.sign(np.sum(q[:, 1:] * q[:, :-1], axis=0))
        flips[flips == 0] = 1.0
        q[:, 1:] *= np.cumprod(flips)
    return np.ascontiguousarray(q)
