"""C3D files: markers over time, read with ezc3d from copies that are known to be whole and hold markers only.

ezc3d ends the process on some files whose parameters contradict each other, and keeps some 200 bytes of every marker
of every frame, and all analog channels. So the parameters are walked here first, and their counts are held against
the size of the file; then ezc3d is given the markers alone, a stretch of frames at a time, with the few parameters that
it needs. The layout is that of the C3D user guide (c3d.org): blocks of 512 bytes, a header, parameters, frames.
"""

from __future__ import annotations

import re
import struct
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ezc3d
import numpy as np
import numpy.typing as npt

from ops.errors import SourceError
from storage.bvh import FASTEST_HZ, SLOWEST_HZ
from storage.positions import MOST_POINTS, Points

F64 = npt.NDArray[np.float64]

BLOCK = 512
INTEL, DEC, MIPS = 84, 85, 86
"""Processor types: how numbers are written."""

_KEY = 0x50
_MOST_SAID = 0xFFFF  # frames that a word can count
_AT_ONCE = 400_000  # markers times frames that ezc3d holds at a time: some 90 MB
_KEPT = re.compile(r"USED|SCALE|RATE|UNITS|[XY]_SCREEN|LABELS\d*")
_UNITS_M = {
    "m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "meters": 1.0, "metres": 1.0, "centimeters": 0.01,
    "centimetres": 0.01, "millimeters": 0.001, "millimetres": 0.001, "inches": 0.0254,
}  # fmt: skip


@dataclass(frozen=True)
class Markers(Points):
    """The markers of a C3D file. up: the axis that the file calls vertical, "x", "y" or "z"; None where it does not."""

    up: str | None = None


@dataclass(frozen=True)
class _Parameter:
    """One parameter as it stands in the file. kind: bytes of a value, −1 for text. raw: kind, dimensions, values."""

    kind: int
    dims: tuple[int, ...]
    values: bytes
    raw: bytes

    @property
    def words(self) -> tuple[int, ...]:
        """The values as unsigned numbers, where they are two bytes each."""
        return struct.unpack(f"<{len(self.values) // 2}H", self.values) if self.kind == 2 else ()


@dataclass(frozen=True)
class _Layout:
    """Where everything is.

    points: markers of a frame. analog: analog samples of a frame. frames: those that the file holds. first: the number
    of the first of them. start: the byte where they begin. size: bytes of one number. processor: INTEL or DEC.
    header: the first block. kept: the parameters that ezc3d needs.
    """

    points: int
    analog: int
    frames: int
    first: int
    start: int
    size: int
    processor: int
    header: bytes
    kept: dict[str, _Parameter]
    warnings: tuple[str, ...]


