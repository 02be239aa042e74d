"""Read keypoints of persons in images from JSON files of OpenPose, of MMPose and of COCO results."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinedex.catalog.keypoint_sets import MAX_KEYPOINTS
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.cameras.persons import Person, SeenPersons, checked_points, refuse_crowds
from kinedex.storage.formats.motion.keypoint_json import IDS
from kinedex.storage.formats.source_files import beginning, file_size, load_json

PEOPLE = "people"
POINTS = "pose_keypoints_2d"

_MAX_BYTES = 8 << 20
_NUMBERED = re.compile(r".*?(?P<number>\d+)(?:_keypoints)?$", re.DOTALL)


def read_openpose(files: Sequence[Path]) -> SeenPersons:
    """Read the persons that a camera saw, from files of OpenPose.

    Parameters
    ----------
    files : sequence of Path
        A file for each frame; the last number in the name is that of the frame, as in
        cam01_000000000012_keypoints.json.

    Raises
    ------
    SourceError
        A file is not of OpenPose, two files have the same number, or the number of keypoints changes.
    """
    seen = SeenPersons(files[0])
    by_number: dict[int, Path] = {}
    keypoints = 0
    for path in files:
        number = frame_number(path)
        if number in by_number:
            raise SourceError(
                path, f"has the frame number {number}, as {by_number[number].name} has; put one camera in a folder"
            )
        by_number[number] = path
        persons = read_frame(path)
        for person in persons:
            if keypoints not in (0, len(person.points)):
                raise SourceError(path, f"has {len(person.points)} keypoints, but earlier files have {keypoints}")
            keypoints = len(person.points)
        seen.frames[number] = persons
    return seen


def frame_number(path: Path) -> int:
    """Return the number of the frame in a file's name.

    Raises
    ------
    SourceError
        The name has no number.
    """
    found = _NUMBERED.fullmatch(path.stem)
    if found is None:
        raise SourceError(path, "expected the number of the frame at the end of the name, as in cam01_000012.json")
    return int(found["number"][-15:])


def read_frame(path: Path) -> list[Person]:
    """Return the persons of a file of one frame.

    Raises
    ------
    SourceError
        The file is not of OpenPose; the message names the person.
    """
    if file_size(path) > _MAX_BYTES:
        raise SourceError(path, f"has more than {_MAX_BYTES >> 20} MB, too much for a file of one frame")
    content = load_json(path)
    people = content.get(PEOPLE) if isinstance(content, Mapping) else None
    if not isinstance(people, list):
        raise SourceError(path, f'expected a JSON object of OpenPose, {{"{PEOPLE}": [{{"{POINTS}": [x, y, c, …]}}]}}')
    refuse_crowds(path, "the frame", people)
    persons = [_person(path, f"person {number}", one) for number, one in enumerate(people)]
    found = [person for person in persons if person is not None]
    counts = sorted({len(person.points) for person in found})
    if len(counts) > 1:
        raise SourceError(
            path, f"has persons of {' and '.join(map(str, counts))} keypoints; expected one number of them"
        )
    return found


def _person(path: Path, where: str, content: Any) -> Person | None:
    """Return a person; None for a person without body keypoints, such as a lone hand."""
    if not isinstance(content, Mapping) or POINTS not in content:
        raise SourceError(path, f"{where}: expected an object with `{POINTS}`")
    if content[POINTS] in ([], None):
        return None
    points = keypoint_rows(path, f"{where}: {POINTS}", content[POINTS])
    return Person(person_id(content), points) if np.isfinite(points[:, 0]).any() else None


def keypoint_rows(path: Path, where: str, values: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the keypoints (P, 3) in a flat list of x, y, confidence; null stands for a missing value.

    Raises
    ------
    SourceError
        The values are not such a list.
    """
    if not isinstance(values, list) or len(values) % 3 or not 3 <= len(values) <= 3 * MAX_KEYPOINTS:
        got = f"{len(values)} values" if isinstance(values, list) else "something else"
        raise SourceError(path, f"{where}: expected a list of x, y and confidence of each keypoint, got {got}")
    if not all(value is None or isinstance(value, float) for value in values):
        raise SourceError(
            path, f"{where}: expected numbers, got {next(v for v in values if not isinstance(v, float))!r}"
        )
    rows = np.array([np.nan if value is None else value for value in values], np.float64).reshape(-1, 3)
    return checked_points(path, where, rows)


def person_id(content: Mapping[str, Any], keys: Sequence[str] = IDS) -> str:
    """Return the id of a person; empty for a person who is not tracked, for whom OpenPose writes [-1]."""
    value = next((content[key] for key in keys if key in content), None)
    value = value[0] if isinstance(value, list) and value else value
    if isinstance(value, float):
        return f"{value:.0f}" if 0 <= value < 1e15 else ""
    return value[:200] if isinstance(value, str) else ""


INSTANCES, MMPOSE_POINTS, SCORES = "instances", "keypoints", "keypoint_scores"

OTHER_NAMES = {"head": "head_top", "hip": "mid_hip"}
"""A dict from the name of a keypoint in MMPose to its name in the keypoint sets."""

_OWN = re.compile(r'"(instance_info|instances|keypoint_scores|frame_id)"|"keypoints"\s*:\s*\[\s*\[')
_MMPOSE_IDS = ("track_id", "person_id", "instance_id")
_MAX_FRAMES = 2_000_000


