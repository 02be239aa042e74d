"""This module computes continuous Euler angles of rotation matrices, in any order of the three axes."""

from __future__ import annotations

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64
from kinedex.ops.copies import copy_row
from kinedex.ops.errors import ParameterError


def matrices_of(angles: F64, order: str) -> F64:
    """Return the products (T, 3, 3) of rotations about axes, the first axis leftmost.

    Parameters
    ----------
    angles : float64 array (T, n)
        Angles in radians, in the order of the axes.
    order : str
        n letters of XYZ: "ZXY" is Rz · Rx · Ry.
    """
    product = np.broadcast_to(np.eye(3), (len(angles), 3, 3))
    for axis, angle in zip(order, angles.T, strict=True):
        i = "XYZ".index(axis)
        j, k = (i + 1) % 3, (i + 2) % 3
        turn = np.zeros((len(angles), 3, 3))
        turn[:, i, i] = 1.0
        turn[:, j, j] = turn[:, k, k] = np.cos(angle)
        turn[:, k, j] = np.sin(angle)
        turn[:, j, k] = -turn[:, k, j]
        product = product @ turn
    return product


def euler_angles(matrices: F64, order: str, near: F64 | None = None) -> F64:
    """Return Euler angles of rotations; of the solutions in a frame, choose the nearest to given or previous angles.

    Parameters
    ----------
    matrices : float64 array (T, 3, 3)
        Rotations.
    order : str
        A permutation of XYZ; the matrix of the first axis is leftmost in the product.
    near : float64 array (T, 3), optional
        Angles that the solution in each frame should be nearest to. The default is the solution of the previous frame,
        and 0 in the first frame.

    Returns
    -------
    float64 array (T, 3)
        Angles in radians, in the order of the axes; they are unwrapped and may exceed 2π.

    Raises
    ------
    ParameterError
        The order is not a permutation of XYZ.
    """
    if sorted(order) != ["X", "Y", "Z"]:
        raise ParameterError("order", "a permutation of XYZ", order)
    i, j, k = ("XYZ".index(axis) for axis in order)
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    out = np.empty((len(matrices), 3))
    given = np.zeros((0, 3)) if near is None else np.ascontiguousarray(near, np.float64)
    _angles(np.ascontiguousarray(matrices), i, j, k, sign, given, out)
    return out


@njit(cache=True, nogil=True)
def _angles(matrices: F64, i: int, j: int, k: int, sign: float, given: F64, out: F64) -> None:
    """Write the Euler angles with the middle angle within ±π/2, or the other solution if that is nearer, to `out`."""
    turn = 2.0 * np.pi
    near = np.zeros(3)
    found, other = np.empty(3), np.empty(3)
    for t in range(len(matrices)):
        m = matrices[t]
        if len(given):
            copy_row(near, given[t])
        sine = min(1.0, max(-1.0, sign * m[i, k]))
        found[1] = np.arcsin(sine)
        if abs(sine) < 1.0 - 1e-12:
            found[0] = np.arctan2(-sign * m[j, k], m[k, k])
            found[2] = np.arctan2(-sign * m[i, j], m[i, i])
        else:  # gimbal lock: only the sum or the difference of the outer angles is known, and the last one stays
            found[2] = near[2]
            around = np.arctan2(sign * m[k, j], m[j, j])
            found[0] = around - found[2] if sine * sign > 0 else around + found[2]
        other[0], other[1], other[2] = found[0] + np.pi, np.pi - found[1], found[2] + np.pi
        far, far_other = 0.0, 0.0
        for a in range(3):
            found[a] += turn * np.round((near[a] - found[a]) / turn)
            other[a] += turn * np.round((near[a] - other[a]) / turn)
            far += abs(found[a] - near[a])
            far_other += abs(other[a] - near[a])
        for a in range(3):
            near[a] = found[a] if far <= far_other + 1e-9 else other[a]
            out[t, a] = near[a]
