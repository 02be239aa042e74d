"""The contour and the mask of capsules by their definition: samples of the surface, and distances of rays."""

from __future__ import annotations

import numpy as np


def surface(
    one: np.ndarray, other: np.ndarray, radius: float, positions: int, rotations: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return points (places, turns, 3) of the mantle of a capsule, and their unit normals."""
    axis = (other - one) / np.sqrt(((other - one) ** 2).sum())
    beside = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    beside /= np.sqrt((beside**2).sum())
    angles = np.arange(rotations) * 2 * np.pi / rotations
    normals = np.cos(angles)[:, None] * beside + np.sin(angles)[:, None] * np.cross(axis, beside)
    centres = one + np.linspace(0, 1, positions)[:, None] * (other - one)
    return centres[:, None] + radius * normals, np.broadcast_to(normals, (positions, rotations, 3))


def contour(one: np.ndarray, other: np.ndarray, radius: float, centre: np.ndarray, positions: int) -> list[np.ndarray]:
    """Return, for each place of the axis, the points of the surface where the normal turns from the camera."""
    points, normals = surface(one, other, radius, positions, 20_000)
    facing = np.einsum("pti,pti->pt", normals, points - centre)
    return [row[np.flatnonzero(np.sign(f) != np.sign(np.roll(f, -1)))] for row, f in zip(points, facing, strict=True)]


def hits(one: np.ndarray, other: np.ndarray, radius: float, ray: np.ndarray) -> bool:
    """Return True where a ray from the origin meets a capsule: by 2,000 balls along its axis."""
    centres = one + np.linspace(0, 1, 2000)[:, None] * (other - one)
    unit = ray / np.sqrt((ray**2).sum())
    along = centres @ unit
    apart = centres - along[:, None] * unit
    return bool((((apart**2).sum(axis=1) <= radius**2) & (along > 0)).any())
