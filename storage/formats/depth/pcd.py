"""Read point clouds in PCD 0.7 (of the Point Cloud Library) and in PLY, both as text and in binary forms."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.depth.lzf import decompress
from kinedex.ops.errors import ParameterError, SourceError
from kinedex.storage.formats.depth.clouds import (
    MAX_BYTES,
    MAX_POINTS,
    Cloud,
    as_points,
    check_bytes,
    cloud_bytes,
    cloud_of,
    number_rows,
    record_points,
    refuse_size,
)

F64 = npt.NDArray[np.float64]

_MAX_HEADER = 1 << 16
_MAX_FILL = 1 << 16
_MAX_FIELDS, _MAX_COUNT = 256, 1024
_KEYS = ("FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT")
_PCD_TYPES = {
    **{f"F{size}": f"<f{size}" for size in (4, 8)},
    **{f"{kind}{size}": f"<{kind.lower()}{size}" for kind in "IU" for size in (1, 2, 4, 8)},
}


@dataclass(frozen=True)
class _PcdHeader:
    """The header of a PCD file.

    `names`, `types` and `counts` hold for each field its name, its NumPy type, and its number of values per point.
    """

    names: tuple[str, ...]
    types: tuple[str, ...]
    counts: tuple[int, ...]
    size: tuple[int, int]
    encoding: str
    start: int
    lines: int

    @property
    def points(self) -> int:
        return self.size[0] * self.size[1]

    @property
    def sizes(self) -> tuple[int, ...]:
        """The bytes of each field of a point."""
        return tuple(np.dtype(one).itemsize * count for one, count in zip(self.types, self.counts, strict=True))


def read_pcd(path: str | Path) -> Cloud:
    """Read a point cloud in the format PCD.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    Cloud
        The points; organised in rows and columns if HEIGHT is above 1.

    Raises
    ------
    SourceError
        The file is not PCD, is truncated, or its header does not fit its data.
    """
    path = Path(path)
    data = cloud_bytes(path)
    header = _pcd_header(path, data)
    refuse_size(path, header.points, sum(header.sizes))
    if header.encoding == "ascii":
        points = _pcd_ascii(path, header, data)
    elif header.encoding == "binary":
        points = _pcd_binary(path, header, data)
    else:
        points = _compressed(path, header, data)
    return cloud_of(path, points, header.size if header.size[1] > 1 else None)


def _pcd_header(path: Path, data: bytes) -> _PcdHeader:
    """Return the header of a PCD file, which ends with the line DATA."""
    found: dict[str, list[str]] = {}
    start = number = 0
    while "DATA" not in found:
        end = data.find(b"\n", start, _MAX_HEADER)
        if end < 0:
            raise SourceError(path, "is no PCD: no line DATA in its first 64 KB")
        words = data[start:end].decode("latin-1").split("#")[0].split()
        start, number = end + 1, number + 1
        if words and words[0] != "VERSION" and words[0] in found:
            raise SourceError(path, f"{words[0]} stands twice", line=number)
        if words:
            found["FIELDS" if words[0] == "COLUMNS" else words[0]] = words[1:]
    for key in _KEYS:
        if key not in found:
            raise SourceError(path, f"is no PCD: no line {key} before DATA")
    names = tuple(found["FIELDS"])
    counts = tuple(_whole(path, "COUNT", word) for word in found.get("COUNT", ["1"] * len(names)))
    kinds = [f"{kind}{size}" for kind, size in zip(found["TYPE"], found["SIZE"], strict=False)]
    if not len(names) == len(counts) == len(found["TYPE"]) == len(found["SIZE"]) or not 0 < len(names) <= _MAX_FIELDS:
        raise SourceError(path, "FIELDS, SIZE, TYPE and COUNT must have as many entries, 1 to 256")
    other = next((kind for kind in kinds if kind not in _PCD_TYPES), None)
    if other is not None or not all(1 <= count <= _MAX_COUNT for count in counts):
        known = "F of 4 or 8 bytes, I or U of 1, 2, 4 or 8, and COUNT 1 to 1024"
        raise SourceError(path, f"expected TYPE and SIZE {known}, got {(other or 'a larger COUNT')[:40]}")
    width, height = (_whole(path, key, " ".join(found[key])) for key in ("WIDTH", "HEIGHT"))
    encoding = " ".join(found["DATA"])
    if encoding not in ("ascii", "binary", "binary_compressed"):
        raise SourceError(path, f"DATA must be ascii, binary or binary_compressed, got {encoding[:40]!r}")
    if "POINTS" in found and _whole(path, "POINTS", " ".join(found["POINTS"])) != width * height:
        claimed = " ".join(found["POINTS"])[:20]
        raise SourceError(path, f"POINTS {claimed} is not WIDTH {width} times HEIGHT {height}")
    return _PcdHeader(
        names, tuple(_PCD_TYPES[kind] for kind in kinds), counts, (width, height), encoding, start, number
    )


def _whole(path: Path, key: str, word: str) -> int:
    if not (word.isascii() and word.isdigit() and len(word) <= 12):
        raise SourceError(path, f"{key} must be a whole number, got {word[:40]!r}")
    return int(word)


def _places(path: Path, header: _PcdHeader) -> list[int]:
    """Return the indices of the fields x, y and z."""
    positions = []
    for axis in "xyz":
        if header.names.count(axis) != 1 or header.counts[header.names.index(axis)] != 1:
            raise SourceError(path, f"expected the fields x, y and z once, with COUNT 1; got {axis} otherwise")
        positions.append(header.names.index(axis))
    return positions


def _pcd_ascii(path: Path, header: _PcdHeader, data: bytes) -> F64:
    positions = _places(path, header)
    firsts = np.cumsum([0, *header.counts])
    rows = number_rows(path, data[header.start :], header.points, int(firsts[-1]), header.lines + 1)
    return np.ascontiguousarray(rows[:, [int(firsts[place]) for place in positions]])


def _pcd_binary(path: Path, header: _PcdHeader, data: bytes) -> F64:
    """Return the points of binary data, in which the record of one point follows that of the previous point."""
    positions, record = _places(path, header), sum(header.sizes)
    _check_bytes(path, header.points * record, data, header.start)
    offsets = np.cumsum([0, *header.sizes])
    types = [header.types[place] for place in positions]
    return record_points(data, header.start, header.points, record, types, [int(offsets[place]) for place in positions])


def _compressed(path: Path, header: _PcdHeader, data: bytes) -> F64:
    """Return the points of compressed data, in which all values of a field come before those of the next."""
    positions, record = _places(path, header), sum(header.sizes)
    if len(data) < header.start + 8:
        raise SourceError(path, "is cut off after its header; copy or export it again")
    packed, unpacked = struct.unpack_from("<II", data, header.start)
    _check_bytes(path, packed, data, header.start + 8)
    if unpacked != header.points * record or unpacked > MAX_BYTES:
        raise SourceError(path, f"claims {unpacked:,} bytes for {header.points:,} points of {record} bytes")
    try:
        fields = decompress(data[header.start + 8 : header.start + 8 + packed], unpacked)
    except ParameterError as fault:
        raise SourceError(path, f"its compressed data are damaged: {fault}") from None
    offsets = header.points * np.cumsum([0, *header.sizes])
    return as_points(
        [np.frombuffer(fields, header.types[place], header.points, int(offsets[place])) for place in positions]
    )


def _check_bytes(path: Path, claimed: int, data: bytes, start: int) -> None:
    """Raise an error if a file has fewer or more bytes than stated; zeros that fill a last memory page are allowed."""
    found = len(data) - start
    if not (claimed < found <= claimed + _MAX_FILL and not data[start + claimed :].strip(b"\0\n")):
        check_bytes(path, claimed, found)


_MAX_PROPERTIES = 1024
_MAX_ELEMENTS = 10**12
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_PLY_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip


@dataclass
class _Element:
    """An element of a PLY file, such as `vertex`: its number of rows, and the names and types of its properties.

    The type of a property that is a list is empty.
    """

    name: str
    rows: int
    names: list[str] = field(default_factory=list)
    types: list[str] = field(default_factory=list)

    @property
    def record(self) -> int:
        """The bytes of a row."""
        return sum(np.dtype(one).itemsize for one in self.types)


def read_ply(path: str | Path) -> Cloud:
    """Read a point cloud in the format PLY, which is never organised in rows and columns.

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
    order, elements, start, lines = _ply_header(path, data)
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
        points = _ply_binary(path, data[start:], order, before, vertices, last)
    else:
        points = _ply_ascii(path, data[start:], lines + 1, before, vertices, last)
    return cloud_of(path, points, None)


