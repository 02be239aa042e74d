"""Read calibrations of EasyMocap: `intri.yml` and `extri.yml`, whose keys end with the name of a camera, as `K_01`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinedex.catalog.configs import Located
from kinedex.ops.errors import ConfigError
from kinedex.storage.formats.cameras.camera_values import Calibration, camera_of, numbers_of, refuse_names

PREFIXES = {"K": ("K_",), "dist": ("dist_", "D_"), "R": ("R_", "Rot_"), "T": ("T_",)}
"""A dict from key of a camera to the prefixes that EasyMocap writes before the camera's name."""

_FILES = ("intri", "extri")
_ENDINGS = (".yml", ".yaml")


def other_file(path: Path) -> Path | None:
    """Return the other file of an EasyMocap pair, `extri.yml` for `intri.yml` and vice versa; None for other names."""
    if path.suffix.lower() in _ENDINGS:
        for one, other in (_FILES, _FILES[::-1]):
            if one in path.stem:
                return path.with_name(path.name.replace(one, other))
    return None


def is_easymocap(content: Mapping[str, Any]) -> bool:
    """Return whether the keys of a file are those of EasyMocap."""
    beginnings = tuple(one for key, those in PREFIXES.items() if key != "dist" for one in those)
    return any(
        isinstance(key, str) and key.startswith(beginnings) and numbers_of(value) is not None
        for key, value in content.items()
    )


def easymocap_calibration(files: Sequence[Located], size: tuple[int, int] | None) -> Calibration:
    """Return the cameras of files of EasyMocap.

    Parameters
    ----------
    files : sequence of Located
        The file of intrinsics and that of poses, or one with both.
    size : tuple of (int, int), optional
        Width and height of the images in pixels, where the files have none.

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
    """The files of a calibration as one; an error names the file that has the key, and the key as written in it."""

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
    if set(order) & set(found):  # unquoted names lose leading zeros in YAML: then the list is ignored
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
