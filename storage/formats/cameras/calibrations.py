"""Read calibrations of cameras in the formats of OpenCV, EasyMocap, AniPose, Pose2Sim and CMU Panoptic.

In every format, x_camera = R · X + t. Cameras have the unit and the axes of their file until `in_metres` converts them
to a world in metres with Y up.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.catalog.cameras import Camera
from kinedex.catalog.configs import Located, parse_yaml
from kinedex.ops.errors import ConfigError
from kinedex.storage.formats.cameras.camera_values import (
    Calibration,
    camera_of,
    numbers_of,
    refuse_names,
    value_of,
)
from kinedex.storage.formats.source_files import file_size, load_json, read_bytes, utf8_text

PREFIXES = {"K": ("K_",), "dist": ("dist_", "D_"), "R": ("R_", "Rot_"), "T": ("T_",)}
"""A dict from each key of a camera to the prefixes that EasyMocap writes before the camera's name."""

_FILES = ("intri", "extri")
_ENDINGS = (".yml", ".yaml")


def other_file(path: Path) -> Path | None:
    """Return the other file of an EasyMocap pair: `extri.yml` for `intri.yml`, and vice versa; None for other names."""
    if path.suffix.lower() in _ENDINGS:
        for one, other in (_FILES, _FILES[::-1]):
            if one in path.stem:
                return path.with_name(path.name.replace(one, other))
    return None


def easymocap_calibration(files: Sequence[Located], size: tuple[int, int] | None) -> Calibration:
    """Return the cameras that files of EasyMocap describe.

    Parameters
    ----------
    files : sequence of Located
        The file of intrinsics and the file of poses, or one file with both.
    size : tuple of (int, int), optional
        Width and height of the images in pixels, used if the files do not state them.

    Raises
    ------
    ConfigError
        A key of a camera is missing or invalid; the message names file, line and key.
    """
    content = {str(key): value for file in reversed(files) for key, value in file.mapping().items()}
    names = _names(files, content)
    keys = {name: {key: _key(files, content, key, name) for key in PREFIXES} for name in names}
    both = _Files(files[0].path, content, {}, tuple(files), keys)
    cameras = []
    for name in names:
        values = {key: content[own] for key, own in keys[name].items() if own}
        image = numbers_of([content.get(f"W_{name}"), content.get(f"H_{name}")])
        if image is not None and len(image) == 2 and image.min() > 0:
            values["size"] = image.tolist()
        cameras.append(camera_of(both, (name,), name, values, size))
    return Calibration(str(files[0].path), "a calibration of EasyMocap", tuple(cameras), "m")


@dataclass(frozen=True)
class _Files(Located):
    """The files of a calibration, read as one; an error names the file with the key, and the key as written there."""

    files: tuple[Located, ...] = ()
    keys: Mapping[str, Mapping[str, str]] | None = None

    def error(self, message: str, *key: str | int) -> ConfigError:
        """Return an error that names the file of a key, the key and its line."""
        name, *rest = key
        own = (self.keys or {}).get(str(name), {})
        written = own.get(str(rest[0])) or f"W_{name}" if rest else own.get("K", "")
        file = next((one for one in self.files if written in one.mapping()), self.files[0])
        return file.error(message, written)


def _names(files: Sequence[Located], content: Mapping[str, Any]) -> list[str]:
    """Return the names of the cameras in the order of the list `names`, or of the keys of their matrices."""
    found = [key.removeprefix("K_") for key in content if key.startswith("K_")]
    listed = content.get("names")
    order = [str(name) for name in listed] if isinstance(listed, list) else []
    if not found:
        raise files[0].error(
            "expected the lenses of cameras (`K_01`, `dist_01`, …) in intri.yml, beside extri.yml with `R_01` and "
            "`T_01`"
        )
    if set(order) & set(found):  # unquoted names lose their leading zeros in YAML; the list is ignored if no name fits
        missing = next((name for name in order if name not in found), None)
        if missing is not None:
            at = next(file for file in files if "names" in file.mapping())
            raise at.error(f"lists camera '{missing}', which has no `K_{missing}`; remove its name", "names")
        found = order
    refuse_names(files[0], found)
    return found


def _key(files: Sequence[Located], content: Mapping[str, Any], key: str, name: str) -> str:
    """Return the key under which the files have a camera's value; empty for a missing distortion."""
    expected = [f"{beginning}{name}" for beginning in PREFIXES[key]]
    found = next((one for one in expected if one in content), "")
    if not found and key != "dist":
        where = " and ".join(file.path.name for file in files)
        raise files[-1].error(
            f"camera '{name}' has no {' or '.join(f'`{one}`' for one in expected)} in {where}; EasyMocap writes lenses "
            "into intri.yml and places into extri.yml, which must lie in one folder"
        )
    return found