def _ply_header(path: Path, data: bytes) -> tuple[str, list[_Element], int, int]:
    """Return byte order and elements, the byte offset of the data, and the number of lines of the header."""
    stop = data.find(b"end_header", 0, _MAX_HEADER)
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
            if len(elements[-1].names) == _MAX_PROPERTIES:
                raise SourceError(path, f"has more than {_MAX_PROPERTIES} properties", line=number)
            elements[-1].names.append(words[-1])
            elements[-1].types.append("" if words[1] == "list" else _PLY_TYPES[words[1]])
        else:
            raise SourceError(path, f"expected a format, an element or a property, got {line[:60]!r}", line=number)
    if order is None:
        raise SourceError(path, f"expected `format` with one of {', '.join(_ORDERS)} and 1.0")
    return order, elements, end + 1, len(lines)


def _is_count(word: str) -> bool:
    return word.isascii() and word.isdigit() and len(word) <= 13 and int(word) <= _MAX_ELEMENTS


def _is_property(words: list[str]) -> bool:
    """Return True for `property TYPE NAME` and `property list TYPE TYPE NAME`."""
    if words[1:2] == ["list"]:
        return len(words) == 5 and words[2] in _PLY_TYPES and words[3] in _PLY_TYPES
    return len(words) == 3 and words[1] in _PLY_TYPES