def parse_c3d(path: Path) -> Markers:
    """Read the markers of a C3D file.

    A marker is not seen, and NaN, where its residual is negative, where a coordinate is NaN, and at 0, 0, 0.

    Returns
    -------
    The markers by their labels, which may begin with a subject's name; rate, unit, and the axis that is up where the
    file states them. A label that several markers have names none of them.

    Raises
    ------
    SourceError: what of the file contradicts itself or its size.
    """
    layout = _layout(path)
    positions = np.empty((layout.points, 3, layout.frames))
    said: dict[str, Any] = {}
    step = max(1, min(30_000, _AT_ONCE // layout.points))
    for start in range(0, layout.frames, step):
        stop = min(start + step, layout.frames)
        positions[:, :, start:stop], said = _read_with_ezc3d(path, layout, start, stop)
    lost = np.isnan(positions).any(axis=1) | (positions == 0.0).all(axis=1)
    positions[np.broadcast_to(lost[:, None], positions.shape)] = np.nan
    warnings = list(layout.warnings)
    names = _names(said, positions, warnings)
    if np.isinf(positions).any():
        point, _, frame = (int(at[0]) for at in np.nonzero(np.isinf(positions)))
        raise SourceError(path, f"marker '{names[point]}' is infinitely far away in source frame {frame}")
    if layout.first > 1:
        warnings.append(f"it begins with frame {layout.first} of its recording, which is source frame 0 here")
    rate_hz, unit_m, up = _rate(path, layout, said, warnings), _unit_m(path, said), _up(said, warnings)
    return Markers(str(path), names, positions, rate_hz, None, unit_m, warnings, up)


def _layout(path: Path) -> _Layout:
    """What the file is made of, held against its size."""
    head, size = _head(path)
    begin = (head[0] - 1) * BLOCK if head else 0
    if len(head) < BLOCK or head[1] != _KEY or not BLOCK <= begin < len(head) - 4:
        raise SourceError(path, "is no C3D file: its first two bytes do not lead to its parameters")
    blocks, processor = head[begin + 2], head[begin + 3]
    if processor not in (INTEL, DEC):
        what = f"numbers in the order of {'MIPS machines' if processor == MIPS else f'processor {processor}'}"
        raise SourceError(path, f"{what}, which are not read; save it again in that of Intel")
    # Some programs leave the count of blocks at 0; the frames begin after the parameters anyhow.
    end = begin + blocks * BLOCK if blocks else len(head)
    found = dict(_parameters(path, head, begin + 4, min(end, len(head))))
    points, analog, first, last = struct.unpack_from("<4H", head, 2)
    start_block, per_frame = struct.unpack_from("<2H", head, 16)
    said = found.get("POINT:USED")
    if said is not None and said.words:
        points = said.words[0]
    if not 0 < points <= MOST_POINTS:
        raise SourceError(path, f"expected 1 to {MOST_POINTS} markers, it says {points}")
    channels = found.get("ANALOG:USED")
    start = _start(path, found, start_block, begin + 4, size)
    number = _number_size(path, found, head)
    counts = _frame_counts(found, first, last)
    samples = {analog}
    if channels is not None and channels.words:
        samples.add(channels.words[0] * per_frame)
    analog, frames, warnings = _fit(path, start, size, number, points, samples, counts)
    begins = _long(found.get("TRIAL:ACTUAL_START_FIELD"))
    kept = {
        name.removeprefix("POINT:"): what
        for name, what in found.items()
        if name.startswith("POINT:") and _KEPT.fullmatch(name.removeprefix("POINT:"))
    }
    return _Layout(
        points, analog, frames, first if begins is None else begins, start, number, processor, head[:BLOCK], kept,
        warnings,
    )  # fmt: skip


def _head(path: Path) -> tuple[bytes, int]:
    """The first bytes of the file, in which header and parameters lie, and its size."""
    try:
        with path.open("rb") as file:
            head = file.read(BLOCK * (255 + 255))
            return head, file.seek(0, 2)
    except OSError as fault:
        raise SourceError(path, f"cannot be read: {fault.strerror}") from None


def _parameters(path: Path, head: bytes, at: int, end: int) -> Iterator[tuple[str, _Parameter]]:
    """All parameters as "GROUP:NAME"; what cannot be a parameter is an error."""
    groups: dict[int, str] = {}
    loose: list[tuple[int, str, _Parameter]] = []
    while True:
        if at + 2 > end:
            raise SourceError(path, "its parameters do not end where it says")
        length, group = struct.unpack_from("<bb", head, at)
        if group == 0 or (length == 0 and group > 0):
            break
        after = at + 2 + abs(length)
        if after + 2 > end:
            raise SourceError(path, "a parameter's name reaches beyond the parameters")
        name = head[at + 2 : after].decode("latin-1").strip().upper()
        (step,) = struct.unpack_from("<H", head, after)
        if group < 0:
            groups.setdefault(-group, name)
        else:
            loose.append((group, name, _parameter(path, head[:end], after + 2, name)))
        if step == 0:
            break
        if step < 2:
            raise SourceError(path, f"what follows its parameter '{name}' cannot be found")
        at = after + step
    for group, name, parameter in loose:
        yield f"{groups.get(group, '')}:{name}", parameter


def _parameter(path: Path, head: bytes, at: int, name: str) -> _Parameter:
    try:
        kind, count = struct.unpack_from("<bB", head, at)
        dims = struct.unpack_from(f"<{count}B", head, at + 2)
        size = abs(kind)
        for dim in dims:
            size *= dim
        begin = at + 2 + count
        if kind not in (-1, 1, 2, 4) or count > 7 or begin + size > len(head):
            raise struct.error
    except struct.error:
        raise SourceError(
            path, f"its parameter '{name}' is larger than there is room for, or of no known kind"
        ) from None
    return _Parameter(kind, dims, head[begin : begin + size], head[at : begin + size])


def _start(path: Path, found: dict[str, _Parameter], block: int, least: int, size: int) -> int:
    """The byte where the frames begin: by the header, else by the parameters."""
    said = found.get("POINT:DATA_START")
    for candidate in (block, *(said.words[:1] if said is not None else ())):
        start = (candidate - 1) * BLOCK
        if least < start < size:
            return start
    raise SourceError(path, f"its frames should begin at block {block}, but it has {size // BLOCK} blocks")


def _number_size(path: Path, found: dict[str, _Parameter], head: bytes) -> int:
    """Bytes of one number: 4 where the scale is negative, else 2; the sign bit is in the same place in both orders."""
    said = found.get("POINT:SCALE")
    raw = said.values if said is not None and said.kind == 4 and len(said.values) == 4 else head[12:16]
    top = raw[3] if head[(head[0] - 1) * BLOCK + 3] == INTEL else raw[1]
    return 4 if top & 0x80 else 2


def _long(parameter: _Parameter | None) -> int | None:
    """A count in two words of 16 bits each, the lower first, as TRIAL:ACTUAL_START_FIELD has it."""
    if parameter is None or len(parameter.words) < 2:
        return None
    return parameter.words[0] + (parameter.words[1] << 16)


def _frame_counts(found: dict[str, _Parameter], first: int, last: int) -> list[int]:
    """What the file says of its number of frames, the places that can hold a large one first."""
    counts = []
    start, end = (_long(found.get(f"TRIAL:ACTUAL_{name}_FIELD")) for name in ("START", "END"))
    if start is not None and end is not None:
        counts.append(end - start + 1)
    for name in ("POINT:LONG_FRAMES", "POINT:FRAMES"):
        said = found.get(name)
        if said is not None and said.words:
            counts.append(said.words[0])
        elif said is not None and said.kind == 4 and len(said.values) == 4:
            (value,) = struct.unpack("<f", said.values)
            counts.append(int(value) if 0 < value < 2**31 else 0)
    counts.append(last - first + 1)
    return [count for count in counts if count > 0]


def _fit(
    path: Path, start: int, end: int, number: int, points: int, samples: set[int], counts: list[int]
) -> tuple[int, int, tuple[str, ...]]:
    """Analog samples a frame and frames, as they fit the bytes from start to end; with a warning where they do not."""
    room = end - start
    # The frames fill their last block, or end where they end.
    sizes = {analog: number * (4 * points + analog) for analog in sorted(samples)}
    for analog, size in sizes.items():
        for count in counts:
            if count * size <= room < count * size + BLOCK:
                return analog, count, ()
    if len(sizes) > 1:
        raise SourceError(path, "its header and its parameters contradict each other in how large a frame is")
    ((analog, size),) = sizes.items()
    there = room // size
    if not there or not counts:
        raise SourceError(path, "holds no frames" if counts else "does not say how many frames it holds")
    if counts[0] > there:
        return analog, there, (f"the file says {counts[0]} frames, it holds {there}, which are kept",)
    if counts[0] == _MOST_SAID:
        there -= _empty(path, start + there * size, size)
        return analog, there, (f"the file says {counts[0]} frames, the most that it can say, and holds {there}",)
    return analog, counts[0], (f"the file says {counts[0]} frames, which are read; it has room for {there}",)


def _empty(path: Path, end: int, size: int) -> int:
    """How many frames before a byte are nothing but what fills the last block up."""
    with path.open("rb") as file:
        file.seek(end - BLOCK // size * size)
        tail = file.read(BLOCK // size * size)
    return next(
        (i for i in range(BLOCK // size) if any(tail[len(tail) - (i + 1) * size : len(tail) - i * size])), BLOCK // size
    )


def _read_with_ezc3d(path: Path, layout: _Layout, start: int, stop: int) -> tuple[F64, dict[str, Any]]:
    """Frames [start, stop) as (points, 3, frames), and the parameters of the markers."""
    try:
        with tempfile.TemporaryDirectory(prefix="kinedex-") as folder:
            copy = Path(folder) / "part.c3d"
            copy.write_bytes(_copy(path, layout, start, stop))
            read = ezc3d.c3d(str(copy))
    except OSError as fault:
        raise SourceError(path, f"cannot be read by way of {tempfile.gettempdir()}: {fault}") from None
    except (RuntimeError, ValueError) as fault:
        raise SourceError(path, f"ezc3d does not read it: {fault}") from None
    found = read["data"]["points"]
    if found.shape[1:] != (layout.points, stop - start):
        raise SourceError(
            path, f"ezc3d reads {found.shape[1:]} markers and frames, not {(layout.points, stop - start)}"
        )
    positions = np.moveaxis(found[:3], 0, 1)
    residuals = read["data"]["meta_points"]["residuals"][0]
    positions = np.where((residuals < 0.0)[:, None], np.nan, positions)
    return positions, read["parameters"]["POINT"]


def _copy(path: Path, layout: _Layout, start: int, stop: int) -> bytes:
    """A C3D file of these frames' markers, without analog channels."""
    frames, number = stop - start, layout.size
    records = [_group("POINT", 1), _group("ANALOG", 2)]
    records += [_record(name, 1, what.raw) for name, what in layout.kept.items() if name not in ("USED", "FRAMES")]
    words = {"USED": layout.points, "FRAMES": frames}
    records += [_record(name, 1, struct.pack("<bBH", 2, 0, value)) for name, value in words.items()]
    records += [_record("USED", 2, struct.pack("<bBH", 2, 0, 0)), b"\0\0"]
    size = 4 + sum(map(len, records)) + 32
    blocks = -(-size // BLOCK)
    if blocks > 250:
        raise SourceError(path, "its labels take more than 125 kB")
    records.insert(2, _record("DATA_START", 1, struct.pack("<bBH", 2, 0, blocks + 2)))
    header = bytearray(BLOCK)
    header[:] = layout.header[:BLOCK]
    header[24:] = bytes(BLOCK - 24)  # events and what else was there
    struct.pack_into("<BBHHHHH", header, 0, 2, _KEY, layout.points, 0, 1, frames, 0)
    struct.pack_into("<HH", header, 16, blocks + 2, 0)
    parameters = struct.pack("<BBBB", 1, _KEY, blocks, layout.processor) + b"".join(records)
    row = number * (4 * layout.points + layout.analog)
    with path.open("rb") as file:
        file.seek(layout.start + start * row)
        data = np.frombuffer(file.read(frames * row), np.uint8).reshape(frames, row)[:, : number * 4 * layout.points]
    return bytes(header) + parameters.ljust(blocks * BLOCK, b"\0") + data.tobytes()


def _group(name: str, number: int) -> bytes:
    return struct.pack("<bb", len(name), -number) + name.encode() + struct.pack("<HB", 3, 0)


def _record(name: str, group: int, raw: bytes) -> bytes:
    return struct.pack("<bb", len(name), group) + name.encode() + struct.pack("<H", len(raw) + 3) + raw + b"\0"


def _texts(said: dict[str, Any], name: str) -> list[str]:
    return [str(text).strip() for text in said.get(name, {}).get("value", [])]


def _names(said: dict[str, Any], positions: F64, warnings: list[str]) -> tuple[str, ...]:
    """A name for every marker; labels that several have in common are numbered, so that none is taken for another."""
    labels = _texts(said, "LABELS")
    for key in sorted((key for key in said if re.fullmatch(r"LABELS\d+", key)), key=lambda key: int(key[6:])):
        labels += _texts(said, key)
    labels = [label or f"unnamed {i}" for i, label in enumerate(labels[: len(positions)])]
    labels += [f"unnamed {i}" for i in range(len(labels), len(positions))]
    seen = [bool(np.isfinite(track[0]).any()) for track in positions]
    twice = [
        label
        for label, count in Counter(label for label, there in zip(labels, seen, strict=True) if there).items()
        if count > 1
    ]
    if twice:
        warnings.append(f"several markers are called {', '.join(twice)}; none of them is used")
    counted = Counter[str]()
    names = []
    for label, there in zip(labels, seen, strict=True):
        counted[label] += 1
        alone = there and label not in twice
        names.append(label if alone or labels.count(label) == 1 else f"{label} ({counted[label]})")
    return tuple(names)


def _rate(path: Path, layout: _Layout, said: dict[str, Any], warnings: list[str]) -> float:
    """POINT:RATE, else the header's rate; a warning where these are not one."""
    rates = [float(value) for value in said.get("RATE", {}).get("value", [])[:1]]
    raw = layout.header[20:24]
    of_header = _dec(raw) if layout.processor == DEC else struct.unpack("<f", raw)[0]
    good = [rate for rate in (*rates, of_header) if SLOWEST_HZ <= rate <= FASTEST_HZ]
    if not good:
        raise SourceError(
            path, f"its rate must be {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz, got {(*rates, of_header)[0]:g}; give --rate"
        )
    if len(good) == 2 and abs(good[0] - good[1]) > 0.01 * good[0]:
        warnings.append(f"its parameters say {good[0]:.6g} Hz, which counts, its header {good[1]:.6g} Hz")
    return good[0]


def _dec(raw: bytes) -> float:
    """A number in DEC order: the halves of an IEEE number exchanged, and four times as large."""
    return float(struct.unpack("<f", raw[2:] + raw[:2])[0]) / 4.0


def _unit_m(path: Path, said: dict[str, Any]) -> float | None:
    """The metres of the unit that POINT:UNITS names; None where it names none."""
    units = [unit.lower() for unit in _texts(said, "UNITS") if unit]
    if not units:
        return None
    if units[0] not in _UNITS_M:
        raise SourceError(path, f"its unit must be one of {', '.join(_UNITS_M)}, got {units[0]!r}")
    return _UNITS_M[units[0]]


def _up(said: dict[str, Any], warnings: list[str]) -> str | None:
    """The axis that POINT:Y_SCREEN calls vertical; None without.

    The sign is left out of account: the floor is at 0 in files of all systems, and some write −Z where Z is up.
    """
    text = next((text.lower() for text in _texts(said, "Y_SCREEN") if text), "")
    if not re.fullmatch(r"[+-]?[xyz]", text):
        return None
    if text[0] == "-":
        warnings.append(f"POINT:Y_SCREEN says {text.upper()}; {text[-1].upper()} is taken to point up")
    return text[-1]
