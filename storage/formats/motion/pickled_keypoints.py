"""Read points from pickles: the 3D keypoints of AIST++, 17 joints of COCO at 60 Hz, and the markers of SOMA."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from kinedex.catalog.keypoint_sets import load_keypoint_set
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.amass import AIST_HZ
from kinedex.storage.formats.motion.numpy_arrays import load_pickle
from kinedex.storage.formats.motion.points import Points, PointsReader
from kinedex.storage.formats.motion.position_tables import whole_points
from kinedex.storage.formats.motion.reader import FASTEST_HZ, MAX_POINTS, SLOWEST_HZ, MotionFile, ReadSettings
from kinedex.storage.formats.motion.shared_labels import unique_names
from kinedex.storage.formats.motion.subjects import points_of_person
from kinedex.storage.formats.source_files import file_size, first_bytes

KEYS = ("keypoints3d_optim", "keypoints3d")
"""The keys of the positions; smoothed ones take precedence."""

_HEAD = 4096

_MARKERS = re.compile(rb"[^A-Za-z_]markers(?![A-Za-z_]*_)")
_FIRST = 64  # bytes in which the first key of a pickle lies

_POINTS = 17  # COCO's number of joints


class PickledKeypointsReader(PointsReader):
    """Reads pickles with `keypoints3d`, or with `markers` and their `labels`."""

    title: ClassVar[str] = "pickle, keypoints (AIST++) or markers (SOMA)"
    endings: ClassVar[tuple[str, ...]] = (".pkl",)

    def sniff(self, path: Path) -> bool:
        """Return whether the first keys of a pickle are those of 3D keypoints, or the first one is that of markers."""
        head = first_bytes(path, _HEAD)
        return KEYS[1].encode() in head or _MARKERS.search(head[:_FIRST]) is not None

    def size(self, file: MotionFile) -> tuple[int, int, int]:
        """Return 0 for the unknown frames, the number of points, and an estimate of the memory in bytes for reading."""
        return 0, _POINTS, 20 * file_size(file.path)

    def points(self, file: MotionFile, settings: ReadSettings) -> Points:
        """Read the positions (T, 17, 3), or markers (T, M, 3); their unit is inferred from the body's size."""
        path = file.path
        arrays = load_pickle(path)
        if "markers" in arrays and "labels" in arrays:
            return points_of_person(_markers(path, arrays), file.person)
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


def _markers(path: Path, arrays: dict[str, Any]) -> Points:
    """Return the markers of a pickle of SOMA: `markers` (T, M, 3), `labels` (M), and perhaps `frame_rate`."""
    markers, labels = arrays["markers"], arrays["labels"]
    if not isinstance(markers, np.ndarray) or markers.ndim != 3 or markers.shape[2] != 3 or not markers.size:
        raise SourceError(path, "`markers` must be numbers of shape (frames, markers, 3)")
    if markers.dtype.kind not in "fiu" or markers.shape[1] > MAX_POINTS:
        raise SourceError(path, f"`markers` must be numbers of at most {MAX_POINTS} markers, got {markers.shape}")
    if not isinstance(labels, np.ndarray) or labels.shape != markers.shape[1:2] or labels.dtype.kind != "U":
        raise SourceError(path, f"`labels` must be {markers.shape[1]} texts, one for each marker")
    rate = arrays.get("frame_rate")
    rate_hz = None
    if isinstance(rate, np.ndarray):
        if rate.size != 1 or rate.dtype.kind not in "fiu" or not SLOWEST_HZ <= float(rate.ravel()[0]) <= FASTEST_HZ:
            raise SourceError(path, f"`frame_rate` must be one number, {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz")
        rate_hz = float(rate.ravel()[0])
    positions = np.ascontiguousarray(np.moveaxis(markers.astype(np.float64), 0, 2))
    positions[~(np.abs(positions) <= 1e9)] = np.nan
    hidden = (positions == 0.0).all(axis=1, keepdims=True)  # as in the C3D files of which they are made
    positions[np.broadcast_to(hidden, positions.shape)] = np.nan
    warnings: list[str] = []
    names = unique_names([str(label) for label in labels], whole_points(positions), None, warnings)
    return Points(str(path), names, positions, rate_hz, warnings=warnings)