def _ply_binary(path: Path, data: bytes, order: str, before: list[_Element], vertices: _Element, last: bool) -> F64:
    """Return x, y, z (n, 3) of the vertices of binary data."""
    skipped = sum(one.rows * one.record for one in before)
    size = vertices.rows * vertices.record
    if last or len(data) < skipped + size:
        check_bytes(path, skipped + size, len(data))
    offsets = np.cumsum([0, *(np.dtype(one).itemsize for one in vertices.types)])
    positions = [vertices.names.index(axis) for axis in "xyz"]
    types = [order + vertices.types[place] for place in positions]
    return record_points(
        data, skipped, vertices.rows, vertices.record, types, [int(offsets[place]) for place in positions]
    )


def _ply_ascii(path: Path, data: bytes, line: int, before: list[_Element], vertices: _Element, last: bool) -> F64:
    """Return x, y, z (n, 3) of the vertices of text."""
    skipped = sum(one.rows for one in before)
    if skipped > MAX_POINTS:
        raise SourceError(path, f"claims {skipped:,} rows before its vertices, and a frame has {MAX_POINTS:,} points")
    start = 0
    for _ in range(skipped):
        start = data.find(b"\n", start) + 1
        if not start:
            raise SourceError(path, f"claims {skipped:,} rows before its vertices, and has fewer: is it cut off?")
    numbers = number_rows(path, data[start:], vertices.rows, len(vertices.names), line + skipped, last)
    return np.ascontiguousarray(numbers[:, [vertices.names.index(axis) for axis in "xyz"]])
