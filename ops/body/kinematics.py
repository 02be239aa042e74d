"""This module does forward kinematics: positions in space from the joint angles of a chain of nodes.

It computes sines and cosines of angles in compiled loops that vectorise.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I32, Bool
from kinedex.ops.errors import ParameterError

ROTATE_X, ROTATE_Y, ROTATE_Z, MOVE_X, MOVE_Y, MOVE_Z, STRETCH = range(7)
"""The kinds of channels: rotation about an axis, translation along one, or lengthening of the bone."""

BLOCK = 120
"""Frames per block, so that the matrices of a whole body fit into the second-level cache. The number is not a power of
two, because rows at such distances would compete for a few lines of the first-level cache.
"""

LARGEST = 1e6
"""The largest angle in radians for which `sincos` is accurate; for larger angles, the range reduction loses digits."""

# A quarter turn in three pieces. The first two have 33 bits, so that their products with a count of quarter turns below
# 2**20 are exact (Cody and Waite, "Software Manual for the Elementary Functions", 1980).
_QUARTERS = 2.0 / math.pi
_FIRST = float.fromhex("0x1.921fb544p+0")
_SECOND = float.fromhex("0x1.0b4611a6p-34")
_THIRD = float.fromhex("0x1.3198a2e037073p-69")

# Taylor's series. Within an eighth of a turn the first term that is left out is below 1e-18 of the sum.
_S1, _S2, _S3, _S4, _S5, _S6, _S7, _S8 = ((-1) ** k / math.factorial(2 * k + 1) for k in range(1, 9))
_C2, _C3, _C4, _C5, _C6, _C7, _C8 = ((-1) ** k / math.factorial(2 * k) for k in range(2, 9))


@dataclass(frozen=True)
class Step:
    """A channel of a node: its kind, and its column in the channel matrix."""

    kind: int
    column: int


@dataclass(frozen=True, eq=False)
class Node:
    """A node of a chain; nodes are compared by identity.

    Attributes
    ----------
    parent : int
        Index of the parent node, −1 for the root.
    frame : float64 array
        The node's axes (3, 3) in the axes of its parent.
    before, after : float64 array
        Offsets (3,) in metres: before the node's rotation, in the parent's axes, and after it.
    direction : float64 array
        Unit vector (3,) along which a STRETCH channel lengthens `after`.
    steps : tuple of Step
        The channels, in the order in which the rotation matrices are multiplied, leftmost first.
    """

    name: str
    parent: int
    frame: F64
    before: F64
    after: F64
    direction: F64
    steps: tuple[Step, ...]


def rotation(axis: int, degrees: float) -> F64:
    """Return the (3, 3) matrix of a rotation about X (0), Y (1) or Z (2)."""
    angle = np.deg2rad(degrees)
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def euler(degrees: tuple[float, float, float], order: str) -> F64:
    """Return the matrix of three rotations, the first axis applied first: order "XYZ" is Rz · Ry · Rx."""
    matrix = np.eye(3)
    for axis, angle in zip(order, degrees, strict=True):
        matrix = rotation("XYZ".index(axis), angle) @ matrix
    return matrix


def forward(
    nodes: tuple[Node, ...], channels: F64, oriented: int = 0, wanted: Iterable[int] | None = None
) -> tuple[F64, F64]:
    """Compute the positions of nodes and the orientation of one of them, by default of the root.

    Parameters
    ----------
    nodes : tuple of Node
        The nodes, parents before children.
    channels : float64 array (T, C)
        Rotations in radians, translations and stretches in metres.
    oriented : int
        Index of the node whose orientation is returned.
    wanted : iterable of int or None
        Indices of the nodes whose positions are returned; None for all. Branches without such a node are not computed.

    Returns
    -------
    tuple[float64 array, float64 array]
        The positions (nodes, 3, T) in metres, NaN for nodes that are not computed, and the rotation matrices of the
        oriented node, row by row, (9, T).

    Raises
    ------
    ParameterError
        If a parent comes after its child, or a step, `oriented` or `wanted` is out of range.
    """
    chain = _chain(nodes)
    if not 0 <= oriented < len(nodes):
        raise ParameterError("oriented", f"the index of one of {len(nodes)} nodes", oriented)
    for node in nodes if chain.columns.max(initial=-1) >= channels.shape[1] else ():
        for step in node.steps:
            if step.column >= channels.shape[1]:
                raise ParameterError(f"channel of '{node.name}'", f"below {channels.shape[1]}", step.column)
    channels = np.ascontiguousarray(channels, dtype=np.float64)
    needed = _needed(nodes, tuple(range(len(nodes))) if wanted is None else (*wanted, oriented))
    near = channels.size == 0 or bool(channels.min() >= -LARGEST and channels.max() <= LARGEST)
    positions = np.empty((len(nodes), 3, channels.shape[0]))
    positions[~needed] = np.nan
    orientation = np.empty((9, channels.shape[0]))
    size = min(BLOCK, channels.shape[0])
    rotations, block = np.empty(9 * len(nodes) * size), np.empty((channels.shape[1] + 2) * size)
    _forward(channels, near, needed, *chain, oriented, positions, orientation, rotations, block, np.eye(3))
    return positions, orientation


class _Chain(NamedTuple):
    """Nodes as arrays: parents, the range of steps of each, the steps, and the fixed rotations and offsets."""

    parents: I32
    counts: I32
    kinds: I32
    columns: I32
    frames: F64
    plain: Bool
    offsets: F64


@lru_cache(maxsize=16)  # The takes of an archive share a few skeletons, so their chains are cached.
def _chain(nodes: tuple[Node, ...]) -> _Chain:
    for i, node in enumerate(nodes):
        if not -1 <= node.parent < i:
            raise ParameterError(f"parent of '{node.name}'", "a node before it", node.parent)
        for step in node.steps:
            if step.column < 0:
                raise ParameterError(f"channel of '{node.name}'", "0 or above", step.column)
    frames = np.array([node.frame for node in nodes], dtype=np.float64).reshape(-1, 9)
    return _Chain(
        parents=np.array([node.parent for node in nodes], dtype=np.int32),
        counts=np.cumsum([0, *(len(node.steps) for node in nodes)], dtype=np.int32),
        kinds=np.array([step.kind for node in nodes for step in node.steps], dtype=np.int32),
        columns=np.array([step.column for node in nodes for step in node.steps], dtype=np.int32),
        frames=frames,
        plain=np.all(frames == np.eye(3).ravel(), axis=1),
        offsets=np.array([(node.before, node.after, node.direction) for node in nodes], dtype=np.float64),
    )


@lru_cache(maxsize=16)
def _needed(nodes: tuple[Node, ...], wanted: tuple[int, ...]) -> Bool:
    """Return a mask of the nodes that are wanted or lie between a wanted node and the root."""
    needed = np.zeros(len(nodes), dtype=np.bool_)
    for index in wanted:
        if not 0 <= index < len(nodes):
            raise ParameterError("wanted", f"indices of {len(nodes)} nodes", index)
        while index >= 0 and not needed[index]:
            needed[index] = True
            index = nodes[index].parent
    return needed


@njit(cache=True, nogil=True, _nrt=False)
def _turn(a: F64, b: F64, sines: F64, cosines: F64) -> None:
    """Rotate a row of a matrix about an axis in every frame; a and b are its two other components."""
    for t in range(a.shape[0]):
        p, q = a[t], b[t]
        a[t] = p * cosines[t] + q * sines[t]
        b[t] = q * cosines[t] - p * sines[t]


@njit(cache=True, nogil=True, _nrt=False)
def _times(a: F64, b: F64, c: F64, matrix: F64, x: F64, y: F64, z: F64) -> None:
    """Multiply rows (a, b, c) by a fixed matrix in every frame, and write the results to x, y, z."""
    f0, f1, f2, f3, f4, f5, f6, f7, f8 = matrix
    for t in range(a.shape[0]):
        p, q, r = a[t], b[t], c[t]
        x[t] = p * f0 + q * f3 + r * f6
        y[t] = p * f1 + q * f4 + r * f7
        z[t] = p * f2 + q * f5 + r * f8


@njit(cache=True, nogil=True, _nrt=False)
def _shift(out: F64, rotations: F64, offset: F64) -> None:
    """Move positions (3, T) by a fixed offset that is rotated by matrices (9, T)."""
    x, y, z = offset
    if x == 0.0 and y == 0.0 and z == 0.0:
        return
    for axis in range(3):
        place, a, b, c = out[axis], rotations[3 * axis], rotations[3 * axis + 1], rotations[3 * axis + 2]
        for t in range(place.shape[0]):
            place[t] += a[t] * x + b[t] * y + c[t] * z


@njit(cache=True, nogil=True, _nrt=False)
def _move(out: F64, rotations: F64, x: float, y: float, z: float, lengths: F64) -> None:
    """Move positions (3, T) along a fixed direction, rotated by matrices (9, T), by the values of a channel."""
    for axis in range(3):
        place, a, b, c = out[axis], rotations[3 * axis], rotations[3 * axis + 1], rotations[3 * axis + 2]
        for t in range(place.shape[0]):
            place[t] += (a[t] * x + b[t] * y + c[t] * z) * lengths[t]


@njit(cache=True, nogil=True, _nrt=False)
def _copy(source: F64, target: F64) -> None:
    """Copy a matrix element by element; slice assignment would also compile numba's error messages for shapes."""
    for i in range(source.shape[0]):
        for t in range(source.shape[1]):
            target[i, t] = source[i, t]


