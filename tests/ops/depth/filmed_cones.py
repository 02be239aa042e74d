"""Depth images of bodies of cones without noise, floor or background, by marching along rays."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from kinedex.ops.depth.cones import body_distance
from kinedex.ops.depth.image_search import DepthView, depth_view
from kinedex.ops.depth.points import FrameCloud, Preparation, ray_table
from tests.ops.depth.cone_bodies import BODY, HEIGHT, POSE

MATRIX = np.array([[126.0, 0, 79.5], [0, 126.0, 71.5], [0, 0, 1]])
SIZE = (160, 144)
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
    z = np.full(lengths.shape, 1.5)
    for _ in range(60):
        d = body_distance(BODY, pose, (directions * z[..., None]).reshape(-1, 3), HEIGHT).d.reshape(z.shape)
        z = np.where((d > 1e-4) & (z < 6), z + d / lengths, z)
    image = np.where(d < 1e-3, z, 0).astype(np.float32)
    return Preparation(rays, turn=turn).prepare(image)


@lru_cache(maxsize=1)
def standing() -> FrameCloud:
    """The points of the standing pose before a level camera."""
    return film(POSE)
