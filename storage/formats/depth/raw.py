"""Read depth images as raw 16-bit numbers, little-endian, row by row: all frames in a file, or a file for each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.depth_cameras import DepthCamera
from kinedex.ops.errors import SourceError

F32 = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class RawFrames:
    """The images of a raw file.

    Attributes
    ----------
    path : Path
        The file.
    camera : DepthCamera
        The camera.
    count : int
        How many images the file has.
    """

    path: Path
    camera: DepthCamera
    count: int

    @property
    def numbers(self) -> Sequence[int]:
        """The numbers of its images, from 0."""
        return range(self.count)

    def read(self, number: int) -> F32:
        """Return the depths (H, W) of an image in metres; a SourceError reports a damaged one."""
        width, height = self.camera.size
        size = 2 * width * height
        try:
            with self.path.open("rb") as file:
                file.seek(number * size)
                data = file.read(size)
        except OSError as fault:
            raise SourceError(self.path, f"cannot be read: {fault.strerror}") from fault
        if len(data) != size:
            raise SourceError(self.path, f"has {len(data):,} bytes of frame {number}, and an image {size:,}")
        return self.camera.depths(np.frombuffer(data, "<u2").reshape(height, width))


def open_raw(path: Path, camera: DepthCamera) -> RawFrames:
    """Return the images of a raw file.

    Raises
    ------
    SourceError
        The file cannot be read, or its size is not a multiple of this camera's image size.
    """
    try:
        size = path.stat().st_size
    except OSError as fault:
        raise SourceError(path, f"cannot be read: {fault.strerror}") from fault
    width, height = camera.size
    count, rest = divmod(size, 2 * width * height)
    if rest or not count:
        raise SourceError(
            path, f"has {size:,} bytes, which is no whole number of images of {width} × {height} pixels with 16 bits "
            f"({2 * width * height:,} bytes); are width and height those of this file?",
        )  # fmt: skip
    return RawFrames(path, camera, count)
