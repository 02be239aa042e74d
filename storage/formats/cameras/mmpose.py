"""Read keypoints in the JSON of MMPose: a file for each camera with the frames of a video, or one for each image."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinedex.catalog.keypoint_sets import MOST_KEYPOINTS
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.cameras.openpose import frame_number, person_id
from kinedex.storage.formats.cameras.persons import Person, SeenPersons, checked_points, refuse_crowds
from kinedex.storage.formats.motion.keypoint_frames import load_json
from kinedex.storage.formats.motion.table_sections import beginning

INSTANCES, POINTS, SCORES = "instances", "keypoints", "keypoint_scores"

OTHER_NAMES = {"head": "head_top", "hip": "mid_hip"}
"""A dict from name of a keypoint in MMPose to its name in the keypoint sets."""

_OWN = re.compile(r'"(instance_info|instances|keypoint_scores|frame_id)"|"keypoints"\s*:\s*\[\s*\[')
_IDS = ("track_id", "person_id", "instance_id")
_MOST_FRAMES = 2_000_000


def are_mmpose(files: Sequence[Path]) -> bool:
    """Return whether a camera's files are those of MMPose; an empty list, an image without persons, does not decide."""
    for path in files:
        text = beginning(path).strip()
        if re.fullmatch(r"\[\s*\]", text) is None:
            return '"people"' not in text and _OWN.search(text) is not None
    return len(files) > 1


def read_mmpose(files: Sequence[Path]) -> SeenPersons:
    """Read the persons that a camera saw, from files of MMPose.

    Parameters
    ----------
    files : sequence of Path
        A file of a video, whose frames have numbers, or a file for each image, whose number is the last in its name.

    Raises
    ------
    SourceError
        A file is not of MMPose, two have the same number, or the number of keypoints changes; the message names the
        place.
    """
    seen = SeenPersons(files[0])
    for path in files:
        content = load_json(path)
        header = content if isinstance(content, Mapping) else {}
        entries = header.get("instance_info", header.get(INSTANCES)) if header else content
        if not isinstance(entries, list) or len(entries) > _MOST_FRAMES:
            raise SourceError(
                path, f'expected keypoints of MMPose, {{"instance_info": [{{"frame_id": 0, "{INSTANCES}": […]}}]}}'
            )
        seen.names = seen.names or _names(header.get("meta_info"))
        if any(isinstance(entry, Mapping) and INSTANCES in entry for entry in entries):
            if len(files) > 1:
                raise SourceError(
                    path, f"has the frames of a video, and must be the one file of a camera; {_others(files)}"
                )
            _add_frames(seen, path, entries)
        elif len(files) > 1 or entries:
            _add(seen, path, "the image", frame_number(path), entries)
    counts = sorted({len(person.points) for persons in seen.frames.values() for person in persons})
    if len(counts) > 1 or (counts and seen.names and len(seen.names) != counts[0]):
        found = [*counts, *([len(seen.names)] if seen.names else [])]
        raise SourceError(
            files[0], f"has persons or names of {' and '.join(map(str, found))} keypoints; expected one number"
        )
    return seen


def _others(files: Sequence[Path]) -> str:
    return f"there are {len(files)}, from {files[0].name} to {files[-1].name}"


def _add_frames(seen: SeenPersons, path: Path, entries: list[Any]) -> None:
    """Add the frames of a video; an entry without a number follows the frame before it."""
    number = -1
    for place, entry in enumerate(entries):
        where = f"frame {place}"
        if not isinstance(entry, Mapping) or not isinstance(entry.get(INSTANCES), list):
            raise SourceError(path, f"{where}: expected an object with a list `{INSTANCES}`")
        given = entry.get("frame_id", number + 1.0)
        if not isinstance(given, float) or not 0 <= given < 1e15 or given != int(given):
            raise SourceError(path, f"{where}: `frame_id` must be a whole number of at least 0, got {given!r:.50}")
        number = int(given)
        _add(seen, path, where, number, entry[INSTANCES])


def _add(seen: SeenPersons, path: Path, where: str, number: int, persons: Sequence[Any]) -> None:
    """Add the persons of a frame to the result."""
    if number in seen.frames:
        raise SourceError(path, f"{where}: a second frame has the number {number}; one camera a folder, or a file")
    refuse_crowds(path, where, persons)
    found = [_person(path, f"{where}, instance {place}", one) for place, one in enumerate(persons)]
    seen.frames[number] = [one for one in found if one is not None]


def _person(path: Path, where: str, content: Any) -> Person | None:
    """Return a person; None for one without any keypoint."""
    points = content.get(POINTS) if isinstance(content, Mapping) else None
    if not isinstance(points, list) or not 1 <= len(points) <= MOST_KEYPOINTS:
        raise SourceError(path, f"{where}: expected an object with `{POINTS}`, a list of [x, y], and `{SCORES}`")
    scores = content.get(SCORES)
    width = len(points[0]) if isinstance(points[0], list) else 0
    if width == 3 and scores is not None:
        raise SourceError(path, f"{where}: has keypoints with depth, which are 3D: ingest the file as motion instead")
    if width not in (2, 3) or any(not isinstance(one, list) or len(one) != width for one in points):
        raise SourceError(path, f"{where}: `{POINTS}` must be pairs of x and y")
    if scores is not None and (not isinstance(scores, list) or len(scores) != len(points)):
        raise SourceError(path, f"{where}: `{SCORES}` must be a list of {len(points)} numbers, one for each keypoint")
    values = [value for one in points for value in one] + (scores or [])
    if not all(value is None or isinstance(value, float) for value in values):
        raise SourceError(path, f"{where}: expected numbers in `{POINTS}` and `{SCORES}`")
    rows = np.full((len(points), 3), np.nan)
    rows[:, :width] = np.array(points, np.float64)
    if scores is not None:
        rows[:, 2] = np.array(scores, np.float64)
    checked = checked_points(path, where, rows)
    return Person(person_id(content, _IDS), checked) if np.isfinite(checked[:, 0]).any() else None


def _names(header: Any) -> tuple[str, ...]:
    """Return the names of the keypoints in their order, from the description of the model; empty where it has none."""
    named = header.get("keypoint_id2name") if isinstance(header, Mapping) else None
    if not isinstance(named, Mapping):
        return ()
    names = [named.get(str(number)) for number in range(len(named))]
    if not names or len({*map(str, names)}) != len(names) or not all(isinstance(one, str) and one for one in names):
        return ()
    return tuple(OTHER_NAMES.get(str(name), str(name))[:200] for name in names)
