"""This module computes JᵀAJ and Jᵀb of all points of a frame by sums over the subtrees of the nodes.

A parameter moves all points below its node as one rigid body, by a twist: a velocity v of the point o where the root
lies, and an angular velocity ω. With r = y − o the point y moves by v − [r]ω, where [r] is the matrix of r × ·. So the
sums of A, [r]A, [r]A[r]ᵀ, b and r × b over the points below a node suffice for its parameters; they are accumulated
from the leaves to the root (as in the composite rigid body algorithm of robotics). The work does not grow with the
points of a node.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.kinematic_chain import PLACES, ChainArrays
from kinedex.ops.copies import copy_row


@njit(cache=True, nogil=True)
def add_points(
    chain: ChainArrays, turned: F64, centres: F64, nodes: I64, points: F64, matrices: F64, vectors: F64,
    hessian: F64, gradient: F64,
) -> None:  # fmt: skip
    """Add JᵀAJ and Jᵀb of all points to H and g of a frame.

    Parameters
    ----------
    chain : ChainArrays
        The body.
    turned, centres : float64 array (K, 3, 3), (K, 3)
        The nodes, see `pose_nodes`.
    nodes : int64 array (P,)
        The node that moves each point.
    points : float64 array (P, 3)
        The points in the world.
    matrices : float64 array (P, 3, 3)
        A of each, symmetric.
    vectors : float64 array (P, 3)
        b of each.
    hessian : float64 array (parameters, parameters)
        H, of which the lower half is added to.
    gradient : float64 array (parameters,)
        g.
    """
    forces, mixed, moments, wrenches = _sums(chain, centres[0], nodes, points, matrices, vectors)
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