F64 = npt.NDArray[np.float64]

UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
"""A dict from unit of length to its size in metres."""

_TURNS = {
    "y": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "z": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "x": ((0, 0, 1), (1, 0, 0), (0, 1, 0)),
    "-y": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "-z": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-x": ((0, 1, 0), (-1, 0, 0), (0, 0, 1)),
}

UP_AXES = tuple(_TURNS)
"""Axes that can point up."""

_MAX_BYTES = {".json": 16 << 20}
_FEWEST_BYTES = 1 << 20  # bytes; the limit for YAML and TOML, which are small

ENDINGS = (".yaml", ".yml", ".json", ".toml")
"""File endings of calibrations."""


def read_calibration(path: str | Path, size: tuple[int, int] | None = None) -> Calibration:
    """Read the cameras of a calibration.

    Parameters
    ----------
    path : str or Path
        A file ending in .yaml, .yml, .json or .toml. Of EasyMocap's two files, `intri.yml` and `extri.yml`, either one.
    size : tuple of (int, int), optional
        Width and height of the images in pixels, for files that do not state them.

    Returns
    -------
    Calibration
        The cameras in the file's unit and axes; a camera at the top level gets the file's name.

    Raises
    ------
    ConfigError
        The file is not a calibration, or uses an unsupported lens model; the message names line and key.
    SourceError
        The file cannot be read.
    """
    path = Path(path)
    located = _load(path)
    if path.suffix.lower() == ".toml":
        return _toml(located, size)
    content = located.mapping()
    beginnings = tuple(one for key, those in PREFIXES.items() if key != "dist" for one in those)
    if any(
        isinstance(key, str) and key.startswith(beginnings) and numbers_of(value) is not None
        for key, value in content.items()
    ):
        return easymocap_calibration(
            # first the file with the camera matrices, then the file with the cameras' poses
            sorted(
                [located, *map(_load, calibration_files(path)[1:])],
                key=lambda file: not any(str(key).startswith("K_") for key in file.mapping()),
            ),
            size,
        )
    cameras = content.get("cameras")
    if isinstance(cameras, list) and all(isinstance(one, Mapping) for one in cameras):
        if all({"K", "R", "t"} <= one.keys() for one in cameras) and cameras:
            return _panoptic(located, cameras, size)
        names = [str(one.get("name", f"cam{i + 1}")) for i, one in enumerate(cameras)]
        refuse_names(located, names)
        places: dict[str, tuple[str | int, ...]] = {name: ("cameras", i) for i, name in enumerate(names)}
        return _sections(located, dict(zip(names, cameras, strict=True)), places, size)
    if isinstance(cameras, Mapping):
        return _sections(located, _mappings(cameras), {str(name): ("cameras", name) for name in cameras}, size)
    if value_of(content, "matrix"):
        return _sections(located, {path.stem: content}, {path.stem: ()}, size)
    return _sections(located, _mappings(content), {str(name): (name,) for name in content}, size)


def calibration_files(path: Path) -> tuple[Path, ...]:
    """Return all files of the calibration that a path belongs to: two for EasyMocap, one otherwise."""
    other = other_file(path)
    return (path,) if other is None or not other.is_file() else (path, other)


def _load(path: Path) -> Located:
    """Return the content of a file, parsed by the format of its extension."""
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise ConfigError(path, f"expected a calibration ending in {', '.join(ENDINGS)}")
    most = _MAX_BYTES.get(ending, _FEWEST_BYTES)
    if file_size(path) > most:
        raise ConfigError(path, f"has {file_size(path) / 1e6:.1f} MB; calibrations have at most {most >> 20} MB")
    if ending == ".json":
        return Located(path, load_json(path))
    return _load_toml(path) if ending == ".toml" else _load_opencv_yaml(path)


