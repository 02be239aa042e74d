"""The surface of a body, its samples and its pivots by their definitions, one number after the other."""

from __future__ import annotations

import numpy as np

from kinedex.ops.body.joint_tree import PARENTS
from kinedex.ops.depth.cones import ConeBody


def ends(body: ConeBody, pose: np.ndarray) -> np.ndarray:
    """The ends of the cones' axes: (C, 2, 3)."""
    return np.einsum("cem,cemi->cei", body.shares, pose[body.joints])


def distance(body: ConeBody, pose: np.ndarray, point: np.ndarray, height: float) -> tuple:
    """Signed distance of one point, its cone, the place on the axis, and the normal."""
    best = None
    for c, (a, b) in enumerate(ends(body, pose)):
        length = (b - a) @ (b - a)
        s = np.clip((point - a) @ (b - a) / length, 0, 1) if length > 0 else 0.0
        q = a + s * (b - a)
        one, other = body.radii[c] * height / body.height_m
        d = np.linalg.norm(point - q) - (one + s * (other - one))
        if best is None or d < best[0]:
            best = (d, c, s, (point - q) / np.linalg.norm(point - q))
    return best


def samples(body: ConeBody, pose: np.ndarray, height: float) -> np.ndarray:
    """The samples of the surface that face the camera: (S, 3)."""
    axes, found = ends(body, pose), []
    for c, s, angle in zip(body.sample_cones, body.sample_places, body.sample_angles, strict=True):
        a, b = axes[c]
        e = (b - a) / np.linalg.norm(b - a)
        q = a + s * (b - a)
        m = -q - (-q @ e) * e
        m /= np.linalg.norm(m)
        if s == 1 and angle == 0:
            m = (m + e) / np.linalg.norm(m + e)
        one, other = body.radii[c] * height / body.height_m
        radius = one + s * (other - one)
        found.append(q + radius * (np.cos(angle) * m + np.sin(angle) * np.cross(e, m)))
    return np.array(found)


def below(joint: int, other: int) -> bool:
    """Return True where a joint hangs below another one."""
    while PARENTS[joint] >= 0:
        joint = PARENTS[joint]
        if joint == other:
            return True
    return False


def rotation(vector: np.ndarray) -> np.ndarray:
    """The rotation matrix of a rotation vector."""
    angle = np.linalg.norm(vector)
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def turned(joints: np.ndarray, pose: np.ndarray, rotations: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """A pose with its pivots turned, the deepest first, and then moved."""
    pose = pose.copy()
    for k in reversed(range(len(joints))):
        matrix = rotation(rotations[k])
        for j in range(len(pose)):
            if below(j, joints[k]):
                pose[j] = pose[joints[k]] + matrix @ (pose[j] - pose[joints[k]])
    return pose + shift
