"""Read keypoints in JSON: persons in the frames of a file, or in a sequence of files as OpenPose writes it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from kinedex.catalog.keypoint_sets import keypoint_sets_by_count
from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.points import Points, PointsReader
from kinedex.storage.formats.motion.reader import (
    FASTEST_HZ,
    MAX_POINTS,
    SLOWEST_HZ,
    Extent,
    MotionFile,
    ReadSettings,
    body_bytes,
)
from kinedex.storage.formats.source_files import beginning, file_size, load_json

F64 = npt.NDArray[np.float64]

FRAMES = ("frames", "instance_info", "results", "data", "poses")
PERSONS = ("people", "persons", "instances")
WORLD = (
    "world_landmarks", "pose_world_landmarks", "worldLandmarks", "poseWorldLandmarks",
)  # fmt: skip
"""Keys of MediaPipe's landmarks in metres relative to the hips, with y down."""

POINTS_3D = (
    "pose_keypoints_3d", "keypoints_3d", "keypoints3d", "joints_3d", "joints3d", "positions", "joints", "keypoints",
)  # fmt: skip
POINTS_2D = ("pose_keypoints_2d", "keypoints_2d", "keypoints2d", "landmarks", "pose_landmarks", "poseLandmarks")
IDS = ("person_id", "track_id", "instance_id", "id")
NAMES = ("names", "joint_names", "keypoint_names")
RATES = ("fps", "rate_hz", "frame_rate", "framerate", "frameRate")
TIMES = {"time": 1.0, "timestamp": 1.0, "timestamp_s": 1.0, "timestamp_ms": 0.001, "time_ms": 0.001}

FLAT_2D = (
    "holds keypoints of one image, without depth: lift them to 3D, or triangulate those of several calibrated cameras, "
    "and ingest the 3D points"
)

_FARTHEST = 1e9


@dataclass
class Keypoints:
    """The keypoints of a file.

    Attributes
    ----------
    persons : dict of str to dict of int to float64 array (N, 3)
        Person → frame → positions; NaN for a missing point.
    names : tuple of str
        Names of the N points; empty if the file has none and their number is not that of a known set.
    frames : int
        The number of frames.
    times : list of float
        The times in seconds of the frames that have one.
    rate_hz : float, optional
        Frames per second, if the file states them.
    world : bool
        True for landmarks of MediaPipe in metres relative to the hips.
    """

    persons: dict[str, dict[int, F64]] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    frames: int = 0
    times: list[float] = field(default_factory=list)
    rate_hz: float | None = None
    world: bool = False


def read_keypoints(path: Path, content: Any) -> Keypoints:
    """Read the keypoints of a file of frames.

    Parameters
    ----------
    path : Path
        The file, for errors.
    content : object
        Its content as JSON: a list of frames, an object that holds one, or a single frame.

    Raises
    ------
    SourceError
        The content has no known form, or no depth coordinate; the error names the frame.
    """
    found = Keypoints()
    frames = content
    if isinstance(content, Mapping):
        key = next((key for key in FRAMES if isinstance(content.get(key), list)), None)
        frames = content[key] if key is not None else [content]
        _header(found, content)
    if not isinstance(frames, list) or not frames:
        raise SourceError(path, "expected a list of frames, or an object with a list `frames` of them")
    for number, frame in enumerate(frames):
        _frame(path, found, number, frame)
    found.frames = len(frames)
    if not found.persons:
        raise SourceError(path, "has no person in any frame")
    return found


def _header(found: Keypoints, content: Mapping[str, Any]) -> None:
    """Set the keypoint names and frame rate of `found` from the file's top-level object, if they are valid."""
    rate = next((content[key] for key in RATES if isinstance(content.get(key), float)), None)
    found.rate_hz = rate if rate is not None and math.isfinite(rate) else None
    names = next((content[key] for key in NAMES if isinstance(content.get(key), list)), None)
    meta = content.get("meta_info")
    if names is None and isinstance(meta, Mapping) and isinstance(meta.get("keypoint_id2name"), Mapping):
        names = list(meta["keypoint_id2name"].values())
    if names is not None and all(isinstance(name, str) for name in names) and len(set(names)) == len(names):
        found.names = tuple(names)


def _frame(path: Path, found: Keypoints, number: int, frame: Any) -> None:
    """Add the persons of a frame to the keypoints; an empty frame has none."""
    if frame is None or frame == [] or frame == {}:
        return
    persons: Sequence[Any] = [frame]
    if isinstance(frame, Mapping):
        key = next((key for key in PERSONS if isinstance(frame.get(key), list)), None)
        persons = frame[key] if key is not None else persons
        times = [scale * frame[key] for key, scale in TIMES.items() if isinstance(frame.get(key), float)]
        found.times += times[:1]
    read = [(_id(person), _places(path, found, number, person)) for person in persons]
    there = [(called, positions) for called, positions in read if positions is not None]
    ids = {called for called, _ in there}
    if len(there) > 1 and (None in ids or len(ids) < len(there)):
        raise SourceError(
            path, f"frame {number} has {len(there)} persons without an id each, so that nobody can be followed: write "
            "one person a file, or a `track_id` for each",
        )  # fmt: skip
    for called, positions in there:
        found.persons.setdefault(called or "", {})[number] = positions


def _id(person: Any) -> str | None:
    """Return a person's id; None if it is not tracked, for which OpenPose writes [-1]."""
    value = next((person[key] for key in IDS if key in person), None) if isinstance(person, Mapping) else None
    value = value[0] if isinstance(value, list) and value else value
    if isinstance(value, float) and value >= 0 and math.isfinite(value):
        return f"{value:g}"
    return value if isinstance(value, str) and value else None


