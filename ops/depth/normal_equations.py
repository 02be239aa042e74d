"""This module computes JᵀJ and Jᵀr of a pose fit from sums over cones and over the tree of pivots.

A point of a cone's axis moves by dq = t + Σ_k ω_k × a_k. Here t is the displacement of the whole body, and ω_k is a
small rotation of each pivot k above the point. The lever a_k is Σ_j w_j (p_j − p_k), summed over the joints j that
pivot k moves, where w_j is the weight of the joint in the point.

Most cones are rigid: one pivot and its ancestors move the whole cone. Each point gives a row (n, r × n) of the Jacobian
with respect to the velocity of the root and the angular velocity, and these rows are summed by pivot. The sums of a
pivot are then added to those of its parent, so that this work does not depend on the number of points. The ends of a
blended cone are moved by different pivots; its rows refer to the velocity and the angular velocity of both ends.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64
from kinedex.ops.depth.cones import ConeBody, Pivots, moved_joints


class MovingCones(NamedTuple):
    """The pivots that move each cone, as arrays for kernels.

    Attributes
    ----------
    rigid : int64 array (C,)
        The lowest pivot that moves the whole cone; −1 for a blended cone.
    blends : int64 array (C,)
        The index of a blended cone among the B blended cones; −1 for a rigid cone.
    cones : int64 array (B,)
        The blended cones.
    pivots : int64 array (B, K)
        The pivots that move each blended cone, parents before children; −1 for unused entries.
    shares : float64 array (B, K, 2, M)
        The shares of the joints at both ends that each pivot moves; see `ConeBody.joints`.
    """

    rigid: I64
    blends: I64
    cones: I64
    pivots: I64
    shares: F64


class Sums(NamedTuple):
    """Preallocated arrays for the sums of a step.

    Attributes
    ----------
    rigid : float64 array (P, 27)
        Sums of the rigid cones of each pivot: the upper half of Σ w row rowᵀ, row by row, for velocity and angular
        velocity, and Σ w row · residual.
    faces : float64 array (B, 24)
        Sums of rows along a normal of blended cones: w n nᵀ times (1 − s)², s (1 − s), s², six numbers each, and
        w n · residual times 1 − s and s.
    blended : float64 array (B, 12, 12)
        Σ w row rowᵀ of all rows of blended cones, for both ends.
    blended_right : float64 array (B, 12)
        Σ w row · residual.
    square : float64 array (6, 6)
        Σ w row rowᵀ of one pivot.
    levers : float64 array (K, 2, 4)
        −a_k at both ends of a cone, and the fraction of the rotation that applies to each end.
    columns : float64 array (12, 3)
        Products of a pivot's columns with the sums.
    matrix : float64 array (3 P + 3, 3 P + 3)
        The upper half of JᵀJ: deepest pivots first, t last.
    right : float64 array (3 P + 3,)
        Jᵀr, in the same order; `solve` replaces it by the step.
    """

    rigid: F64
    faces: F64
    blended: F64
    blended_right: F64
    square: F64
    levers: F64
    columns: F64
    matrix: F64
    right: F64


def moving_cones(body: ConeBody) -> MovingCones:
    """Return the pivots that move each cone of a body.

    A pivot moves the joints below it. If one end of a cone lies in the pivot's joint and the pivot moves the other end,
    the pivot also rotates the surface around the first end.
    """
    moved, count = moved_joints(body.pivots), len(body.radii)
    weights = np.zeros((count, len(body.pivots), 2, body.joints.shape[2]))
    for c in range(count):
        for e in range(2):
            others = body.joints[c, 1 - e][body.shares[c, 1 - e] > 0]
            for m, joint in enumerate(body.joints[c, e]):
                turned = moved[:, joint] | ((body.pivots == joint) & moved[:, others].any(axis=1))
                weights[c, :, e, m] = turned * body.shares[c, e, m]
    whole: F64 = weights.sum(axis=3)
    is_rigid = np.array([bool((np.isclose(part, 0.0) | np.isclose(part, 1.0)).all()) for part in whole])
    is_rigid &= np.isclose(whole[:, :, 0], whole[:, :, 1]).all(axis=1)
    blended = np.flatnonzero(~is_rigid)
    rigid = np.where(is_rigid, [int(np.flatnonzero(part[:, 0] + part[:, 1] > 0)[-1]) for part in whole], -1)
    lists = [np.flatnonzero(whole[c].any(axis=1)) for c in blended]
    most = max((len(chain) for chain in lists), default=0)
    pivots = np.full((len(blended), most), -1, np.int64)
    shares = np.zeros((len(blended), most, *weights.shape[2:]))
    numbers = np.full(count, -1, np.int64)
    for b, (c, chain) in enumerate(zip(blended.tolist(), lists, strict=True)):
        numbers[c], pivots[b, : len(chain)], shares[b, : len(chain)] = b, chain, weights[c, chain]
    return MovingCones(rigid.astype(np.int64), numbers, blended.astype(np.int64), pivots, shares)


def make_sums(pivots: int, moving: MovingCones) -> Sums:
    """Allocate the arrays of sums for a body."""
    blends, size = len(moving.cones), 3 * pivots + 3
    return Sums(
        np.zeros((pivots, 27)), np.zeros((blends, 24)), np.zeros((blends, 12, 12)), np.zeros((blends, 12)),
        np.zeros((6, 6)), np.zeros((moving.pivots.shape[1], 2, 4)), np.zeros((12, 3)), np.zeros((size, size)),
        np.zeros(size),
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def clear_sums(sums: Sums) -> None:
    """Set all sums to 0."""
    sums.rigid[:] = 0.0
    sums.faces[:] = 0.0
    sums.blended[:] = 0.0
    sums.blended_right[:] = 0.0
    sums.matrix[:] = 0.0
    sums.right[:] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def add_rigid_face(
    rigid: F64, pivot: int, x: float, y: float, z: float, a: float, b: float, c: float, residual: float, weight: float
) -> None:
    """Add the row n · dq = residual of a point on the axis of a rigid cone.

    Parameters
    ----------
    rigid : float64 array (P, 27)
        The sums of rigid cones, which are added to.
    pivot : int
        The lowest pivot that moves the cone.
    x, y, z : float
        The position of the point in metres, relative to the root.
    a, b, c : float
        The unit vector n.
    residual : float
        The residual in metres.
    weight : float
        The weight w of the squared residual.
    """
    u, v, w = y * c - z * b, z * a - x * c, x * b - y * a
    row = (a, b, c, u, v, w)
    n = 0
    for i in range(6):
        part = weight * row[i]
        for j in range(i, 6):
            rigid[pivot, n] += part * row[j]
            n += 1
        rigid[pivot, 21 + i] += part * residual


@njit(cache=True, nogil=True, error_model="numpy")
def add_blended_face(
    faces: F64, blend: int, s: float, a: float, b: float, c: float, residual: float, weight: float
) -> None:
    """Add the row n · dq = residual of a point on the axis of a blended cone.

    Parameters
    ----------
    faces : float64 array (B, 24)
        The sums, to which the row is added.
    blend : int
        The index of the cone among the blended cones.
    s : float
        The position on the cone's axis, from 0 to 1.
    a, b, c : float
        The unit vector n.
    residual : float
        The residual in metres.
    weight : float
        The weight w of the squared residual.
    """
    row = (a, b, c)
    n = 0
    for i in range(3):
        part = weight * row[i]
        for j in range(i, 3):
            product = part * row[j]
            faces[blend, n] += (1.0 - s) * (1.0 - s) * product
            faces[blend, 6 + n] += (1.0 - s) * s * product
            faces[blend, 12 + n] += s * s * product
            n += 1
        faces[blend, 18 + i] += (1.0 - s) * part * residual
        faces[blend, 21 + i] += s * part * residual


@njit(cache=True, nogil=True, error_model="numpy")
def add_blended_vector(
    matrix: F64, right: F64, s: float, offset: F64, x: float, y: float, z: float, weight: float
) -> None:
    """Add the three rows dq + Σ ω_k × offset = (x, y, z) of a sample on a blended cone.

    Parameters
    ----------
    matrix, right : float64 array (12, 12), (12,)
        The sums of the cone, to which the rows are added.
    s : float
        The place on its axis, from 0 to 1.
    offset : float64 array (3,)
        The offset of the sample from the axis in metres.
    x, y, z : float
        The residual in metres.
    weight : float
        The weight of the squared length of the residual.
    """
    residual = (x, y, z)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        columns, factors = (i, 3 + j, 3 + k), (1.0, offset[k], -offset[j])  # e_i and offset × e_i
        for one in range(6):
            part = weight * factors[one % 3] * (1.0 - s if one < 3 else s)
            row = columns[one % 3] + (0 if one < 3 else 6)
            right[row] += part * residual[i]
            for other in range(6):
                share = 1.0 - s if other < 3 else s
                matrix[row, columns[other % 3] + (0 if other < 3 else 6)] += part * share * factors[other % 3]


@njit(cache=True, nogil=True, error_model="numpy")
def assemble(moving: MovingCones, joints: I64, pivots: Pivots, pose: F64, sums: Sums) -> None:
    """Compute JᵀJ and Jᵀr from the sums of all rows.

    Parameters
    ----------
    moving : MovingCones
        The cones.
    joints : int64 array (C, 2, M)
        The joints of their ends.
    pivots : Pivots
        The pivots.
    pose : float64 array (24, 3)
        Joints in metres.
    sums : Sums
        The sums; `matrix` and `right` are added to.
    """
    _add_rigid(pivots, pose, sums)
    for b in range(len(moving.cones)):
        _complete(sums.faces[b], sums.blended[b], sums.blended_right[b])
        _add_blended(moving, joints, pivots, pose, b, sums)


@njit(cache=True, nogil=True, error_model="numpy")
def _add_rigid(pivots: Pivots, pose: F64, sums: Sums) -> None:
    """Add the sums of rigid cones, passing them on from each pivot to its parent."""
    count = len(pivots.joints)
    shift, columns, s = 3 * count, sums.columns, sums.square
    root = pose[pivots.joints[0]]
    for k in range(count - 1, -1, -1):
        own, parent = sums.rigid[k], pivots.parents[k]
        right, n = own[21:], 0
        for i in range(6):
            for j in range(i, 6):
                s[i, j] = s[j, i] = own[n]
                n += 1
        centre = pose[pivots.joints[k]]
        x, y, z = centre[0] - root[0], centre[1] - root[1], centre[2] - root[2]
        for i in range(6):
            columns[i, 0] = s[i, 3] + z * s[i, 1] - y * s[i, 2]
            columns[i, 1] = s[i, 4] + x * s[i, 2] - z * s[i, 0]
            columns[i, 2] = s[i, 5] + y * s[i, 0] - x * s[i, 1]
        row = 3 * (count - 1 - k)
        sums.right[row] += right[3] + z * right[1] - y * right[2]
        sums.right[row + 1] += right[4] + x * right[2] - z * right[0]
        sums.right[row + 2] += right[5] + y * right[0] - x * right[1]
        above = k
        while above >= 0:
            place = pose[pivots.joints[above]]
            x, y, z = place[0] - root[0], place[1] - root[1], place[2] - root[2]
            column = 3 * (count - 1 - above)
            for j in range(3):
                sums.matrix[row + j, column] += columns[3, j] + z * columns[1, j] - y * columns[2, j]
                sums.matrix[row + j, column + 1] += columns[4, j] + x * columns[2, j] - z * columns[0, j]
                sums.matrix[row + j, column + 2] += columns[5, j] + y * columns[0, j] - x * columns[1, j]
            above = pivots.parents[above]
        for i in range(3):
            for j in range(3):
                sums.matrix[row + j, shift + i] += columns[i, j]
        if parent >= 0:
            for i in range(27):
                sums.rigid[parent, i] += own[i]
    for i in range(3):
        sums.right[shift + i] += sums.rigid[0, 21 + i]
        for j in range(i, 3):
            sums.matrix[shift + i, shift + j] += s[i, j]


@njit(cache=True, nogil=True, error_model="numpy")
def _complete(face: F64, matrix: F64, right: F64) -> None:
    """Add the packed sums `face` along the normals of a blended cone to its normal equations `matrix` and `right`."""
    for i in range(3):
        right[i] += face[18 + i]
        right[6 + i] += face[21 + i]
        for j in range(3):
            low, high = min(i, j), max(i, j)
            n = high if low == 0 else low + high + 1
            matrix[i, j] += face[n]
            matrix[i, 6 + j] += face[6 + n]
            matrix[6 + i, j] += face[6 + n]
            matrix[6 + i, 6 + j] += face[12 + n]


@njit(cache=True, nogil=True, error_model="numpy")
def _add_blended(moving: MovingCones, joints: I64, pivots: Pivots, pose: F64, b: int, sums: Sums) -> None:
    """Add the sums of a blended cone to those of the pivots that move it."""
    count, levers, columns = len(pivots.joints), sums.levers, sums.columns
    shift, cone, matrix = 3 * count, moving.cones[b], sums.blended[b]
    right = sums.blended_right[b]
    chain = 0
    while chain < moving.pivots.shape[1] and moving.pivots[b, chain] >= 0:
        centre = pose[pivots.joints[moving.pivots[b, chain]]]
        for e in range(2):
            lever = levers[chain, e]
            lever[:] = 0.0
            for m in range(joints.shape[2]):
                share, place = moving.shares[b, chain, e, m], pose[joints[cone, e, m]]
                lever[0] -= share * (place[0] - centre[0])
                lever[1] -= share * (place[1] - centre[1])
                lever[2] -= share * (place[2] - centre[2])
                lever[3] += share
        chain += 1
    for n in range(chain):
        row = 3 * (count - 1 - moving.pivots[b, n])
        columns[:] = 0.0
        for e in range(2):
            x, y, z, share = levers[n, e]
            for i in range(12):
                s = matrix[i, 6 * e : 6 * e + 6]
                columns[i, 0] += share * s[3] + z * s[1] - y * s[2]
                columns[i, 1] += share * s[4] + x * s[2] - z * s[0]
                columns[i, 2] += share * s[5] + y * s[0] - x * s[1]
            g = right[6 * e : 6 * e + 6]
            sums.right[row] += share * g[3] + z * g[1] - y * g[2]
            sums.right[row + 1] += share * g[4] + x * g[2] - z * g[0]
            sums.right[row + 2] += share * g[5] + y * g[0] - x * g[1]
        for m in range(n + 1):
            column = 3 * (count - 1 - moving.pivots[b, m])
            for e in range(2):
                x, y, z, share = levers[m, e]
                f = columns[6 * e : 6 * e + 6]
                for j in range(3):
                    sums.matrix[row + j, column] += share * f[3, j] + z * f[1, j] - y * f[2, j]
                    sums.matrix[row + j, column + 1] += share * f[4, j] + x * f[2, j] - z * f[0, j]
                    sums.matrix[row + j, column + 2] += share * f[5, j] + y * f[0, j] - x * f[1, j]
        for i in range(3):
            for j in range(3):
                sums.matrix[row + j, shift + i] += columns[i, j] + columns[6 + i, j]
    for i in range(3):
        sums.right[shift + i] += right[i] + right[6 + i]
        for j in range(i, 3):
            total = matrix[i, j] + matrix[i, 6 + j] + matrix[6 + i, j] + matrix[6 + i, 6 + j]
            sums.matrix[shift + i, shift + j] += total


@njit(cache=True, nogil=True, error_model="numpy")
def solve(sums: Sums) -> bool:
    """Solve JᵀJ x = Jᵀr by Cholesky decomposition; since deeper pivots come first, the factor is as sparse as the tree.

    Parameters
    ----------
    sums : Sums
        The sums of the step: the upper half of `matrix` is overwritten by its factor, and `right` by the step.

    Returns
    -------
    bool
        False if the matrix is not positive definite; the step is then undefined.
    """
    matrix, step = sums.matrix, sums.right
    size = len(step)
    for i in range(size):
        top = matrix[i]
        if not top[i] > 0.0:
            return False
        scale = 1.0 / np.sqrt(top[i])
        for j in range(i, size):
            top[j] *= scale
        step[i] *= scale
        for k in range(i + 1, size):
            factor = top[k]
            if factor != 0.0:
                step[k] -= factor * step[i]
                row = matrix[k]
                for j in range(k, size):
                    row[j] -= factor * top[j]
    for i in range(size - 1, -1, -1):
        top = matrix[i]
        total = step[i]
        for j in range(i + 1, size):
            total -= top[j] * step[j]
        step[i] = total / top[i]
    return True
