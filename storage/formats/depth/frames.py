"""Read the frames of a depth recording one at a time, from images or clouds, NPZ, or raw 16-bit numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from kinedex.catalog.depth_cameras import DepthCamera
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.depth.clouds import Cloud, cloud_depths
from kinedex.storage.formats.depth.frame_files import RAW
from kinedex.storage.formats.depth.pcd import read_pcd, read_ply
from kinedex.storage.formats.depth.png import read_depth_png
from kinedex.storage.formats.source_files import file_size, part_of

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
        The number of images in the file.
    """

    path: Path
    camera: DepthCamera
    count: int

    @property
    def numbers(self) -> Sequence[int]:
        """The numbers of its images, from 0."""
        return range(self.count)

    def read(self, number: int) -> F32:
        """Return the depths (H, W) of an image in metres; raise SourceError if the image is damaged."""
        width, height = self.camera.size
        size = 2 * width * height
        data = part_of(self.path, size, number * size)
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
    size = file_size(path)
    width, height = camera.size
    count, rest = divmod(size, 2 * width * height)
    if rest or not count:
        raise SourceError(
            path, f"has {size:,} bytes, which is no whole number of images of {width} × {height} pixels with 16 bits "
            f"({2 * width * height:,} bytes); are width and height those of this file?",
        )  # fmt: skip
    return RawFrames(path, camera, count)


_CLOUDS: dict[str, Callable[[Path], Cloud]] = {".pcd": read_pcd, ".ply": read_ply}


class DepthSource(Protocol):
    """A source of numbered depth images."""

    @property
    def numbers(self) -> Sequence[int]:
        """The numbers of its images, ascending."""

    def read(self, number: int) -> F32:
        """Return the depths (H, W) of an image in metres; raise SourceError if the image is damaged."""


@dataclass(frozen=True, eq=False)
class ImageFiles:
    """Depth frames that are in separate files.

    Attributes
    ----------
    files : mapping of int to Path
        Number of a frame → the file that holds it.
    camera : DepthCamera
        The camera.
    unit_m : float
        Metres per unit of clouds.
    """

    files: Mapping[int, Path]
    camera: DepthCamera
    unit_m: float = 1.0

    @property
    def numbers(self) -> Sequence[int]:
        """The numbers of its images, ascending."""
        return sorted(self.files)

    def read(self, number: int) -> F32:
        """Return the depths (H, W) of an image in metres; raise SourceError if the image is damaged."""
        return read_frame(self.files[number], self.camera, self.unit_m)


def read_frame(path: str | Path, camera: DepthCamera, unit_m: float = 1.0) -> F32:
    """Read the depths of a file that holds one frame.

    Parameters
    ----------
    path : str or Path
        The file.
    camera : DepthCamera
        The camera of the frame; a cloud that is not organised is projected into the image of this camera.
    unit_m : float, optional
        Metres per unit of clouds; images use the camera's unit.

    Returns
    -------
    float32 array (H, W)
        Depths z in metres; 0 where nothing was measured.

    Raises
    ------
    SourceError
        The file is damaged, or is not a frame of this camera.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending in _CLOUDS:
        return cloud_depths(_CLOUDS[ending](path), camera, unit_m)
    if ending in RAW:
        frames = open_raw(path, camera)
        if frames.count != 1:
            raise SourceError(path, f"has {frames.count} images, but must have one")
        return frames.read(0)
    return read_depth_png(path, camera)


def read_cloud(path: Path) -> Cloud | None:
    """Return the points of a point cloud file; None for any other file."""
    read = _CLOUDS.get(path.suffix.lower())
    return None if read is None else read(path)


@dataclass(eq=False)
class DepthFrames:
    """The frames of a recording; `frames[t]` is an image (H, W) in metres, or None if it is missing or damaged.

    Attributes
    ----------
    source : DepthSource
        The images.
    damaged : dict of int to str
        Frame, counted from 0 → the fault of its image, for damaged frames that were read.
    """

    source: DepthSource
    damaged: dict[int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._numbers = frozenset(self.source.numbers)
        self.first = min(self._numbers)
        self._length = max(self._numbers) - self.first + 1

    @property
    def numbers(self) -> range:
        """The numbers of all frames in the files, including missing frames."""
        return range(self.first, self.first + self._length)

    @property
    def missing(self) -> tuple[int, ...]:
        """The frames, counted from 0, that are missing in the files."""
        return tuple(t for t in range(self._length) if self.first + t not in self._numbers)

    def notes(self) -> list[str]:
        """Return notes on missing frames, and on the damaged frames that were read."""
        found = []
        if missing := self._length - len(self._numbers):
            found.append(f"{missing} of {self._length} frames are missing in the numbering of the files")
        if self.damaged:
            first = min(self.damaged)
            more = f", and {len(self.damaged) - 1} more" if len(self.damaged) > 1 else ""
            found.append(f"frame {first} is damaged and counts as missing{more}: {self.damaged[first]}")
        return found

    def __len__(self) -> int:
        return self._length

    def __getitem__(self, frame: int) -> F32 | None:
        if not 0 <= frame < self._length:
            raise IndexError(frame)
        if self.first + frame not in self._numbers or frame in self.damaged:
            return None
        try:
            return self.source.read(self.first + frame)
        except SourceError as fault:
            self.damaged[frame] = str(fault)
            return None
