"""Naive twin of BVH kinematics: joint by joint and frame by frame, as the format's description states them."""

from __future__ import annotations

import numpy as np

from tests.bvh_files import Joint
from tests.oracles.kinematics import turn


def pose(root: Joint, frame: dict[str, list[float]]) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Positions and orientations of all joints and End Sites of one frame.

    The channels of a joint are turns multiplied left to right; a position channel replaces its axis of the OFFSET.
    """
    positions: dict[str, np.ndarray] = {}
    orientations: dict[str, np.ndarray] = {}

    def place(joint: Joint, start: np.ndarray, axes: np.ndarray) -> None:
        offset = list(joint.offset)
        rotation = np.eye(3)
        for channel, value in zip(joint.channels, frame.get(joint.name, []), strict=True):
            if channel.endswith("position"):
                offset["XYZ".index(channel[0])] = value
            else:
                rotation = rotation @ turn(channel[0], value)
        here = start + axes @ np.array(offset)
        positions[joint.name], orientations[joint.name] = here, axes @ rotation
        for child in joint.children:
            place(child, here, orientations[joint.name])
        for number, end in enumerate(joint.ends, 1):
            name = f"{joint.name}_end" + (str(number) if number > 1 else "")
            positions[name] = here + orientations[joint.name] @ np.array(end)

    place(root, np.zeros(3), np.eye(3))
    return positions, orientations
