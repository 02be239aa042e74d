"""C3D files for tests, written with ezc3d: a standing body with the markers of HDM05, whatever is asked of it."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import ezc3d
import numpy as np

MARKERS = {
    "LFWT": (0.12, 1.02, 0.09), "LBWT": (0.09, 0.98, -0.09), "LKNE": (0.16, 0.50, 0.0), "LANK": (0.13, 0.10, -0.05),
    "LHEE": (0.08, 0.06, -0.11), "LTOE": (0.10, 0.03, 0.16), "LFHD": (0.06, 1.74, 0.07), "LBHD": (0.06, 1.66, -0.07),
    "LSHO": (0.16, 1.50, -0.03), "LELB": (0.27, 1.20, -0.08), "LWRA": (0.29, 0.97, 0.05), "LWRB": (0.31, 0.95, -0.06),
    "LFIN": (0.32, 0.83, 0.05),
}  # fmt: skip
"""The left markers in metres: Y up, facing +Z, left at +X."""

MIDDLE = {"CLAV": (0, 1.44, 0.07), "STRN": (0, 1.31, 0.11), "C7": (0, 1.51, -0.07), "T10": (0, 1.36, -0.13)}

LABELS = (*MARKERS, *(f"R{name[1:]}" for name in MARKERS), *MIDDLE)


def standing_markers(frames: int) -> np.ndarray:
    """Markers (len(LABELS), 3, frames) in metres, Y up; the body walks along Z."""
    left = np.array(list(MARKERS.values()), float)
    pose = np.concatenate([left, left * [-1, 1, 1], np.array(list(MIDDLE.values()), float)])
    walk = np.repeat(pose[:, :, None], frames, axis=2)
    walk[:, 2] += 0.01 * np.arange(frames)
    return walk


def z_up(points: np.ndarray) -> np.ndarray:
    """Points (N, 3, T) with Y up, as a system writes them that has Z up: what faced +Z faces −Y."""
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    return np.stack([x, -z, y], axis=1)


def write_c3d(
    path: Path,
    points: np.ndarray,
    labels: tuple[str, ...] = LABELS,
    *,
    rate: float = 120.0,
    unit: str = "mm",
    first: int = 0,
    analog: int = 0,
    **point: Any,
) -> Path:
    """Write points (N, 3, T), in the file's unit and axes; NaN is written as occluded.

    first: the first frame's number, from 0. analog: channels beside them, at twice the rate. point: more parameters.
    """
    c3d = ezc3d.c3d()
    frames = points.shape[2]
    data = np.ones((4, len(labels), frames))
    data[:3] = np.moveaxis(points, 0, 1)
    lost = np.isnan(points).any(axis=1)
    data[:3, lost] = 0.0
    c3d["header"]["points"]["first_frame"] = first
    c3d["parameters"]["POINT"]["RATE"]["value"] = [rate]
    c3d["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    c3d["parameters"]["POINT"]["LABELS"]["value"] = list(labels)
    for name, value in point.items():
        c3d.add_parameter("POINT", name, value)
    c3d["data"]["points"] = data
    residuals = np.zeros((1, len(labels), frames))
    residuals[0, lost] = -1.0
    c3d["data"]["meta_points"]["residuals"] = residuals
    c3d["data"]["meta_points"]["camera_masks"] = np.zeros((7, len(labels), frames), bool)
    if analog:
        c3d["parameters"]["ANALOG"]["RATE"]["value"] = [2 * rate]
        c3d["parameters"]["ANALOG"]["LABELS"]["value"] = [f"force {i}" for i in range(analog)]
        c3d["data"]["analogs"] = np.random.default_rng(0).normal(size=(1, analog, 2 * frames))
    c3d.write(str(path))
    return path


PROCESSORS = {"Intel": 84, "DEC": 85, "MIPS": 86}


def _real(value: float, processor: str) -> bytes:
    if processor == "DEC":
        raw = struct.pack("<f", 4.0 * value)
        return raw[2:] + raw[:2]
    return struct.pack(">f" if processor == "MIPS" else "<f", value)


def c3d_bytes(
    points: np.ndarray,
    labels: tuple[str, ...] = LABELS,
    *,
    processor: str = "Intel",
    scale: float = -1.0,
    analog: int = 0,
    rate: float = 120.0,
) -> bytes:
    """A C3D file by hand, in the numbers of any processor: (N, 3, T) in mm, NaN as occluded.

    scale: of 16-bit numbers; floating-point ones if negative. analog: samples of a frame.
    """
    order = ">" if processor == "MIPS" else "<"
    frames, count = points.shape[2], len(labels)
    width = max(map(len, labels))
    texts = b"".join(label.encode().ljust(width) for label in labels)

    def record(name: str, group: int, kind: int, dims: tuple[int, ...], values: bytes) -> bytes:
        body = struct.pack("<bB", kind, len(dims)) + bytes(dims) + values + b"\0"
        return struct.pack("<bb", len(name), group) + name.encode() + struct.pack(f"{order}H", len(body) + 2) + body

    def group(name: str, number: int) -> bytes:
        return struct.pack("<bb", len(name), -number) + name.encode() + struct.pack(f"{order}HB", 3, 0)

    word = f"{order}H"
    records = [
        group("POINT", 1), record("USED", 1, 2, (), struct.pack(word, count)),
        record("SCALE", 1, 4, (), _real(scale, processor)), record("RATE", 1, 4, (), _real(rate, processor)),
        record("FRAMES", 1, 2, (), struct.pack(word, min(frames, 65535))),
        record("LABELS", 1, -1, (width, count), texts), record("UNITS", 1, -1, (2,), b"mm"),
        group("ANALOG", 2), record("USED", 2, 2, (), struct.pack(word, analog)),
        group("TRIAL", 3),
        record("ACTUAL_START_FIELD", 3, 2, (2,), struct.pack(f"{order}2H", 1, 0)),
        record("ACTUAL_END_FIELD", 3, 2, (2,), struct.pack(f"{order}2H", frames & 0xFFFF, frames >> 16)),
    ]  # fmt: skip
    parameters = b"".join(records) + b"\0\0"
    blocks = -(-(len(parameters) + 4) // 512)
    start = 2 + blocks
    header = struct.pack(f"{order}5H", count, analog, 1, min(frames, 65535), 10) + _real(scale, processor)
    header += struct.pack(f"{order}2H", start, 1) + _real(rate, processor)
    rows = np.zeros((frames, 4 * count + analog))
    places = np.moveaxis(points, 2, 0)
    lost = np.isnan(places).any(axis=2)
    quads = np.concatenate([np.where(lost[..., None], 0.0, places), np.where(lost, -1.0, 0.0)[..., None]], axis=2)
    if scale > 0:
        quads[..., :3] = np.round(quads[..., :3] / scale)
    rows[:, : 4 * count] = quads.reshape(frames, -1)
    if scale > 0:
        data = rows.astype(f"{order}i2").tobytes()
    elif processor == "DEC":
        data = (4.0 * rows + 0.0).astype("<f4").view("<u2").reshape(-1, 2)[:, ::-1].tobytes()
    else:
        data = rows.astype(f"{order}f4").tobytes()
    head = bytes([2, 0x50]) + header
    whole = head.ljust(512, b"\0") + bytes([1, 0x50, blocks & 0xFF, PROCESSORS[processor]]) + parameters
    whole = whole.ljust(512 * (1 + blocks), b"\0") + data
    return whole.ljust(-(-len(whole) // 512) * 512, b"\0")
