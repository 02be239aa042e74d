"""Read CSV files of OptiTrack's programs before Motive, Tracking Tools and Arena: rows of frames with their markers.

The files describe themselves in comments. Rows that begin with `frame` have a number, a time, the rigid bodies that are
tracked and the markers that are seen; only those of version 1.1 name the markers.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops.arrays import F64
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.csv_tables import csv_cells
from kinedex.storage.formats.motion.numpy_arrays import MAX_BYTES
from kinedex.storage.formats.motion.points import Points, PointsReader
from kinedex.storage.formats.motion.position_tables import parse_number, refuse_jumps
from kinedex.storage.formats.motion.positions import clock_rate
from kinedex.storage.formats.motion.reader import MAX_POINTS, MotionFile, ReadSettings
from kinedex.storage.formats.motion.subjects import bodies_of, points_of_person
from kinedex.storage.formats.motion.text_blocks import after_last_line, blocks
from kinedex.storage.formats.source_files import beginning, file_size, text_of

_HEAD = re.compile(
    r"(?i)\s*(comment,\"?(optitrack export|naturalpoint trackable export)|info,\"?(version|framecount)|"
    r"(right|left)handed\s)"
)
_BODIES = ("rigidbody", "trackable")
_BODY_CELLS, _NAMED = 11, 5  # cells of a rigid body in a frame; those of a marker that has a name
_UNLABELLED = re.compile(r"unlabell?ed\b|\s*$", re.IGNORECASE)


@dataclass
class _Frames:
    """The frames of a file: numbers, times, lines, and the places of points by their labels."""

    numbers: list[float] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    places: dict[str, dict[int, list[float]]] = field(default_factory=dict)
    unlabelled: int = 0
    mirrored: bool = False

    def add(self, path: Path, label: str, place: list[float]) -> None:
        """Add the place of a point in the last frame; the first of equal labels counts."""
        self.places.setdefault(label, {}).setdefault(len(self.numbers) - 1, place)
        if len(self.places) > MAX_POINTS:
            raise SourceError(
                path, f"expected at most {MAX_POINTS} points; export named markers alone", line=self.lines[-1]
            )


class ArenaReader(PointsReader):
    """Reads the CSV files of Tracking Tools and Arena: markers by their names, or the origins of rigid bodies."""

    title: ClassVar[str] = "CSV (OptiTrack Tracking Tools or Arena)"
    endings: ClassVar[tuple[str, ...]] = (".csv",)

    def sniff(self, path: Path) -> bool:
        """Return whether the file begins with a row of these programs."""
        return _HEAD.match(beginning(path, 256)) is not None

    def points(self, file: MotionFile, settings: ReadSettings) -> Points:
        """Read the markers that have names, or the rigid bodies where no marker has one, in metres."""
        return points_of_person(_points(file.path), file.person)

    def persons(self, file: MotionFile, mappings: Mappings) -> tuple[str, ...]:
        """Return the subjects of labels such as `Ann:LKNE` that have the landmarks of a body, if there are several."""
        with_subjects = re.search(r"(?im)^frame,.*:", beginning(file.path, 1 << 20))
        return tuple(bodies_of(_points(file.path).names)) if with_subjects else ()

    def size(self, file: MotionFile) -> tuple[int, int, int]:
        """Return the frames that the file states, no points, and the memory of its numbers as Python has them."""
        stated = re.search(r"(?im)^info,\"?framecount\"?,\"?(\d{1,9})", beginning(file.path, 16_384))
        return int(stated[1]) if stated else 0, 0, 10 * file_size(file.path)


def _points(path: Path) -> Points:
    frames = _Frames()
    bodies: dict[str, str] = {}
    for number, line in _lines(path):
        kind, _, rest = line.partition(",")
        kind = kind.strip().lower()
        if kind == "frame":
            _add_frame(path, frames, csv_cells(rest, ","), bodies, number)
        elif kind in _BODIES and not frames.numbers:
            cells = csv_cells(rest, ",")
            if len(cells) > 1:
                bodies[cells[1].strip()] = cells[0].strip()
        frames.mirrored |= kind == "lefthanded"
    if not frames.numbers:
        raise SourceError(path, "expected rows that begin with 'frame', found none; export frames, too")
    if not frames.places:
        raise SourceError(
            path, f"its {frames.unlabelled} markers have no names, and it tracks no rigid body: open the recording in "
            "Motive, label it, and export it as CSV or C3D",
        )  # fmt: skip
    named = {label: those for label, those in frames.places.items() if not label.startswith(_BODY)}
    numbers, times, where = (np.array(those) for those in (frames.numbers, frames.times, frames.lines))
    refuse_jumps(path, numbers, where)
    positions = _positions(path, frames, named or frames.places)
    warnings = [] if named else ["its markers have no names; the body is that of its rigid bodies"]
    if named and frames.unlabelled:
        warnings.append(f"{frames.unlabelled} places of markers without a name are not used")
    names = tuple(label.removeprefix(_BODY) for label in (named or frames.places))
    return Points(str(path), names, positions, clock_hz=clock_rate(path, times, where), unit_m=1.0, warnings=warnings)


_BODY = "\0"
"""The beginning of the labels of rigid bodies, which no marker has."""


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    lines = (line for block in blocks(path, None, after_last_line) for line in text_of(block.data).splitlines())
    return enumerate(lines, 1)


def _add_frame(path: Path, frames: _Frames, cells: Sequence[str], bodies: dict[str, str], line: int) -> None:
    """Add a frame: its number, its time, a count of rigid bodies and eleven cells for each, a count of markers and
    four or five cells for each.
    """
    frames.lines.append(line)
    frames.numbers.append(parse_number(path, _cell(path, cells, 0, line), "frame", line))
    frames.times.append(parse_number(path, _cell(path, cells, 1, line), "time", line))
    count = _count(path, cells, 2, line)
    markers = 3 + _BODY_CELLS * count
    for at in range(3, markers, _BODY_CELLS):
        if name := bodies.get(_cell(path, cells, at, line).strip(), ""):
            frames.add(path, _BODY + name, _place(path, cells, at + 1, line))
    seen = _count(path, cells, markers, line)
    left = len(cells) - markers - 1
    width = left // seen if seen else 0
    if seen and (width not in (_NAMED - 1, _NAMED) or width * seen != left):
        raise SourceError(
            path, f"expected {_NAMED - 1} or {_NAMED} cells for each of {seen} markers, got {left} cells", line=line
        )
    for at in range(markers + 1, markers + 1 + width * seen, width or 1):
        label = cells[at + _NAMED - 1].strip() if width == _NAMED else ""
        if _UNLABELLED.match(label):
            frames.unlabelled += 1
        else:
            frames.add(path, label.replace(_BODY, ""), _place(path, cells, at, line))


def _cell(path: Path, cells: Sequence[str], at: int, line: int) -> str:
    if at >= len(cells):
        raise SourceError(path, f"the row of the frame ends after {len(cells)} cells; cut off?", line=line)
    return cells[at]


def _count(path: Path, cells: Sequence[str], at: int, line: int) -> int:
    number = parse_number(path, _cell(path, cells, at, line), "count", line)
    if not (number.is_integer() and 0 <= number <= MAX_POINTS):
        raise SourceError(path, f"expected a number of bodies or markers, got {cells[at]}", line=line)
    return int(number)


def _place(path: Path, cells: Sequence[str], at: int, line: int) -> list[float]:
    place = [parse_number(path, _cell(path, cells, at + axis, line), "xyz"[axis], line) for axis in range(3)]
    if any(map(math.isinf, place)):
        raise SourceError(path, "a point is infinitely far away", line=line)
    return place


def _positions(path: Path, frames: _Frames, places: dict[str, dict[int, list[float]]]) -> F64:
    """Return the positions (N, 3, T) in right-handed axes, NaN where a point is not seen."""
    if 24 * len(places) * len(frames.numbers) > MAX_BYTES:
        raise SourceError(path, f"takes more than {MAX_BYTES / 1e9:.1f} GB in memory; export shorter takes")
    positions = np.full((len(places), 3, len(frames.numbers)), np.nan)
    for track, those in zip(positions, places.values(), strict=True):
        track[:, list(those)] = np.array(list(those.values())).T
    positions[np.broadcast_to(np.isnan(positions).any(axis=1, keepdims=True), positions.shape)] = np.nan
    if frames.mirrored:
        positions[:, 2] *= -1.0
    return positions
