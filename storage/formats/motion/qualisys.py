"""Read TSV files of Qualisys Track Manager: markers under a header of keys, such as NO_OF_FRAMES."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.points import Points
from kinedex.storage.formats.motion.position_tables import PointTable, TableReader, first_lines, parse_number
from kinedex.storage.formats.motion.reader import FASTEST_HZ, MAX_POINTS, SLOWEST_HZ, MotionFile, ReadSettings
from kinedex.storage.formats.source_files import as_number, beginning

_HEADER_LINES = 40
_FIRST_KEY, _NAMES = "NO_OF_FRAMES", "MARKER_NAMES"
_MISSING = "NULL"
_KEY = re.compile(r"[A-Z]+(_[A-Z0-9]+)+|FREQUENCY|DESCRIPTION")
_UNIT_M = 0.001


@dataclass(frozen=True)
class _Table(PointTable):
    """The table of a file, and the keys before it with their values."""

    stated: dict[str, list[str]] = field(default_factory=dict)

    def number(self, key: str) -> float:
        """Return the number that a key states."""
        line = list(self.stated).index(key) + 1 if key in self.stated else 1
        if not self.stated.get(key):
            raise SourceError(self.path, f"the header has no {key}", line=line)
        return parse_number(self.path, self.stated[key][0], key, line)


class QualisysReader(TableReader):
    """Reads TSV files of markers; those of rigid bodies and skeletons are refused."""

    title: ClassVar[str] = "TSV (Qualisys), markers"
    endings: ClassVar[tuple[str, ...]] = (".tsv",)

    def sniff(self, path: Path) -> bool:
        """Return whether the file begins with the first key of Qualisys."""
        return beginning(path, 64).startswith(f"{_FIRST_KEY}\t")

    def table(self, path: Path) -> PointTable:
        """Return the table of markers."""
        return _table(path)

    def points(self, file: MotionFile, settings: ReadSettings) -> Points:
        """Read the markers; one at exactly 0, 0, 0 counts as missing."""
        path, table = file.path, _table(file.path)
        warnings: list[str] = []
        rate_hz = table.number("FREQUENCY")
        if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
            raise SourceError(path, f"FREQUENCY must be {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz, got {rate_hz:g}")
        names, positions = table.read(file.person, warnings)
        claimed, frames = table.number(_FIRST_KEY), positions.shape[2]
        if claimed != frames:
            warnings.append(f"the header states {claimed:g} frames, the file holds {frames}, which are kept")
        return Points(str(path), names, positions, rate_hz, unit_m=table.unit_m, warnings=warnings)


def _table(path: Path) -> _Table:
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
    if len(labels) > MAX_POINTS:
        raise SourceError(path, f"expected at most {MAX_POINTS} {_NAMES}, got {len(labels)}")
    if last == len(rows):
        raise SourceError(path, "no frames: the file ends after its header", line=last)
    heads = rows[last][0] != _MISSING and as_number(rows[last][0] or "nan") is None
    row = rows[last + heads] if last + heads < len(rows) else []
    cells = len(row) - (not row[-1]) if row else 0
    leading = cells - 3 * len(labels)
    if leading not in (0, 1, 2):
        raise SourceError(
            path, f"expected {3 * len(labels)} coordinates of {len(labels)} markers in a row, perhaps after frame and "
            f"time, got {cells} cells", line=last + 1 + heads,
        )  # fmt: skip
    header = [*("Frame", "Time")[:leading], *(f"{name} {axis}" for name in labels for axis in "XYZ")]
    columns = tuple((x, x + 1, x + 2) for x in range(leading, cells, 3))
    return _Table(
        path, tuple(labels), tuple(header), columns, last + heads, "\t", missing=_MISSING, numbered=leading > 0,
        unit_m=_UNIT_M, origin_missing=True, stated=stated,
    )  # fmt: skip