@njit(cache=True, nogil=True, _nrt=False)
def _add(values: F64, to: F64) -> None:
    """Add values in place element by element, as in `_copy`."""
    for t in range(to.shape[0]):
        to[t] += values[t]


@njit(cache=True, nogil=True, _nrt=False)
def _rotate(own: F64, kind: int, angles: F64, near: bool, s: F64, c: F64) -> None:
    """Rotate the matrices (9, T) of a node about one of its axes; s and c are buffers for sines and cosines."""
    if near:
        sincos(angles, s, c)
    else:
        sincos_far(angles, s, c)
    i, j = (kind + 1) % 3, (kind + 2) % 3
    for k in (0, 3, 6):
        _turn(own[k + i], own[k + j], s, c)


@njit(cache=True, nogil=True, _nrt=False)
def _forward(
    channels: F64, near: bool, needed: Bool, parents: I32, counts: I32, kinds: I32, columns: I32,
    frames: F64, plain: Bool, offsets: F64, oriented: int, positions: F64, orientation: F64,
    rotations: F64, block: F64, axes: F64,
) -> None:  # fmt: skip
    """Write positions and orientation into preallocated memory; the kernel allocates nothing and counts no references.

    `rotations` and `block` are work memory for a block of frames: `rotations` for the rotation matrices of all nodes,
    `block` for the channels and for one row each of sines and cosines. Both are divided into contiguous arrays, so that
    the compiler can vectorise the loops over frames.
    """
    total, width = channels.shape
    nodes = len(parents)
    for start in range(0, total, BLOCK):
        size = min(BLOCK, total - start)
        stop = start + size
        h = rotations[: nodes * 9 * size].reshape(nodes, 9, size)
        of_channel = block[: (width + 2) * size].reshape(width + 2, size)
        s, c = of_channel[width], of_channel[width + 1]
        for t in range(size):
            for column in range(width):
                of_channel[column, t] = channels[start + t, column]
        for node in range(nodes):
            if not needed[node]:
                continue
            parent = parents[node]
            own, out = h[node], positions[node, :, start:stop]
            # The node starts at the parent's end plus the fixed offset, moved by its own channels.
            if parent < 0:
                for k in range(9):
                    own[k] = frames[node, k]
                for axis in range(3):
                    out[axis] = offsets[node, 0, axis]
            else:
                up = h[parent]
                if plain[node]:
                    _copy(up, own)
                else:
                    for k in (0, 3, 6):
                        _times(up[k], up[k + 1], up[k + 2], frames[node], own[k], own[k + 1], own[k + 2])
                _copy(positions[parent, :, start:stop], out)
                _shift(out, up, offsets[node, 0])
            for step in range(counts[node], counts[node + 1]):
                kind, along = kinds[step], of_channel[columns[step]]
                if MOVE_X <= kind <= MOVE_Z:
                    axis = kind - MOVE_X
                    if parent < 0:
                        _add(along, out[axis])
                    else:
                        _move(out, own, axes[axis, 0], axes[axis, 1], axes[axis, 2], along)
            for step in range(counts[node], counts[node + 1]):
                if kinds[step] <= ROTATE_Z:
                    _rotate(own, kinds[step], of_channel[columns[step]], near, s, c)
            _shift(out, own, offsets[node, 1])
            for step in range(counts[node], counts[node + 1]):
                if kinds[step] == STRETCH:
                    x, y, z = offsets[node, 2]
                    _move(out, own, x, y, z, of_channel[columns[step]])
        _copy(h[oriented], orientation[:, start:stop])


