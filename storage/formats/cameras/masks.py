"""Read silhouettes frame by frame, from PNG images (one for each frame and camera) or from packed bits in NPZ files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from kinedex.catalog.cameras import Camera
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.cameras.openpose import frame_number
from kinedex.storage.formats.motion.numpy_arrays import array_shapes, load_arrays

U8 = npt.NDArray[np.uint8]

_MODES = ("1", "L", "LA", "RGB", "RGBA")
_DARK = 1
"""The largest value in a mask that marks the foreground by a small number instead of 255."""


@dataclass(frozen=True, eq=False)
class CameraMasks:
    """The masks of one camera.

    Attributes
    ----------
    size : tuple of (int, int)
        Width and height of the masks in pixels: those of the camera's images, or both divided by the same integer.
    images : mapping of int to Path
        Number of a frame → the image of its mask; empty for packed bits.
    bits : uint8 array (T, H, ceil(W / 8)), optional
        Frames of packed bits, the first pixel of a row in the highest bit.
    """

    size: tuple[int, int]
    images: Mapping[int, Path]
    bits: U8 | None = None

    @property
    def frames(self) -> Sequence[int]:
        """The numbers of the frames that have a mask."""
        return sorted(self.images) if self.bits is None else range(len(self.bits))

    def read(self, frame: int) -> U8 | None:
        """Return the mask of a frame as foreground probabilities from 0 to 255; None for a frame without a mask.

        Raises
        ------
        SourceError
            The image is damaged, or has only the values 0 and 1.
        """
        if self.bits is not None:
            if not 0 <= frame < len(self.bits):
                return None
            mask: U8 = np.unpackbits(self.bits[frame], axis=1, count=self.size[0]) * np.uint8(255)
            return mask
        path = self.images.get(frame)
        return None if path is None else read_mask(path, self.size)


@dataclass(frozen=True, eq=False)
class MaskFrames:
    """The masks of a recording; for frame t, each camera has an array (H, W) of uint8, or None.

    Attributes
    ----------
    cameras : tuple of CameraMasks or None
        The masks of each camera.
    first : tuple of int
        The number that the recording's first frame has in the files of each camera.
    frames : int
        The number of frames.
    """

    cameras: tuple[CameraMasks | None, ...]
    first: tuple[int, ...]
    frames: int

    def __len__(self) -> int:
        return self.frames

    def __getitem__(self, frame: int) -> tuple[U8 | None, ...]:
        if not 0 <= frame < self.frames:
            raise IndexError(frame)
        return tuple(
            None if masks is None else masks.read(first + frame)
            for masks, first in zip(self.cameras, self.first, strict=True)
        )


def read_mask(path: Path, size: tuple[int, int]) -> U8:
    """Return the mask (H, W) in an 8-bit PNG image, as foreground probabilities from 0 to 255.

    Raises
    ------
    SourceError
        The file is not such an image, has another size, or has only the values 0 and 1.
    """
    _check_image(path, size)
    try:
        with Image.open(path, formats=("PNG",)) as image:
            mask: U8 = np.asarray(image.convert("L"))
    except Exception as fault:  # Pillow, zlib and struct raise many classes of errors for damaged data
        raise SourceError(path, f"cannot be read as PNG: {str(fault)[:200]}") from None
    if 0 < mask.max(initial=0) <= _DARK:
        raise SourceError(path, "has only the values 0 and 1; foreground must be above 127: multiply the mask by 255")
    return mask


def _check_image(path: Path, size: tuple[int, int]) -> None:
    """Raise an error if the header of an image states another size or kind; its pixels are not decoded."""
    found, mode = _header(path)
    if found != size:
        raise SourceError(path, f"has {found[0]} × {found[1]} pixels, and the first mask of its camera {_times(size)}")
    if mode not in _MODES:
        raise SourceError(path, f"expected an 8-bit grey image, got one of Pillow's mode {mode}; convert it to grey")


def _header(path: Path) -> tuple[tuple[int, int], str]:
    try:
        with Image.open(path, formats=("PNG",)) as image:
            return image.size, image.mode
    except Exception as fault:
        raise SourceError(path, f"cannot be read as PNG: {str(fault)[:200]}") from None


def open_images(files: Sequence[Path], camera: Camera) -> CameraMasks:
    """Check the headers of PNG images, and return the masks of a camera that they hold.

    Parameters
    ----------
    files : sequence of Path
        An image for each frame; the last number in the name is that of the frame.
    camera : Camera
        The camera.

    Raises
    ------
    SourceError
        An image has another size or kind, or two images have the same number.
    """
    images: dict[int, Path] = {}
    size = _header(files[0])[0]
    _refuse_size(files[0], size, camera)
    for path in files:
        number = frame_number(path)
        if number in images:
            raise SourceError(path, f"has the frame number {number}, as {images[number].name} has")
        _check_image(path, size)
        images[number] = path
    return CameraMasks(size, images)


def open_bits(path: Path, array: str, camera: Camera) -> CameraMasks:
    """Return the masks of a camera from the packed bits of an NPZ file, which begin with frame 0.

    Parameters
    ----------
    path : Path
        The file.
    array : str
        The name of the array, uint8 (T, H, ceil(W / 8)), as `numpy.packbits(masks, axis=2)` makes it.
    camera : Camera
        The camera.

    Raises
    ------
    SourceError
        The file has no such array, or its size does not fit the camera.
    """
    arrays, names = load_arrays(path, [array])
    if array not in arrays:
        raise SourceError(path, f"has no array '{array}'; it has {', '.join(names[:12]) or 'none'}")
    bits = arrays[array]
    if bits.dtype != np.uint8 or bits.ndim != 3 or 0 in bits.shape:
        raise SourceError(
            path, f"'{array}' must be uint8 of shape (frames, height, width / 8), got {bits.dtype} of {bits.shape}; "
            "write numpy.packbits(masks, axis=2)",
        )  # fmt: skip
    width, height = camera.size
    scale = height // bits.shape[1]
    fits = scale >= 1 and bits.shape[1] * scale == height and width % scale == 0
    if not fits or bits.shape[2] != -(-(width // scale) // 8):
        raise SourceError(
            path, f"'{array}' has {bits.shape[1]} rows of {8 * bits.shape[2]} bits, which is no whole fraction of the "
            f"{_times(camera.size)} pixels of camera '{camera.name}'",
        )  # fmt: skip
    return CameraMasks((width // scale, height // scale), {}, np.ascontiguousarray(bits))


def mask_arrays(path: Path) -> list[str]:
    """Return the names of the arrays of an NPZ file."""
    return list(array_shapes(path))


def _refuse_size(path: Path, size: tuple[int, int], camera: Camera) -> None:
    scale = camera.size[0] // size[0] if size[0] else 0
    if scale < 1 or (size[0] * scale, size[1] * scale) != camera.size:
        raise SourceError(
            path, f"has {_times(size)} pixels, which is no whole fraction of the {_times(camera.size)} of camera "
            f"'{camera.name}'; are masks and calibration of the same images?",
        )  # fmt: skip


def _times(size: tuple[int, int]) -> str:
    return f"{size[0]} × {size[1]}"
