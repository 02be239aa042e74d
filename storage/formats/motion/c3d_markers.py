"""The markers of C3D files, read with ezc3d from copies that are known to be whole and hold markers only.

ezc3d ends the process on some files whose parameters contradict each other, and keeps some 200 bytes of every marker
of every frame, and all analog channels. So the parameters are checked here first, and their counts compared with the
size of the file; then ezc3d gets the markers alone, a block of frames at a time, with the few parameters that it needs.
"""

from __future__ import annotations

import re
import struct
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.c3d_layout import BLOCK, DEC, INTEL, KEY, Layout, read_layout
from kinedex.storage.formats.motion.numpy_arrays import MOST_BYTES
from kinedex.storage.formats.motion.points import Points
from kinedex.storage.formats.motion.reader import FASTEST_HZ, SLOWEST_HZ

F64 = npt.NDArray[np.float64]

_HUNDRED = {INTEL: struct.pack("<f", 100.0), DEC: struct.pack("<f", 400.0)[2:] + struct.pack("<f", 400.0)[:2]}
_AT_ONCE = 400_000  # markers times frames that ezc3d holds at a time: some 90 MB
_UNITS_M = {
    "m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "meters": 1.0, "metres": 1.0, "centimeters": 0.01,
    "centimetres": 0.01, "millimeters": 0.001, "millimetres": 0.001, "inches": 0.0254,
}  # fmt: skip


@dataclass(frozen=True)
class Markers(Points):
    """The markers of a C3D file.

    Attributes
    ----------
    up : str, optional
        The axis that the file calls vertical: "x", "y" or "z".
    """

    up: str | None = None


def parse_c3d(path: Path) -> Markers:
    """Read the markers of a C3D file.

    A marker is not seen, and NaN, where its residual is negative, where a coordinate is NaN, and at 0, 0, 0.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    Markers
        The markers by their labels, which may begin with a subject's name; rate, unit, and the axis that is up where
        the file states them. A label that several markers share names none of them.

    Raises
    ------
    SourceError
        The file contradicts itself or its size.
    """
    layout = read_layout(path)
    if 24 * layout.points * layout.frames > MOST_BYTES:
        size = 24 * layout.points * layout.frames / 1e9
        raise SourceError(
            path, f"takes {size:.1f} GB in memory; write shorter takes, of {MOST_BYTES / 1e9:.1f} GB at most"
        )
    positions = np.empty((layout.points, 3, layout.frames))
    step = _frames_at_once(layout)
    for start in range(0, layout.frames, step):
        stop = min(start + step, layout.frames)
        positions[:, :, start:stop] = _read_with_ezc3d(path, layout, start, stop)
    lost = np.isnan(positions).any(axis=1) | (positions == 0.0).all(axis=1)
    positions[np.broadcast_to(lost[:, None], positions.shape)] = np.nan
    warnings = list(layout.warnings)
    names = _names(layout, positions, warnings)
    if np.isinf(positions).any():
        point, _, frame = (int(at[0]) for at in np.nonzero(np.isinf(positions)))
        raise SourceError(path, f"marker '{names[point]}' is infinitely far away in source frame {frame}")
    if layout.first > 1:
        warnings.append(f"it begins with frame {layout.first} of its recording, which is source frame 0 here")
    rate_hz, unit_m, up = _rate(path, layout, warnings), _unit_m(path, layout), _up(layout, warnings)
    return Markers(str(path), names, positions, rate_hz, None, unit_m, warnings, up)


def ezc3d_bytes(layout: Layout) -> int:
    """Return the memory of a block of frames, as a copy of the file and as ezc3d holds it."""
    frames = min(layout.frames, _frames_at_once(layout))
    return frames * (400 * layout.points + 2 * layout.size * (4 * layout.points + layout.analog))


