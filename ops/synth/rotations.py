"""This module converts between stacks of rotation matrices and Acclaim angles."""

from __future__ import annotations

import numpy as np

from kinedex.ops.arrays import F64


def about(axis: str, radians: F64 | float) -> F64:
    """Return the rotations (…, 3, 3) about x, y or z by angles in radians."""
    angle = np.asarray(radians, dtype=np.float64)
    i, j, k = {"x": (0, 1, 2), "y": (1, 2, 0), "z": (2, 0, 1)}[axis]
    result = np.zeros((*angle.shape, 3, 3))
    result[..., i, i] = 1.0
    result[..., j, j] = result[..., k, k] = np.cos(angle)
    result[..., k, j] = np.sin(angle)
    result[..., j, k] = -result[..., k, j]
    return result


def xyz_angles(rotations: F64) -> F64:
    """Return the angles (rx, ry, rz) in radians of rotations Rz·Ry·Rx, (T, 3), without jumps between frames."""
    y = np.arcsin(np.clip(-rotations[:, 2, 0], -1.0, 1.0))
    x = np.arctan2(rotations[:, 2, 1], rotations[:, 2, 2])
    z = np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0])
    return np.unwrap(np.stack([x, y, z], axis=1), axis=0)


def apply(rotations: F64, vectors: F64) -> F64:
    """Rotate vectors (3,) or (T, 3) by rotations (T, 3, 3) to vectors (T, 3)."""
    return (rotations * vectors[..., None, :]).sum(axis=-1)


def apply_inverse(rotations: F64, vectors: F64) -> F64:
    """Rotate vectors by the inverse rotations, (T, 3)."""
    return (rotations * vectors[..., :, None]).sum(axis=-2)


def unit(vectors: F64) -> F64:
    """Return vectors (T, 3) normalised to length 1; a zero vector stays zero."""
    length = np.sqrt((vectors * vectors).sum(axis=-1, keepdims=True))
    return vectors / np.maximum(length, 1e-12)
