"""Bodies before a depth camera: a standing pose of the usual proportions, and bodies of one cone."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from kinedex.catalog.bodies import load_body
from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.joint_tree import JOINTS, PARENTS
from kinedex.ops.depth.cones import ConeBody, pivots_of, turn_pose
from tests.bodies import STANDING

BODY = load_body()
POSE = np.array([STANDING[joint] for joint in JOINTS]) + np.array([0.05, -1.0, -3.0])
"""A person who stands 3 m before the camera and faces it, in the axes of the kernels: y up, z towards the camera."""


def turned_pose(joints: I64, pose: F64, rotations: F64, shift: npt.ArrayLike = (0.0, 0.0, 0.0)) -> F64:
    """Return a pose after rotating every pivot, the deepest ones first, and then translating the whole body."""
    turned = np.array(pose, np.float64)
    turn_pose(pivots_of(joints), turned, np.ascontiguousarray(rotations, np.float64), np.asarray(shift, np.float64))
    return turned


def bone_lengths(pose: np.ndarray) -> np.ndarray:
    """The length of the bone that ends at each joint, 0 for the root."""
    lengths = np.linalg.norm(pose - pose[PARENTS], axis=1)
    lengths[0] = 0
    return lengths


HEIGHT = BODY.standing_height(bone_lengths(POSE))


def random_pose(seed: int, degrees: float) -> np.ndarray:
    """The standing pose with every pivot turned by an angle about a random axis."""
    axes = np.random.default_rng(seed).normal(size=(len(BODY.pivots), 3))
    return turned_pose(BODY.pivots, POSE, np.deg2rad(degrees) * axes / np.linalg.norm(axes, axis=1)[:, None])


def one_cone(radii: tuple[float, float]) -> ConeBody:
    """A body whose only cone lies between the root and the left hip."""
    joints = np.array([[[0], [1]]])
    bones, pivots = np.zeros(len(JOINTS)), BODY.pivots
    return ConeBody(
        "one", ("one",), joints, np.ones((1, 2, 1)), np.array([radii]), 1.7, bones, 1.7, np.array([0]), np.array([0.5]),
        np.array([0.0]), pivots, BODY.stiffness,
    )  # fmt: skip
