"""Read CSV files that OptiTrack's Motive exports: bones of skeletons, or markers, in global coordinates."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from kinedex.catalog.skeletons.units import STATED_UNITS_M
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.csv_tables import csv_cells
from kinedex.storage.formats.motion.points import Points
from kinedex.storage.formats.motion.position_tables import PointTable, TableReader, first_lines, parse_number
from kinedex.storage.formats.motion.reader import FASTEST_HZ, MAX_POINTS, SLOWEST_HZ, MotionFile, ReadSettings
from kinedex.storage.formats.source_files import beginning

_HEADER_LINES = 16  # lines: the first one, some empty ones, and up to six rows that describe the columns
_UNLABELED = re.compile(r"unlabell?ed\b", re.IGNORECASE)
_KINDS = ("Bone", "Marker", "Bone Marker", "Rigid Body Marker")
"""The types of columns whose positions are points; the first type that a file has is used."""


@dataclass(frozen=True)
class _Table(PointTable):
    """The table of a file, the type of its points, and the key, value pairs of its first line."""

    kind: str = ""
    stated: dict[str, str] = field(default_factory=dict)


class MotiveReader(TableReader):
    """Reads the CSV files of Motive, whose first line begins with "Format Version"."""

    title: ClassVar[str] = "CSV (OptiTrack Motive)"
    endings: ClassVar[tuple[str, ...]] = (".csv",)

    def sniff(self, path: Path) -> bool:
        """Return whether the first line is that of Motive."""
        return beginning(path).replace('"', "").startswith("Format Version,")

    def table(self, path: Path) -> PointTable:
        """Return the table of the first type of points that the file has."""
        return _table(path)

    def points(self, file: MotionFile, settings: ReadSettings) -> Points:
        """Read the positions of the bones of a skeleton, or of markers if there is no skeleton."""
        path, table = file.path, _table(file.path)
        stated, warnings = table.stated, list[str]()
        if stated.get("Coordinate Space", "Global").lower() != "global":
            raise SourceError(
                path, f"positions are in the space {stated['Coordinate Space']!r}, in which bones lie on each other: "
                "export it again with Coordinate Space: Global", line=1,
            )  # fmt: skip
        if table.unit_m is None and stated.get("Length Units"):
            warnings.append(f"Length Units is none of {', '.join(STATED_UNITS_M)}, but {stated['Length Units']!r}")
        names, positions = table.read(file.person, warnings)
        if table.kind != "Bone":
            warnings.append(f"it holds no bones; the body is that of its points of type {table.kind}")
        return Points(str(path), names, positions, _rate(path, stated), unit_m=table.unit_m, warnings=warnings)


def _table(path: Path) -> _Table:
    """Read the rows before the numbers: key, value pairs, then a row each for type, name and axis of the columns."""
    rows = [[cell.strip() for cell in csv_cells(line, ",")] for line in first_lines(path, _HEADER_LINES)]
    if rows[0][:1] != ["Format Version"]:
        raise SourceError(path, "expected a CSV file of Motive, which begins with 'Format Version'", line=1)
    last = next((i for i, row in enumerate(rows) if row[0] == "Frame" and row[1:2] and row[1].startswith("Time")), None)
    if last is None:
        raise SourceError(path, f"expected a row 'Frame,Time (Seconds),X,…' in its first {_HEADER_LINES} lines", line=1)
    axes, kinds, names, parts = rows[last], *_described(path, rows[1:last])
    stated = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    points: dict[str, list[tuple[str, dict[str, int]]]] = {}
    for i, axis in enumerate(axes):
        kind, name, part = (row[i] if i < len(row) else "" for row in (kinds, names, parts))
        if kind in _KINDS and part == "Position" and axis in ("X", "Y", "Z") and not _UNLABELED.match(name):
            of_kind = points.setdefault(kind, [])
            if not of_kind or of_kind[-1][0] != name or axis in of_kind[-1][1]:
                of_kind.append((name, {}))
            of_kind[-1][1][axis] = i
    used = next((kind for kind in _KINDS if kind in points), None)
    if used is None or not all(len(found) == 3 for _, found in points[used]):
        held = sorted({cell for cell in kinds if cell and cell != "Type"}) or ["no columns"]
        raise SourceError(
            path, f"has no positions of bones or labelled markers, only {', '.join(held[:6])}; export it with bones, "
            "or with labelled markers", line=last + 1,
        )  # fmt: skip
    if len(points[used]) > MAX_POINTS:
        raise SourceError(
            path, f"expected at most {MAX_POINTS} points, found {len(points[used])}; export fewer", line=last + 1
        )
    columns = tuple((at["X"], at["Y"], at["Z"]) for _, at in points[used])
    texts = tuple(i for i, axis in enumerate(axes) if axis.lower().startswith("timecode"))
    labels = tuple(name for name, _ in points[used])
    unit_m = STATED_UNITS_M.get(stated.get("Length Units", "").lower())  # older files state none
    return _Table(path, labels, tuple(axes), columns, last + 1, texts=texts, unit_m=unit_m, kind=used, stated=stated)


def _described(path: Path, rows: list[list[str]]) -> tuple[list[str], list[str], list[str]]:
    """Return the rows of types, of names, and of Rotation or Position; rows of IDs and parents lie between."""
    filled = [row for row in rows if any(row)]
    first = next((i for i, row in enumerate(filled) if {*_KINDS, "Rigid Body"} & set(row)), None)
    if first is None or len(filled) < first + 3:
        raise SourceError(path, f"expected a row of types of columns: {', '.join(_KINDS)}, Rigid Body", line=2)
    return filled[first], filled[first + 1], filled[-1]


def _rate(path: Path, stated: dict[str, str]) -> float:
    """Return the frames per second of the export, or else of the recording."""
    key = next((key for key in ("Export Frame Rate", "Capture Frame Rate") if stated.get(key)), None)
    if key is None:
        raise SourceError(
            path, "its first line has neither Export Frame Rate nor Capture Frame Rate; export it again", line=1
        )
    rate_hz = parse_number(path, stated[key], key, 1)
    if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        raise SourceError(path, f"{key} must be {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz, got {stated[key]}", line=1)
    return rate_hz
