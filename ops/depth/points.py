"""This module converts a depth image to the points of the person (thesis, Section 8.3.1).

The axes of points are x right, y up and z backward, with the camera at the origin, after a rotation that makes +Y up.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kinedex.ops.arrays import F32, F64, I32
from kinedex.ops.cameras.projection import undistort
from kinedex.ops.depth.foreground import (
    ABOVE_FLOOR_M,
    FAR_M,
    NEAR_M,
    PointArrays,
    depth_limits,
    find_foreground,
    float32_below,
    remove_noise,
)
from kinedex.ops.depth.nearest_pixels import NearestBuffers, nearest_buffers
from kinedex.ops.errors import ParameterError

MAX_POINTS = 6000
"""Maximum of the median number of points per frame; the smallest stride that does not exceed it is used."""

STRIDE_FRAMES = 10
"""Number of first frames from which the stride is chosen."""


class FrameCloud(NamedTuple):
    """The points of a frame; its arrays are overwritten when the next frame is prepared.

    Attributes
    ----------
    points : float64 array (n, 3)
        Positions in metres, in row-major order of the image.
    pixels : int32 array (n, 2)
        Column and row of each point in the strided image.
    numbers : int32 array (h, w)
        The index of the point of each pixel; −1 for a pixel without a point.
    depth : float32 array (h, w)
        The cleaned depths in metres; 0 where there is no point.
    box : (int, int, int, int)
        The bounding box of all points: first column, first row, and the column and the row after the last; zeros if
        there are no points.
    foreground : int
        The number of foreground pixels before cleaning.
    buffers : NearestBuffers, optional
        Arrays for `nearest_pixels` to reuse; None allocates them.
    """

    points: F64
    pixels: I32
    numbers: I32
    depth: F32
    box: tuple[int, int, int, int]
    foreground: int
    buffers: NearestBuffers | None = None


def ray_table(matrix: npt.ArrayLike, distortion: npt.ArrayLike, size: tuple[int, int], stride: int = 1) -> F64:
    """Return the rays (a, b, 1) of the pixels of a strided image, corrected for distortion.

    Parameters
    ----------
    matrix : float64 array (3, 3)
        [[fx, skew, cx], [0, fy, cy], [0, 0, 1]], in pixels of the whole image.
    distortion : float64 array (0,), (4,), (5,) or (8,)
        k1 k2 p1 p2 k3 k4 k5 k6, or the first of them.
    size : (int, int)
        Width and height of the whole image.
    stride : int
        The step between the rows and columns that are used.

    Returns
    -------
    float64 array (h, w, 2)
        a and b of each pixel; NaN for pixels that no ray maps to.
    """
    (fx, skew, cx), (_, fy, cy) = np.asarray(matrix, np.float64)[:2]
    columns, rows = np.meshgrid(np.arange(0, size[0], stride), np.arange(0, size[1], stride))
    b = (rows - cy) / fy
    return undistort(distortion, np.stack([(columns - cx - skew * b) / fx, b], axis=-1))


class Preparation:
    """Prepares the frames of one recording, with preallocated arrays.

    Parameters
    ----------
    rays : float64 array (h, w, 2)
        a and b of the pixels of the strided image, see `ray_table`.
    background : float32 array (H, W), optional
        Depths of the empty scene in metres, or distances if the frames hold distances; 0 where nothing was measured.
    turn : float64 array (3, 3), optional
        The rotation from the camera's axes (x, −y, −z) to axes with +Y up; None for a level camera.
    floor_height : float, optional
        The Y coordinate of the floor after that rotation, in metres, which is minus the height of the camera; None if
        it is unknown.
    near, far : float
        The smallest and the largest depth of the foreground, in metres.
    stride : int
        The step between the rows and columns that are used.
    """

    def __init__(
        self,
        rays: F64,
        background: npt.ArrayLike | None = None,
        turn: npt.ArrayLike | None = None,
        floor_height: float | None = None,
        near: float = NEAR_M,
        far: float = FAR_M,
        *,
        stride: int = 1,
    ) -> None:
        if stride < 1:
            raise ParameterError("stride", "at least 1", stride)
        if floor_height is not None and not floor_height < -ABOVE_FLOOR_M:
            way = f"below −{ABOVE_FLOOR_M:g}, since the camera is at 0 and the floor below it"
            raise ParameterError("floor_height", way, floor_height)
        self.stride, self.shape = stride, rays.shape[:2]
        height, width = self.shape
        around = np.eye(3) if turn is None else np.asarray(turn, np.float64)
        a, b = rays[..., 0], rays[..., 1]
        directions = np.ascontiguousarray(np.stack([a, -b, -np.ones_like(a)], axis=-1) @ around.T)
        self._image = np.zeros(self.shape, np.float32)
        wall = None if background is None else self._strided("background", background).copy()
        self._limits = depth_limits(wall, directions[..., 1], floor_height, far)
        self._near = float32_below(near)
        self._foreground = np.zeros((height + 2, width + 2), np.float32)
        self._runs = np.zeros((height, 2), np.int64)
        self._rows = np.zeros((5, width + 2), np.float32)
        self._found = PointArrays(
            directions, np.zeros((height * width, 3)), np.zeros((height * width, 2), np.int32),
            np.full(self.shape, -1, np.int32), np.zeros(self.shape, np.float32), np.zeros(4, np.int64),
        )  # fmt: skip
        self._nearest = nearest_buffers(self.shape)

    def prepare(self, image: npt.ArrayLike) -> FrameCloud:
        """Return the person's points in a frame.

        Parameters
        ----------
        image : float32 array (H, W)
            Depths in metres; 0 where nothing was measured.

        Returns
        -------
        FrameCloud
            The points, in arrays that the next frame overwrites.

        Raises
        ------
        ParameterError
            The image has another size than the rays.
        """
        depths = self._strided("image", image)
        count = find_foreground(depths, self._limits, self._near, self._foreground, self._runs)
        found = self._found
        n = remove_noise(self._foreground, self._runs, self._rows, found)
        u0, v0, u1, v1 = found.box.tolist()
        return FrameCloud(
            found.points[:n], found.pixels[:n], found.numbers, found.depth, (u0, v0, u1, v1), count, self._nearest
        )

    def _strided(self, name: str, image: npt.ArrayLike) -> F32:
        """Return every k-th row and column of an image as depths z, in an array that the next image overwrites."""
        taken = np.asarray(image)[:: self.stride, :: self.stride]
        if taken.shape != self.shape:
            raise ParameterError(name, f"of shape {self.shape} at stride {self.stride}", taken.shape)
        if taken.dtype == np.float32 and taken.flags.c_contiguous:
            return taken
        np.copyto(self._image, taken, casting="same_kind")
        return self._image


def choose_stride(
    images: Sequence[npt.ArrayLike],
    matrix: npt.ArrayLike,
    distortion: npt.ArrayLike = (),
    background: npt.ArrayLike | None = None,
    turn: npt.ArrayLike | None = None,
    floor_height: float | None = None,
    *,
    most: int = MAX_POINTS,
) -> int:
    """Return the smallest stride at which the median of the first ten frames has at most `most` points.

    Parameters
    ----------
    images : sequence of float32 array (H, W)
        The first frames of a recording, in metres; frames after the tenth are ignored.
    matrix, distortion
        The camera, see `ray_table`.
    background, turn, floor_height
        See `Preparation`.
    most : int
        The maximum number of points.

    Returns
    -------
    int
        The stride; 1 without images.
    """
    first = [np.asarray(image) for image in images[:STRIDE_FRAMES]]
    if not first:
        return 1
    height, width = first[0].shape
    for stride in range(1, max(height, width) + 1):
        rays = ray_table(matrix, distortion, (width, height), stride)
        work = Preparation(rays, background, turn, floor_height, stride=stride)
        if np.median([len(work.prepare(image).points) for image in first]) <= most:
            return stride
    return max(height, width)
