"""This module sums a frame's silhouette correspondences, and adds them to its H and g (thesis, Eq. 6.4)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64
from kinedex.ops.body.capsules import Capsules
from kinedex.ops.body.kinematic_chain import ChainArrays, point_jacobian
from kinedex.ops.tracking.blocks import FrameRoom, add_point
from kinedex.ops.tracking.contours import Contours
from kinedex.ops.tracking.views import View

WEIGHT, SIGMA_PX = 0.15, 3.0
"""Weight of a correspondence, and standard deviation of the boundary in pixels of the camera."""

_NEAREST_M = 0.3  # least depth in metres at which the size of a pixel is computed, as for rays of keypoints


class ContourSums(NamedTuple):
    """Correspondences as quadratic forms in the displacements of joints from the pose at which they were found.

    A point at position s of a capsule's axis moves by (1 − s) times the start joint's displacement plus s times the end
    joint's.

    Attributes
    ----------
    joints : float64 array (J, 3)
        The joints of the pose at which the correspondences were found.
    matrices : float64 array (J, 3, 3)
        Sums of (1 − s)² A or s² A with A = w (I − n nᵀ).
    vectors : float64 array (J, 3)
        Sums of (1 − s) b or s b with b = w (I − n nᵀ)(y − C).
    mixed : float64 array (N, 3, 3)
        Sums of s (1 − s) A of each capsule.
    """

    joints: F64
    matrices: F64
    vectors: F64
    mixed: F64


def contour_sums(capsules: Capsules, joints: int) -> ContourSums:
    """Allocate sums without correspondences, for J joints."""
    shapes = (joints, 3), (joints, 3, 3), (joints, 3), (len(capsules.radii), 3, 3)
    return ContourSums(*(np.zeros(shape) for shape in shapes))


@njit(cache=True, nogil=True)
def add_contours(view: View, found: Contours, count: int, capsules: Capsules, sums: ContourSums) -> float:
    """Add correspondences of one camera to the sums of a frame (thesis, Eq. 6.4).

    Parameters
    ----------
    view : View
        The camera.
    found : Contours
        The correspondences.
    count : int
        Their number.
    capsules : Capsules
        The surface of the body.
    sums : ContourSums
        The sums, which are added to.

    Returns
    -------
    float
        The sum of the squares, w ‖(I − n nᵀ)(y − C)‖².
    """
    cost = 0.0
    focal = 0.5 * (view.matrix[0, 0] + view.matrix[1, 1])
    apart = np.empty(3)
    for c in range(count):
        n = found.directions[c]
        depth = 0.0
        for i in range(3):
            apart[i] = found.points[c, i] - view.centre[i]
            depth += apart[i] * n[i]
        weight = WEIGHT * (focal / (max(depth, _NEAREST_M) * SIGMA_PX)) ** 2
        capsule, share = found.capsules[c], found.shares[c]
        start, end = capsules.starts[capsule], capsules.ends[capsule]
        for i in range(3):
            apart[i] -= depth * n[i]
            cost += weight * apart[i] * apart[i]
        for i in range(3):
            sums.vectors[start, i] += weight * (1.0 - share) * apart[i]
            sums.vectors[end, i] += weight * share * apart[i]
            for j in range(3):
                part = weight * ((1.0 if i == j else 0.0) - n[i] * n[j])
                sums.matrices[start, i, j] += (1.0 - share) ** 2 * part
                sums.matrices[end, i, j] += share**2 * part
                sums.mixed[capsule, i, j] += share * (1.0 - share) * part
    return cost


@njit(cache=True, nogil=True)
def sums_cost(capsules: Capsules, sums: ContourSums, joints: F64) -> float:
    """Return the change of the correspondences' cost from the pose at which they were found to another pose.

    Parameters
    ----------
    capsules : Capsules
        The surface of the body.
    sums : ContourSums
        The sums of the correspondences.
    joints : float64 array (J, 3)
        The joints of another pose in metres.

    Returns
    -------
    float
        The difference of the squares, which is negative where the pose fits better.
    """
    cost = 0.0
    moves = joints - sums.joints
    for j in range(len(joints)):
        for i in range(3):
            along = 2.0 * sums.vectors[j, i]
            for a in range(3):
                along += sums.matrices[j, i, a] * moves[j, a]
            cost += along * moves[j, i]
    for n in range(len(capsules.radii)):
        start, end = capsules.starts[n], capsules.ends[n]
        for i in range(3):
            for a in range(3):
                cost += 2.0 * moves[start, i] * sums.mixed[n, i, a] * moves[end, a]
    return cost


@njit(cache=True, nogil=True)
def add_sums(
    chain: ChainArrays, capsules: Capsules, sums: ContourSums, joints: F64, room: FrameRoom, gradient: F64
) -> float:
    """Add the correspondences to H and g of a frame, and return their cost.

    Parameters
    ----------
    chain : ChainArrays
        The body.
    capsules : Capsules
        Its surface.
    sums : ContourSums
        The sums of the correspondences.
    joints : float64 array (J, 3)
        The joints of the pose in metres.
    room : FrameRoom
        The arrays of a frame, with the nodes of the pose; its H is added to.
    gradient : float64 array (P,)
        The vector g of the P parameters of the pose, which is added to.

    Returns
    -------
    float
        The cost, as `sums_cost` returns it.
    """
    moves, vectors = joints - sums.joints, sums.vectors.copy()
    others = np.empty_like(room.columns)
    for n in range(len(capsules.radii)):
        start, end = capsules.starts[n], capsules.ends[n]
        if sums.mixed[n, 0, 0] + sums.mixed[n, 1, 1] + sums.mixed[n, 2, 2] <= 0.0:
            continue
        for i in range(3):
            for a in range(3):
                vectors[start, i] += sums.mixed[n, i, a] * moves[end, a]
                vectors[end, i] += sums.mixed[n, i, a] * moves[start, a]
        one = point_jacobian(chain, room.turned, room.centres, chain.joint_nodes[start], joints[start], room.columns)
        other = point_jacobian(chain, room.turned, room.centres, chain.joint_nodes[end], joints[end], others)
        _add_mixed(room.columns, one, others, other, sums.mixed[n], room.hessian)
    for j in range(len(joints)):
        if sums.matrices[j, 0, 0] + sums.matrices[j, 1, 1] + sums.matrices[j, 2, 2] <= 0.0:
            continue
        for i in range(3):
            for a in range(3):
                vectors[j, i] += sums.matrices[j, i, a] * moves[j, a]
        add_point(
            chain, room.turned, room.centres, chain.joint_nodes[j], joints[j], sums.matrices[j], vectors[j],
            room.columns, room.hessian, gradient,
        )  # fmt: skip
    return sums_cost(capsules, sums, joints)


@njit(cache=True, nogil=True)
def _add_mixed(columns: F64, one: int, others: F64, other: int, matrix: F64, hessian: F64) -> None:
    """Add JᵀAK + KᵀAJ of the derivatives of two points to the lower half of H."""
    for a in range(one):
        p, u, v, w = int(columns[a, 0]), columns[a, 1], columns[a, 2], columns[a, 3]
        x = matrix[0, 0] * u + matrix[0, 1] * v + matrix[0, 2] * w
        y = matrix[1, 0] * u + matrix[1, 1] * v + matrix[1, 2] * w
        z = matrix[2, 0] * u + matrix[2, 1] * v + matrix[2, 2] * w
        for b in range(other):
            q = int(others[b, 0])
            product = x * others[b, 1] + y * others[b, 2] + z * others[b, 3]
            hessian[max(p, q), min(p, q)] += 2.0 * product if p == q else product
