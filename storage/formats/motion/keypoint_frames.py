"""Parse keypoints in JSON: persons in frames, in the forms of OpenPose, MMPose, MediaPipe and plain lists."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.catalog.keypoint_sets import keypoint_sets_by_count
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.reader import MOST_POINTS, file_size
from kinedex.storage.formats.motion.text_blocks import LONGEST

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


def load_json(path: Path) -> Any:
    """Return the content of a JSON file; raise SourceError if it is too large, too deeply nested, or not JSON.

    All numbers are parsed as floats, so that no integer of a million digits is built.
    """
    if file_size(path) > LONGEST:
        raise SourceError(path, f"has more than {LONGEST >> 20} MB of JSON; write shorter takes, or a table (CSV, NPZ)")
    try:
        return json.loads(path.read_bytes(), parse_int=float)
    except OSError as fault:
        raise SourceError(path, f"cannot be read: {fault.strerror}") from fault
    except json.JSONDecodeError as fault:
        raise SourceError(path, f"is not JSON: {fault.msg}", line=fault.lineno) from None
    except (RecursionError, ValueError) as fault:
        raise SourceError(path, f"is no JSON that can be read: {str(fault)[:200]}") from None


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
    there = [(called, places) for called, places in read if places is not None]
    ids = {called for called, _ in there}
    if len(there) > 1 and (None in ids or len(ids) < len(there)):
        raise SourceError(
            path, f"frame {number} has {len(there)} persons without an id each, so that nobody can be followed: write "
            "one person a file, or a `track_id` for each",
        )  # fmt: skip
    for called, places in there:
        found.persons.setdefault(called or "", {})[number] = places


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
    places: F64 = np.where(unseen[:, None], np.nan, rows[:, :3])
    return places


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
    if (
        len(names) > MOST_POINTS
        or (found.names and found.names != names)
        or (count is not None and count != len(names))
    ):
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
