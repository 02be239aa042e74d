"""Naive twins of the orientations of limbs, one frame after the other."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]


def kabsch(shape: F64, positions: F64) -> F64:
    """Return the rotation that turns a shape (M, 3) best onto places (M, 3), by the eigenvector of Horn (1987)."""
    a, b = shape - shape.mean(axis=0), positions - positions.mean(axis=0)
    s = sum(np.outer(one, other) for one, other in zip(a, b, strict=True))
    n = np.empty((4, 4))
    n[0, 0] = np.trace(s)
    n[0, 1:] = n[1:, 0] = s[1, 2] - s[2, 1], s[2, 0] - s[0, 2], s[0, 1] - s[1, 0]
    n[1:, 1:] = s + s.T - np.trace(s) * np.eye(3)
    w, x, y, z = np.linalg.eigh(n)[1][:, -1]
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def hinge_normals(axes: F64, others: F64, beyond: bool, least_deg: float) -> F64:
    """Return the normals of a hinge's plane (T, 3), carried over frames in which it is nearly straight."""
    normals: list[F64 | None] = []
    for axis, other in zip(axes, others, strict=True):
        angle = np.degrees(np.arccos(np.clip(axis @ other, -1.0, 1.0)))
        normal = np.cross(axis, other) if beyond else np.cross(other, axis)
        normals.append(normal / np.linalg.norm(normal) if angle >= least_deg else None)
    first = next(t for t, normal in enumerate(normals) if normal is not None)
    for t in range(first + 1, len(axes)):
        if normals[t] is None:
            normals[t] = _turned(axes[t - 1], axes[t], normals[t - 1])
    for t in range(first - 1, -1, -1):
        normals[t] = _turned(axes[t + 1], axes[t], normals[t + 1])
    return np.array(normals)


def _turned(before: F64, after: F64, vector: F64 | None) -> F64:
    """Turn a vector by Rodrigues' formula with the shortest turn from one unit vector to another."""
    assert vector is not None
    cross = np.cross(before, after)
    sine = np.linalg.norm(cross)
    if sine < 1e-12:
        return vector
    angle, k = np.arctan2(sine, before @ after), cross / sine
    turned: F64 = (
        vector * np.cos(angle) + np.cross(k, vector) * np.sin(angle) + k * (k @ vector) * (1.0 - np.cos(angle))
    )
    return turned
