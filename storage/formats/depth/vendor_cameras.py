"""Read intrinsics of depth cameras in JSON, as the programs of RealSense, Open3D and Azure Kinect write them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.catalog.configs import Located
from kinedex.catalog.depth_cameras import DepthCamera
from kinedex.ops.errors import ParameterError
from kinedex.storage.formats.cameras.camera_values import numbers_of

F64 = npt.NDArray[np.float64]

MILLIMETRE_M = 0.001
"""Metres per unit if a file states none; the person's distance reveals a wrong unit."""

_AZURE_MODES = {
    (320, 288): (512, 96, 90), (640, 576): (1024, 192, 180), (512, 512): (512, 0, 0), (1024, 1024): (1024, 0, 0),
}  # fmt: skip
"""A dict from size of the depth images of Azure Kinect to side of the sensor's image, and the pixels cut off at the
left and top.
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
        Width and height of the images in pixels, where the file does not state them.

    Raises
    ------
    ConfigError
        The file has no intrinsics, or those of a lens model that is not supported; the message names the key.
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
    """Return the camera matrix, of `fx fy ppx ppy`, `fx fy cx cy`, or Open3D's `intrinsic_matrix` by columns."""
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
    """Return distortion coefficients in OpenCV's order; another model is refused unless its coefficients are 0."""
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
    """Return metres per unit: RealSense writes that (0.001), Open3D the number of units in a metre (1000)."""
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

    Its numbers refer to the whole square sensor, as fractions of its side, with pixel corners at integers; each mode
    crops its images from it.
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
    """Build the camera from checked values; errors name the section."""
    try:
        return DepthCamera(matrix, distortion, size, unit_m, rate_hz)
    except ParameterError as fault:
        raise located.error(str(fault), *at) from None


def _number(located: Located, at: tuple[str, ...], content: Mapping[str, Any], key: str) -> float:
    value = content[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e12:
        raise located.error(f"must be a finite number, got {str(value)[:80]!r}", *at, key)
    return float(value)
