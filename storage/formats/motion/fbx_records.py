"""Parse records of FBX files, binary and text: named lists of values with records below them.

Only what describes nodes and their motion is kept; geometry, materials and embedded media are skipped. No count is used
before it is compared with the bytes present, and compressed arrays are decompressed only to their stated size.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import SourceError

Array: TypeAlias = npt.NDArray[Any]
Value: TypeAlias = int | float | str | Array

MAGIC = b"Kaydara FBX Binary  \x00\x1a\x00"
VERSIONS = (7000, 7999)
"""The range of versions that are read: FBX 2011 to 2020."""

DEEPEST = 40
"""The largest depth of nested records; files have about seven levels."""

KEPT: dict[str, set[str] | None] = {
    "Objects": {"Model", "Pose", "AnimationStack", "AnimationLayer", "AnimationCurveNode", "AnimationCurve"},
    "Connections": None,
    "GlobalSettings": None,
}
"""A dict from the top-level records that are kept to the records in them that are kept, None for all."""

UNPACKED = 30
"""The largest ratio of decompressed arrays to the records that are kept, beyond `FREE_BYTES`."""

FREE_BYTES = 16 << 20

_TYPES = {b"Y": "<h", b"C": "<b", b"I": "<i", b"F": "<f", b"D": "<d", b"L": "<q"}
_ARRAYS = {b"f": "<f4", b"d": "<f8", b"l": "<i8", b"i": "<i4", b"b": "<i1", b"c": "<u1"}


@dataclass(eq=False)
class Record:
    """A record of an FBX file.

    Attributes
    ----------
    name : str
        Its name, such as "Model".
    values : list
        Its values: numbers, texts and arrays.
    records : list of Record
        The records below it.
    """

    name: str
    values: list[Value] = field(default_factory=list)
    records: list[Record] = field(default_factory=list)

    def all(self, name: str) -> Iterator[Record]:
        """Yield the direct child records with this name."""
        return (record for record in self.records if record.name == name)

    def first(self, name: str) -> Record:
        """Return the first record with a name directly below; an empty record if there is none."""
        return next(self.all(name), Record(name))

    def numbers(self) -> npt.NDArray[np.float64]:
        """Return all numbers of the record, in its own values or in one array."""
        for value in self.values:
            if isinstance(value, np.ndarray):
                return value.astype(np.float64)
        return np.array([value for value in self.values if isinstance(value, int | float)], np.float64)

    def whole_numbers(self) -> npt.NDArray[np.int64]:
        """Return the numbers as integers; in text files, values that are not numbers become 0."""
        for value in self.values:
            if isinstance(value, np.ndarray):
                with np.errstate(invalid="ignore"):
                    return value.astype(np.int64)
        return np.array([value for value in self.values if isinstance(value, int) and abs(value) < 1 << 62], np.int64)


def read_records(path: Path, data: bytes) -> tuple[Record, int]:
    """Parse the records of an FBX file that describe nodes and their motion.

    Parameters
    ----------
    path : Path
        The file that errors name.
    data : bytes
        Its content.

    Returns
    -------
    tuple[Record, int]
        A record with the top-level records below it, and the version, such as 7400.

    Raises
    ------
    SourceError
        The file is damaged, not FBX, or of an unsupported version.
    """
    return _Binary(path, data).top() if data.startswith(MAGIC[:18]) else _Text(path, data).top()


def check_version(path: Path, version: int) -> None:
    """Raise SourceError for an unsupported version."""
    if not VERSIONS[0] <= version <= VERSIONS[1]:
        raise SourceError(path, f"is FBX of version {version}; save it as FBX 2013 to 2020 (version 7.3 to 7.7)")


# ---- binary ----------------------------------------------------------------------------------------------


class _Binary:
    """A parser of binary FBX files."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path, self.data = path, data
        if len(data) < 27:
            raise SourceError(path, "is cut off in its header")
        self.version = int.from_bytes(data[23:27], "little")
        check_version(path, self.version)
        self.head = struct.Struct("<QQQB" if self.version >= 7500 else "<IIIB")
        self.kept_bytes = 0
        self.unpacked = 0

    def error(self, at: int, message: str) -> SourceError:
        return SourceError(self.path, f"{message}, at byte {at}; is the file cut off or damaged?")

    def top(self) -> tuple[Record, int]:
        top = Record("")
        for where in self._records(27, len(self.data)):
            if where[0] in KEPT:
                top.records.append(self._record(where, 1, KEPT[where[0]]))
        return top, self.version

    def _records(self, at: int, end: int) -> Iterator[tuple[str, int, int, int, int]]:
        """Yield the records from `at` on: name, start of the values, their number and bytes, and end of the record."""
        while at + self.head.size <= end:
            stop, count, length, letters = self.head.unpack_from(self.data, at)
            if stop == 0:
                return
            start = at + self.head.size + letters
            if not start + length <= stop <= end:
                raise self.error(at, "a record claims to end elsewhere than inside of the one above it")
            name = self.data[at + self.head.size : start].decode("utf-8", "replace")
            yield name, start, count, start + length, stop
            at = stop

    def _record(self, where: tuple[str, int, int, int, int], depth: int, kept: set[str] | None = None) -> Record:
        name, start, count, values, stop = where
        if depth > DEEPEST:
            raise self.error(start, f"has records in more than {DEEPEST} levels")
        if kept is None:
            self.kept_bytes += stop - start
        record = Record(name, self._values(start, count, values) if kept is None else [])
        for below in self._records(values, stop):
            if kept is None or below[0] in kept:
                record.records.append(self._record(below, depth + 1))
        return record

    def _values(self, at: int, count: int, end: int) -> list[Value]:
        values: list[Value] = []
        for _ in range(count):
            kind = self.data[at : at + 1]
            at += 1
            if kind in _TYPES:
                number = struct.Struct(_TYPES[kind])
                if at + number.size > end:
                    raise self.error(at, "a number is longer than its record")
                values.append(number.unpack_from(self.data, at)[0])
                at += number.size
            elif kind in (b"S", b"R"):
                if at + 4 > end:
                    raise self.error(at, "a length is missing")
                length = int.from_bytes(self.data[at : at + 4], "little")
                if at + 4 + length > end:
                    raise self.error(at, "a text is longer than its record")
                text = self.data[at + 4 : at + 4 + length] if kind == b"S" else b""
                values.append(text.decode("utf-8", "replace"))
                at += 4 + length
            elif kind in _ARRAYS:
                at = self._array(values, np.dtype(_ARRAYS[kind]), at, end)
            else:
                raise self.error(at, f"a value has the unknown type {kind!r}")
        return values

    def _array(self, values: list[Value], dtype: np.dtype[Any], at: int, end: int) -> int:
        if at + 12 > end:
            raise self.error(at, "the length of an array is missing")
        count, packed, length = struct.unpack_from("<III", self.data, at)
        at += 12
        size = count * dtype.itemsize
        self.unpacked += size
        if at + length > end or packed > 1 or self.unpacked > FREE_BYTES + UNPACKED * self.kept_bytes:
            raise self.error(at, f"an array of {count} numbers is longer than its record")
        content = self.data[at : at + length]
        if packed:
            try:
                content = zlib.decompressobj().decompress(content, size + 1)
            except zlib.error as fault:
                raise self.error(at, f"an array cannot be unpacked ({fault})") from None
        if len(content) != size:
            raise self.error(at, f"an array must have {size} bytes, got {len(content)}")
        values.append(np.frombuffer(content, dtype))
        return at + int(length)


