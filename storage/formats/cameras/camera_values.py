"""Check the values of a section of a calibration file in any format, and make a camera from them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.catalog.cameras import Camera
from kinedex.catalog.configs import Located
from kinedex.ops.body.axisangle import matrices
from kinedex.ops.errors import ParameterError, did_you_mean

F64 = npt.NDArray[np.float64]

MAX_CAMERAS = 1000
"""The largest number of cameras in a calibration."""

KEYS = {
    "matrix": ("matrix", "camera_matrix", "cameraMatrix", "intrinsic_matrix", "intrinsics", "K"),
    "distortion": (
        "distortion", "distortions", "dist_coeffs", "distCoeffs", "distortion_coefficients", "dist_coefs", "distCoef",
        "dist",
    ),
    "rotation": ("rotation", "R", "rvec", "rotation_matrix", "rotation_vector", "r"),
    "translation": ("translation", "T", "tvec", "translation_vector", "t"),
    "centre": ("centre", "center"),
    "size": ("size", "image_size", "resolution", "imageSize", "img_size"),
}  # fmt: skip
"""A dict from each attribute of a camera to the keys under which programs write the attribute."""

_MAX_NUMBERS = 64
_NO_POINT = re.compile(r"[-+]?[0-9]{1,18}[eE][-+]?[0-9]{1,2}")
_ROTATION_ERROR = 0.01


@dataclass(frozen=True)
class Calibration:
    """The cameras of a calibration file, in the unit and the axes of the file.

    Attributes
    ----------
    path : str
        The file.
    kind : str
        The kind of file, for messages.
    cameras : tuple of Camera
        The cameras, in the order of the file.
    unit : str
        The unit of lengths in the file, "m", "cm" or "mm"; empty if the kind of file does not determine it.
    up : str
        The axis of the world that points up, such as "z" or "-y"; empty if the kind of file does not determine it.
    labels : mapping of str to str
        Other names of cameras, such as a `name` inside a section → the camera's name.
    """

    path: str
    kind: str
    cameras: tuple[Camera, ...]
    unit: str = ""
    up: str = ""
    labels: Mapping[str, str] | None = None


def value_of(values: Mapping[str, Any], attribute: str) -> str:
    """Return the key under which a section has an attribute of a camera; empty if it has none."""
    return next((key for key in KEYS[attribute] if key in values), "")


def camera_of(
    located: Located, at: tuple[str | int, ...], name: str, values: Mapping[str, Any], size: tuple[int, int] | None
) -> Camera:
    """Return the camera of one section of a calibration.

    Parameters
    ----------
    located : Located
        The file.
    at : tuple
        The key of the section in it.
    name : str
        The camera's name.
    values : mapping
        The section.
    size : tuple of (int, int), optional
        Width and height of the images, used if the section does not state them.

    Raises
    ------
    ConfigError
        A value is missing or invalid, or the lens has an unsupported model; the message names the key.
    """
    _refuse_other_lenses(located, at, values)
    matrix = _read(located, at, values, "matrix", (9,)).reshape(3, 3)
    rotation = _rotation(located, at, values)
    key = value_of(values, "centre")
    if value_of(values, "translation") or not key:
        translation = _read(located, at, values, "translation", (3,))
    else:
        translation = -rotation @ _read(located, at, values, "centre", (3,))
    parts = (matrix, _distortion(located, at, values), rotation, translation, _size(located, at, values, size))
    try:
        return Camera(name, *parts)
    except ParameterError as fault:
        key = value_of(values, fault.name) or fault.name
        raise located.error(f"camera '{name}': {fault}", *at, key) from None


def numbers_of(value: object) -> F64 | None:
    """Return the numbers of nested lists or of an OpenCV matrix as a flat array; None for anything else."""
    if isinstance(value, Mapping) and "data" in value:
        rows, columns, data = value.get("rows"), value.get("cols"), numbers_of(value["data"])
        if data is None or not isinstance(rows, int | float) or not isinstance(columns, int | float):
            return None
        return data if rows * columns == len(data) else None
    flat: list[float] = []
    waiting: list[object] = [value]
    while waiting:
        one = waiting.pop()
        if isinstance(one, str) and _NO_POINT.fullmatch(one):  # YAML 1.1 reads 1e-05 as text
            one = float(one)
        if isinstance(one, list):
            if len(flat) + len(waiting) + len(one) > _MAX_NUMBERS:
                return None
            waiting.extend(reversed(one))
        elif isinstance(one, int | float) and not isinstance(one, bool) and abs(one) < 1e300:
            flat.append(float(one))
        else:
            return None
    return np.array(flat)


def _read(
    located: Located, at: tuple[str | int, ...], values: Mapping[str, Any], attribute: str, counts: tuple[int, ...]
) -> F64:
    """Return the numbers of an attribute, whose count must be one of `counts`."""
    key = value_of(values, attribute)
    if not key:
        near = did_you_mean(attribute, [str(name) for name in values])
        expected = " or ".join(f"`{name}`" for name in KEYS[attribute][:4])
        raise located.error(f"camera without {expected}{near}", *at)
    found = numbers_of(values[key])
    if found is None or len(found) not in counts:
        expected = " or ".join(str(count) for count in counts)
        got = "something else" if found is None else f"{len(found)}"
        raise located.error(f"must be {expected} finite numbers, got {got}", *at, key)
    return found


def _rotation(located: Located, at: tuple[str | int, ...], values: Mapping[str, Any]) -> F64:
    """Return the rotation that is nearest to a 3 × 3 matrix, or the rotation of a Rodrigues vector."""
    numbers = _read(located, at, values, "rotation", (3, 9))
    if len(numbers) == 3:
        if np.abs(numbers).max() > 100:
            raise located.error("must be a rotation vector in radians", *at, value_of(values, "rotation"))
        turned: F64 = matrices(numbers[None])[0]
        return turned
    given = numbers.reshape(3, 3)
    if np.abs(given).max() <= 1 + _ROTATION_ERROR:
        u, _, v = np.linalg.svd(given)
        nearest: F64 = u @ v
        if np.linalg.det(nearest) > 0 and np.abs(nearest - given).max() <= _ROTATION_ERROR:
            return nearest
    key = value_of(values, "rotation")
    raise located.error("must be a rotation, three rows of unit length at right angles, not mirrored", *at, key)


def _distortion(located: Located, at: tuple[str | int, ...], values: Mapping[str, Any]) -> F64:
    """Return the distortion coefficients; trailing zeros of longer models are dropped."""
    key = value_of(values, "distortion")
    if not key or values[key] is None:
        return np.zeros(0)
    numbers = numbers_of(values[key])
    if numbers is None:
        raise located.error("must be numbers in OpenCV's order: k1 k2 p1 p2 k3 k4 k5 k6", *at, key)
    used = np.trim_zeros(numbers, "b")
    count = next((count for count in (0, 4, 5, 8) if len(used) <= count), 0)
    if len(used) > 8 or len(numbers) in (1, 2, 3):
        raise located.error(
            f"must be 4, 5 or 8 numbers (k1 k2 p1 p2 k3 k4 k5 k6), got {len(numbers)}: lenses with more terms are not "
            "read; calibrate with fewer ones (OpenCV without CALIB_THIN_PRISM_MODEL and CALIB_TILTED_MODEL)",
            *at,
            key,
        )
    return np.pad(used, (0, count - len(used)))


def _size(
    located: Located, at: tuple[str | int, ...], values: Mapping[str, Any], size: tuple[int, int] | None
) -> tuple[int, int]:
    """Return width and height of the images in pixels."""
    key = value_of(values, "size")
    if key:
        numbers = numbers_of(values[key])
    elif {"image_width", "image_height"} <= values.keys():
        key, numbers = "image_width", numbers_of([values["image_width"], values["image_height"]])
    elif {"width", "height"} <= values.keys():
        key, numbers = "width", numbers_of([values["width"], values["height"]])
    elif size is not None:
        return size
    else:
        raise located.error(
            "camera without the size of its images; write `size: [width, height]` in the recording", *at
        )
    if numbers is None or len(numbers) != 2 or (numbers != np.round(numbers)).any() or np.abs(numbers).max() > 1e6:
        raise located.error("must be width and height in whole pixels", *at, key)
    return int(numbers[0]), int(numbers[1])


def _refuse_other_lenses(located: Located, at: tuple[str | int, ...], values: Mapping[str, Any]) -> None:
    for key in ("fisheye", "omnidirectional"):
        if values.get(key) not in (None, False, 0):
            raise located.error(
                f"{key} lenses are not read; undistort images and keypoints first, and write a pinhole camera",
                *at,
                key,
            )
    for key in ("distortion_model", "camera_model", "model", "lens"):
        model = values.get(key)
        if isinstance(model, str) and any(word in model.lower() for word in ("fish", "equi", "omni", "kannala", "fov")):
            raise located.error(
                f"lenses of the model '{model[:40]}' are not read; undistort the images and their keypoints first",
                *at,
                key,
            )


def refuse_names(located: Located, names: list[str]) -> None:
    """Raise an error unless there are 1 to `MAX_CAMERAS` cameras, with printable names that all differ."""
    if not 1 <= len(names) <= MAX_CAMERAS:
        raise located.error(f"expected 1 to {MAX_CAMERAS} cameras, found {len(names)}")
    seen: set[str] = set()
    for name in names:
        if not name or len(name) > 200 or not name.isprintable():
            raise located.error(f"a camera must have a name of 1 to 200 characters, got {name[:50]!r}")
        if name in seen:
            raise located.error(f"two cameras are called '{name}'; rename one of them")
        seen.add(name)
