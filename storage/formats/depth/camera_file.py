"""Read the file of a depth camera: YAML of kinedex, JSON of RealSense, Open3D or Azure Kinect, or text of TUM RGB-D."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.configs import Located, parse_yaml
from kinedex.catalog.depth_cameras import FASTEST_HZ, DepthCamera
from kinedex.ops.errors import ConfigError, ParameterError
from kinedex.storage.disk import whole_file
from kinedex.storage.formats.depth.vendor_cameras import vendor_camera
from kinedex.storage.formats.motion.keypoint_frames import load_json
from kinedex.storage.formats.small_files import read_bytes

F64 = npt.NDArray[np.float64]

TUM_UNIT_M = 1 / 5000
"""Metres per unit of the images of TUM RGB-D."""

MOST_BYTES = 1 << 20
"""The largest size of a camera file in bytes."""

_ENDINGS = (".yaml", ".yml", ".json", ".txt")
_ROTATION_ERROR = 0.01
_Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e9, le=1e9)]
_Vector = Annotated[list[_Number], Field(min_length=3, max_length=3)]


class CameraPose(BaseModel):
    """The pose of a camera: x_camera = rotation · (x_world − place).

    Attributes
    ----------
    rotation : list of 3 lists of 3 floats
        The rotation matrix from world axes to camera axes.
    place : list of 3 floats
        Its centre in the world in metres.
    """

    model_config = ConfigDict(extra="forbid")
    rotation: Annotated[list[_Vector], Field(min_length=3, max_length=3)]
    place: _Vector


class CameraValues(BaseModel):
    """The keys of a camera's YAML file.

    Attributes
    ----------
    width, height : int
        The size of its images in pixels.
    fx, fy, cx, cy : float
        Focal lengths and principal point in pixels; the centre of the first pixel is (0, 0).
    depth_unit_m : float
        Metres of one unit of integer images.
    distortion : list of float
        0, 4, 5 or 8 numbers in OpenCV's order.
    rate_hz : float, optional
        Frames per second.
    range : bool
        True if images hold distances along the ray instead of depths z.
    pose : CameraPose, optional
        Its place in the world.
    up : list of 3 floats, optional
        A vector that points upwards, in the camera's axes (x right, y down, z forward).
    """

    model_config = ConfigDict(extra="forbid")
    width: Annotated[int, Field(gt=0, le=100_000)]
    height: Annotated[int, Field(gt=0, le=100_000)]
    fx: _Number
    fy: _Number
    cx: _Number
    cy: _Number
    depth_unit_m: Annotated[float, Field(gt=0, le=1)]
    distortion: Annotated[list[_Number], Field(max_length=8)] = []
    rate_hz: Annotated[float, Field(gt=0, le=FASTEST_HZ)] | None = None
    range: bool = False
    pose: CameraPose | None = None
    up: _Vector | None = None


def read_camera(path: str | Path, size: tuple[int, int] | None = None) -> DepthCamera:
    """Read the camera of a depth recording.

    Parameters
    ----------
    path : str or Path
        A file ending in .yaml, .yml, .json or .txt.
    size : tuple of (int, int), optional
        Width and height of the images in pixels, for files that do not state them (TUM RGB-D, Azure Kinect).

    Returns
    -------
    DepthCamera
        The camera.

    Raises
    ------
    ConfigError
        The file describes no camera; the message names line and key.
    SourceError
        The file cannot be read.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in _ENDINGS:
        raise ConfigError(path, f"expected the file of a depth camera ending in {', '.join(_ENDINGS)}")
    if ending == ".json":
        return vendor_camera(Located(path, load_json(path)), size)
    text = _text(path)
    return _tum_camera(path, text, size) if ending == ".txt" else parse_camera(parse_yaml(text, path))


def parse_camera(located: Located) -> DepthCamera:
    """Return the camera that parsed YAML describes.

    Raises
    ------
    ConfigError
        A key is missing or invalid.
    """
    located.mapping()
    values = located.model(CameraValues)
    rotation = place = None
    if values.pose is not None:
        rotation, place = _rotation(located, values.pose.rotation), np.array(values.pose.place)
    matrix = np.array([[values.fx, 0, values.cx], [0, values.fy, values.cy], [0, 0, 1]])
    try:
        return DepthCamera(
            matrix, np.array(values.distortion), (values.width, values.height), values.depth_unit_m, values.rate_hz,
            values.range, rotation, place, None if values.up is None else np.array(values.up),
        )  # fmt: skip
    except ParameterError as fault:
        keys: Mapping[str, tuple[str, ...]] = {"matrix": ("fx",), "place": ("pose", "place")}
        raise located.error(str(fault), *keys.get(fault.name, (fault.name,))) from None


