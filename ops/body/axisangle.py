"""This module does forward kinematics for joint rotations that are given as rotation vectors (axis times angle)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.body import kinematics
from kinedex.ops.errors import ParameterError

_BLOCK_FRAMES = 4096  # frames at a time, so that the matrices take a few megabytes however long the take is


def matrices(vectors: F64) -> F64:
    """Return the rotation matrices (T, 3, 3) of rotation vectors (T, 3) in radians.

    Rodrigues' formula is R = I + (sin θ / θ) K + ((1 − cos θ) / θ²) K², where θ is the vector's length and K the matrix
    of the cross product with the vector.
    """
    angle = np.sqrt(np.einsum("ta,ta->t", vectors, vectors))
    # 1 − cos θ as 2 sin² (θ/2), which keeps its digits where θ is small; sinc is sin(πx)/(πx), and 1 at 0.
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    turned: F64 = np.eye(3) + first[:, None, None] * cross + second[:, None, None] * (cross @ cross)
    return turned


def vectors(turned: F64) -> F64:
    """Return the rotation vectors (T, 3) in radians, of length π at most, of rotation matrices (T, 3, 3)."""
    w, x, y, z = kinematics.quaternions(turned.reshape(-1, 9).T)
    axis = np.stack([x, y, z], axis=1) * np.where(w < 0, -1.0, 1.0)[:, None]
    sine = np.sqrt(np.einsum("ta,ta->t", axis, axis))
    # θ / sin(θ/2) is 2 where θ is 0
    ratio = np.where(sine > 1e-12, 2 * np.arctan2(sine, np.abs(w)) / np.maximum(sine, 1e-12), 2.0)
    return axis * ratio[:, None]


def forward(rest: F64, parents: Sequence[int], rotations: F64, places: F64) -> tuple[F64, F64]:
    """Compute the joint positions of a body from the rotation of each joint relative to its parent.

    This is the skeleton of SMPL (Loper et al. 2015, Eq. 4): the offset of a joint from its parent in the rest pose is
    rotated by the rotations of all the joint's ancestors.

    Parameters
    ----------
    rest : float64 array (J, 3)
        The joints in the rest pose.
    parents : sequence of int
        The index of each joint's parent, which must be smaller than the joint's index; −1 for the first joint, the
        root.
    rotations : float64 array (T, J, 3)
        Rotation vectors in radians.
    places : float64 array (T, 3)
        The displacement of the root from its rest position.

    Returns
    -------
    tuple[float64 array, float64 array]
        The positions, (J, 3, T), and the rotation matrices of the root row by row, (9, T).

    Raises
    ------
    ParameterError
        If the shapes do not agree, or a parent does not come before its child.
    """
    joints, frames = len(rest), len(rotations)
    if rest.shape != (joints, 3) or rotations.shape != (frames, joints, 3) or places.shape != (frames, 3):
        shapes = (rest.shape, rotations.shape, places.shape)
        raise ParameterError("rest, turns and places", "of shapes (J, 3), (T, J, 3) and (T, 3)", shapes)
    if len(parents) != joints or parents[0] != -1 or any(not 0 <= parents[j] < j for j in range(1, joints)):
        raise ParameterError("parents", "indices of earlier joints, and -1 for the first", list(parents))
    positions = np.empty((joints, 3, frames))
    root = np.empty((9, frames))
    for start in range(0, frames, _BLOCK_FRAMES):
        part = slice(start, start + _BLOCK_FRAMES)
        whole: list[F64] = []
        at: list[F64] = []
        for j, parent in enumerate(parents):
            turned = matrices(rotations[part, j])
            if parent < 0:
                whole.append(turned)
                at.append(rest[j] + places[part])
            else:
                whole.append(whole[parent] @ turned)
                at.append(at[parent] + whole[parent] @ (rest[j] - rest[parent]))
            positions[j, :, part] = at[j].T
        root[:, part] = whole[0].reshape(-1, 9).T
    return positions, root
