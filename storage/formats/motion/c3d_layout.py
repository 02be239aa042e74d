"""Read the layout of C3D files from header and parameters, and check it against the size of the file.

Blocks of 512 bytes: a header, parameters, frames (the C3D user guide, c3d.org). No stated count is used before it is
checked.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.reader import MAX_POINTS
from kinedex.storage.formats.source_files import any_text, file_size, part_of

BLOCK = 512
KEY = 0x50
INTEL, DEC, MIPS = 84, 85, 86
"""Processor types, which determine byte order and floating-point format."""

_USED = {
    "POINT": r"USED|SCALE|RATE|DATA_START|FRAMES|LONG_FRAMES|UNITS|Y_SCREEN|LABELS\d*",
    "ANALOG": "USED",
    "TRIAL": r"ACTUAL_(START|END)_FIELD",
}
"""The groups and parameters that are read; others may be damaged."""

_LONGEST_HEAD = 16 << 20  # bytes of header and parameters; 300 labels take some 50 kB
_MAX_COUNTED = 0xFFFF  # frames; the largest number in 16 bits


@dataclass(frozen=True)
class Parameter:
    """A parameter as the file stores it.

    Attributes
    ----------
    kind : int
        Bytes per value; −1 for text.
    dims : tuple of int
        Its number of values along each dimension.
    values : bytes
        All values.
    order : str
        The byte order of numbers, in the notation of `struct`.
    """

    kind: int
    dims: tuple[int, ...]
    values: bytes
    order: str = "<"

    @property
    def words(self) -> tuple[int, ...]:
        """The values as unsigned integers if they have two bytes each; otherwise empty."""
        return struct.unpack(f"{self.order}{len(self.values) // 2}H", self.values) if self.kind == 2 else ()

    @property
    def real(self) -> bytes:
        """The bytes of the first value if it is a number of four bytes; otherwise empty."""
        return self.values[:4] if self.kind == 4 else b""

    @property
    def texts(self) -> list[str]:
        """The values as texts; the first dimension is the length of each."""
        width = self.dims[0] if self.dims else 1
        if self.kind != -1 or not width:
            return []
        cut = [self.values[at : at + width] for at in range(0, len(self.values), width)]
        return [any_text(text).strip(" \0") for text in cut]


def real(raw: bytes, processor: int) -> float:
    """Decode a 4-byte float; DEC's has its 16-bit halves exchanged and is four times as large."""
    if processor != DEC:
        return float(struct.unpack(order_of(processor) + "f", raw)[0])
    return float(struct.unpack("<f", raw[2:] + raw[:2])[0]) / 4.0


def order_of(processor: int) -> str:
    """Return the byte order of numbers in the notation of `struct`: big-endian for MIPS, else little-endian."""
    return ">" if processor == MIPS else "<"


@dataclass(frozen=True)
class Layout:
    """The byte offsets and sizes of everything in a C3D file.

    Attributes
    ----------
    points : int
        Markers of a frame.
    analog : int
        Analog samples of a frame.
    frames : int
        Frames that the file holds.
    first : int
        Number of the first frame.
    start : int
        Byte where the frames begin.
    size : int
        Bytes per number.
    processor : int
        `INTEL`, `DEC` or `MIPS`.
    scale : bytes
        The scale factor of integers, in the bytes of the file.
    rates : tuple of float
        Frames per second by the parameters, and by the header.
    parameters : dict of str to Parameter
        The parameters of the group POINT.
    warnings : tuple of str
        Warnings about the file.
    """

    points: int
    analog: int
    frames: int
    first: int
    start: int
    size: int
    processor: int
    scale: bytes
    rates: tuple[float, ...]
    parameters: dict[str, Parameter]
    warnings: tuple[str, ...]