def write_camera(path: str | Path, camera: DepthCamera) -> None:
    """Write a camera as YAML, whole or not at all; every number is read back to the bit.

    Parameters
    ----------
    path : str or Path
        The file.
    camera : DepthCamera
        The camera, without skew.

    Raises
    ------
    ParameterError
        The camera has skew, for which the file has no key.
    """
    (fx, skew, cx), (_, fy, cy) = camera.matrix[:2].tolist()
    if skew:
        raise ParameterError("camera", "one without skew", skew)
    values: dict[str, Any] = {"width": camera.size[0], "height": camera.size[1], "fx": fx, "fy": fy, "cx": cx, "cy": cy}
    values["depth_unit_m"] = float(camera.depth_unit_m)
    if camera.distortion.any():
        values["distortion"] = camera.distortion.tolist()
    if camera.rate_hz is not None:
        values["rate_hz"] = float(camera.rate_hz)
    if camera.is_range:
        values["range"] = True
    lines = [f"{key}: {_written(value)}" for key, value in values.items()]
    if camera.rotation is not None and camera.place is not None:
        lines += [
            "pose:                # x_camera = rotation · (x_world − place): world in metres, Y up, floor at Y = 0"
        ]
        lines += [f"  rotation: {_written(camera.rotation.tolist())}", f"  place: {_written(camera.place.tolist())}"]
    if camera.up is not None:
        lines.append(f"up: {_written(camera.up.tolist())}")
    with whole_file(Path(path)) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _written(value: object) -> str:
    """Format a number, a bool or a list of them as YAML; an exponent needs a decimal point to be read as a number."""
    if isinstance(value, list):
        return f"[{', '.join(map(_written, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    text = repr(value)
    if "e" in text:
        digits, exponent = text.split("e")
        text = f"{digits}{'' if '.' in digits else '.0'}e{int(exponent):+d}"
    return text


def _rotation(located: Located, rows: list[list[float]]) -> F64:
    """Return a rotation matrix; a rounded one is replaced by the nearest exact rotation."""
    given = np.array(rows)
    error = np.abs(given @ given.T - np.eye(3)).max()
    if error <= _ROTATION_ERROR and np.linalg.det(given) > 0:
        if error <= 1e-7:
            return given
        u, _, v = np.linalg.svd(given)
        nearest: F64 = u @ v
        return nearest
    raise located.error(
        "must be a rotation, three rows of unit length at right angles, not mirrored", "pose", "rotation"
    )


def _tum_camera(path: Path, text: str, size: tuple[int, int] | None) -> DepthCamera:
    """Return the camera of a text with `fx fy cx cy` and, optionally, k1 k2 p1 p2 k3."""
    numbers: list[float] = []
    for number, line in enumerate(text.splitlines(), 1):
        try:
            numbers += [float(word) for word in line.split("#")[0].replace(",", " ").split()]
        except ValueError:
            raise ConfigError(path, f"expected the numbers fx fy cx cy, got {line[:80]!r}", line=number) from None
    if len(numbers) not in (4, 8, 9):
        raise ConfigError(path, f"expected fx fy cx cy, and optionally k1 k2 p1 p2 k3, got {len(numbers)} numbers")
    if size is None:
        raise ConfigError(path, "states no size of the images; write a YAML file with width and height")
    fx, fy, cx, cy = numbers[:4]
    try:
        return DepthCamera(
            np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), np.array(numbers[4:]), size, depth_unit_m=TUM_UNIT_M
        )
    except ParameterError as fault:
        raise ConfigError(path, str(fault)) from None


def _text(path: Path) -> str:
    data = read_bytes(path, "files of a camera", "write one camera a file")
    if len(data) > MOST_BYTES:
        raise ConfigError(path, f"has {len(data) / 1e6:.1f} MB, and the file of a camera {MOST_BYTES >> 20} MB at most")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as fault:
        raise ConfigError(path, f"is not UTF-8 text (byte {fault.start})") from None
