"""Read keypoints in the JSON of OpenPose: a file for each frame, a folder for each camera."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinedex.catalog.keypoint_sets import MOST_KEYPOINTS
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.cameras.persons import Person, SeenPersons, checked_points, refuse_crowds
from kinedex.storage.formats.motion.keypoint_frames import IDS, load_json
from kinedex.storage.formats.motion.reader import file_size

PEOPLE = "people"
POINTS = "pose_keypoints_2d"

_MOST_BYTES = 8 << 20
_NUMBERED = re.compile(r".*?(?P<number>\d+)(?:_keypoints)?$", re.DOTALL)


def read_openpose(files: Sequence[Path]) -> SeenPersons:
    """Read the persons that a camera saw, from files of OpenPose.

    Parameters
    ----------
    files : sequence of Path
        A file for each frame, whose number is the last one in its name, as cam01_000000000012_keypoints.json.

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
                path, f"has the frame number {number}, as {by_number[number].name} has: one camera a folder"
            )
        by_number[number] = path
        persons = read_frame(path)
        for person in persons:
            if keypoints not in (0, len(person.points)):
                raise SourceError(path, f"has {len(person.points)} keypoints, and the files before it {keypoints}")
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
    if file_size(path) > _MOST_BYTES:
        raise SourceError(path, f"has more than {_MOST_BYTES >> 20} MB, which is no file of one frame")
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
    """Return a person; None for one without body keypoints, such as a lone hand."""
    if not isinstance(content, Mapping) or POINTS not in content:
        raise SourceError(path, f"{where}: expected an object with `{POINTS}`")
    if content[POINTS] in ([], None):
        return None
    points = keypoint_rows(path, f"{where}: {POINTS}", content[POINTS])
    return Person(person_id(content), points) if np.isfinite(points[:, 0]).any() else None


def keypoint_rows(path: Path, where: str, values: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return keypoints (P, 3) of a flat list of x, y, confidence; null is missing.

    Raises
    ------
    SourceError
        The values are not such a list.
    """
    if not isinstance(values, list) or len(values) % 3 or not 3 <= len(values) <= 3 * MOST_KEYPOINTS:
        got = f"{len(values)} values" if isinstance(values, list) else "something else"
        raise SourceError(path, f"{where}: expected a list of x, y and confidence of each keypoint, got {got}")
    if not all(value is None or isinstance(value, float) for value in values):
        raise SourceError(
            path, f"{where}: expected numbers, got {next(v for v in values if not isinstance(v, float))!r}"
        )
    rows = np.array([np.nan if value is None else value for value in values], np.float64).reshape(-1, 3)
    return checked_points(path, where, rows)


def person_id(content: Mapping[str, Any], keys: Sequence[str] = IDS) -> str:
    """Return the id of a person; empty if it is not tracked, for which OpenPose writes [-1]."""
    value = next((content[key] for key in keys if key in content), None)
    value = value[0] if isinstance(value, list) and value else value
    if isinstance(value, float):
        return f"{value:.0f}" if 0 <= value < 1e15 else ""
    return value[:200] if isinstance(value, str) else ""
