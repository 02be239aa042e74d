"""Read the 3D keypoints of AIST++: pickles of the 17 joints of COCO at 60 Hz."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np

from kinedex.catalog.keypoint_sets import load_keypoint_set
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.amass import AIST_HZ
from kinedex.storage.formats.motion.numpy_arrays import load_pickle
from kinedex.storage.formats.motion.points import Points, PointsReader
from kinedex.storage.formats.motion.position_tables import whole_points
from kinedex.storage.formats.motion.reader import MotionFile, ReadSettings
from kinedex.storage.formats.source_files import file_size, first_bytes

KEYS = ("keypoints3d_optim", "keypoints3d")
"""The keys of the positions; smoothed ones take precedence."""

_HEAD = 4096

_POINTS = 17  # COCO's number of joints


class PickledKeypointsReader(PointsReader):
    """Reads pickles with `keypoints3d`."""

    title: ClassVar[str] = "pickle, keypoints (AIST++)"
    endings: ClassVar[tuple[str, ...]] = (".pkl",)

    def sniff(self, path: Path) -> bool:
        """Return whether the first keys of a pickle are those of 3D keypoints."""
        return KEYS[1].encode() in first_bytes(path, _HEAD)

    def size(self, file: MotionFile) -> tuple[int, int, int]:
        """Return 0 for the unknown frames, the number of points, and an estimate of the memory in bytes for reading."""
        return 0, _POINTS, 20 * file_size(file.path)

    def points(self, file: MotionFile, settings: ReadSettings) -> Points:
        """Read the positions (T, 17, 3); their unit is inferred from the body's size."""
        path = file.path
        arrays = load_pickle(path)
        key = next((key for key in KEYS if isinstance(arrays.get(key), np.ndarray)), None)
        if key is None:
            raise SourceError(path, f"has no array {' or '.join(KEYS)}; it has {', '.join(arrays)[:200] or 'none'}")
        array = arrays[key]
        if array.ndim != 3 or array.shape[1:] != (_POINTS, 3) or not len(array) or array.dtype.kind not in "fiu":
            raise SourceError(
                path, f"`{key}` must be numbers of shape (frames, {_POINTS}, 3), got {array.shape} of {array.dtype}"
            )
        positions = np.ascontiguousarray(np.moveaxis(array.astype(np.float64), 0, 2))
        positions[~(np.abs(positions) <= 1e9)] = np.nan
        rate_hz = settings.override_rate_hz or settings.rate_hz or AIST_HZ
        return Points(str(path), load_keypoint_set("coco-17").order, whole_points(positions), rate_hz)
