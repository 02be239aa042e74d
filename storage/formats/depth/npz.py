"""Read depth images from an NPZ file that has one array for all frames; only a few are unpacked at a time."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.catalog.depth_cameras import FASTEST_HZ, MAX_PIXELS, DepthCamera
from kinedex.ops.errors import ParameterError, SourceError
from kinedex.storage.formats.depth.png import size_fault
from kinedex.storage.formats.motion.numpy_arrays import load_arrays, npy_header

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]

MAX_FRAMES = 2_000_000
"""The largest number of images in an array."""

_ARRAY = "depth"
_INTRINSICS = ("fx", "fy", "cx", "cy")
_NUMBERS = ("intrinsics", *_INTRINSICS, "rate_hz", "depth_unit_m")
_BLOCK_BYTES = 1 << 24


@dataclass(eq=False)
class NpzFrames:
    """The images of an NPZ file.

    Attributes
    ----------
    path : Path
        The file.
    camera : DepthCamera
        The camera.
    shape : tuple of (int, int, int)
        Number of frames, height and width.
    kind : str
        The NumPy type of the values.
    start : int
        The byte offset of the first image in the array's entry.
    unit_m : float
        Metres per unit of floating-point values.
    """

    path: Path
    camera: DepthCamera
    shape: tuple[int, int, int]
    kind: str
    start: int
    unit_m: float = 1.0
    _block: tuple[int, bytes] = field(default=(-1, b""), repr=False)

    @property
    def numbers(self) -> Sequence[int]:
        """The numbers of its images, from 0."""
        return range(self.shape[0])

    def read(self, number: int) -> F32:
        """Return the depths (H, W) of an image in metres; raise SourceError if the image is damaged."""
        _, height, width = self.shape
        size = height * width * np.dtype(self.kind).itemsize
        each = max(1, _BLOCK_BYTES // size)
        if self._block[0] != number // each:
            self._block = (number // each, self._unpack(number // each * each * size, each * size))
        data = self._block[1][number % each * size : (number % each + 1) * size]
        if len(data) < size:
            raise SourceError(self.path, f"'{_ARRAY}' is cut off or damaged at frame {number}; copy the file again")
        image = np.frombuffer(data, self.kind).reshape(height, width)
        if image.dtype.kind == "f":
            image = image * self.unit_m
        return self.camera.depths(image)

    def _unpack(self, start: int, size: int) -> bytes:
        """Return `size` bytes of the array from offset `start` on; fewer if the file is damaged."""
        data = b""
        try:
            with zipfile.ZipFile(self.path) as packed, packed.open(f"{_ARRAY}.npy") as entry:
                entry.seek(self.start + start)
                while len(data) < size and (more := entry.read(size - len(data))):
                    data += more
        except Exception:  # zipfile and zlib raise many classes of errors for damaged data
            return data
        return data


@dataclass(frozen=True)
class NpzValues:
    """Values that an NPZ file may state besides its images; values that it does not state are None.

    Attributes
    ----------
    matrix : float64 array (3, 3) or None
        The camera matrix.
    rate_hz : float or None
        Frames per second.
    depth_unit_m : float or None
        Metres per unit.
    size : tuple of (int, int)
        Width and height of the images.
    """

    matrix: F64 | None
    rate_hz: float | None
    depth_unit_m: float | None
    size: tuple[int, int]


def npz_values(path: Path) -> NpzValues:
    """Return the values that an NPZ file of depth images states besides the images.

    Raises
    ------
    SourceError
        The file cannot be read, or a value is not valid.
    """
    shape, _, _ = _layout(path)
    arrays, _ = load_arrays(path, _NUMBERS)
    numbers = {name: _finite(path, name, values) for name, values in arrays.items()}
    matrix: F64 | None = None
    if "intrinsics" in numbers:
        if numbers["intrinsics"].size != 9:
            raise SourceError(path, f"'intrinsics' must be of shape (3, 3), got {numbers['intrinsics'].shape}")
        matrix = numbers["intrinsics"].reshape(3, 3)
    elif all(name in numbers for name in _INTRINSICS):
        fx, fy, cx, cy = (_scalar(path, name, numbers) or 0.0 for name in _INTRINSICS)
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    rate_hz = _scalar(path, "rate_hz", numbers)
    if rate_hz is not None and not 0 < rate_hz <= FASTEST_HZ:
        raise SourceError(path, f"'rate_hz' must be above 0 and at most {FASTEST_HZ:g}, got {rate_hz:g}")
    return NpzValues(matrix, rate_hz, _scalar(path, "depth_unit_m", numbers), (shape[2], shape[1]))


def open_npz(path: Path, camera: DepthCamera, unit_m: float = 1.0) -> NpzFrames:
    """Return the images of an NPZ file.

    Parameters
    ----------
    path : Path
        The file, with an array `depth` (T, H, W): integers in units of the camera, or floats in metres.
    camera : DepthCamera
        The camera.
    unit_m : float, optional
        Metres per unit of floating-point values.

    Raises
    ------
    SourceError
        There is no such array, or its size is not that of the camera.
    """
    shape, kind, start = _layout(path)
    if (shape[2], shape[1]) != camera.size:
        raise SourceError(path, f"'{_ARRAY}' {size_fault((shape[2], shape[1]), camera.size)}")
    return NpzFrames(path, camera, shape, kind, start, unit_m)


def _layout(path: Path) -> tuple[tuple[int, int, int], str, int]:
    """Return shape and type of the images, and their byte offset in the entry, from the array's header."""
    try:
        with zipfile.ZipFile(path) as packed:
            names = {entry.filename: entry for entry in packed.infolist()}
            if f"{_ARRAY}.npy" not in names:
                listed = ", ".join(name.removesuffix(".npy") for name in list(names)[:12]) or "none"
                raise SourceError(path, f"has no array '{_ARRAY}' of shape (frames, height, width); it has {listed}")
            with packed.open(names[f"{_ARRAY}.npy"]) as entry:
                shape, fortran, dtype = npy_header(entry)
                start, size = entry.tell(), names[f"{_ARRAY}.npy"].file_size
    except SourceError:
        raise
    except Exception as fault:  # NumPy, zipfile and zlib raise many classes of errors for damaged data
        raise SourceError(path, f"cannot be read as NumPy arrays: {str(fault)[:200]}; is the file cut off?") from None
    if dtype.kind not in "iuf" or len(shape) != 3 or min(shape) < 1:
        raise SourceError(
            path, f"'{_ARRAY}' must be integers in units or floats in metres of shape (frames, height, width), got "
            f"{dtype} of shape {shape}",
        )  # fmt: skip
    if fortran:
        raise SourceError(path, f"'{_ARRAY}' is stored by columns; write numpy.ascontiguousarray({_ARRAY})")
    if shape[1] * shape[2] > MAX_PIXELS or shape[0] > MAX_FRAMES:
        raise SourceError(path, f"'{_ARRAY}' claims {shape[0]:,} images of {shape[2]:,} × {shape[1]:,} pixels")
    if math.prod(shape) * dtype.itemsize != size - start:
        raise SourceError(
            path, f"'{_ARRAY}' claims {shape[0]:,} images of {shape[2]} × {shape[1]} {dtype}, and has "
            f"{size - start:,} bytes; is it cut off?",
        )  # fmt: skip
    return (shape[0], shape[1], shape[2]), dtype.str, start


def _finite(path: Path, name: str, values: npt.NDArray[Any]) -> F64:
    if values.dtype.kind not in "iuf" or values.size > 9 or not (np.abs(values.astype(np.float64)) <= 1e9).all():
        raise SourceError(path, f"'{name}' must be finite numbers, got {values.dtype} of shape {values.shape}")
    return values.astype(np.float64)


def _scalar(path: Path, name: str, numbers: dict[str, F64]) -> float | None:
    if name not in numbers:
        return None
    if numbers[name].size != 1:
        raise SourceError(path, f"'{name}' must be one number, got {numbers[name].size}")
    return float(numbers[name].ravel()[0])


def camera_of_npz(path: Path, values: NpzValues) -> DepthCamera | None:
    """Return the camera that an NPZ file describes; None if the file has no intrinsics.

    Raises
    ------
    SourceError
        The values do not describe a valid camera.
    """
    if values.matrix is None:
        return None
    unit_m = 0.001 if values.depth_unit_m is None else values.depth_unit_m
    try:
        return DepthCamera(values.matrix, np.zeros(0), values.size, unit_m, values.rate_hz)
    except ParameterError as fault:
        raise SourceError(path, str(fault)) from None