def _places(path: Path, found: Keypoints, number: int, person: Any) -> F64 | None:
    """Return the points (N, 3) of a person in a frame; None if there are none."""
    points, flat = person, False
    if isinstance(person, Mapping):
        key = next((key for key in (*WORLD, *POINTS_3D) if person.get(key)), None)
        if key is None:
            if any(person.get(key) for key in POINTS_2D):
                raise SourceError(path, f"frame {number}: {FLAT_2D}")
            if any(key in person for key in (*WORLD, *POINTS_3D, *POINTS_2D)):
                return None
            raise SourceError(path, f"frame {number}: expected keypoints under one of {', '.join(POINTS_3D[:5])}, …")
        points, found.world = person[key], found.world or key in WORLD
        flat = key == "keypoints"
    if isinstance(points, list) and len(points) == 1 and isinstance(points[0], list):
        points = points[0]  # MediaPipe has a list of persons with one entry
    if isinstance(points, Mapping):
        _name(path, found, number, tuple(points))
        points = list(points.values())
    rows = _rows(path, number, points)
    if flat and rows.shape[1] == 3 and ((rows[:, 2] >= 0) & (rows[:, 2] <= 1)).all() and (rows[:, :2].max() > 10):
        raise SourceError(path, f"frame {number}: {FLAT_2D} (the third number of each is its score)")
    named = [point.get("name") for point in points if isinstance(point, Mapping)]
    if named and all(isinstance(name, str) for name in named) and len(set(named)) == len(named):
        _name(path, found, number, tuple(str(name) for name in named))
    _name(path, found, number, found.names or _names_of(len(rows)), len(rows))
    unseen = (rows[:, :3] == 0).all(axis=1)
    if rows.shape[1] == 4:
        unseen |= rows[:, 3] <= 0
    positions: F64 = np.where(unseen[:, None], np.nan, rows[:, :3])
    return positions


def _names_of(count: int) -> tuple[str, ...]:
    """Return names for as many unnamed keypoints; empty if no known set has this number."""
    known = keypoint_sets_by_count().get(count, ())
    return known[0].order if known else ()


def _name(path: Path, found: Keypoints, number: int, names: tuple[str, ...], count: int | None = None) -> None:
    """Record the names of the points, which must be the same in all frames."""
    if count is not None and not names:
        known = ", ".join(map(str, keypoint_sets_by_count()))
        raise SourceError(
            path, f"frame {number} has {count} points without names; of {known} they would be known: add a list `names`"
        )
    if len(names) > MAX_POINTS or (found.names and found.names != names) or (count is not None and count != len(names)):
        raise SourceError(path, f"frame {number} has other points than the frames before it, or than there are names")
    found.names = names


def _rows(path: Path, number: int, points: Any) -> F64:
    """Return points as rows of x, y, z and an optional score; a flat list is split into rows."""
    rows: Any = points
    if isinstance(points, list) and points and all(isinstance(point, Mapping) for point in points):
        rows = [[point.get(axis) for axis in "xyz"] for point in points]
    elif isinstance(points, list) and points and all(isinstance(point, float) for point in points):
        wide = next((w for w in (4, 3) if len(points) % w == 0 and _names_of(len(points) // w)), 3)
        rows = [points[i : i + wide] for i in range(0, len(points), wide)]
    try:
        found = np.array([[np.nan if value is None else float(value) for value in row] for row in rows], np.float64)
    except (TypeError, ValueError):
        found = np.zeros((0, 0))
    if found.ndim != 2 or found.shape[1:] not in ((3,), (4,)) or not len(found) or (np.abs(found) > _FARTHEST).any():
        if found.ndim == 2 and found.shape[1:] == (2,):
            raise SourceError(path, f"frame {number}: {FLAT_2D}")
        raise SourceError(path, f"frame {number}: expected points of x, y and z, within {_FARTHEST:g}")
    return found


_NAMED = [key for key in (*WORLD, *POINTS_3D, *POINTS_2D, *NAMES) if "_" in key or "3d" in key or "L" in key]
_KEYS = re.compile(rf'"({"|".join(_NAMED)})"\s*:')
_KINDS = re.compile(r'"(people|instance_info)"\s*:\s*\[')
_NUMBERED = re.compile(r"(?P<before>.*?)(?P<number>\d+)(?P<after>_keypoints)?$")
_MAX_FILES = 200_000
_PER_BYTE = 12  # bytes of memory per byte of JSON, whose numbers become objects


class KeypointReader(PointsReader):
    """Reads keypoints of persons; a sequence of files is represented by its first one."""

    title: ClassVar[str] = "JSON, keypoints"
    endings: ClassVar[tuple[str, ...]] = (".json",)
    beside: ClassVar[tuple[str, ...]] = (".json",)

    def sniff(self, path: Path) -> bool:
        """Return whether a file begins like a file of keypoints, and is not a later file of a sequence."""
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
        """Return the number of files, each a frame, 0 for the unknown points, and the memory for reading in bytes."""
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
        if isinstance(content, dict) and any(content.get(key) == [] for key in PERSONS):
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
    return {key: tuple(sorted(paths, key=_number)[:_MAX_FILES]) for key, paths in found.items()}


def _number(path: Path) -> int:
    found = _NUMBERED.fullmatch(path.stem)
    return int(found["number"][-15:]) if found else 0
