"""Read the file of a depth camera, from kinedex, RealSense, Open3D, Azure Kinect or TUM RGB-D."""

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
from kinedex.storage.durable_files import whole_file
from kinedex.storage.formats.cameras.camera_values import numbers_of
from kinedex.storage.formats.source_files import load_json, read_bytes, utf8_text

F64 = npt.NDArray[np.float64]

MILLIMETRE_M = 0.001
"""The metres per unit that are assumed if a file states none; the person's distance reveals a wrong unit."""

_AZURE_MODES = {
    (320, 288): (512, 96, 90), (640, 576): (1024, 192, 180), (512, 512): (512, 0, 0), (1024, 1024): (1024, 0, 0),
}  # fmt: skip
"""A dict from the size of Azure Kinect's depth images to the side of the sensor's square image and the numbers of
pixels that are cut off at its left and top.
"""

_UNIT_KEYS = ("depth_unit_m", "depth_scale", "depth_units")
_RATE_KEYS = ("rate_hz", "fps", "framerate")


def vendor_camera(located: Located, size: tuple[int, int] | None) -> DepthCamera:
    """Return the camera of a JSON file.

    Parameters
    ----------
    located : Located
        The content of the file.
    size : tuple of (int, int), optional
        Width and height of the images in pixels, used if the file does not state them.

    Raises
    ------
    ConfigError
        The file has no intrinsics, or its lens model is not supported; the message names the key.
    """
    content = located.mapping()
    if "CalibrationInformation" in content:
        return _azure_camera(located, size)
    at: tuple[str, ...] = ()
    for key in ("intrinsics", "depth_intrinsics", "depth", "intrinsic"):
        if isinstance(content.get(key), Mapping):
            at, content = (key,), {**located.mapping(), **content[key]}
            break
    matrix = _matrix(located, at, content)
    found = _size(located, at, content) or size
    if found is None:
        raise located.error("states no `width` and `height` of the images", *at)
    rate_hz = next((_number(located, at, content, key) for key in _RATE_KEYS if content.get(key) is not None), None)
    return _checked(
        located, at, matrix, _distortion(located, at, content), found, _unit_m(located, at, content), rate_hz
    )


def _matrix(located: Located, at: tuple[str, ...], content: Mapping[str, Any]) -> F64:
    """Return the camera matrix, from `fx fy ppx ppy`, `fx fy cx cy`, or Open3D's `intrinsic_matrix` by columns."""
    for key in ("intrinsic_matrix", "camera_matrix", "K"):
        if key in content:
            numbers = numbers_of(content[key])
            if numbers is None or len(numbers) != 9:
                raise located.error("must be 9 finite numbers", *at, key)
            given = numbers.reshape(3, 3)
            # Open3D writes its matrices by columns, others by rows; the last row is 0 0 1
            return np.ascontiguousarray(given.T if given[2, :2].any() else given)
    keys = ("fx", "fy", "ppx", "ppy") if "ppx" in content else ("fx", "fy", "cx", "cy")
    for key in keys:
        if key not in content:
            raise located.error(
                "no intrinsics: expected `fx fy ppx ppy` (RealSense), `fx fy cx cy`, `intrinsic_matrix` (Open3D) or "
                f"`CalibrationInformation` (Azure Kinect); `{key}` is missing", *at,
            )  # fmt: skip
    fx, fy, cx, cy = (_number(located, at, content, key) for key in keys)
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def _distortion(located: Located, at: tuple[str, ...], content: Mapping[str, Any]) -> F64:
    """Return the distortion coefficients in OpenCV's order; empty if there are none, or if all are 0.

    If the file states a lens model that is not OpenCV's, all must be 0.
    """
    key = next(
        (key for key in ("coeffs", "distortion", "distortion_coefficients", "dist_coeffs") if key in content), ""
    )
    if not key or content[key] is None:
        return np.zeros(0)
    numbers = numbers_of(content[key])
    if numbers is None or len(numbers) not in (0, 4, 5, 8):
        raise located.error("must be 0, 4, 5 or 8 finite numbers (k1 k2 p1 p2 k3 k4 k5 k6)", *at, key)
    model = str(content.get("model", content.get("distortion_model", "")))
    plain = "brown" in model.lower() and "inverse" not in model.lower()
    known = not model or plain or any(word in model.lower() for word in ("none", "plumb", "rational", "opencv"))
    if numbers.any() and not known:
        raise located.error(
            f"the lens model '{model[:60]}' is not read; have the images undistorted (depth aligned to a rectified "
            "stream), and write 0 for each number", *at, key,
        )  # fmt: skip
    return numbers if numbers.any() else np.zeros(0)


