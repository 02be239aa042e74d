"""Read TSV files of Qualisys Track Manager: markers under a header of keys, such as NO_OF_FRAMES."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.points import Points, PointsReader, bodies_of, labels_of_person
from kinedex.storage.formats.motion.position_tables import Section, first_lines, parse_number, refuse_jumps
from kinedex.storage.formats.motion.reader import FASTEST_HZ, MOST_POINTS, SLOWEST_HZ, MotionFile, ReadSettings
from kinedex.storage.formats.source_files import beginning

_HEADER_LINES = 40
_FIRST_KEY, _NAMES = "NO_OF_FRAMES", "MARKER_NAMES"
_MISSING = "NULL"
_KEY = re.compile(r"[A-Z]+(_[A-Z0-9]+)+|FREQUENCY|DESCRIPTION")
_UNIT_M = 0.001


@dataclass(frozen=True)
class _Layout:
    """The keys of a file, the last line before the rows, the columns, and the number of columns before the markers."""

    stated: dict[str, list[str]]
    line: int
    labels: tuple[str, ...]
    header: tuple[str, ...]
    leading: int


class QualisysReader(PointsReader):
    """Reads TSV files of markers; those of rigid bodies and skeletons are refused."""

    title: ClassVar[str] = "TSV (Qualisys), markers"
    endings: ClassVar[tuple[str, ...]] = (".tsv",)

    def sniff(self, path: Path) -> bool:
        """Return whether the file begins with the first key of Qualisys."""
        return beginning(path, 64).startswith(f"{_FIRST_KEY}\t")

    def persons(self, file: MotionFile, mappings: Mappings) -> tuple[str, ...]:
        """Return the names of the subjects, if several have enough points for a person."""
        return tuple(bodies_of(_layout(file.path).labels))

    def size(self, file: MotionFile) -> tuple[int, int, int]:
        """Return the numbers of rows and markers of a file, and the memory in bytes that reading it needs."""
        layout = _layout(file.path)
        table = _table(file.path, layout)
        return table.rows, len(layout.labels), table.bytes + 24 * table.rows

    def points(self, file: MotionFile, settings: ReadSettings) -> Points:
        """Read the markers; one at exactly 0, 0, 0 counts as missing."""
        path, layout = file.path, _layout(file.path)
        warnings: list[str] = []
        rate_hz = _number(path, layout, "FREQUENCY")
        if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
            raise SourceError(path, f"FREQUENCY must be {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz, got {rate_hz:g}")
        places, names = labels_of_person(path, layout.labels, file.person, warnings)
        order = [layout.leading + 3 * i + axis for i in places for axis in range(3)]
        table = _table(path, layout)
        others = (0,) if layout.leading else ()
        positions, numbers, where = table.points(layout.header, order, others)
        if numbers:
            refuse_jumps(path, numbers[0], where)
        hidden = (positions == 0.0).all(axis=1, keepdims=True)
        positions[np.broadcast_to(hidden, positions.shape)] = np.nan
        claimed = _number(path, layout, _FIRST_KEY)
        if claimed != table.rows:
            warnings.append(f"the header states {claimed:g} frames, the file holds {table.rows}, which are kept")
        return Points(str(path), names, positions, rate_hz, unit_m=_UNIT_M, warnings=warnings)


def _table(path: Path, layout: _Layout) -> Section:
    return Section(path, "\t", 1, layout.line, 1 << 62, missing=_MISSING)


def _layout(path: Path) -> _Layout:
    """Read the keys, each with its values on its line, and determine the columns."""
    lines = first_lines(path, _HEADER_LINES)
    rows = [[cell.strip() for cell in line.split("\t")] for line in lines]
    if rows[0][0] != _FIRST_KEY:
        raise SourceError(path, f"expected a TSV file of Qualisys, which begins with {_FIRST_KEY}", line=1)
    last = next((i for i, row in enumerate(rows) if not _KEY.fullmatch(row[0])), len(rows))
    stated = {row[0]: row[1:] for row in rows[:last]}
    labels = [name for name in stated.get(_NAMES, []) if name]
    if not labels:
        held = ", ".join(stated.get("DATA_INCLUDED", [])) or ", ".join(key for key in stated if key.endswith("_NAMES"))
        raise SourceError(
            path,
            f"holds no markers but {held or 'something else'}; export 3D data, with {_NAMES} in the header",
            line=last,
        )
    twice = next((name for name, count in Counter(labels).items() if count > 1), None)
    if twice is not None or len(labels) > MOST_POINTS:
        raise SourceError(path, f"expected at most {MOST_POINTS} different {_NAMES}, got '{twice or len(labels)}'")
    if last == len(rows):
        raise SourceError(path, "no frames: the file ends after its header", line=last)
    heads = not _is_number(rows[last][0])
    row = rows[last + heads] if last + heads < len(rows) else []
    cells = len(row) - (not row[-1]) if row else 0
    leading = cells - 3 * len(labels)
    if leading not in (0, 1, 2):
        raise SourceError(
            path, f"expected {3 * len(labels)} coordinates of {len(labels)} markers in a row, perhaps after frame and "
            f"time, got {cells} cells", line=last + 1 + heads,
        )  # fmt: skip
    header = [*("Frame", "Time")[:leading], *(f"{name} {axis}" for name in labels for axis in "XYZ")]
    return _Layout(stated, last + heads, tuple(labels), tuple(header), leading)


def _is_number(cell: str) -> bool:
    try:
        float(cell or "nan")
    except ValueError:
        return cell == _MISSING
    return True


def _number(path: Path, layout: _Layout, key: str) -> float:
    """Return the number that a key states."""
    line = list(layout.stated).index(key) + 1 if key in layout.stated else 1
    if not layout.stated.get(key):
        raise SourceError(path, f"the header has no {key}", line=line)
    return parse_number(path, layout.stated[key][0], key, line)
