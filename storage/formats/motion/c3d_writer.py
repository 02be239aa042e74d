"""Write C3D files: named joints as points, in floating-point numbers of Intel processors (C3D user guide)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.storage.formats.motion.c3d_layout import BLOCK, INTEL, KEY
from kinedex.storage.formats.motion.joint_motion import MARKER_NAMES, JointMotion, seen_markers

_MAX_COUNTED = 0xFFFF  # frames; the largest number in 16 bits
_FLOATS = -1.0  # a negative scale marks floating-point numbers
_BLOCK_FRAMES = 16_384  # frames written at once
_NEAR_ORIGIN_MM = 1e-6


def write_c3d(path: Path, motion: JointMotion) -> None:
    """Write the joints of a motion as the points of a C3D file, in millimetres with Y up.

    A joint that is missing in a frame has the residual −1 there, and one that is always missing is not written. A joint
    exactly at the origin is moved by a millionth of a millimetre, because readers take a point at 0, 0, 0 for missing.
    Takes of more than 65,535 frames state their length by POINT:LONG_FRAMES and TRIAL:ACTUAL_END_FIELD.

    Parameters
    ----------
    path : Path
        The file to write.
    motion : JointMotion
        The motion.

    Raises
    ------
    KinedexError
        No joint is seen in any frame.
    """
    joints, positions = seen_markers(motion)
    frames = len(positions)
    counted = min(frames, _MAX_COUNTED)
    blocks = -(-(4 + len(_parameters(joints, motion.rate_hz, frames, 1))) // BLOCK)
    parameters = _parameters(joints, motion.rate_hz, frames, 2 + blocks)
    header = struct.pack(
        "<BB5HfHHf", 2, KEY, len(joints), 0, 1, counted, 0, _FLOATS, 2 + blocks, 0, motion.rate_hz
    )  # fmt: skip
    with path.open("wb") as file:
        file.write(header.ljust(BLOCK, b"\0"))
        file.write((bytes([1, KEY, blocks, INTEL]) + parameters).ljust(blocks * BLOCK, b"\0"))
        for start in range(0, frames, _BLOCK_FRAMES):
            file.write(_numbers(positions[start : start + _BLOCK_FRAMES]).tobytes())
        if frames <= _MAX_COUNTED:  # some programs read frames up to the end of the file in longer takes
            file.write(b"\0" * (-file.tell() % BLOCK))


def _numbers(positions: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return x, y, z in millimetres and the residual of every point (T, points, 4)."""
    numbers = np.zeros((*positions.shape[:2], 4), "<f4")
    seen = np.isfinite(positions[:, :, 0])
    found = positions[seen].astype(np.float64) * 1000.0
    found[~found.any(axis=1), 0] = _NEAR_ORIGIN_MM
    numbers[seen, :3] = found
    numbers[~seen, 3] = -1.0
    return numbers


def _parameters(joints: Sequence[str], rate_hz: float, frames: int, start: int) -> bytes:
    """Return the groups with their parameters; `start` is the block of the first frame, from 1."""
    labels = [MARKER_NAMES[joint] for joint in joints]
    long = [_parameter(1, "LONG_FRAMES", _real(frames))] if frames > _MAX_COUNTED else []
    parts = [
        _group(1, "POINT", "joints of a body in place of markers"),
        _parameter(1, "USED", _words(len(joints))),
        _parameter(1, "SCALE", _real(_FLOATS)),
        _parameter(1, "RATE", _real(rate_hz)),
        _parameter(1, "DATA_START", _words(start)),
        _parameter(1, "FRAMES", _words(min(frames, _MAX_COUNTED))),
        *long,
        _parameter(1, "LABELS", _texts(labels)),
        _parameter(1, "DESCRIPTIONS", _texts([f"joint {joint} of kinedex" for joint in joints])),
        _parameter(1, "UNITS", _texts(["mm"])),
        _parameter(1, "X_SCREEN", _texts(["+X"])),
        _parameter(1, "Y_SCREEN", _texts(["+Y"])),
        _group(2, "ANALOG", "none"),
        _parameter(2, "USED", _words(0)),
        _parameter(2, "RATE", _real(0.0)),
        _group(3, "TRIAL", "frames as numbers of 32 bits"),
        _parameter(3, "ACTUAL_START_FIELD", _words(1, 0)),
        _parameter(3, "ACTUAL_END_FIELD", _words(frames & 0xFFFF, frames >> 16)),
        _parameter(3, "CAMERA_RATE", _real(rate_hz)),
        _group(4, "MANUFACTURER", ""),
        _parameter(4, "SOFTWARE", _texts(["kinedex"])),
    ]
    return b"".join(parts) + b"\0\0"


def _group(number: int, name: str, description: str) -> bytes:
    body = bytes([len(description)]) + description.encode("ascii")
    return struct.pack("<bb", len(name), -number) + name.encode("ascii") + struct.pack("<H", 2 + len(body)) + body


def _parameter(group: int, name: str, value: bytes) -> bytes:
    """Return a parameter without a description."""
    return (
        struct.pack("<bb", len(name), group) + name.encode("ascii") + struct.pack("<H", 3 + len(value)) + value + b"\0"
    )


def _words(*numbers: int) -> bytes:
    """Encode integers with two bytes each."""
    dims = bytes([1, len(numbers)]) if len(numbers) > 1 else b"\0"
    return b"\2" + dims + struct.pack(f"<{len(numbers)}H", *numbers)


def _real(number: float) -> bytes:
    return b"\4\0" + struct.pack("<f", number)


def _texts(texts: Sequence[str]) -> bytes:
    """Encode texts padded to equal width."""
    width = max(len(text) for text in texts)
    return b"\xff\2" + bytes([width, len(texts)]) + "".join(text.ljust(width) for text in texts).encode("ascii")