def _frames_at_once(layout: Layout) -> int:
    return max(1, min(30_000, _AT_ONCE // layout.points))


def _read_with_ezc3d(path: Path, layout: Layout, start: int, stop: int) -> F64:
    """Return the frames [start, stop) as (points, 3, frames), NaN where the residual is negative."""
    import ezc3d  # loading the library takes longer than reading a file of another format

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
    return np.where((residuals < 0.0)[:, None], np.nan, positions)


def _copy(path: Path, layout: Layout, start: int, stop: int) -> bytes:
    """Return a C3D file of only these frames' markers: a block of header, one of parameters, the frames."""
    frames, markers = stop - start, layout.size * 4 * layout.points
    words = {"USED": layout.points, "FRAMES": frames, "DATA_START": 3}
    records = [
        _group("POINT", 1), *(_record(name, 1, struct.pack("<bBH", 2, 0, value)) for name, value in words.items()),
        _record("SCALE", 1, struct.pack("<bB", 4, 0) + layout.scale),
        _record("RATE", 1, struct.pack("<bB", 4, 0) + _HUNDRED[layout.processor]),
        _group("ANALOG", 2), _record("USED", 2, struct.pack("<bBH", 2, 0, 0)), b"\0\0",
    ]  # fmt: skip
    header = struct.pack("<BBHHHHH", 2, KEY, layout.points, 0, 1, frames, 0) + layout.scale
    header += struct.pack("<HH", 3, 0) + _HUNDRED[layout.processor]
    parameters = struct.pack("<BBBB", 1, KEY, 1, layout.processor) + b"".join(records)
    row = markers + layout.size * layout.analog
    with path.open("rb") as file:
        file.seek(layout.start + start * row)
        data = np.frombuffer(file.read(frames * row), np.uint8).reshape(frames, row)[:, :markers]
    return header.ljust(BLOCK, b"\0") + parameters.ljust(BLOCK, b"\0") + data.tobytes()


def _group(name: str, number: int) -> bytes:
    return struct.pack("<bb", len(name), -number) + name.encode() + struct.pack("<HB", 3, 0)


def _record(name: str, group: int, raw: bytes) -> bytes:
    return struct.pack("<bb", len(name), group) + name.encode() + struct.pack("<H", len(raw) + 3) + raw + b"\0"


def _texts(layout: Layout, name: str) -> list[str]:
    return layout.parameters[name].texts if name in layout.parameters else []


def labels_of(layout: Layout) -> tuple[str, ...]:
    """Return the labels of all markers, those of POINT:LABELS2 and on included; markers without one are numbered."""
    labels = _texts(layout, "LABELS")
    for key in sorted(
        (key for key in layout.parameters if re.fullmatch(r"LABELS\d+", key)), key=lambda key: int(key[6:])
    ):
        labels += _texts(layout, key)
    named = [label or f"unnamed {i}" for i, label in enumerate(labels[: layout.points])]
    return (*named, *(f"unnamed {i}" for i in range(len(named), layout.points)))


def _names(layout: Layout, positions: F64, warnings: list[str]) -> tuple[str, ...]:
    """Return a name for every marker; labels that several share are numbered, so that none is mistaken."""
    labels = labels_of(layout)
    seen = [bool(np.isfinite(track[0]).any()) for track in positions]
    twice = [
        label
        for label, count in Counter(label for label, there in zip(labels, seen, strict=True) if there).items()
        if count > 1
    ]
    if twice:
        warnings.append(f"several markers are called {', '.join(twice)}; none of them is used")
    counts, counted = Counter(labels), Counter[str]()
    names = []
    for label, there in zip(labels, seen, strict=True):
        counted[label] += 1
        alone = there and label not in twice
        names.append(label if alone or counts[label] == 1 else f"{label} ({counted[label]})")
    return tuple(names)


def _rate(path: Path, layout: Layout, warnings: list[str]) -> float:
    """Return POINT:RATE, else the header's rate; warn if they differ."""
    good = [rate for rate in layout.rates if SLOWEST_HZ <= rate <= FASTEST_HZ]
    if not good:
        raise SourceError(path, f"its rate must be {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz, got {layout.rates[0]:g}")
    if len(good) == 2 and abs(good[0] - good[1]) > 0.01 * good[0]:
        warnings.append(f"its parameters state {good[0]:.6g} Hz, which counts, its header {good[1]:.6g} Hz")
    return good[0]


def _unit_m(path: Path, layout: Layout) -> float | None:
    """Return the metres of the unit that POINT:UNITS names; None if it names none."""
    units = [unit.lower() for unit in _texts(layout, "UNITS") if unit]
    if not units:
        return None
    if units[0] not in _UNITS_M:
        raise SourceError(path, f"its unit must be one of {', '.join(_UNITS_M)}, got {units[0]!r}")
    return _UNITS_M[units[0]]


def _up(layout: Layout, warnings: list[str]) -> str | None:
    """Return the axis that POINT:Y_SCREEN calls vertical; None without.

    The sign is ignored: the floor is at 0 in files of all systems, and some write −Z where Z is up.
    """
    text = next((text.lower() for text in _texts(layout, "Y_SCREEN") if text), "")
    if not re.fullmatch(r"[+-]?[xyz]", text):
        return None
    if text[0] == "-":
        warnings.append(f"POINT:Y_SCREEN is {text.upper()}; {text[-1].upper()} is taken to point up")
    return text[-1]