def _unit_m(located: Located, at: tuple[str, ...], content: Mapping[str, Any]) -> float:
    """Return metres per unit; RealSense writes this number (0.001), and Open3D the units per metre (1000)."""
    key = next((key for key in _UNIT_KEYS if content.get(key) is not None), "")
    if not key:
        return MILLIMETRE_M
    value = _number(located, at, content, key)
    if not value > 0:
        raise located.error(f"must be above 0, got {value!r}", *at, key)
    return 1 / value if value > 1 else value


def _size(located: Located, at: tuple[str, ...], content: Mapping[str, Any]) -> tuple[int, int] | None:
    if not {"width", "height"} <= content.keys():
        return None
    sides = []
    for key in ("width", "height"):
        value = _number(located, at, content, key)
        if value != round(value) or not 0 < value <= 100_000:
            raise located.error(f"must be a whole number of pixels, got {value!r}", *at, key)
        sides.append(int(value))
    return sides[0], sides[1]


def _azure_camera(located: Located, size: tuple[int, int] | None) -> DepthCamera:
    """Return the depth camera from the calibration stored in an Azure Kinect, for images of a given size.

    The calibration refers to the whole square sensor: lengths are fractions of its side, and pixel corners are at
    integers. The images of each mode are a part of the sensor's image.
    """
    at: tuple[str | int, ...] = ("CalibrationInformation", "Cameras")
    information = located.mapping()["CalibrationInformation"]
    cameras = information.get("Cameras") if isinstance(information, Mapping) else None
    entries = cameras if isinstance(cameras, list) else []
    found = next(
        (i for i, one in enumerate(entries) if isinstance(one, Mapping) and "D0" in str(one.get("Location"))), None
    )
    if found is None:
        raise located.error("no camera with the location CALIBRATION_CameraLocationD0, the depth camera", *at)
    at = (*at, found, "Intrinsics")
    lens = entries[found].get("Intrinsics")
    numbers = numbers_of(lens.get("ModelParameters")) if isinstance(lens, Mapping) else None
    if numbers is None or len(numbers) < 14:
        raise located.error("must be 14 or 15 finite numbers", *at, "ModelParameters")
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, codx, cody, p2, p1 = numbers[:14]
    model = str(lens.get("ModelType", ""))
    if codx or cody or ("BrownConrady" not in model and (p1 or p2)):
        raise located.error(f"the lens model '{model[:60]}' is not read; only that of Brown and Conrady is", *at)
    if size not in _AZURE_MODES:
        given = "images whose size is not known yet" if size is None else f"images of {size[0]} × {size[1]} pixels"
        modes = ", ".join(f"{width} × {height}" for width, height in _AZURE_MODES)
        raise located.error(f"{given}; an Azure Kinect's depth images have {modes}", *at)
    side, left, top = _AZURE_MODES[size]
    matrix = np.array([[fx * side, 0, cx * side - left - 0.5], [0, fy * side, cy * side - top - 0.5], [0, 0, 1]])
    return _checked(located, at, matrix, np.array([k1, k2, p1, p2, k3, k4, k5, k6]), size, MILLIMETRE_M, None)


def _checked(
    located: Located,
    at: tuple[str | int, ...],
    matrix: F64,
    distortion: F64,
    size: tuple[int, int],
    unit_m: float,
    rate_hz: float | None,
) -> DepthCamera:
    """Check values and build the camera from them; errors name the section of the file."""
    try:
        return DepthCamera(matrix, distortion, size, unit_m, rate_hz)
    except ParameterError as fault:
        raise located.error(str(fault), *at) from None


def _number(located: Located, at: tuple[str, ...], content: Mapping[str, Any], key: str) -> float:
    value = content[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e12:
        raise located.error(f"must be a finite number, got {str(value)[:80]!r}", *at, key)
    return float(value)


TUM_UNIT_M = 1 / 5000
"""Metres per unit of the images of TUM RGB-D."""

MAX_BYTES = 1 << 20
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
        The position of the camera's centre in the world, in metres.
    """

    model_config = ConfigDict(extra="forbid")
    rotation: Annotated[list[_Vector], Field(min_length=3, max_length=3)]
    place: _Vector


class CameraValues(BaseModel):
    """The keys of a camera's YAML file.

    Attributes
    ----------
    width, height : int
        The size of the images in pixels.
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
        The pose of the camera in the world.
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
    """Write a camera as YAML, atomically; every number is read back exactly.

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
    """Return a rotation matrix; a rounded matrix is replaced by the nearest exact rotation."""
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
    if len(data) > MAX_BYTES:
        raise ConfigError(path, f"has {len(data) / 1e6:.1f} MB, and the file of a camera {MAX_BYTES >> 20} MB at most")
    return utf8_text(path, data, ConfigError)
