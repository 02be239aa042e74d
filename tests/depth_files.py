"""Files of depth recordings for tests: clouds as other programs write them, and a small recording."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from kinedex.catalog.depth_cameras import DepthCamera
from kinedex.storage.formats.depth.camera_file import write_camera
from kinedex.storage.formats.depth.png import write_depth_png

SIZE = (32, 24)
FOCAL = 28.0


def camera(**changed: Any) -> DepthCamera:
    """Return a small camera, 60° wide, whose principal point is the middle."""
    matrix = np.array([[FOCAL, 0, 15.5], [0, FOCAL, 11.5], [0, 0, 1]])
    return DepthCamera(**({"matrix": matrix, "distortion": np.zeros(0), "size": SIZE, "rate_hz": 30.0} | changed))


def room(found: DepthCamera, height: float = 1.0, wall: float = 4.0) -> np.ndarray:
    """Return the depths of a room without people: a floor below a camera that looks level, and a wall."""
    b = found.rays[..., 1]
    with np.errstate(divide="ignore"):
        return np.where(b > 0, np.minimum(height / np.maximum(b, 1e-9), wall), wall).astype(np.float32)


def with_person(depths: np.ndarray, found: DepthCamera, at: float = 0.0, z: float = 2.5) -> np.ndarray:
    """Return depths in which a flat person, 1.6 m high and 0.5 m wide, stands on the floor."""
    a, b = np.moveaxis(found.rays, -1, 0)
    body = (np.abs(a * z - at) < 0.25) & (b * z > -0.6) & (b * z < 1.0)
    return np.where(body & (depths > z), np.float32(z), depths)


def lzf(data: bytes) -> bytes:
    """Return data packed as LZF: a copy wherever the last place of three equal bytes allows it."""
    packed, literals = bytearray(), bytearray()
    places: dict[bytes, int] = {}

    def flush() -> None:
        for start in range(0, len(literals), 32):
            run = literals[start : start + 32]
            packed.append(len(run) - 1)
            packed.extend(run)
        literals.clear()

    i = 0
    while i < len(data):
        key = data[i : i + 3]
        place = places.get(key, -1)
        places[key] = i
        if len(key) < 3 or place < 0 or i - place > 8192:
            literals.append(data[i])
            i += 1
            continue
        count = 3
        while count < 264 and i + count < len(data) and data[place + count] == data[i + count]:
            count += 1
        flush()
        back, length = i - place - 1, count - 2
        packed.append((min(length, 7) << 5) | (back >> 8))
        if length >= 7:
            packed.append(length - 7)
        packed.append(back & 255)
        i += count
    flush()
    return bytes(packed)


def pcd(points: np.ndarray, encoding: str, size: tuple[int, int] | None = None, colour: bool = False) -> bytes:
    """Return points (n, 3) as PCD, with a colour between y and z if wanted."""
    width, height = size or (len(points), 1)
    fields = ["x", "y", "rgb", "z"] if colour else ["x", "y", "z"]
    values = {axis: points[:, i].astype("<f4") for i, axis in enumerate("xyz")}
    values["rgb"] = np.arange(len(points)).astype("<u4")
    kinds = ["U" if name == "rgb" else "F" for name in fields]
    header = (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {' '.join(fields)}\n"
        f"SIZE {' '.join('4' for _ in fields)}\nTYPE {' '.join(kinds)}\nCOUNT {' '.join('1' for _ in fields)}\n"
        f"WIDTH {width}\nHEIGHT {height}\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {width * height}\nDATA {encoding}\n"
    ).encode()
    if encoding == "ascii":
        rows = zip(*(values[name].tolist() for name in fields), strict=True)
        return header + "".join(f"{' '.join(map(repr, row))}\n" for row in rows).encode()
    if encoding == "binary":
        return header + b"".join(b"".join(values[name][i].tobytes() for name in fields) for i in range(len(points)))
    raw = b"".join(values[name].tobytes() for name in fields)
    packed = lzf(raw)
    return header + struct.pack("<II", len(packed), len(raw)) + packed


def ply(points: np.ndarray, encoding: str, more: bool = False) -> bytes:
    """Return points (n, 3) as PLY; `more` adds normals, colours and a face."""
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[encoding]
    kinds = {"x": "float", "nx": "double", "y": "float", "red": "uchar", "z": "float"} if more else {}
    kinds = kinds or dict.fromkeys("xyz", "float")
    header = f"ply\nformat {encoding} 1.0\ncomment made up\nelement vertex {len(points)}\n"
    header += "".join(f"property {kind} {name}\n" for name, kind in kinds.items())
    header += "element face 1\nproperty list uchar int vertex_indices\n" if more else ""
    header += "end_header\n"
    letters = {"float": "f", "double": "d", "uchar": "B"}
    body = b""
    for i, (x, y, z) in enumerate(points.tolist()):
        values = {"x": x, "y": y, "z": z, "nx": 0.5, "red": i % 256}
        row = [values[name] for name in kinds]
        if order:
            body += struct.pack(order + "".join(letters[kind] for kind in kinds.values()), *row)
        else:
            body += (" ".join(map(repr, row)) + "\n").encode()
    if more:
        body += struct.pack(order + "B3i", 3, 0, 1, 2) if order else b"3 0 1 2\n"
    return header.encode() + body


@dataclass
class Recorded:
    """A recording that is written into a folder, and its depths (T, H, W)."""

    folder: Path
    camera: DepthCamera
    depths: np.ndarray

    def write(self, **changed: Any) -> Path:
        """Write recordings.yaml with a recording `walk`, whose keys are changed; None removes one."""
        entry: dict[str, Any] = {"depth": "depth/*.png", "camera": "camera.yaml", "background": "background.png"}
        entry = {key: value for key, value in {**entry, **changed}.items() if value is not None}
        path = self.folder / "recordings.yaml"
        path.write_text(yaml.safe_dump({"recordings": {"walk": entry}}, sort_keys=False), encoding="utf-8")
        return path


def recorded(folder: Path, frames: int = 6, **changed: Any) -> Recorded:
    """Write a recording of a person that walks through a room, in PNG."""
    seen = camera(**changed)
    empty = room(seen)
    depths = np.stack([with_person(empty, seen, 0.3 * t - 0.8) for t in range(frames)])
    (folder / "depth").mkdir(parents=True, exist_ok=True)
    for t, one in enumerate(depths):
        write_depth_png(folder / "depth" / f"frame_{t:04d}.png", one)
    write_depth_png(folder / "background.png", empty)
    write_camera(folder / "camera.yaml", seen)
    return Recorded(folder, seen, depths)


def cloud_points(found: DepthCamera, depths: np.ndarray) -> np.ndarray:
    """Return the points (H · W, 3) of a depth image, row by row; NaN where nothing was measured."""
    z = np.where(depths > 0, depths, np.nan)[..., None]
    return np.concatenate([found.rays * z, z], axis=2).reshape(-1, 3)
