"""Find files of cameras by a pattern, in which `{camera}` stands for the part of a name that differs by camera.

In a pattern, `*` stands for any characters of a name and `?` for one character; all other characters match themselves.
A relative pattern cannot leave the folder of the file that states the pattern.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from kinedex.ops.errors import SourceError

CAMERA = "{camera}"
"""The placeholder for the part of a name that differs by camera."""

MAX_FILES = 2_000_000
"""The largest number of files that a pattern may match."""

_DIGITS = re.compile(r"(\d+)")


@dataclass(frozen=True)
class CameraFiles:
    """The files that a pattern names.

    Attributes
    ----------
    pattern : str
        The pattern.
    files : mapping of str to tuple of Path
        Value of `{camera}` → the files, in natural order; the key is "" for a pattern without `{camera}`.
    """

    pattern: str
    files: Mapping[str, tuple[Path, ...]]

    @property
    def each_camera(self) -> bool:
        """True if the pattern has `{camera}`."""
        return CAMERA in self.pattern


def natural_key(text: str) -> tuple[tuple[int, str], ...]:
    """Return a sort key that compares numbers in names by value: cam2 before cam10."""
    parts = _DIGITS.split(text)
    keys = [(int(part[-18:]), part) if place % 2 else (0, part.casefold()) for place, part in enumerate(parts)]
    return (*keys, (0, text))


def find_files(folder: Path, pattern: str, endings: tuple[str, ...] = (), excluded: Path | None = None) -> CameraFiles:
    """Return the files that a pattern names.

    Parameters
    ----------
    folder : Path
        The folder that a relative pattern starts from.
    pattern : str
        The pattern; if it names a folder, all files of the folder with one of `endings` match.
    endings : tuple of str, optional
        Endings of the files of a folder, such as ".json".
    excluded : Path, optional
        A file that is not returned, although the pattern may match it.

    Raises
    ------
    SourceError
        The pattern leaves the folder or matches nothing, or a folder cannot be read.
    """
    path = Path(pattern)
    parts = path.parts[1:] if path.is_absolute() else path.parts
    if not parts or ".." in parts or "**" in pattern or "\0" in pattern:
        raise SourceError(
            folder,
            f"'{pattern}' must be a path below this folder, without '..' and '**'; files elsewhere need absolute paths",
        )
    found: list[tuple[Path, str | None]] = [(Path(path.anchor) if path.is_absolute() else folder, None)]
    for part in parts:
        found = [match for place, camera in found for match in _step(place, camera, part)]
        if len(found) > MAX_FILES:
            raise SourceError(folder, f"'{pattern}' matches more than {MAX_FILES:,} files")
    if endings:
        found = [match for place, camera in found for match in _inside(place, camera, endings)]
    files: dict[str, list[Path]] = {}
    for place, camera in found:
        if place.is_file() and place != excluded:
            files.setdefault(camera or "", []).append(place)
    if not files:
        below = "" if path.is_absolute() else f" below {folder.absolute()}"
        raise SourceError(
            folder, f"no file matches '{pattern}'{below}; {{camera}} stands for a part of a name, * for letters"
        )
    order = sorted(files, key=natural_key)
    return CameraFiles(
        pattern, {key: tuple(sorted(files[key], key=lambda path: natural_key(str(path)))) for key in order}
    )


def match_cameras(
    path: Path, what: str, names: Iterable[str], labels: Mapping[str, str], files: Iterable[str]
) -> tuple[dict[str, str], str]:
    """Return a dict from camera to the value of `{camera}` in its file names, and a note on how they were matched.

    Cameras and files are matched by name if any name agrees. Otherwise they are matched by natural order, provided that
    there are as many files as cameras.

    Parameters
    ----------
    path : Path
        The file with the pattern, for errors.
    what : str
        The key that states the pattern, for messages.
    names : iterable of str
        The cameras of the calibration.
    labels : mapping of str to str
        Further name of a camera → the camera's name in `names`.
    files : iterable of str
        The values of `{camera}` in the file names.

    Raises
    ------
    SourceError
        No name agrees, and there are more or fewer cameras than files.
    """
    cameras, found = list(names), list(files)
    own = {camera: camera for camera in cameras if camera in found}
    own |= {camera: label for label, camera in labels.items() if camera not in own and label in found}
    if own:
        lone = [camera for camera in cameras if camera not in own]
        other = [value for value in found if value not in own.values()]
        notes = [f"no {what} of camera {', '.join(lone)}"] if lone else []
        notes += (
            [f"{what} of {', '.join(other)}, which the calibration does not have, are passed over"] if other else []
        )
        return {camera: own[camera] for camera in cameras if camera in own}, "; ".join(notes)
    if len(cameras) != len(found):
        raise SourceError(
            path,
            f"{{camera}} stands for {_some(found)} in the files of the {what}, and the calibration has "
            f"{_some(cameras)}: no name is in both, and {len(found)} names cannot be matched with {len(cameras)}; give "
            "the cameras of the calibration the names that the files have",
        )
    pairs = dict(zip(sorted(cameras, key=natural_key), sorted(found, key=natural_key), strict=True))
    listed = ", ".join(f"{camera} = {value}" for camera, value in pairs.items())
    return {camera: pairs[camera] for camera in cameras}, f"{what} matched to cameras in natural order: {listed}"


def _some(names: list[str]) -> str:
    return ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")


def _step(place: Path, camera: str | None, part: str) -> Iterable[tuple[Path, str | None]]:
    """Yield the entries of a folder that match one component of the pattern, with the value of `{camera}` so far."""
    plain = not set("*?") & set(part)
    if plain and (camera is not None or CAMERA not in part):
        literal = place / part.replace(CAMERA, camera or "")
        if os.path.lexists(literal):
            yield literal, camera
        return
    expression = _expression(part, camera)
    for name in _names(place):
        if (match := expression.fullmatch(name)) is not None:
            yield place / name, match.groupdict().get("camera") or camera


def _inside(place: Path, camera: str | None, endings: tuple[str, ...]) -> Iterable[tuple[Path, str | None]]:
    if not place.is_dir():
        return [(place, camera)]
    return [(place / name, camera) for name in _names(place) if name.lower().endswith(endings)]


def _names(place: Path) -> list[str]:
    """Return the names in a folder, except hidden ones; the list is empty if the path is not a folder."""
    try:
        return sorted(name for name in os.listdir(place) if not name.startswith("."))
    except (NotADirectoryError, FileNotFoundError):
        return []
    except OSError as fault:
        raise SourceError(place, f"cannot be read: {fault.strerror}") from fault


def _expression(part: str, camera: str | None) -> re.Pattern[str]:
    """Return the regular expression for one component of a pattern."""
    text, known = "", camera is not None
    for piece in re.split(r"(\{camera\}|\*+|\?)", part):
        if piece == CAMERA:
            text += re.escape(camera) if camera is not None else "(?P=camera)" if known else "(?P<camera>.+?)"
            known = True
        elif piece.startswith("*"):
            text += ".*"
        else:
            text += "." if piece == "?" else re.escape(piece)
    return re.compile(text, re.DOTALL)
