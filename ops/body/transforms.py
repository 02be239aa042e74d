"""This module converts quaternions to rotations, and composes the transforms of a tree of nodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.errors import ParameterError


def rotations(quaternions: F64) -> F64:
    """Return the rotation matrices (..., 3, 3) of quaternions (..., 4) w x y z, which need not have length 1.

    A quaternion of length 0 gives the identity.
    """
    squared = np.einsum("...a,...a->...", quaternions, quaternions)
    scale = np.divide(2.0, squared, out=np.zeros_like(squared), where=squared > 0)
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    matrices = np.empty((*quaternions.shape[:-1], 3, 3))
    matrices[..., 0, 0] = 1 - scale * (y * y + z * z)
    matrices[..., 0, 1] = scale * (x * y - w * z)
    matrices[..., 0, 2] = scale * (x * z + w * y)
    matrices[..., 1, 0] = scale * (x * y + w * z)
    matrices[..., 1, 1] = 1 - scale * (x * x + z * z)
    matrices[..., 1, 2] = scale * (y * z - w * x)
    matrices[..., 2, 0] = scale * (x * z - w * y)
    matrices[..., 2, 1] = scale * (y * z + w * x)
    matrices[..., 2, 2] = 1 - scale * (x * x + y * y)
    return matrices


def slerp(first: F64, second: F64, share: F64) -> F64:
    """Interpolate between unit quaternions (T, 4) along the shorter arc, at constant speed.

    Parameters
    ----------
    first, second : float64 array (T, 4)
        Unit quaternions, in any order of components.
    share : float64 array (T,)
        Numbers from 0 (the first quaternion) to 1 (the second).
    """
    cosine = np.einsum("ta,ta->t", first, second)
    second = np.where(cosine[:, None] < 0, -second, second)
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    sine = np.sin(angle)
    near = sine < 1e-6  # the arc is so short that linear interpolation is as good
    divisor = np.where(near, 1.0, sine)
    before = np.where(near, 1.0 - share, np.sin((1.0 - share) * angle) / divisor)
    after = np.where(near, share, np.sin(share * angle) / divisor)
    mixed: F64 = before[:, None] * first + after[:, None] * second
    return mixed


def global_transforms(parents: Sequence[int], linear: F64, offsets: F64) -> tuple[F64, F64]:
    """Compute the transforms of nodes in the scene from transforms relative to the parents.

    Parameters
    ----------
    parents : sequence of int
        The index of each node's parent, which must be smaller than the node's index; −1 for a root.
    linear : float64 array (N, T, 3, 3)
        Rotation and scale of each node in its parent's axes; T may be 1 for all.
    offsets : float64 array (N, T, 3)
        Position of each node in its parent's axes.

    Returns
    -------
    tuple[float64 array, float64 array]
        Rotation and scale (N, T, 3, 3), and positions (N, T, 3), in the scene's axes.

    Raises
    ------
    ParameterError
        If shapes do not agree, or a parent does not come before its child.
    """
    nodes, frames = linear.shape[:2]
    if linear.shape != (nodes, frames, 3, 3) or offsets.shape != (nodes, frames, 3):
        raise ParameterError(
            "linear and offsets", "of shapes (N, T, 3, 3) and (N, T, 3)", (linear.shape, offsets.shape)
        )
    if len(parents) != nodes or any(not -1 <= parent < i for i, parent in enumerate(parents)):
        raise ParameterError("parents", "indices of earlier nodes, or -1", list(parents))
    whole, positions = np.empty_like(linear), np.empty_like(offsets)
    for i, parent in enumerate(parents):
        if parent < 0:
            whole[i], positions[i] = linear[i], offsets[i]
        else:
            whole[i] = whole[parent] @ linear[i]
            positions[i] = positions[parent] + np.einsum("tab,tb->ta", whole[parent], offsets[i])
    return whole, positions


def without_scale(linear: F64) -> F64:
    """Return the rotations (..., 3, 3) nearest to matrices with scale; the identity for singular or mirroring ones."""
    sound = np.all(np.isfinite(linear), axis=(-1, -2), keepdims=True)
    left, sizes, right = np.linalg.svd(np.where(sound, linear, np.eye(3)))
    turned = left @ right
    usable = sound[..., 0, 0] & (sizes[..., 2] > 1e-9 * sizes[..., 0]) & (np.linalg.det(turned) > 0)
    return np.where(usable[..., None, None], turned, np.eye(3))
