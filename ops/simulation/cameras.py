"""This module places cameras evenly around a scene, looking at its centre."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.errors import ParameterError


@dataclass(frozen=True)
class CameraRing:
    """A ring of identical cameras.

    Attributes
    ----------
    count : int
        Number of cameras, 1 or more.
    distance_m : float
        Distance of the ring from the outermost position of the root, in metres.
    height_m : float
        Height of the cameras above the floor, in metres.
    aim_m : float
        Height above the floor of the point that they look at, in metres.
    focal_px : float
        Focal length in pixels.
    size : tuple of (int, int)
        Width and height of the images in pixels.

    Raises
    ------
    ParameterError
        A value is out of range.
    """

    count: int = 4
    distance_m: float = 4.0
    height_m: float = 2.2
    aim_m: float = 1.0
    focal_px: float = 1000.0
    size: tuple[int, int] = (1280, 960)

    def __post_init__(self) -> None:
        if not 1 <= self.count <= 100:
            raise ParameterError("count", "from 1 to 100 cameras", self.count)
        for name in ("distance_m", "focal_px"):
            if not 0 < getattr(self, name) < np.inf:
                raise ParameterError(name, "above 0", getattr(self, name))
        if min(self.size) < 1:
            raise ParameterError("size", "a width and a height in pixels", self.size)

    @property
    def matrix(self) -> F64:
        """Return the camera matrix (3, 3), in pixels, that all cameras share."""
        width, height = self.size
        return np.array([[self.focal_px, 0.0, width / 2], [0.0, self.focal_px, height / 2], [0.0, 0.0, 1.0]])


def ring_of_cameras(ring: CameraRing, roots: F64, floor_m: float, generator: np.random.Generator) -> tuple[F64, F64]:
    """Place cameras evenly around the centre of a take, the first in a random direction.

    Parameters
    ----------
    ring : CameraRing
        The ring.
    roots : float64 array (T, 3)
        The body's root in metres, Y up.
    floor_m : float
        Height of the floor, in metres.
    generator : numpy.random.Generator
        Draws the direction of the first camera.

    Returns
    -------
    rotations : float64 array (V, 3, 3)
        From the world to the camera; rows point right, down and forward.
    translations : float64 array (V, 3)
        x_camera = R · X + t, in metres.
    """
    middle = roots.mean(axis=0)
    radius = ring.distance_m + np.abs(roots[:, [0, 2]] - middle[[0, 2]]).max()
    angles = generator.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi * np.arange(ring.count) / ring.count
    centres = np.stack(
        [
            middle[0] + radius * np.sin(angles),
            np.full(ring.count, floor_m + ring.height_m),
            middle[2] + radius * np.cos(angles),
        ],
        axis=1,
    )
    forward = np.array([middle[0], floor_m + ring.aim_m, middle[2]]) - centres
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    rotations = np.stack([right, np.cross(forward, right), forward], axis=1)
    return rotations, -np.einsum("vij,vj->vi", rotations, centres)
