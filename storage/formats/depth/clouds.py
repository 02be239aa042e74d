"""Convert point clouds to depth images: organised clouds already are images, and others are projected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.catalog.depth_cameras import FARTHEST_M, MAX_PIXELS, DepthCamera
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.depth.png import size_fault
from kinedex.storage.formats.source_files import as_number, part_of

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]

MAX_BYTES = 1 << 28
"""The largest size in memory of the cloud of a frame, in bytes."""

MAX_POINTS = MAX_PIXELS
"""The largest number of points in the cloud of a frame."""

_MIN_POINTS = 100
_NEAREST = 1e-6  # metres; the direction of nearer points is not defined
_MIN_BEFORE = 0.9  # share of points; some programs leave a few behind the camera
_MAX_RESIDUAL_PX = 1.0


@dataclass(frozen=True, eq=False)
class Cloud:
    """The points of a frame in the camera's axes: x right, y down, z forward.

    Attributes
    ----------
    path : Path
        The file, for errors.
    points : float64 array (n, 3)
        Positions in the unit of the file; NaN where nothing was measured.
    size : tuple of (int, int), optional
        Width and height if the points are the pixels of an image, row by row (an organised cloud); otherwise None.
    """

    path: Path
    points: F64
    size: tuple[int, int] | None = None


def cloud_of(path: Path, points: F64, size: tuple[int, int] | None) -> Cloud:
    """Return the cloud of a file's points (n, 3), an array that is modified in place.

    If all points have z < 0, they are in OpenGL's axes (y up, z backward), and are converted to the camera's axes.

    Raises
    ------
    SourceError
        Points lie in front of the camera, but more than a tenth lie behind it.
    """
    z = points[:, 2]
    with np.errstate(invalid="ignore"):
        known = np.abs(z) >= _NEAREST
        for axis in range(3):
            known &= np.abs(points[:, axis]) <= FARTHEST_M
        before = int((known & (z > 0)).sum())
    if not before and known.any():
        points[:, 1:] *= -1.0
    elif before < _MIN_BEFORE * int(known.sum()):
        raise SourceError(
            path, f"{int(known.sum()) - before} of {int(known.sum())} points lie behind the camera; expected its own "
            "axes, x right, y down, z forward: write clouds before they are turned into a world",
        )  # fmt: skip
    with np.errstate(invalid="ignore"):
        points[~(known & (z > 0))] = np.nan
    return Cloud(path, points, size)


def cloud_depths(cloud: Cloud, camera: DepthCamera, unit_m: float = 1.0) -> F32:
    """Return the depth image of a cloud.

    Parameters
    ----------
    cloud : Cloud
        The points.
    camera : DepthCamera
        The camera into which points are projected; a pixel gets the depth of its nearest point. An organised cloud is
        already an image, and must have the size of the camera's images.
    unit_m : float, optional
        Metres per unit of the file.

    Returns
    -------
    float32 array (H, W)
        Depths z in metres; 0 for pixels without a point.

    Raises
    ------
    SourceError
        An organised cloud has another size than the images of the camera.
    """
    width, height = camera.size
    if cloud.size is not None:
        if cloud.size != camera.size:
            raise SourceError(cloud.path, size_fault(cloud.size, camera.size))
        return np.nan_to_num(unit_m * cloud.points[:, 2], nan=0.0).astype(np.float32).reshape(height, width)
    points = cloud.points[np.isfinite(cloud.points[:, 2])]
    pixels, _ = camera.project(points)
    with np.errstate(invalid="ignore"):
        u, v = np.floor(pixels + 0.5).T
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    depths = np.full((height, width), np.inf, np.float32)
    positions = v[inside].astype(np.int64), u[inside].astype(np.int64)
    np.minimum.at(depths, positions, (unit_m * points[inside, 2]).astype(np.float32))
    return np.where(np.isfinite(depths), depths, np.float32(0.0))


def fitted_matrix(cloud: Cloud) -> F64:
    """Return the camera matrix of an organised cloud by least squares of u = fx x/z + cx and v = fy y/z + cy.

    Raises
    ------
    SourceError
        The cloud has no rows and columns, has too few points, or does not fit a camera without distortion.
    """
    found = _fit(cloud)
    matrix, residual = found
    if not (matrix[0, 0] >= 1 and matrix[1, 1] >= 1 and residual <= _MAX_RESIDUAL_PX):
        raise SourceError(
            cloud.path, f"rows and columns are no image of a pinhole camera: fx {matrix[0, 0]:.4g}, fy "
            f"{matrix[1, 1]:.4g}, {residual:.3g} pixels off in the mean; give the recording a camera",
        )  # fmt: skip
    return matrix


def check_camera(cloud: Cloud, camera: DepthCamera) -> None:
    """Raise an error unless the camera projects the points of an organised cloud to their rows and columns.

    Raises
    ------
    SourceError
        The cloud has another size, or the median distance exceeds a pixel; the message states intrinsics that fit.
    """
    if cloud.size != camera.size:
        raise SourceError(cloud.path, size_fault(cloud.size or (0, 0), camera.size))
    known = np.flatnonzero(np.isfinite(cloud.points[:, 2]))
    if len(known) < _MIN_POINTS:
        return
    pixels, _ = camera.project(cloud.points[known])
    grid = np.stack([known % camera.size[0], known // camera.size[0]], axis=1)
    off = float(np.nanmedian(np.linalg.norm(pixels - grid, axis=1)))
    if not off <= _MAX_RESIDUAL_PX:
        matrix, residual = _fit(cloud)
        fits = (
            f"; fx {matrix[0, 0]:.5g}, fy {matrix[1, 1]:.5g}, cx {matrix[0, 2]:.5g}, cy {matrix[1, 2]:.5g} fit"
            if residual <= _MAX_RESIDUAL_PX
            else ""
        )
        raise SourceError(
            cloud.path, f"its points lie {off:.3g} pixels off their rows and columns with this camera{fits}"
        )


def _fit(cloud: Cloud) -> tuple[F64, float]:
    """Fit a pinhole camera to an organised cloud: return its matrix (3, 3), and the mean reprojection error in pixels.

    Raises
    ------
    SourceError
        The cloud has no rows and columns, or too few points.
    """
    known = np.flatnonzero(np.isfinite(cloud.points[:, 2]))
    if cloud.size is None or len(known) < _MIN_POINTS:
        raise SourceError(
            cloud.path, "no intrinsics follow from a cloud without rows and columns, or with fewer than "
            f"{_MIN_POINTS} points; give the recording a camera",
        )  # fmt: skip
    x, y, z = cloud.points[known].T
    matrix = np.eye(3)
    total = np.zeros(len(known))
    for row, ratios, positions in ((0, x / z, known % cloud.size[0]), (1, y / z, known // cloud.size[0])):
        design = np.stack([ratios, np.ones(len(known))], axis=1)
        (focal, centre), *_ = np.linalg.lstsq(design, positions.astype(np.float64))
        matrix[row, row], matrix[row, 2] = focal, centre
        total += (design @ [focal, centre] - positions) ** 2
    return matrix, float(np.sqrt(total).mean())


def refuse_size(path: Path, points: int, record: int) -> None:
    """Raise an error for a header that states more, or larger, points than a frame can have.

    Raises
    ------
    SourceError
        The cloud would take more memory than any frame.
    """
    if not 0 < points <= MAX_POINTS or points * max(record, 24) > MAX_BYTES:
        raise SourceError(path, f"claims {points:,} points of {record} bytes, and a frame has 1 to {MAX_POINTS:,}")


def number_rows(path: Path, data: bytes, rows: int, columns: int, line: int, last: bool = True) -> F64:
    """Parse the text after a header as an array of numbers (rows, columns).

    Parameters
    ----------
    path : Path
        The file, for errors.
    data : bytes
        The text after the header.
    rows, columns : int
        The numbers of rows and columns that the header states.
    line : int
        The number of the first line of the text.
    last : bool, optional
        False if other data may follow the rows.

    Raises
    ------
    SourceError
        There are fewer or more rows or columns, or cells that are not numbers.
    """
    if 2 * rows * columns > len(data) + 1:
        raise SourceError(path, f"claims {rows:,} points, and has {len(data):,} bytes of them: is it cut off?")
    words = data.split(maxsplit=rows * columns)
    if not last:
        del words[rows * columns :]
    if len(words) == rows * columns and b"_" not in data:
        try:
            return np.fromiter(map(float, words), np.float64, len(words)).reshape(rows, columns)
        except ValueError:
            pass
    for number, row in enumerate(data.split(b"\n", rows)[:rows], line):
        cells = row.split(maxsplit=columns)
        if any(as_number(cell) is None or b"_" in cell for cell in cells):
            raise SourceError(path, f"expected {columns} numbers, got {row[:60].decode('latin-1')!r}", line=number)
        if cells and len(cells) != columns:
            raise SourceError(path, f"expected {columns} numbers, got {len(cells)}", line=number)
    if len(words) > rows * columns:
        raise SourceError(path, f"claims {rows:,} points, and has more: the header does not fit its data")
    raise SourceError(path, f"claims {rows:,} points, and has {len(words) // columns:,}: is it cut off?")


def check_bytes(path: Path, claimed: int, found: int) -> None:
    """Raise SourceError if a file has fewer or more bytes of points than its header states."""
    if claimed != found:
        what = "is it cut off?" if claimed > found else "the header does not fit its data"
        raise SourceError(path, f"claims {claimed:,} bytes of points, and has {found:,}: {what}")


def record_points(data: bytes, start: int, rows: int, record: int, types: list[str], offsets: list[int]) -> F64:
    """Return the coordinates x, y, z (n, 3) in binary records.

    Parameters
    ----------
    data : bytes
        The file.
    start : int
        The byte offset of the first record.
    rows, record : int
        The number of records, and the bytes of each.
    types, offsets : list
        The NumPy type of x, y and z, and their byte offsets in a record.
    """
    records = np.frombuffer(data, np.uint8, rows * record, start).reshape(rows, record)
    cells = (records[:, offset : offset + np.dtype(kind).itemsize] for kind, offset in zip(types, offsets, strict=True))
    return as_points([np.ascontiguousarray(cell).view(kind)[:, 0] for cell, kind in zip(cells, types, strict=True)])


def as_points(columns: Sequence[npt.NDArray[Any]]) -> F64:
    """Return x, y and z, of any type, as float64 points (n, 3), without warnings for NaN."""
    points = np.empty((len(columns[0]), 3))
    with np.errstate(invalid="ignore"):
        for axis, column in enumerate(columns):
            points[:, axis] = column
    return points


def cloud_bytes(path: Path) -> bytes:
    """Return the bytes of a file; raise SourceError if it cannot be read or is larger than a frame can be."""
    data = part_of(path, MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise SourceError(path, f"has more than {MAX_BYTES >> 20} MB; write a file for each frame")
    return data
