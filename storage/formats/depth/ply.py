"""Read point clouds in PLY: ascii, and binary in both byte orders."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.depth.clouds import (
    MOST_POINTS,
    Cloud,
    check_bytes,
    cloud_bytes,
    cloud_of,
    number_rows,
    record_points,
    refuse_size,
)

F64 = npt.NDArray[np.float64]

_MOST_HEADER = 1 << 16
_MOST_PROPERTIES = 1024
_MOST_ELEMENTS = 10**12
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip


@dataclass
class _Element:
    """An element of a file, such as `vertex`: its rows, and the name and type of each property; lists have no type."""

    name: str
    rows: int
    names: list[str] = field(default_factory=list)
    types: list[str] = field(default_factory=list)

    @property
    def record(self) -> int:
        """The bytes of a row."""
        return sum(np.dtype(one).itemsize for one in self.types)


def read_ply(path: str | Path) -> Cloud:
    """Read a point cloud in PLY; it is never organised in rows and columns.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    Cloud
        The vertices; colours, normals and faces are skipped.

    Raises
    ------
    SourceError
        The file is not PLY, is truncated, or its header does not fit its data.
    """
    path = Path(path)
    data = cloud_bytes(path)
    order, elements, start, lines = _header(path, data)
    vertices = next((one for one in elements if one.name == "vertex"), None)
    if vertices is None:
        raise SourceError(path, "has no element vertex, the points of a cloud")
    before = elements[: elements.index(vertices)]
    if any("" in one.types for one in (*before, vertices)):
        raise SourceError(path, "has lists before or in its vertices, which are not read; write vertices first")
    for axis in "xyz":
        if vertices.names.count(axis) != 1:
            raise SourceError(path, f"vertices must have one property {axis}, got {vertices.names.count(axis)}")
    refuse_size(path, vertices.rows, vertices.record)
    last = vertices is elements[-1]
    if order:
        points = _binary(path, data[start:], order, before, vertices, last)
    else:
        points = _ascii(path, data[start:], lines + 1, before, vertices, last)
    return cloud_of(path, points, None)


def _header(path: Path, data: bytes) -> tuple[str, list[_Element], int, int]:
    """Return byte order, elements, the byte offset of the data, and the number of lines of the header."""
    stop = data.find(b"end_header", 0, _MOST_HEADER)
    end = data.find(b"\n", stop) if stop >= 0 else -1
    if data[:3] != b"ply" or end < 0:
        raise SourceError(path, "is no PLY: expected `ply` at the beginning, and `end_header` in its first 64 KB")
    order: str | None = None
    elements: list[_Element] = []
    lines = data[:end].decode("latin-1").split("\n")
    for number, line in enumerate(lines[1:-1], 2):
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) == 3 and words[1] in _ORDERS and order is None:
            order = _ORDERS[words[1]]
        elif words[0] == "element" and len(words) == 3 and _is_count(words[2]):
            elements.append(_Element(words[1], int(words[2])))
        elif words[0] == "property" and elements and _is_property(words):
            if len(elements[-1].names) == _MOST_PROPERTIES:
                raise SourceError(path, f"has more than {_MOST_PROPERTIES} properties", line=number)
            elements[-1].names.append(words[-1])
            elements[-1].types.append("" if words[1] == "list" else _TYPES[words[1]])
        else:
            raise SourceError(path, f"expected a format, an element or a property, got {line[:60]!r}", line=number)
    if order is None:
        raise SourceError(path, f"expected `format` with one of {', '.join(_ORDERS)} and 1.0")
    return order, elements, end + 1, len(lines)


def _is_count(word: str) -> bool:
    return word.isascii() and word.isdigit() and len(word) <= 13 and int(word) <= _MOST_ELEMENTS


def _is_property(words: list[str]) -> bool:
    """Return True for `property TYPE NAME` and `property list TYPE TYPE NAME`."""
    if words[1:2] == ["list"]:
        return len(words) == 5 and words[2] in _TYPES and words[3] in _TYPES
    return len(words) == 3 and words[1] in _TYPES


def _binary(path: Path, data: bytes, order: str, before: list[_Element], vertices: _Element, last: bool) -> F64:
    """Return x, y, z (n, 3) of the vertices of binary data."""
    skipped = sum(one.rows * one.record for one in before)
    size = vertices.rows * vertices.record
    if last or len(data) < skipped + size:
        check_bytes(path, skipped + size, len(data))
    offsets = np.cumsum([0, *(np.dtype(one).itemsize for one in vertices.types)])
    places = [vertices.names.index(axis) for axis in "xyz"]
    types = [order + vertices.types[place] for place in places]
    return record_points(
        data, skipped, vertices.rows, vertices.record, types, [int(offsets[place]) for place in places]
    )


def _ascii(path: Path, data: bytes, line: int, before: list[_Element], vertices: _Element, last: bool) -> F64:
    """Return x, y, z (n, 3) of the vertices of text."""
    skipped = sum(one.rows for one in before)
    if skipped > MOST_POINTS:
        raise SourceError(path, f"claims {skipped:,} rows before its vertices, and a frame has {MOST_POINTS:,} points")
    start = 0
    for _ in range(skipped):
        start = data.find(b"\n", start) + 1
        if not start:
            raise SourceError(path, f"claims {skipped:,} rows before its vertices, and has fewer: is it cut off?")
    numbers = number_rows(path, data[start:], vertices.rows, len(vertices.names), line + skipped, last)
    return np.ascontiguousarray(numbers[:, [vertices.names.index(axis) for axis in "xyz"]])
