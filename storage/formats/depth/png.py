"""Read and write depth images as 16-bit PNG files, one per frame; headers are checked before pixels are decoded."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from kinedex.catalog.depth_cameras import MAX_PIXELS, NOT_MEASURED, DepthCamera
from kinedex.ops.errors import ParameterError, SourceError
from kinedex.storage.durable_files import whole_file

F32 = npt.NDArray[np.float32]
U16 = npt.NDArray[np.uint16]

_DEPTH_MODES = ("I;16", "I;16B", "I;16L", "I;16N", "I")
_NUMBER = re.compile(r"[0-9]+")
_COMPRESSION = 6


def frame_number(path: Path) -> int:
    """Return the last number in a file's name, which counts frames.

    Raises
    ------
    SourceError
        The name has no number.
    """
    numbers = _NUMBER.findall(path.stem)
    if not numbers:
        raise SourceError(path, "expected a number of the frame in the name, as in depth_000012.png")
    return int(numbers[-1][-15:])


def image_size(path: Path) -> tuple[int, int]:
    """Return width and height of a depth image by its header.

    Raises
    ------
    SourceError
        The file is not a 16-bit grey PNG.
    """
    with _opened(path) as image:
        return image.size


def read_png(path: Path, size: tuple[int, int]) -> U16:
    """Return the values (H, W) of a 16-bit grey PNG.

    Parameters
    ----------
    path : Path
        The file.
    size : tuple of (int, int)
        The required width and height.

    Raises
    ------
    SourceError
        The file is damaged, of another size, or has 8 bits or colours.
    """
    with _opened(path) as image:
        if image.size != size:
            raise SourceError(path, size_fault(image.size, size))
        try:
            values = np.asarray(image)
        except Exception as fault:  # Pillow, zlib and struct raise many classes of errors for damaged data
            raise SourceError(path, f"cannot be read as PNG: {str(fault)[:200]}") from None
    return values.astype(np.uint16)


def read_depth_png(path: str | Path, camera: DepthCamera) -> F32:
    """Return the depths of a PNG image.

    Parameters
    ----------
    path : str or Path
        The file.
    camera : DepthCamera
        The camera, which defines the unit of the values.

    Returns
    -------
    float32 array (H, W)
        Depths z in metres; 0 where nothing was measured.

    Raises
    ------
    SourceError
        The file is damaged, of another size than the camera, or has 8 bits or colours.
    """
    return camera.depths(read_png(Path(path), camera.size))


def write_depth_png(path: str | Path, depths: npt.ArrayLike, depth_unit_m: float = 0.001) -> None:
    """Write depths as a 16-bit grey PNG, atomically; equal depths give equal bytes.

    Parameters
    ----------
    path : str or Path
        The file.
    depths : float array (H, W)
        Depths z in metres. NaN and values of at most 0 stand for pixels that were not measured, and become 0.
    depth_unit_m : float, optional
        Metres per unit; depths are rounded to whole units.

    Raises
    ------
    ParameterError
        The image has no pixels, or a depth does not fit into 16 bits.
    """
    metres = np.asarray(depths, np.float64)
    if metres.ndim != 2 or not metres.size:
        raise ParameterError("depths", "of shape (H, W)", metres.shape)
    units = np.round(np.where(metres > 0, metres, 0.0) / depth_unit_m)
    if not units.max() < NOT_MEASURED[1]:
        most = (NOT_MEASURED[1] - 1) * depth_unit_m
        raise ParameterError("depths", f"at most {most:g} m in units of {depth_unit_m:g} m", float(metres.max()))
    with whole_file(Path(path)) as temporary:
        Image.fromarray(units.astype(np.uint16)).save(temporary, "PNG", compress_level=_COMPRESSION)


def size_fault(found: Sequence[int], size: Sequence[int]) -> str:
    """Return the message on an image whose size is not that of its camera."""
    text = f"has {found[0]} × {found[1]} pixels, and its camera {size[0]} × {size[1]}"
    scale = found[0] / size[0]
    if scale == found[1] / size[1]:
        return f"{text}; with the images scaled by {scale:g}, write width, height, fx, fy, cx and cy of the scaled ones"
    if tuple(found) == tuple(size)[::-1]:
        return f"{text}; turn the images, or exchange width and height, fx and fy, cx and cy"
    return f"{text}; are camera and images those of one recording?"


def _opened(path: Path) -> Image.Image:
    """Open an image without decoding its pixels; raise SourceError if it is no depth image of a plausible size."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            image = Image.open(path, formats=("PNG",))
    except OSError as fault:
        reason = fault.strerror or "it is no PNG, or its beginning is damaged"
        raise SourceError(path, f"cannot be read as PNG: {reason}") from None
    except Exception as fault:
        raise SourceError(path, f"cannot be read as PNG: {str(fault)[:200]}") from None
    width, height = image.size
    reason = ""
    if image.mode not in _DEPTH_MODES:
        kind = "8 bits a pixel" if image.mode in ("L", "1", "P", "LA") else "colours"
        reason = (
            f"expected depth in a 16-bit grey PNG, got {kind} (Pillow's mode {image.mode}): a picture that has "
            "lost the depths; write the camera's own 16-bit values"
        )
    elif width * height > MAX_PIXELS:
        reason = f"has {width} × {height} pixels, and depth images {MAX_PIXELS:,} at most"
    if reason:
        image.close()
        raise SourceError(path, reason)
    return image
