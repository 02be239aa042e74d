"""A standing figure among four cameras, and its masks."""

from __future__ import annotations

import numpy as np

from kinedex.catalog.kinematics import load_kinematic_chain, load_surface
from kinedex.ops.body.capsules import body_capsules
from kinedex.ops.body.pose_fit import measured_body
from kinedex.ops.tracking.views import View, camera_view
from tests.bodies import index, standing

CHAIN, SURFACE = load_kinematic_chain(), load_surface()
JOINTS = np.stack([standing(1)[index(joint)] for joint in CHAIN.joints])
"""The joints of the figure (J, 3, 1), in the order of the chain."""

BODY = measured_body(CHAIN, JOINTS)
CAPSULES = body_capsules(BODY, SURFACE)


def looking_at(centre: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation of a camera that looks from a centre at a target."""
    forward = (target - centre) / np.sqrt(((target - centre) ** 2).sum())
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.sqrt((right**2).sum())
    rotation = np.stack([right, np.cross(forward, right), forward])
    return rotation, -rotation @ centre


def cameras(
    count: int = 4, size: tuple[int, int] = (640, 480), share: int = 1, distortion: tuple[float, ...] = ()
) -> tuple[View, ...]:
    """Cameras around the origin, 4.5 m away and 2.2 m high."""
    found = []
    for angle in 0.4 + np.arange(count) * 2 * np.pi / count:
        centre = np.array([4.5 * np.cos(angle), 2.2, 4.5 * np.sin(angle)])
        rotation, translation = looking_at(centre, np.array([0.0, 1.0, 0.0]))
        matrix = [[size[0] / 1.28, 0, size[0] / 2], [0, size[0] / 1.28, size[1] / 2], [0, 0, 1]]
        mask_size = (size[0] // share, size[1] // share)
        found.append(camera_view(matrix, rotation, translation, distortion, size, mask_size))
    return tuple(found)