def read_layout(path: Path) -> Layout:
    """Read the layout of a file.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    SourceError
        The file contradicts itself or its size.
    """
    head, size = part_of(path, _LONGEST_HEAD), file_size(path)
    begin = (head[0] - 1) * BLOCK if head else 0
    if len(head) < BLOCK or head[1] != KEY or not BLOCK <= begin < len(head) - 4:
        raise SourceError(path, "is no C3D file: its first two bytes do not lead to its parameters")
    processor = head[begin + 3]
    if processor not in (INTEL, DEC, MIPS):
        raise SourceError(path, f"numbers in the order of processor {processor}, which is none of C3D files (84 to 86)")
    order = order_of(processor)
    points, analog, first, last = struct.unpack_from(f"{order}4H", head, 2)
    start_block, per_frame = struct.unpack_from(f"{order}2H", head, 16)
    # The count of blocks may be 0 or, above 255 blocks, overflow; the frames always begin after the parameters.
    end = max(begin + head[begin + 2] * BLOCK, (start_block - 1) * BLOCK)
    found = dict(_parameters(path, head[: end if end > begin else len(head)], begin + 4, order))
    stated = found.get("POINT:USED")
    if stated is not None and stated.words:
        points = stated.words[0]
    if not 0 < points <= MAX_POINTS:
        raise SourceError(path, f"expected 1 to {MAX_POINTS} markers, it states {points}")
    channels = found.get("ANALOG:USED")
    start = _start(path, found, start_block, begin + 4, size)
    scale = _real(found, "POINT:SCALE") or head[12:16]
    number = 4 if scale[{INTEL: 3, DEC: 1, MIPS: 0}[processor]] & 0x80 else 2  # a negative scale marks floats
    counts = _frame_counts(found, first, last, processor)
    samples = {analog}
    if channels is not None and channels.words:
        samples.add(channels.words[0] * per_frame)
    analog, frames, warnings = _fit(path, start, size, number, points, samples, counts)
    begins = _long(found.get("TRIAL:ACTUAL_START_FIELD"))
    rates = [real(raw, processor) for raw in (_real(found, "POINT:RATE"), head[20:24]) if raw]
    of_points = {name.removeprefix("POINT:"): what for name, what in found.items() if name.startswith("POINT:")}
    return Layout(
        points=points,
        analog=analog,
        frames=frames,
        first=first if begins is None else begins,
        start=start,
        size=number,
        processor=processor,
        scale=scale,
        rates=tuple(rates),
        parameters=of_points,
        warnings=warnings,
    )


def _real(found: dict[str, Parameter], name: str) -> bytes:
    return found[name].real if name in found else b""


def _parameters(path: Path, head: bytes, at: int, order: str) -> Iterator[tuple[str, Parameter]]:
    """Yield all parameters with their names "GROUP:NAME"; raise an error for a damaged one that is needed."""
    end = len(head)
    groups: dict[int, str] = {}
    loose: list[tuple[int, str, Parameter | None]] = []
    while True:
        if at + 2 > end:
            if not loose:
                raise SourceError(path, "has no parameters where its header states them")
            break
        length, group = struct.unpack_from("<bb", head, at)
        if group == 0 or (length == 0 and group > 0):
            break
        after = at + 2 + abs(length)
        if after + 2 > end:
            raise SourceError(path, "a parameter's name reaches beyond the parameters")
        name = head[at + 2 : after].decode("latin-1").strip().upper()
        (step,) = struct.unpack_from(f"{order}H", head, after)
        if group < 0:
            groups.setdefault(-group, name)
        else:
            loose.append((group, name, _parameter(head, after + 2, order)))
        if step == 0:
            break
        if step < 2:
            raise SourceError(path, f"what follows its parameter '{name}' cannot be found")
        at = after + step
    for group, name, parameter in loose:
        of = groups.get(group, "")
        if parameter is not None:
            yield f"{of}:{name}", parameter
        elif re.fullmatch(_USED.get(of, ""), name):
            raise SourceError(path, f"its parameter {of}:{name} is larger than there is room for, or of no known kind")


