"""Read point clouds in PCD 0.7 of the Point Cloud Library: ascii, binary and binary_compressed."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.depth.lzf import decompress
from kinedex.ops.errors import ParameterError, SourceError
from kinedex.storage.formats.depth.clouds import (
    MOST_BYTES,
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

_MOST_HEADER = 1 << 16
_MOST_FILL = 1 << 16
_MOST_FIELDS, _MOST_COUNT = 256, 1024
_KEYS = ("FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT")
_TYPES = {
    **{f"F{size}": f"<f{size}" for size in (4, 8)},
    **{f"{kind}{size}": f"<{kind.lower()}{size}" for kind in "IU" for size in (1, 2, 4, 8)},
}


@dataclass(frozen=True)
class _Header:
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
    """Read a point cloud in PCD.

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
    header = _header(path, data)
    refuse_size(path, header.points, sum(header.sizes))
    if header.encoding == "ascii":
        points = _ascii(path, header, data)
    elif header.encoding == "binary":
        points = _binary(path, header, data)
    else:
        points = _compressed(path, header, data)
    return cloud_of(path, points, header.size if header.size[1] > 1 else None)


def _header(path: Path, data: bytes) -> _Header:
    """Return the header, which ends with the line DATA."""
    found: dict[str, list[str]] = {}
    start = number = 0
    while "DATA" not in found:
        end = data.find(b"\n", start, _MOST_HEADER)
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
    if not len(names) == len(counts) == len(found["TYPE"]) == len(found["SIZE"]) or not 0 < len(names) <= _MOST_FIELDS:
        raise SourceError(path, "FIELDS, SIZE, TYPE and COUNT must have as many entries, 1 to 256")
    other = next((kind for kind in kinds if kind not in _TYPES), None)
    if other is not None or not all(1 <= count <= _MOST_COUNT for count in counts):
        known = "F of 4 or 8 bytes, I or U of 1, 2, 4 or 8, and COUNT 1 to 1024"
        raise SourceError(path, f"expected TYPE and SIZE {known}, got {(other or 'a larger COUNT')[:40]}")
    width, height = (_whole(path, key, " ".join(found[key])) for key in ("WIDTH", "HEIGHT"))
    encoding = " ".join(found["DATA"])
    if encoding not in ("ascii", "binary", "binary_compressed"):
        raise SourceError(path, f"DATA must be ascii, binary or binary_compressed, got {encoding[:40]!r}")
    if "POINTS" in found and _whole(path, "POINTS", " ".join(found["POINTS"])) != width * height:
        claimed = " ".join(found["POINTS"])[:20]
        raise SourceError(path, f"POINTS {claimed} is not WIDTH {width} times HEIGHT {height}")
    return _Header(names, tuple(_TYPES[kind] for kind in kinds), counts, (width, height), encoding, start, number)


def _whole(path: Path, key: str, word: str) -> int:
    if not (word.isascii() and word.isdigit() and len(word) <= 12):
        raise SourceError(path, f"{key} must be a whole number, got {word[:40]!r}")
    return int(word)


def _places(path: Path, header: _Header) -> list[int]:
    """Return the indices of the fields x, y and z."""
    places = []
    for axis in "xyz":
        if header.names.count(axis) != 1 or header.counts[header.names.index(axis)] != 1:
            raise SourceError(path, f"expected the fields x, y and z once, with COUNT 1; got {axis} otherwise")
        places.append(header.names.index(axis))
    return places


def _ascii(path: Path, header: _Header, data: bytes) -> F64:
    places = _places(path, header)
    firsts = np.cumsum([0, *header.counts])
    rows = number_rows(path, data[header.start :], header.points, int(firsts[-1]), header.lines + 1)
    return np.ascontiguousarray(rows[:, [int(firsts[place]) for place in places]])


def _binary(path: Path, header: _Header, data: bytes) -> F64:
    """Return the points of binary data, in which one record follows the other."""
    places, record = _places(path, header), sum(header.sizes)
    _check_bytes(path, header.points * record, data, header.start)
    offsets = np.cumsum([0, *header.sizes])
    types = [header.types[place] for place in places]
    return record_points(data, header.start, header.points, record, types, [int(offsets[place]) for place in places])


def _compressed(path: Path, header: _Header, data: bytes) -> F64:
    """Return the points of compressed data, in which all values of a field come before those of the next."""
    places, record = _places(path, header), sum(header.sizes)
    if len(data) < header.start + 8:
        raise SourceError(path, "is cut off after its header")
    packed, unpacked = struct.unpack_from("<II", data, header.start)
    _check_bytes(path, packed, data, header.start + 8)
    if unpacked != header.points * record or unpacked > MOST_BYTES:
        raise SourceError(path, f"claims {unpacked:,} bytes for {header.points:,} points of {record} bytes")
    try:
        fields = decompress(data[header.start + 8 : header.start + 8 + packed], unpacked)
    except ParameterError as fault:
        raise SourceError(path, f"its compressed data are damaged: {fault}") from None
    offsets = header.points * np.cumsum([0, *header.sizes])
    return as_points(
        [np.frombuffer(fields, header.types[place], header.points, int(offsets[place])) for place in places]
    )


def _check_bytes(path: Path, claimed: int, data: bytes, start: int) -> None:
    """Raise an error for fewer or more bytes than claimed; zeros up to a whole memory page at the end are allowed."""
    found = len(data) - start
    if not (claimed < found <= claimed + _MOST_FILL and not data[start + claimed :].strip(b"\0\n")):
        check_bytes(path, claimed, found)
