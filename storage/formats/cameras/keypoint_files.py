"""Read the keypoint files of a recording, in any format, and return arrays over time for one person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.keypoint_sets import (
    NAMED,
    KeypointSet,
    keypoint_sets_by_count,
    likeliest_set,
    load_keypoint_set,
)
from kinedex.ops.errors import SourceError, did_you_mean
from kinedex.storage.formats.cameras.file_patterns import CameraFiles
from kinedex.storage.formats.cameras.keypoint_tables import read_keypoint_table
from kinedex.storage.formats.cameras.openpose import are_mmpose, read_coco_results, read_mmpose, read_openpose
from kinedex.storage.formats.cameras.persons import SeenPersons, chosen_persons
from kinedex.storage.formats.source_files import beginning

F64 = npt.NDArray[np.float64]

TABLES = (".csv", ".parquet")

_MAX_NUMBERS = 200_000_000
_SAMPLE = 2000  # number of persons from which the keypoint set is chosen


@dataclass(frozen=True, eq=False)
class KeypointArrays:
    """Keypoints over time of the person who is tracked.

    Attributes
    ----------
    keypoint_set : KeypointSet
        The keypoint set, which defines names and positions of keypoints.
    names : tuple of str
        Names of the P keypoints that have a position on the body.
    unused : tuple of str
        Names of keypoints that have no position on the body, or that no camera has.
    pixels : float64 array (T, V, P, 2)
        Positions in the images, in pixels; NaN where a keypoint is missing.
    confidence : float64 array (T, V, P)
        Confidence in [0, 1]; 0 where a keypoint is missing.
    first_frame : int
        The number of the first frame in the files.
    several : int
        The number of images with several persons.
    empty : int
        The number of images without a person.
    without_confidence : int
        The number of keypoints without a confidence; their confidence is set to 1.
    above_one : int
        The number of keypoints with a confidence above 1, which is set to 1.
    """

    keypoint_set: KeypointSet
    names: tuple[str, ...]
    unused: tuple[str, ...]
    pixels: F64
    confidence: F64
    first_frame: int
    several: int
    empty: int
    without_confidence: int
    above_one: int


def read_keypoint_files(files: CameraFiles, recording: str) -> dict[str, SeenPersons]:
    """Read the persons of every camera.

    Parameters
    ----------
    files : CameraFiles
        Files of OpenPose (one per frame), MMPose (one per camera or frame), COCO results (one per camera), or tables
        (one per camera, or one for all cameras).
    recording : str
        The recording whose rows of a table are read.

    Returns
    -------
    dict of str to SeenPersons
        Value of `{camera}`, or the camera that a table names → the persons that this camera saw.

    Raises
    ------
    SourceError
        A file has another form, or there are too many files.
    """
    found: dict[str, SeenPersons] = {}
    for camera, paths in files.files.items():
        ending = paths[0].suffix.lower()
        if ending in TABLES:
            tables = read_keypoint_table(_only(paths, "a table"), recording)
            if files.each_camera and len(tables) > 1 and camera not in tables:
                raise SourceError(paths[0], f"has rows of {len(tables)} cameras, but is the file of '{camera}'")
            found |= {camera: tables.get(camera) or next(iter(tables.values()))} if files.each_camera else tables
        elif ending != ".json":
            raise SourceError(paths[0], "expected keypoints ending in .json, .csv or .parquet")
        elif not files.each_camera:
            raise SourceError(paths[0], "keypoints in JSON need {camera} in their path, as pose/{camera}/*.json")
        elif are_mmpose(paths):
            found[camera] = read_mmpose(paths)
        elif beginning(paths[0]).lstrip().startswith("[") or '"annotations"' in beginning(paths[0]):
            found[camera] = read_coco_results(_only(paths, "COCO results"))
        else:
            found[camera] = read_openpose(paths)
    return found


def _only(paths: Sequence[Path], what: str) -> Path:
    if len(paths) > 1:
        raise SourceError(paths[1], f"{what} must be one file for each camera, but there is {paths[0].name} already")
    return paths[0]


def keypoint_arrays(
    seen: Sequence[SeenPersons | None], choice: KeypointSet | None, person: str, offsets: Sequence[int]
) -> KeypointArrays:
    """Return the keypoints of one person in all cameras as arrays.

    Parameters
    ----------
    seen : sequence of SeenPersons or None
        The persons of V cameras; None for a camera without keypoints.
    choice : KeypointSet, optional
        The keypoint set; by default it is recognised by the names or the number of keypoints.
    person : str
        "largest", "most_confident", or an id.
    offsets : sequence of int
        The offset of each camera's frame numbers: frame k of the recording is frame k + offset of the camera.

    Raises
    ------
    SourceError, ConfigError
        The keypoint set is unknown or does not fit the files, no person is seen, or most frames are missing.
    """
    there = [one for one in seen if one is not None and one.keypoints]
    if not there:
        raise SourceError(next(one.path for one in seen if one is not None), "has no person in any frame")
    keypoint_set, columns = _columns(there, choice)
    names = tuple(name for name in columns if name in keypoint_set.positions)
    unused = tuple(name for name in (keypoint_set.order or columns) if name not in names)
    if not names:
        raise SourceError(
            there[0].path, f"has no keypoint with a place on the body{did_you_mean('', keypoint_set.positions)}"
        )
    by_camera = [None if one is None else chosen_persons(one, person) if one.keypoints else {} for one in seen]
    numbers = [
        frame - offset
        for one, offset in zip(seen, offsets, strict=True)
        if one is not None
        for frame in (min(one.frames, default=0), max(one.frames, default=0))
    ]
    first, frames = min(numbers), max(numbers) - min(numbers) + 1
    most = max(len(one.frames) for one in there)
    if frames > 10 * most + 1000 or frames * len(seen) * len(names) * 3 > _MAX_NUMBERS:
        raise SourceError(
            there[0].path, f"frames {first} to {first + frames - 1}, of which one camera has {most} at most: too many "
            "are missing, or too many for one recording; check the numbers in the names and `offsets:`, or divide it",
        )  # fmt: skip
    rows = np.full((frames, len(seen), len(names), 3), np.nan)
    rows[..., 2] = 0.0
    for v, (one, points, offset) in enumerate(zip(seen, by_camera, offsets, strict=True)):
        if one is None or points is None:
            continue
        own = one.names or keypoint_set.order
        positions = [own.index(name) for name in names if name in own]
        into = [p for p, name in enumerate(names) if name in own]
        for frame, person_rows in points.items():
            rows[frame - offset - first, v, into] = _padded(person_rows, len(own))[positions]
    seen_points = np.isfinite(rows[..., 0])
    confidence = rows[..., 2]
    without, above = int((np.isnan(confidence) & seen_points).sum()), int((confidence > 1).sum())
    confidence = np.where(seen_points, np.clip(np.where(np.isnan(confidence), 1.0, confidence), 0.0, 1.0), 0.0)
    images = frames * sum(one is not None for one in seen)
    return KeypointArrays(
        keypoint_set,
        names,
        unused,
        np.ascontiguousarray(rows[..., :2]),
        confidence,
        first,
        sum(one.crowded() for one in there),
        images - int(seen_points.any(axis=2).sum()),
        without,
        above,
    )


def _columns(seen: Sequence[SeenPersons], choice: KeypointSet | None) -> tuple[KeypointSet, tuple[str, ...]]:
    """Return the keypoint set, and the names of the keypoints that the files have."""
    named = [one for one in seen if one.names]
    if named:
        keypoint_set = choice or load_keypoint_set(NAMED)
        if len(named) < len(seen):
            other = next(one for one in seen if not one.names)
            raise SourceError(other.path, f"numbers its keypoints, but {named[0].path.name} names them")
        columns = tuple(dict.fromkeys(name for one in seen for name in one.names))
        strange = next((name for name in columns if keypoint_set.order and name not in keypoint_set.order), None)
        if strange is not None:
            near = did_you_mean(strange, keypoint_set.order)
            raise SourceError(named[0].path, f"the keypoint set '{keypoint_set.name}' has no '{strange}'{near}")
        return keypoint_set, columns
    count = max(one.keypoints for one in seen)
    other_count = next((one for one in seen if one.keypoints != count), None)
    if other_count is not None and other_count.path.suffix.lower() not in TABLES:
        raise SourceError(other_count.path, f"has {other_count.keypoints} keypoints, but other cameras have {count}")
    if choice is not None:
        table = seen[0].path.suffix.lower() in TABLES  # the last keypoints may be missing in all persons
        if not (len(choice.order) == count or (table and count < len(choice.order))):
            raise SourceError(
                seen[0].path, f"has {count} keypoints of a person, and the set '{choice.name}' {len(choice.order)}; "
                "give the set of these files as `keypoint_set`",
            )  # fmt: skip
        return choice, choice.order
    known_sets = keypoint_sets_by_count()
    sets = known_sets.get(count, ())
    if not sets:
        known = ", ".join(f"{count} ({' or '.join(one.name for one in sets)})" for count, sets in known_sets.items())
        raise SourceError(
            seen[0].path, f"has {count} keypoints of a person, which no set has (they have {known}); write "
            "`keypoint_set:` in the recording, a shipped set or a file of your own",
        )  # fmt: skip
    if len(sets) == 1:
        return sets[0], sets[0].order
    persons = [person.points[:, :2] for one in seen for those in one.frames.values() for person in those]
    step = max(1, len(persons) // _SAMPLE)
    chosen = likeliest_set(sets, np.array(persons[::step]))
    return chosen, chosen.order


def _padded(rows: F64, count: int) -> F64:
    """Return the keypoints (count, 3) of a person, padded with missing keypoints (NaN, NaN, 0)."""
    if len(rows) == count:
        return rows
    return np.concatenate([rows, np.tile([np.nan, np.nan, 0.0], (count - len(rows), 1))])
