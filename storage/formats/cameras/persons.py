"""Hold the persons that a detector found in the frames of a camera, and choose the person who is tracked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import SourceError

F64 = npt.NDArray[np.float64]

MAX_PERSONS = 1000
"""The largest number of persons in a frame."""

FARTHEST_PX = 1e6
"""The largest absolute value of a keypoint's coordinate, in pixels."""

OUT_OF_BOUNDS = f"expected pixels within {FARTHEST_PX:g} and a confidence, got a number beyond"

LARGEST, MOST_CONFIDENT = "largest", "most_confident"


@dataclass(frozen=True)
class Person:
    """The keypoints of a person in a frame.

    Attributes
    ----------
    called : str
        The id by which the detector tracks the person; empty if the person has none.
    points : float64 array (P, 3)
        x and y in pixels and the confidence of each keypoint; NaN for missing values.
    """

    called: str
    points: F64


@dataclass
class SeenPersons:
    """The persons seen by one camera.

    Attributes
    ----------
    path : Path
        The file, or the first of several, for messages.
    frames : dict of int to list of Person
        Number of a frame → the persons in it; frames without persons may be absent.
    names : tuple of str
        Names of the keypoints; empty if the file has none.
    """

    path: Path
    frames: dict[int, list[Person]] = field(default_factory=dict)
    names: tuple[str, ...] = ()

    @property
    def keypoints(self) -> int:
        """The number of keypoints of each person; 0 if there are no persons."""
        return next((len(person.points) for persons in self.frames.values() for person in persons), 0)

    def crowded(self) -> int:
        """Count the frames with several persons."""
        return sum(len(persons) > 1 for persons in self.frames.values())


def checked_points(path: Path, where: str, rows: F64, line: int | None = None) -> F64:
    """Check keypoints and return them as x, y, confidence; missing ones become (NaN, NaN, 0).

    A keypoint is missing without x or y, with a confidence of 0, or at (0, 0) without a confidence.

    Parameters
    ----------
    path : Path
        The file, for errors.
    where : str
        The place in the file, for errors.
    rows : float64 array (P, 3)
        x, y and confidence in the file.
    line : int, optional
        The line of the file.

    Raises
    ------
    SourceError
        A coordinate is larger than that of any image.
    """
    if (np.abs(rows) > FARTHEST_PX).any():
        raise SourceError(path, f"{where}: {OUT_OF_BOUNDS}", line=line)
    missing = np.isnan(rows[:, :2]).any(axis=1) | (rows[:, 2] <= 0)
    missing |= (rows[:, :2] == 0).all(axis=1) & ~(rows[:, 2] > 0)
    found = rows.copy()
    found[missing] = np.nan, np.nan, 0.0
    return found


def chosen_persons(seen: SeenPersons, choice: str) -> dict[int, F64]:
    """Return the keypoints (P, 3) of the person who is tracked, for each frame that shows the person.

    Parameters
    ----------
    seen : SeenPersons
        The persons of a camera.
    choice : str
        "largest" (by the box around the keypoints), "most_confident" (by the sum of confidences), or an id.

    Raises
    ------
    SourceError
        The choice is an id that no person has.
    """
    if choice in (LARGEST, MOST_CONFIDENT):
        rule = _box_size if choice == LARGEST else _confidence
        return {frame: max(persons, key=rule).points for frame, persons in seen.frames.items() if persons}
    found = {
        frame: next((one.points for one in persons if one.called == choice), None)
        for frame, persons in seen.frames.items()
    }
    if all(points is None for points in found.values()):
        ids = sorted({one.called for persons in seen.frames.values() for one in persons if one.called})
        known = f"it has {', '.join(ids[:12])}" if ids else "its persons have no ids"
        raise SourceError(
            seen.path, f"no person has the id '{choice}'; {known}; `person:` may also be {LARGEST} or {MOST_CONFIDENT}"
        )
    return {frame: points for frame, points in found.items() if points is not None}


def refuse_crowds(path: Path, where: str, persons: Sequence[object]) -> None:
    """Raise an error for a frame with more persons than `MAX_PERSONS`."""
    if len(persons) > MAX_PERSONS:
        raise SourceError(path, f"{where}: has {len(persons)} persons, and {MAX_PERSONS} are read at most")


def _box_size(person: Person) -> float:
    seen = person.points[np.isfinite(person.points[:, 0]), :2]
    return float(np.prod(np.ptp(seen, axis=0))) if len(seen) else -1.0


def _confidence(person: Person) -> float:
    return float(np.nansum(person.points[:, 2]))