# ---- text ------------------------------------------------------------------------------------------------

_BLANK = re.compile(rb"\s*+(?:;[^\n\r]*+\s*+)*+")
_NAME = re.compile(_BLANK.pattern + rb"([A-Za-z0-9_|.\-]{1,80}+)[ \t]*+:")
_VALUE = re.compile(
    rb'\s*+(?:"([^"]*+)"'
    rb"|([-+]?[0-9.](?:[0-9.]|[eE][-+]?)*+|[-+]?(?:nan|inf)\w*+)"
    rb"|(\*[0-9]++)|([A-Za-z]\w*+)(?!:))"
)
_OPEN, _CLOSE = re.compile(_BLANK.pattern + rb"\{"), re.compile(_BLANK.pattern + rb"\}")
_COMMA = re.compile(rb"\s*+,")
_SKIPPED = re.compile(rb'"[^"]*+"|[{}]|;[^\n\r]*+')
_VERSION = re.compile(rb"FBXVersion:\s*([0-9]{1,6})")


class _Text:
    """A parser of text FBX files."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path, self.data = path, data
        found = _VERSION.search(data, 0, 1 << 16)
        if found is None:
            raise SourceError(path, "is no FBX file: it is neither binary nor has it FBXVersion near its beginning")
        self.version = int(found[1])
        check_version(path, self.version)

    def error(self, at: int, message: str) -> SourceError:
        return SourceError(self.path, message, line=self.data.count(b"\n", 0, at) + 1)

    def top(self) -> tuple[Record, int]:
        top, at = Record(""), 0
        while (found := _NAME.match(self.data, at)) is not None:
            record, at = self._record(found, 0, keep=True)
            if record.name in KEPT:
                top.records.append(record)
        rest = _BLANK.match(self.data, at)
        if rest is not None and rest.end() != len(self.data):
            raise self.error(rest.end(), "expected the name of a record with a colon, or the end of the file")
        return top, self.version

    def _record(self, found: re.Match[bytes], depth: int, keep: bool) -> tuple[Record, int]:
        if depth > DEEPEST:
            raise self.error(found.start(), f"has records in more than {DEEPEST} levels")
        record = Record(found[1].decode("utf-8", "replace").strip())
        at, length = self._values(record, found.end())
        opened = _OPEN.match(self.data, at)
        if opened is None:
            return record, at
        if length is not None:
            return record, self._array(record, opened.end(), length, keep)
        kept = KEPT.get(record.name) if depth == 0 else None
        if not keep or (depth == 0 and record.name not in KEPT):
            return record, self._end(opened.end())
        at = opened.end()
        while (below := _NAME.match(self.data, at)) is not None:
            name = below[1].decode("utf-8", "replace").strip()
            inner, at = self._record(below, depth + 1, keep=kept is None or name in kept)
            if kept is None or inner.name in kept:
                record.records.append(inner)
        closed = _CLOSE.match(self.data, at)
        if closed is None:
            raise self.error(at, f"the record {record.name[:60]} does not end; is the file cut off?")
        return record, closed.end()

    def _values(self, record: Record, at: int) -> tuple[int, int | None]:
        """Add the values after a name to a record; return their end, and the length of an array that follows."""
        while True:
            found = _VALUE.match(self.data, at)
            if found is None or (b"\n" in self.data[at : found.end()] and not record.values):
                return at, None
            text, number, count, word = found.groups()
            if count is not None:
                return found.end(), int(count[1:20])
            if text is not None:
                record.values.append(text.decode("utf-8", "replace").replace("&quot;", '"'))
            elif number is not None:
                record.values.append(self._parsed(number, at))
            else:
                record.values.append(word.decode("utf-8", "replace"))
            at = found.end()
            comma = _COMMA.match(self.data, at)
            if comma is None:
                return at, None
            at = comma.end()

    def _parsed(self, number: bytes, at: int) -> int | float:
        try:
            return int(number) if number.lstrip(b"+-").isdigit() and len(number) < 20 else float(number)
        except ValueError:
            raise self.error(at, f"expected a number, got {number[:40]!r}") from None

    def _array(self, record: Record, at: int, count: int, keep: bool) -> int:
        """Add the numbers of `*3 { a: 1,2,3 }` to a record."""
        stop = self.data.find(b"}", at)
        if stop < 0:
            raise self.error(at, f"the array of {record.name[:60]} does not end; is the file cut off?")
        if keep:
            words = self.data[at:stop].partition(b":")[2].split(b",") if count else []
            if len(words) != count:
                raise self.error(at, f"{record.name[:60]} must have {count} numbers, got {len(words)}")
            try:
                whole = all(b"." not in word and b"e" not in word and b"n" not in word for word in words)
                record.values.append(np.array([int(w) if whole else float(w) for w in words], "i8" if whole else "f8"))
            except (ValueError, OverflowError) as fault:
                raise self.error(at, f"{record.name[:60]} must be numbers: {str(fault)[:100]}") from None
        return stop + 1

    def _end(self, at: int) -> int:
        """Return the end of a block that is skipped; braces in texts do not count."""
        depth = 1
        for found in _SKIPPED.finditer(self.data, at):
            depth += {b"{": 1, b"}": -1}.get(found[0], 0)
            if not depth:
                return found.end()
        raise self.error(at, "a record does not end; is the file cut off?")
