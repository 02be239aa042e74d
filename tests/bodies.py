"""A body built by hand: a standing figure whose joints the tests move about."""

from __future__ import annotations

import numpy as np

from tests.oracles.features import JOINTS

STANDING = {
    "root": (0, 1.0, 0), "lhip": (0.1, 0.95, 0), "lknee": (0.1, 0.5, 0.02), "lankle": (0.1, 0.1, 0),
    "ltoes": (0.1, 0.0, 0.15), "rhip": (-0.1, 0.95, 0), "rknee": (-0.1, 0.5, 0.02), "rankle": (-0.1, 0.1, 0),
    "rtoes": (-0.1, 0.0, 0.15), "belly": (0, 1.1, 0), "chest": (0, 1.25, 0), "neck": (0, 1.45, 0),
    "head": (0, 1.55, 0), "headtop": (0, 1.75, 0), "lclavicle": (0, 1.45, 0), "lshoulder": (0.2, 1.4, 0),
    "lelbow": (0.25, 1.1, 0), "lwrist": (0.27, 0.85, 0.02), "lfingers": (0.27, 0.7, 0.03),
    "rclavicle": (0, 1.45, 0), "rshoulder": (-0.2, 1.4, 0), "relbow": (-0.25, 1.1, 0),
    "rwrist": (-0.27, 0.85, 0.02), "rfingers": (-0.27, 0.7, 0.03),
}  # fmt: skip
"""Joint → (x, y, z) in metres: Y up, facing +Z, the left side at +X."""


def standing(frames: int) -> np.ndarray:
    """The figure standing still: float64 (24, 3, frames)."""
    pose = np.array([STANDING[joint] for joint in JOINTS], dtype=float)
    return np.repeat(pose[:, :, None], frames, axis=2)


def index(joint: str) -> int:
    """The joint's place in the arrays."""
    return JOINTS.index(joint)


def upright(frames: int) -> np.ndarray:
    """The root's orientation in every frame, unturned: (4, frames)."""
    quaternion = np.zeros((4, frames))
    quaternion[0] = 1.0
    return quaternion


def turned(degrees: np.ndarray) -> np.ndarray:
    """The root turned about Y by these angles: (4, T)."""
    half = np.deg2rad(degrees) / 2
    return np.stack([np.cos(half), np.zeros_like(half), np.sin(half), np.zeros_like(half)])


def x_axes(orientation: np.ndarray) -> np.ndarray:
    """The root's X axis in every frame, (T, 3)."""
    w, x, y, z = orientation
    return np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1)
