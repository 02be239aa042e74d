"""Define the camera model that is used for keypoints, silhouettes and depth images.

The conventions are those of OpenCV. In the camera, x points right, y down and z forward. A point X of the world has the
camera coordinates R · X + t. Pixel centres are whole numbers, the first (0, 0), and distortion coefficients are in the
order k1 k2 p1 p2 k3 k4 k5 k6. `ops.cameras.projection` has the formulas. Calibrations are converted on reading to a
world in metres with Y up, whose floor need not be at Y = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from kinedex.ops.arrays import F64, Bool
from kinedex.ops.cameras import projection
from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking.observations import Rays

_LARGEST_SIZE = 100_000
_LARGEST_VALUE = 1e9
_SHORTEST_FOCAL_PX = 1.0
_ORTHONORMAL = 1e-6


@dataclass(frozen=True, eq=False)
class Camera:
    """A calibrated camera.

    Attributes
    ----------
    name : str
        The name of the camera in the calibration.
    matrix : float64 array (3, 3)
        [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], in pixels.
    distortion : float64 array (0,), (4,), (5,) or (8,)
        k1 k2 p1 p2 k3 k4 k5 k6, or the first of them.
    rotation : float64 array (3, 3)
        The rotation R from the world to the camera.
    translation : float64 array (3,)
        The translation t in metres.
    size : tuple of (int, int)
        Width and height of its images in pixels.

    Raises
    ------
    ParameterError
        A value is out of its domain; the message names the attribute.
    """

    name: str
    matrix: F64
    distortion: F64
    rotation: F64
    translation: F64
    size: tuple[int, int]

    def __post_init__(self) -> None:
        for key, shape in (("matrix", (3, 3)), ("rotation", (3, 3)), ("translation", (3,)), ("distortion", None)):
            values = np.ascontiguousarray(getattr(self, key), np.float64)
            if shape is not None and values.shape != shape:
                raise ParameterError(key, f"of shape {shape}", values.shape)
            if not (np.abs(values) <= _LARGEST_VALUE).all():
                raise ParameterError(key, f"finite, within {_LARGEST_VALUE:g}", values.tolist())
            object.__setattr__(self, key, values)
        (fx, _, _), (zero, fy, _), last = self.matrix
        if min(fx, fy) < _SHORTEST_FOCAL_PX:
            must_be = f"one with focal lengths of at least {_SHORTEST_FOCAL_PX:g} pixel on its diagonal"
            raise ParameterError("matrix", must_be, [float(fx), float(fy)])
        if zero != 0 or last.tolist() != [0, 0, 1]:
            raise ParameterError("matrix", "[[fx, skew, cx], [0, fy, cy], [0, 0, 1]]", self.matrix.tolist())
        if self.distortion.ndim != 1 or len(self.distortion) not in projection.DISTORTION_COUNTS:
            counts = "of 0, 4, 5 or 8 numbers (k1 k2 p1 p2 k3 k4 k5 k6)"
            raise ParameterError("distortion", counts, self.distortion.shape)
        error = np.abs(self.rotation @ self.rotation.T - np.eye(3)).max()
        if error > _ORTHONORMAL or np.linalg.det(self.rotation) < 0:
            raise ParameterError("rotation", "a rotation, without mirroring or scaling", self.rotation.tolist())
        if not all(0 < side <= _LARGEST_SIZE for side in self.size):
            raise ParameterError("size", f"width and height of 1 to {_LARGEST_SIZE} pixels", self.size)

    @cached_property
    def centre(self) -> F64:
        """The centre C = −Rᵀ t of the camera in the world, in metres."""
        return projection.camera_centre(self.rotation, self.translation)

    @property
    def focal_px(self) -> float:
        """The focal length in pixels, the mean of both axes."""
        return float(self.matrix[0, 0] + self.matrix[1, 1]) / 2

    def project(self, points: npt.ArrayLike) -> tuple[F64, F64]:
        """Return pixels (…, 2) and depths (…,) in metres of points (…, 3); points behind the camera give NaN pixels."""
        return projection.project(self.matrix, self.rotation, self.translation, self.distortion, points)

    def directions(self, pixels: npt.ArrayLike) -> F64:
        """Return unit vectors (…, 3) in the world along the rays of pixels (…, 2)."""
        return projection.pixel_directions(self.matrix, self.rotation, self.distortion, pixels)

    def contains(self, pixels: npt.ArrayLike) -> Bool:
        """Return which of the pixels (…, 2) lie inside the image, which extends from −0.5 to size − 0.5."""
        positions = np.asarray(pixels, np.float64)
        return np.asarray(((positions >= -0.5) & (positions <= np.array(self.size) - 0.5)).all(axis=-1))

    def in_world(self, turn: npt.ArrayLike, scale: float = 1.0) -> Camera:
        """Return the same camera in a world whose points are X' = scale · turn · X.

        Parameters
        ----------
        turn : float64 array (3, 3)
            A rotation of the world.
        scale : float, optional
            Metres in one length unit of the present world.
        """
        rotation = self.rotation @ np.asarray(turn, np.float64).T
        return replace(self, rotation=rotation, translation=scale * self.translation)


def observed_rays(cameras: Sequence[Camera], pixels: F64, confidence: F64) -> Rays:
    """Convert keypoints in the images of cameras to rays in the world.

    Parameters
    ----------
    cameras : sequence of Camera
        V cameras.
    pixels : float64 array (T, V, P, 2)
        Keypoints in their images; NaN where a keypoint is missing.
    confidence : float64 array (T, V, P)
        Confidence in [0, 1].

    Returns
    -------
    Rays
        The rays. A missing keypoint, or a pixel that the lens model assigns no ray, has confidence 0 and the camera's
        axis as its direction.

    Raises
    ------
    ParameterError
        The shapes of the arguments do not agree.
    """
    if pixels.ndim != 4 or pixels.shape[1] != len(cameras) or pixels.shape[3] != 2:
        raise ParameterError("pixels", f"of shape (T, {len(cameras)}, P, 2)", pixels.shape)
    if confidence.shape != pixels.shape[:3]:
        raise ParameterError("confidence", f"of shape {pixels.shape[:3]}", confidence.shape)
    directions = np.stack([camera.directions(pixels[:, v]) for v, camera in enumerate(cameras)], axis=1)
    missing = np.isnan(directions[..., 0])
    axes = np.stack([camera.rotation[2] for camera in cameras])[None, :, None]
    directions = np.where(missing[..., None], axes, directions)
    focal = np.array([camera.focal_px for camera in cameras])
    centres = np.stack([camera.centre for camera in cameras])
    return Rays(centres, focal, directions, np.where(missing, 0.0, confidence))
