"""Simple motions of a standing body, by which recognition is tested."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.body.joint_tree import JOINTS
from tests.bodies import STANDING

RATE_HZ = 30.0
MIRROR = {"raise left": "raise right", "raise right": "raise left", "bow": "bow"}
ARM = ("elbow", "wrist", "fingers")
UPPER = tuple(joint for joint in JOINTS if joint not in {"root"} and joint[1:] not in {"hip", "knee", "ankle", "toes"})


def standing_body(frames: int, seed: int) -> F64:
    """Return a body (L, 24, 3) that stands in a posture of its own, and trembles a little."""
    pose = np.array([STANDING[joint] for joint in JOINTS], np.float64)
    generator = np.random.default_rng(seed)
    swaying = np.cumsum(generator.normal(0, 0.0005, (frames, 1, 3)), axis=0) * np.array([1.0, 0.0, 1.0])
    posture = generator.normal(0, 0.004, (24, 3))
    return pose + posture + swaying + generator.normal(0, 0.002, (frames, 24, 3))


def motion(name: str, frames: int, seed: int = 0) -> F64:
    """Return a body (L, 24, 3) that raises an arm and lowers it again, bows, or walks ahead."""
    body = standing_body(frames, seed)
    size = np.random.default_rng(seed + 1000).uniform(0.85, 1.15)
    rise = size * np.sin(np.pi * np.linspace(0, 1, frames)) ** 2
    if name.startswith("raise"):
        side = name[6]
        shoulder = body[:, JOINTS.index(f"{side}shoulder")]
        for part in ARM:
            arm = body[:, JOINTS.index(side + part)] - shoulder
            body[:, JOINTS.index(side + part)] = shoulder + _turned(arm, -2.4 * rise, 0)
    elif name == "bow":
        places = [JOINTS.index(joint) for joint in UPPER]
        hips = body[:, :1]
        body[:, places] = hips + _turned(body[:, places] - hips, np.repeat((1.1 * rise)[:, None], len(places), 1), 0)
    elif name == "walk":
        body[:, :, 2] += 1.2 * size * np.arange(frames)[:, None] / RATE_HZ
    return body


def in_a_row(names: Sequence[str], frames: Sequence[int], seed: int = 0) -> F64:
    """Return motions one after the other, (sum of frames, 24, 3)."""
    return np.concatenate(
        [motion(name, length, seed + k) for k, (name, length) in enumerate(zip(names, frames, strict=True))]
    )


def _turned(vectors: F64, angles: F64, axis: int) -> F64:
    """Return vectors (…, 3) turned about an axis by angles (…)."""
    first, second = [(1, 2), (2, 0), (0, 1)][axis]
    found = vectors.copy()
    cosine, sine = np.cos(angles), np.sin(angles)
    found[..., first] = cosine * vectors[..., first] - sine * vectors[..., second]
    found[..., second] = sine * vectors[..., first] + cosine * vectors[..., second]
    return found
