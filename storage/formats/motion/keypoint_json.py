"""Read keypoints in JSON: a file of frames, or a sequence of files of one frame each, as OpenPose writes it."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path
from typing import ClassVar

import numpy as np

from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.keypoint_frames import (
    FRAMES,
    NAMES,
    PERSONS,
    POINTS_2D,
    POINTS_3D,
    WORLD,
    Keypoints,
    load_json,
    read_keypoints,
)
from kinedex.storage.formats.motion.points import Points
from kinedex.storage.formats.motion.points_reader import PointsReader
from kinedex.storage.formats.motion.reader import (
    FASTEST_HZ,
    SLOWEST_HZ,
    Extent,
    MotionFile,
    ReadSettings,
    body_bytes,
    file_size,
)
from kinedex.storage.formats.motion.table_sections import beginning

_NAMED = [key for key in (*WORLD, *POINTS_3D, *POINTS_2D, *NAMES) if "_" in key or "3d" in key or "L" in key]
_KEYS = re.compile(rf'"({"|".join(_NAMED)})"\s*:')
_KINDS = re.compile(r'"(people|instance_info)"\s*:\s*\[')
_NUMBERED = re.compile(r"(?P<before>.*?)(?P<number>\d+)(?P<after>_keypoints)?$")
_MOST_FILES = 200_000
_PER_BYTE = 12  # bytes of memory per byte of JSON, whose numbers become objects


class KeypointReader(PointsReader):
    """Reads keypoints of persons; a sequence of files is represented by its first one."""

    title: ClassVar[str] = "JSON, keypoints"
    endings: ClassVar[tuple[str, ...]] = (".json",)

    def sniff(self, path: Path) -> bool:
        """Return whether a file begins like one of keypoints, and is not a later one of a sequence."""
        head = beginning(path)
        if not (_KEYS.search(head) or _KINDS.search(head)):
            return False
        files = sequence_of(path, head)
        return not files or files[0] == path

    def persons(self, file: MotionFile, mappings: Mappings) -> tuple[str, ...]:
        """Return the ids of the persons, if there are several."""
        found = tuple(_keypoints(file.path).persons)
        return found if len(found) > 1 else ()

    def size(self, file: MotionFile) -> tuple[int, int, int]:
        """Return the number of files of a sequence as its frames, and the memory of their numbers."""
        files = sequence_of(file.path, beginning(file.path)) or (file.path,)
        return len(files), 0, _PER_BYTE * max(file_size(path) for path in files) + 4000 * len(files)

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Estimate the memory for reading the JSON; the frames of a single file are unknown, and given as 0."""
        frames, _, need = self.size(file)
        return Extent(0 if frames == 1 else frames, need + body_bytes(frames, joints), settings.override_rate_hz)

    def points(self, file: MotionFile, settings: ReadSettings) -> Points:
        """Read the points of one person.

        Raises
        ------
        SourceError
            The file holds 2D keypoints, several persons of whom none is chosen, or is damaged.
        """
        path = file.path
        found = _keypoints(path)
        if file.person not in found.persons and len(found.persons) > 1:
            raise SourceError(
                path, f"holds {len(found.persons)} persons, {', '.join(found.persons)}; ask for one of them"
            )
        frames = found.persons.get(file.person) or next(iter(found.persons.values()))
        positions = np.full((len(found.names), 3, found.frames), np.nan)
        for number, places in frames.items():
            positions[:, :, number] = places
        warnings = []
        if found.world:
            positions[:, 1:] *= -1.0  # MediaPipe's y points down and its z away from the camera
            warnings.append("MediaPipe's world landmarks lie about the hips: the body turns, but stays in its place")
        rate_hz = found.rate_hz
        if rate_hz is not None and not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
            raise SourceError(path, f"the rate must be {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz, got {rate_hz:g}")
        clock = _clock(found)
        unit_m = 1.0 if found.world else None
        return Points(str(path), found.names, positions, rate_hz or clock, clock, unit_m, warnings)


def _clock(found: Keypoints) -> float | None:
    """Return the frames per second from the times of the frames, if all have one; else None."""
    if len(found.times) != found.frames or found.frames < 2:
        return None
    span = found.times[-1] - found.times[0]
    rate_hz = (found.frames - 1) / span if span > 0 else 0.0
    return rate_hz if SLOWEST_HZ <= rate_hz <= FASTEST_HZ else None


def _keypoints(path: Path) -> Keypoints:
    """Read a file, or all files of its sequence; a missing file number is a frame without a person."""
    files = sequence_of(path, beginning(path))
    if len(files) < 2:
        return read_keypoints(path, load_json(path))
    numbers = [_number(other) for other in files]
    frames = numbers[-1] - numbers[0] + 1
    if frames > 10 * len(files):
        raise SourceError(
            path, f"is one of {len(files)} files of a sequence, of whose {frames} frames most are missing"
        )
    whole = Keypoints(frames=frames)
    for other, number in zip(files, numbers, strict=True):
        content = load_json(other)
        if _is_empty(content):
            continue
        found = read_keypoints(other, content)
        if whole.names not in ((), found.names):
            raise SourceError(other, f"has other points than {path.name}")
        whole.names, whole.world, whole.rate_hz = found.names, found.world, found.rate_hz
        for person, at in found.persons.items():
            whole.persons.setdefault(person, {})[number - numbers[0]] = at[0]
    if not whole.persons:
        raise SourceError(path, f"and the {len(files) - 1} files after it have no person in any frame")
    return whole


def _is_empty(content: object) -> bool:
    return isinstance(content, dict) and any(content.get(key) == [] for key in PERSONS)


def sequence_of(path: Path, head: str) -> tuple[Path, ...]:
    """Return the files of the sequence that contains a file, by the numbers in their names; empty for a file of frames.

    Parameters
    ----------
    path : Path
        The file.
    head : str
        The beginning of its text: files of OpenPose have `people` before any frame.
    """
    if any(f'"{key}"' in head for key in FRAMES) or not re.search(
        rf'^\s*\{{.*?"({"|".join(PERSONS)})"', head, re.DOTALL
    ):
        return ()
    found = _NUMBERED.fullmatch(path.stem)
    if found is None:
        return ()
    try:
        stamp = path.parent.stat().st_mtime_ns
    except OSError:
        return ()
    return _sequences(path.parent, stamp).get((found["before"], found["after"] or ""), ())


@lru_cache(maxsize=8)
def _sequences(folder: Path, _stamp: int) -> dict[tuple[str, str], tuple[Path, ...]]:
    """Return the numbered JSON files of a folder in numeric order, grouped by the text before and after the number."""
    found: dict[tuple[str, str], list[Path]] = {}
    for path in folder.iterdir():
        if path.suffix.lower() == ".json" and (parts := _NUMBERED.fullmatch(path.stem)):
            found.setdefault((parts["before"], parts["after"] or ""), []).append(path)
    return {key: tuple(sorted(paths, key=_number)[:_MOST_FILES]) for key, paths in found.items()}


def _number(path: Path) -> int:
    found = _NUMBERED.fullmatch(path.stem)
    return int(found["number"][-15:]) if found else 0
