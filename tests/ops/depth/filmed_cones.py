"""Depth images of bodies of cones without noise, floor or background, by marching along rays."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from kinedex.ops.depth.cones import body_distance
from kinedex.ops.depth.image_search import DepthView, depth_view
from kinedex.ops.depth.points import FrameCloud, Preparation, ray_table
from tests.ops.depth.cone_bodies import BODY, HEIGHT, POSE
from tests.plain_python import PLAIN

SCALE = 4 if PLAIN else 1
"""Images are smaller by this factor where kernels run as plain Python."""

MATRIX = np.array([[126.0 / SCALE, 0, 79.5 / SCALE], [0, 126.0 / SCALE, 71.5 / SCALE], [0, 0, 1]])
SIZE = (160 // SCALE, 144 // SCALE)
LEVEL = np.eye(3)


def tilted(degrees: float) -> np.ndarray:
    """The turn to level axes of a camera that looks down by an angle."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[1, 0, 0], [0, c, s], [0, -s, c]])


def view(turn: np.ndarray = LEVEL) -> DepthView:
    """The camera."""
    return depth_view(MATRIX, (), turn)


def film(pose: np.ndarray, turn: np.ndarray = LEVEL) -> FrameCloud:
    """The points of a pose, which is given in level axes."""
    rays = ray_table(MATRIX, (), SIZE)
    directions = np.stack([rays[..., 0], -rays[..., 1], -np.ones(rays.shape[:2])], axis=-1) @ turn.T
    lengths = np.linalg.norm(directions, axis=-1)
    z, d = np.full(lengths.shape, 1.5), np.full(lengths.shape, np.inf)
    for _ in range(60):
        going = (d > 1e-4) & (z < 6)
        d[going] = body_distance(BODY, pose, directions[going] * z[going, None], HEIGHT).d
        z[going] += np.where(d > 1e-4, d / lengths, 0)[going]
    image = np.where(d < 1e-3, z, 0).astype(np.float32)
    return Preparation(rays, turn=turn).prepare(image)


@lru_cache(maxsize=1)
def standing() -> FrameCloud:
    """The points of the standing pose before a level camera."""
    return film(POSE)
