"""Read HumanML3D arrays: 263 features a frame, or the positions of the 22 joints of SMPL, at 20 Hz."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.body_models import BODY
from kinedex.storage.formats.motion.numpy_arrays import array_shapes, load_array
from kinedex.storage.formats.motion.points import Points, PointsReader
from kinedex.storage.formats.motion.position_tables import whole_points
from kinedex.storage.formats.motion.reader import MotionFile, ReadSettings

F64 = npt.NDArray[np.float64]

RATE_HZ = 20.0
"""The rate of HumanML3D, which its files do not state."""

FEATURES = 4 + 3 * 21 + 6 * 21 + 3 * 22 + 4
"""The number of features: the root's rotation, steps and height; joints' positions, rotations, velocities; contacts."""

_LARGEST = 1e6


class HumanMlReader(PointsReader):
    """Reads NPY files of shape (frames, 263) or (frames, 22, 3)."""

    title: ClassVar[str] = "NPY (HumanML3D)"
    endings: ClassVar[tuple[str, ...]] = (".npy",)
    up: ClassVar[str | None] = "y"

    def sniff(self, path: Path) -> bool:
        """Return whether an array has one of these two shapes."""
        try:
            shape, kind = array_shapes(path)[""]
        except SourceError:
            return False
        return kind.kind == "f" and (shape[1:] == (FEATURES,) or shape[1:] == (len(BODY), 3)) and shape[0] > 0

    def size(self, file: MotionFile) -> tuple[int, int, int]:
        """Return the numbers of frames and points by the header, and the memory in bytes for reading."""
        shape, kind = array_shapes(file.path)[""]
        numbers = int(np.prod(shape))
        return shape[0], len(BODY), numbers * (kind.itemsize + 8) + 400 * shape[0]

    def points(self, file: MotionFile, settings: ReadSettings) -> Points:
        """Read the positions of the joints, or recover them from features."""
        array: npt.NDArray[Any] = load_array(file.path)
        found = array.astype(np.float64)
        if not (np.abs(found[np.isfinite(found)]) <= _LARGEST).all() or np.isinf(found).any():
            raise SourceError(file.path, f"has numbers beyond {_LARGEST:g}")
        joints = recovered_joints(found) if found.ndim == 2 else np.moveaxis(found, 0, 2)
        set_hz = settings.override_rate_hz or settings.rate_hz
        warnings = [] if set_hz else [f"it is read at the {RATE_HZ:g} Hz of HumanML3D, which it does not state"]
        positions = whole_points(np.ascontiguousarray(joints))
        return Points(str(file.path), BODY, positions, set_hz or RATE_HZ, unit_m=1.0, warnings=warnings)


def recovered_joints(features: F64) -> F64:
    """Return the positions of the joints (22, 3, T) from features (T, 263).

    The root's rotation about the vertical axis is twice the sum of the half angles per frame, its path the sum of its
    steps.
    Steps and joints are given in the root's axes, joints relative to the root horizontally and to the ground
    vertically. (C. Guo et al., Generating Diverse and Natural 3D Human Motions from Text, CVPR 2022, Section 3.)
    """
    frames = len(features)
    half = np.concatenate([[0.0], np.cumsum(features[:-1, 0])])
    cosine, sine = np.cos(2 * half), np.sin(2 * half)

    def turned_back(x: F64, z: F64) -> tuple[F64, F64]:
        """Rotate coordinates x and z from the root's axes to the axes of the ground."""
        return cosine * x - sine * z, sine * x + cosine * z

    steps = np.zeros((2, frames))
    steps[:, 1:] = features[:-1, 1:3].T
    path = np.cumsum(np.stack(turned_back(steps[0], steps[1])), axis=1)
    local = features[:, 4 : 4 + 3 * 21].reshape(frames, 21, 3).transpose(1, 2, 0)
    joints = np.empty((22, 3, frames))
    joints[0] = path[0], features[:, 3], path[1]
    x, z = turned_back(local[:, 0], local[:, 2])
    joints[1:, 0], joints[1:, 1], joints[1:, 2] = x + path[0], local[:, 1], z + path[1]
    return joints
