"""Naive twin of the rotation vectors and the joints they move: quaternions, one joint of one frame at a time."""

from __future__ import annotations

import math

import numpy as np


def rotate(vector: np.ndarray, point: np.ndarray) -> np.ndarray:
    """A point turned by a rotation vector, by way of q p q⁻¹ with quaternions."""
    angle = math.sqrt(sum(x * x for x in vector))
    if angle == 0.0:
        return np.array(point, float)
    s = math.sin(angle / 2) / angle
    w, (x, y, z) = math.cos(angle / 2), (float(v) * s for v in vector)
    return _product(_product((w, x, y, z), (0.0, *map(float, point))), (w, -x, -y, -z))[1:]


def _product(a: tuple[float, ...], b: tuple[float, ...]) -> np.ndarray:
    w, x, y, z = a
    p, q, r, s = b
    return np.array([
        w * p - x * q - y * r - z * s,
        w * q + x * p + y * s - z * r,
        w * r - x * s + y * p + z * q,
        w * s + x * r - y * q + z * p,
    ])  # fmt: skip


def pose(rest: np.ndarray, parents: list[int], rotations: np.ndarray, place: np.ndarray) -> np.ndarray:
    """The joints (J, 3) of one frame: each one's offset is turned by its parent, that one's parent, and so on."""
    found = []
    for j, parent in enumerate(parents):
        if parent < 0:
            found.append(rest[j] + place)
            continue
        offset = rest[j] - rest[parent]
        above = parent
        while above >= 0:
            offset = rotate(rotations[above], offset)
            above = parents[above]
        found.append(found[parent] + offset)
    return np.array(found)