def in_metres(calibration: Calibration, unit: str | None, up: str | None) -> tuple[Camera, ...]:
    """Return the cameras of a calibration in a world in metres with Y up.

    Parameters
    ----------
    calibration : Calibration
        The cameras of a file.
    unit : str, optional
        "m", "cm", "mm" or "in"; None for the usual unit of files of this kind.
    up : str, optional
        The axis that points up; None for the usual one in files of this kind.

    Raises
    ------
    ConfigError
        `unit` or `up` is None, and the kind of file does not determine it.
    """
    for key, given, known, values in (
        ("unit", unit, calibration.unit, UNITS_M),
        ("up", up, calibration.up, UP_AXES),
    ):
        if not (given or known):
            raise ConfigError(
                calibration.path,
                f"{calibration.kind} does not state {'its unit' if key == 'unit' else 'which axis points up'}; write "
                f"`{key}:` in the recording, one of {', '.join(values)}",
            )
    turn = np.array(_TURNS[up or calibration.up], np.float64)
    scale = UNITS_M[unit or calibration.unit]
    return tuple(camera.in_world(turn, scale) for camera in calibration.cameras)


def _mappings(content: Mapping[Any, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the sections that have a camera matrix; other sections, such as `metadata`, describe no camera."""
    return {
        str(name): values
        for name, values in content.items()
        if isinstance(values, Mapping) and value_of(values, "matrix")
    }


def _sections(
    located: Located,
    entries: Mapping[str, Mapping[str, Any]],
    places: Mapping[str, tuple[str | int, ...]],
    size: tuple[int, int] | None,
) -> Calibration:
    """Return the cameras of an OpenCV file, which states neither unit nor up axis."""
    if not entries:
        raise located.error(
            "expected cameras, each with `camera_matrix`, `dist_coeffs`, `rvec` or `R`, and `tvec` or `T`"
        )
    refuse_names(located, list(entries))
    cameras = tuple(camera_of(located, places[name], name, one, size) for name, one in entries.items())
    return Calibration(str(located.path), "a calibration of OpenCV", cameras)


def _panoptic(located: Located, entries: list[Mapping[str, Any]], size: tuple[int, int] | None) -> Calibration:
    names = [str(one.get("name", i)) for i, one in enumerate(entries)]
    refuse_names(located, names)
    cameras = tuple(
        camera_of(located, ("cameras", i), name, one, size)
        for i, (name, one) in enumerate(zip(names, entries, strict=True))
    )
    return Calibration(str(located.path), "a calibration of CMU Panoptic", cameras, "cm", "-y")


def _toml(located: Located, size: tuple[int, int] | None) -> Calibration:
    """Return the cameras of a TOML file: Pose2Sim writes `fisheye` into each section, AniPose only where it is true."""
    content = located.mapping()
    entries = _mappings(content)
    if not entries:
        raise located.error(
            "expected a section for each camera with `matrix`, `distortions`, `rotation`, `translation`"
        )
    refuse_names(located, list(entries))
    cameras = tuple(camera_of(located, (name,), name, one, size) for name, one in entries.items())
    labels = {str(one["name"]): name for name, one in entries.items() if one.get("name") not in (None, name)}
    if any("fisheye" in one for one in entries.values()):
        return Calibration(str(located.path), "a calibration of Pose2Sim", cameras, "m", "z", labels)
    return Calibration(str(located.path), "a calibration of AniPose", cameras, "mm", "", labels)


def _load_toml(path: Path) -> Located:
    """Return a TOML file with the lines of its sections and of the keys in them."""
    text = _text(path)
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as fault:
        found = re.search(r"\(at line (\d+)", str(fault))
        raise ConfigError(path, f"is not valid TOML: {fault}", line=int(found[1]) if found else None) from None
    except (RecursionError, ValueError) as fault:
        raise ConfigError(path, f"is not TOML that can be read: {str(fault)[:200]}") from None
    return Located(path, data, _toml_lines(text.split("\n")))


def _toml_lines(lines: Iterable[str]) -> dict[tuple[str | int, ...], int]:
    """Return the line numbers of sections and keys in the usual TOML notation; in other notations they have none."""
    found: dict[tuple[str | int, ...], int] = {}
    section: tuple[str | int, ...] = ()
    for number, line in enumerate(lines, 1):
        if (header := re.match(r'\s*\[\s*"?([^\]\["]+?)"?\s*\]', line)) is not None:
            section = (header[1],)
            found.setdefault(section, number)
        elif (key := re.match(r"\s*([A-Za-z0-9_-]+)\s*=", line)) is not None:
            found.setdefault((*section, key[1]), number)
    return found


def _load_opencv_yaml(path: Path) -> Located:
    """Load a YAML file of OpenCV; its first line, %YAML:1.0, is not valid YAML and is replaced by an empty line."""
    text = _text(path)
    if text.startswith("%YAML:1.0"):
        _, end, rest = text.partition("\n")
        text = end + rest
    return parse_yaml(text, path)


def _text(path: Path) -> str:
    return utf8_text(path, read_bytes(path, "calibrations", "write one calibration a file"), ConfigError)