def are_mmpose(files: Sequence[Path]) -> bool:
    """Return whether the files of a camera are from MMPose; files with an empty list of persons are not considered."""
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
        One file for a video, whose frames are numbered, or a file for each image, with its number last in the name.

    Raises
    ------
    SourceError
        A file is not of MMPose, two frames have the same number, or the number of keypoints changes; the message names
        the place.
    """
    seen = SeenPersons(files[0])
    for path in files:
        content = load_json(path)
        header = content if isinstance(content, Mapping) else {}
        entries = header.get("instance_info", header.get(INSTANCES)) if header else content
        if not isinstance(entries, list) or len(entries) > _MAX_FRAMES:
            raise SourceError(
                path, f'expected keypoints of MMPose, {{"instance_info": [{{"frame_id": 0, "{INSTANCES}": […]}}]}}'
            )
        seen.names = seen.names or _mmpose_names(header.get("meta_info"))
        if any(isinstance(entry, Mapping) and INSTANCES in entry for entry in entries):
            if len(files) > 1:
                raise SourceError(
                    path,
                    f"has the frames of a video, and must be the one file of a camera; there are {len(files)}, "
                    f"from {files[0].name} to {files[-1].name}",
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


def _add_frames(seen: SeenPersons, path: Path, entries: list[Any]) -> None:
    """Add the frames of a video; an entry without a number is the frame after the previous entry."""
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
        raise SourceError(path, f"{where}: a second frame has the number {number}; use one folder or file per camera")
    refuse_crowds(path, where, persons)
    found = [_mmpose_person(path, f"{where}, instance {place}", one) for place, one in enumerate(persons)]
    seen.frames[number] = [one for one in found if one is not None]


def _mmpose_person(path: Path, where: str, content: Any) -> Person | None:
    """Return a person; None for a person without any keypoint."""
    points = content.get(MMPOSE_POINTS) if isinstance(content, Mapping) else None
    if not isinstance(points, list) or not 1 <= len(points) <= MAX_KEYPOINTS:
        raise SourceError(path, f"{where}: expected an object with `{MMPOSE_POINTS}`, a list of [x, y], and `{SCORES}`")
    scores = content.get(SCORES)
    width = len(points[0]) if isinstance(points[0], list) else 0
    if width == 3 and scores is not None:
        raise SourceError(path, f"{where}: has keypoints with depth, which are 3D: ingest the file as motion instead")
    if width not in (2, 3) or any(not isinstance(one, list) or len(one) != width for one in points):
        raise SourceError(path, f"{where}: `{MMPOSE_POINTS}` must be pairs of x and y")
    if scores is not None and (not isinstance(scores, list) or len(scores) != len(points)):
        raise SourceError(path, f"{where}: `{SCORES}` must be a list of {len(points)} numbers, one for each keypoint")
    values = [value for one in points for value in one] + (scores or [])
    if not all(value is None or isinstance(value, float) for value in values):
        raise SourceError(path, f"{where}: expected numbers in `{MMPOSE_POINTS}` and `{SCORES}`")
    rows = np.full((len(points), 3), np.nan)
    rows[:, :width] = np.array(points, np.float64)
    if scores is not None:
        rows[:, 2] = np.array(scores, np.float64)
    checked = checked_points(path, where, rows)
    return Person(person_id(content, _MMPOSE_IDS), checked) if np.isfinite(checked[:, 0]).any() else None


def _mmpose_names(header: Any) -> tuple[str, ...]:
    """Return the names of the keypoints, in order, from the description of the model; empty if it has no names."""
    named = header.get("keypoint_id2name") if isinstance(header, Mapping) else None
    if not isinstance(named, Mapping):
        return ()
    names = [named.get(str(number)) for number in range(len(named))]
    if not names or len({*map(str, names)}) != len(names) or not all(isinstance(one, str) and one for one in names):
        return ()
    return tuple(OTHER_NAMES.get(str(name), str(name))[:200] for name in names)


_COCO_IDS = ("person_id", "track_id", "instance_id", "idx")  # not `id`, which numbers the entries
_MAX_ENTRIES = 2_000_000


def read_coco_results(path: Path) -> SeenPersons:
    """Read the persons that a camera saw, from COCO results.

    `image_id` gives the frame, as a number or as the name of an image that contains a number. Visibilities 0, 1 and 2
    become confidences 0, 1 and 1.

    Raises
    ------
    SourceError
        The file is not a list of results; the message names the entry.
    """
    content = load_json(path)
    if isinstance(content, Mapping) and isinstance(content.get("annotations"), list):
        content = content["annotations"]
    if not isinstance(content, list) or len(content) > _MAX_ENTRIES:
        raise SourceError(path, 'expected COCO results, a list of {"image_id": …, "keypoints": [x, y, c, …]}')
    seen = SeenPersons(path)
    keypoints = 0
    for number, entry in enumerate(content):
        where = f"entry {number}"
        if not isinstance(entry, Mapping) or not {"image_id", "keypoints"} <= entry.keys():
            raise SourceError(path, f"{where}: expected an object with `image_id` and `keypoints`")
        points = keypoint_rows(path, f"{where}: keypoints", entry["keypoints"])
        if keypoints not in (0, len(points)):
            raise SourceError(path, f"{where}: has {len(points)} keypoints, and the entries before it {keypoints}")
        keypoints = len(points)
        persons = seen.frames.setdefault(_coco_frame(path, where, entry["image_id"]), [])
        if np.isfinite(points[:, 0]).any():
            persons.append(Person(person_id(entry, _COCO_IDS), points))
            refuse_crowds(path, where, persons)
    return seen


def _coco_frame(path: Path, where: str, value: Any) -> int:
    if isinstance(value, float) and 0 <= value < 1e15 and value == int(value):
        return int(value)
    numbers = re.findall(r"\d+", value[:300]) if isinstance(value, str) else []
    if not numbers:
        raise SourceError(path, f"{where}: `image_id` must be a frame's number, or the name of an image with one")
    return int(numbers[-1][-15:])
