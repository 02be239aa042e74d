"""Read keypoints in the JSON of COCO results: a file for each camera, a list of persons with their image's id."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.cameras.openpose import keypoint_rows, person_id
from kinedex.storage.formats.cameras.persons import Person, SeenPersons, refuse_crowds
from kinedex.storage.formats.motion.keypoint_frames import load_json

_IDS = ("person_id", "track_id", "instance_id", "idx")  # `id` numbers the entries, it tracks no person
_MOST_ENTRIES = 2_000_000


def read_coco_results(path: Path) -> SeenPersons:
    """Read the persons that a camera saw, from COCO results.

    The frame is `image_id`, a number or the name of an image with one. Visibilities 0, 1 and 2 become confidences 0, 1
    and 1.

    Raises
    ------
    SourceError
        The file is not a list of results; the message names the entry.
    """
    content = load_json(path)
    if isinstance(content, Mapping) and isinstance(content.get("annotations"), list):
        content = content["annotations"]
    if not isinstance(content, list) or len(content) > _MOST_ENTRIES:
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
        persons = seen.frames.setdefault(_frame(path, where, entry["image_id"]), [])
        if np.isfinite(points[:, 0]).any():
            persons.append(Person(person_id(entry, _IDS), points))
            refuse_crowds(path, where, persons)
    return seen


def _frame(path: Path, where: str, value: Any) -> int:
    if isinstance(value, float) and 0 <= value < 1e15 and value == int(value):
        return int(value)
    numbers = re.findall(r"\d+", value[:300]) if isinstance(value, str) else []
    if not numbers:
        raise SourceError(path, f"{where}: `image_id` must be a frame's number, or the name of an image with one")
    return int(numbers[-1][-15:])