def _parameter(head: bytes, at: int, order: str) -> Parameter | None:
    """Read the parameter at a byte; None if that cannot be a parameter."""
    try:
        kind, count = struct.unpack_from("<bB", head, at)
        dims = struct.unpack_from(f"<{count}B", head, at + 2)
    except struct.error:
        return None
    begin, size = at + 2 + count, abs(kind) * math.prod(dims)
    if kind not in (-1, 1, 2, 4) or count > 7 or begin + size > len(head):
        return None
    return Parameter(kind, dims, head[begin : begin + size], order)


def _start(path: Path, found: dict[str, Parameter], block: int, least: int, size: int) -> int:
    """Return the byte at which the frames begin, from the header or else from the parameters."""
    stated = found.get("POINT:DATA_START")
    for candidate in (block, *(stated.words[:1] if stated is not None else ())):
        start = (candidate - 1) * BLOCK
        if least < start < size:
            return start
    raise SourceError(path, f"its frames should begin at block {block}, but it has {size // BLOCK} blocks")


def _long(parameter: Parameter | None) -> int | None:
    """Return a count in two words of 16 bits each, the lower first, as in TRIAL:ACTUAL_START_FIELD; None if absent."""
    if parameter is None or len(parameter.words) < 2:
        return None
    return parameter.words[0] + (parameter.words[1] << 16)


def _frame_counts(found: dict[str, Parameter], first: int, last: int, processor: int) -> list[int]:
    """Return the numbers of frames stated in a file, most reliable first: parameters are not limited to 16 bits."""
    counts = []
    start, end = (_long(found.get(f"TRIAL:ACTUAL_{name}_FIELD")) for name in ("START", "END"))
    if start is not None and end is not None:
        counts.append(end - start + 1)
    for name in ("POINT:LONG_FRAMES", "POINT:FRAMES"):
        stated = found.get(name)
        if stated is not None and stated.words:
            counts.append(stated.words[0])
        elif stated is not None and stated.kind == 4 and len(stated.values) == 4:
            value = real(stated.values, processor)
            counts.append(int(value) if 0 < value < 2**31 else 0)
    counts.append(last - first + 1)
    return [count for count in counts if count > 0]


def _fit(
    path: Path, start: int, end: int, number: int, points: int, samples: set[int], counts: list[int]
) -> tuple[int, int, tuple[str, ...]]:
    """Return the analog samples per frame and the frames that fit the bytes from start to end, and warnings."""
    room = end - start
    # The frames fill their last block, or end within it; some programs add a block to frames that fill it exactly.
    sizes = {analog: number * (4 * points + analog) for analog in sorted(samples)}
    for analog, size in sizes.items():
        for count in counts:
            if count * size <= room <= count * size + BLOCK:
                return analog, count, ()
    doubt: tuple[str, ...] = ()
    if len(sizes) > 1:
        doubt = ("its header and its parameters contradict each other in the analog samples of a frame",)
    analog, size = min(sizes.items(), key=lambda item: min(abs(count * item[1] - room) for count in counts or [0]))
    there = room // size
    if not there or not counts:
        raise SourceError(path, "holds no frames" if counts else "does not state how many frames it holds")
    if counts[0] > there:
        return analog, there, (*doubt, f"the file states {counts[0]} frames, it holds {there}, which are kept")
    if counts[0] == _MAX_COUNTED:
        there -= _empty(path, start + there * size, size)
        most = f"the file states {counts[0]} frames, the most that it can state, and holds {there}"
        return analog, there, (*doubt, most)
    return analog, counts[0], (*doubt, f"the file states {counts[0]} frames, which are read; it has room for {there}")


def _empty(path: Path, end: int, size: int) -> int:
    """Return the number of frames before a byte that only pad the last block."""
    tail = part_of(path, BLOCK // size * size, end - BLOCK // size * size)
    return next(
        (i for i in range(BLOCK // size) if any(tail[len(tail) - (i + 1) * size : len(tail) - i * size])), BLOCK // size
    )
