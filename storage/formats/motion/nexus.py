"""Read CSV files that Vicon Nexus and Workstation export: sections with a rate, labels, axes and units."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import ClassVar

from kinedex.catalog.skeletons.units import STATED_UNITS_M
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.csv_tables import csv_cells
from kinedex.storage.formats.motion.points import Points
from kinedex.storage.formats.motion.position_tables import PointTable, TableReader, parse_number
from kinedex.storage.formats.motion.reader import FASTEST_HZ, MAX_POINTS, SLOWEST_HZ, MotionFile, ReadSettings
from kinedex.storage.formats.motion.text_blocks import after_last_line, blocks
from kinedex.storage.formats.source_files import as_number, beginning, text_of

_TITLES = ("trajectories", "model outputs", "segments", "joints", "devices", "events")
_USED = ("trajectories", "model outputs", "segments")
"""The sections that hold positions; the first that a file has is used."""

_FIRST_CELLS = ("frame", "field #", "field")
_START = re.compile(rf'(?im)^"?({"|".join(_TITLES)})"?[,\s]*?\r?\n"?\d+(\.\d+)?"?(,|\r?\n)')
_OTHER = re.compile(r"(Angles?|Force|Moment|Power|GRF)\d?$")
_AXES = (("X", "Y", "Z"), ("TX", "TY", "TZ"))
"""The axis names of points, and of the origins of segments, whose names end in O as in C3D files."""


@dataclass(frozen=True)
class _Table(PointTable):
    """A section with positions: its title and its rate."""

    title: str = ""
    rate_hz: float = 0.0


class NexusReader(TableReader):
    """Reads CSV files of Vicon, whose sections begin with a line for the title and one for the rate."""

    title: ClassVar[str] = "CSV (Vicon Nexus)"
    endings: ClassVar[tuple[str, ...]] = (".csv",)

    def sniff(self, path: Path) -> bool:
        """Return whether the file begins with a section, after optional header lines of Workstation."""
        return _START.search(beginning(path, 1 << 14)) is not None

    def table(self, path: Path) -> PointTable:
        """Return the table of the section with positions."""
        return _table(path)

    def points(self, file: MotionFile, settings: ReadSettings) -> Points:
        """Read the markers of a subject, or the points that its model computes if there are no markers."""
        table, warnings = _table(file.path), list[str]()
        if table.title != "trajectories":
            warnings.append(f"it has no section Trajectories; the body is that of {table.title.title()}")
        names, positions = table.read(file.person, warnings)
        return Points(str(file.path), names, positions, table.rate_hz, unit_m=table.unit_m, warnings=warnings)


def _table(path: Path) -> _Table:
    """Find the section with positions, and describe its columns."""
    found: dict[str, tuple[int, int, list[str]]] = {}
    for title, start, stop, head in _sections(path):
        found.setdefault(title, (start, stop, head))
    used = next((title for title in _USED if title in found), None)
    if used is None:
        held = ", ".join(name.title() for name in found) or "none"
        raise SourceError(
            path, f"has no section with positions (Trajectories or Model Outputs), only: {held}; export trajectories",
            line=1,
        )  # fmt: skip
    start, stop, head = found[used]
    rows = [[cell.strip() for cell in csv_cells(line, ",")] for line in head]
    rate_hz = parse_number(path, rows[1][0] if len(rows) > 1 else "", "rate", start + 1)
    if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        raise SourceError(path, f"expected a rate of {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz, got {rate_hz:g}", line=start)
    if len(rows) < 4 or not rows[3] or rows[3][0].lower() not in _FIRST_CELLS:
        raise SourceError(path, "expected a line of labels and one that begins with 'Frame'", line=min(start + 3, stop))
    has_units = len(rows) > 4 and any(cell and as_number(cell) is None for cell in rows[4])
    labels, columns, unit_m = _points(path, rows[2], rows[3], rows[4] if has_units else [], start)
    cells = tuple(f"{axis} {i}" for i, axis in enumerate(rows[3]))
    line = start + (4 if has_units else 3)
    return _Table(
        path, labels, cells, columns, line, start=start, stop=stop, title=used, rate_hz=rate_hz, unit_m=unit_m
    )  # fmt: skip


def _sections(path: Path) -> Iterator[tuple[str, int, int, list[str]]]:
    """Yield title, first line, last line and the first five lines of every section; empty lines separate them."""
    title, start, head = "", 0, list[str]()
    number = 0
    lines = (line for block in blocks(path, None, after_last_line) for line in text_of(block.data).splitlines())
    for number, line in enumerate(lines, 1):
        bare = line.strip(', "\t')
        if title and not bare and len(head) > 3:
            yield title, start, number - 1, head
            title = ""
        elif not title and bare.lower() in _TITLES:
            title, start, head = bare.lower(), number, [line]
        elif title and len(head) < 5:
            head.append(line)
    if title:
        yield title, start, number, head


def _points(
    path: Path, names: list[str], axes: list[str], units: list[str], line: int
) -> tuple[tuple[str, ...], tuple[tuple[int, int, int], ...], float | None]:
    """Return the labels of points, the columns of each, and the metres per unit."""
    starts = [i for i, name in enumerate(names) if name]
    labels, columns, units_m = [], [], set[float | None]()
    for start, stop in pairwise([*starts, len(axes)]):
        at = {axis.upper(): i for i, axis in enumerate(axes[start:stop], start)}
        own = next((own for own in _AXES if all(axis in at for axis in own)), None)
        unit = units[at[own[0]]] if own is not None and at[own[0]] < len(units) else ""
        if (
            own is None
            or names[start].startswith("*")
            or _OTHER.search(names[start])
            or (units and unit not in STATED_UNITS_M)
        ):
            continue
        labels.append(names[start] + ("O" if own == _AXES[1] else ""))
        columns.append((at[own[0]], at[own[1]], at[own[2]]))
        units_m.add(STATED_UNITS_M.get(unit))
    if not 0 < len(labels) <= MAX_POINTS or len(units_m) > 1:
        raise SourceError(
            path, f"expected 1 to {MAX_POINTS} labelled points in mm or another unit of length, one for all, found "
            f"{len(labels)} points in {len(units_m)} units", line=line + 2,
        )  # fmt: skip
    return tuple(labels), tuple(columns), units_m.pop()