def frames_along(across: F64, up: F64) -> F64:
    """Return rotation matrices (9, T), row by row, with X along `across` and Y as near to `up` as possible.

    Parameters
    ----------
    across, up : float64 array (3, T)
        Vectors of any length. If a vector is zero or both are parallel, some entries of the matrix are not finite.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        x = across / np.linalg.norm(across, axis=0)
        z = np.cross(x, up / np.linalg.norm(up, axis=0), axis=0)
        length = np.linalg.norm(z, axis=0)
        z = z / np.where(length > 1e-9, length, 0.0)
        matrices: F64 = np.stack([x, np.cross(z, x, axis=0), z], axis=1)  # columns are the axes
    return np.ascontiguousarray(matrices.reshape(9, -1))


def quaternions(matrices: F64, before: F64 | None = None, after: F64 | None = None) -> F64:
    """Convert rotation matrices (9, T) to unit quaternions (4, T) in the order w x y z, continuous in sign.

    Parameters
    ----------
    matrices : float64 array (9, T)
        Row by row.
    before, after : float64 array or None
        Fixed rotations (3, 3) by which every matrix is multiplied from the left and right; None for the identity.
    """
    q = np.empty((4, matrices.shape[1]))
    left = np.eye(3) if before is None else np.ascontiguousarray(before, dtype=np.float64)
    right = np.eye(3) if after is None else np.ascontiguousarray(after, dtype=np.float64)
    _quaternions(np.ascontiguousarray(matrices, dtype=np.float64), left, right, q)
    return q


@njit(cache=True, nogil=True, error_model="numpy")
def _quaternions(matrices: F64, left: F64, right: F64, out: F64) -> None:
    """Convert matrices to quaternions by way of the largest component, so that no divisor is near zero."""
    m, half = np.empty((3, 3)), np.empty((3, 3))
    last = np.array([1.0, 0.0, 0.0, 0.0])  # the first one has w ≥ 0
    for t in range(out.shape[1]):
        for i in range(3):
            for j in range(3):
                half[i, j] = (
                    matrices[3 * i, t] * right[0, j]
                    + matrices[3 * i + 1, t] * right[1, j]
                    + matrices[3 * i + 2, t] * right[2, j]
                )
        for i in range(3):
            for j in range(3):
                m[i, j] = left[i, 0] * half[0, j] + left[i, 1] * half[1, j] + left[i, 2] * half[2, j]
        xx, yy, zz = m[0, 0], m[1, 1], m[2, 2]
        sw, sx, sy, sz = 1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz
        wx, wy, wz = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
        xy, xz, yz = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]
        if sw >= sx and sw >= sy and sw >= sz:
            w, x, y, z = sw, wx, wy, wz
        elif sx >= sy and sx >= sz:
            w, x, y, z = wx, sx, xy, xz
        elif sy >= sz:
            w, x, y, z = wy, xy, sy, yz
        else:
            w, x, y, z = wz, xz, yz, sz
        length = np.sqrt(w * w + x * x + y * y + z * z)
        w, x, y, z = w / length, x / length, y / length, z / length
        if w * last[0] + x * last[1] + y * last[2] + z * last[3] < 0.0:
            w, x, y, z = -w, -x, -y, -z
        out[0, t], out[1, t], out[2, t], out[3, t] = w, x, y, z
        if not np.isnan(w):
            last[0], last[1], last[2], last[3] = w, x, y, z


@njit(cache=True, nogil=True, _nrt=False)
def sincos(angles: F64, sines: F64, cosines: F64) -> None:
    """Compute sines and cosines of angles in radians into given arrays, with errors below 0.8 units of the last place.

    Angles are at most `LARGEST` from zero: see `sincos_far`. An infinity or a NaN gives NaN.
    """
    for t in range(angles.shape[0]):
        angle = angles[t]
        quarters = np.rint(angle * _QUARTERS)
        # The remainder of the angle in two parts: x, and the rounding error of x.
        near = angle - quarters * _FIRST
        second = quarters * _SECOND
        x = near - second
        rest = ((near - x) - second) - quarters * _THIRD
        whole = x + rest
        rest = (x - whole) + rest
        x = whole
        z = x * x
        series = _S2 + z * (_S3 + z * (_S4 + z * (_S5 + z * (_S6 + z * (_S7 + z * _S8)))))
        cube = z * x
        sine = x - ((z * (0.5 * rest - cube * series) - rest) - cube * _S1)
        series = z * (_C2 + z * (_C3 + z * (_C4 + z * (_C5 + z * (_C6 + z * (_C7 + z * _C8))))))
        half = 0.5 * z
        near_one = 1.0 - half
        cosine = near_one + (((1.0 - near_one) - half) + (z * series - x * rest))
        # Every quarter turn swaps the two and changes one sign.
        swapped = quarters * 0.5 != np.rint(quarters * 0.5)
        quadrant = quarters - 4.0 * np.floor(quarters * 0.25)
        upright = cosine if swapped else sine
        level = sine if swapped else cosine
        sines[t] = -upright if quadrant >= 2.0 else upright
        cosines[t] = -level if quadrant == 1.0 or quadrant == 2.0 else level


@njit(cache=True, nogil=True, _nrt=False)
def sincos_far(angles: F64, sines: F64, cosines: F64) -> None:
    """Compute sines and cosines of angles of any size, one by one, with the C library."""
    for t in range(angles.shape[0]):
        sines[t] = np.sin(angles[t])
        cosines[t] = np.cos(angles[t])
