"""Parsers of joint positions: TRC, CSV, NPZ and NPY, as marker-less systems and kinedex itself write them."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import SourceError, did_you_mean
from kinedex.storage.formats.motion.numpy_arrays import array_shapes, load_array, load_arrays
from kinedex.storage.formats.motion.points import Points
from kinedex.storage.formats.motion.position_tables import Lines, Table, cells_of, parse_number, whole_points
from kinedex.storage.formats.motion.reader import FASTEST_HZ, MOST_POINTS, SLOWEST_HZ

F64 = npt.NDArray[np.float64]

ARRAYS = ("positions", "joints", "keypoints", "keypoints_3d")
NAMES = ("names", "joint_names", "keypoint_names")
RATES = ("rate_hz", "fps", "mocap_framerate", "mocap_frame_rate")
"""The keys of an NPZ file: the positions (frames, joints, 3), the joints' names, and frames per second."""

_READ = (*ARRAYS, *NAMES, *RATES)
_AT_ONCE = 16_384  # frames that are converted at a time
_UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
_AXIS = re.compile(r"(.+)_([xyzXYZ])")


def parse_positions(path: Path) -> Points:
    """Read a file of joint positions by its ending: .trc, .csv, .npz or .npy.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    SourceError
        The file is damaged; the error names the line, and the column or key, of the first fault.
    """
    readers: dict[str, Callable[[Path], Points]] = {
        ".trc": parse_trc, ".csv": parse_csv, ".npz": parse_arrays, ".npy": parse_arrays,
    }  # fmt: skip
    return readers[path.suffix.lower()](path)


def is_positions_csv(path: Path) -> bool:
    """Return whether the header of a CSV file names joint positions; archives hold other tables, too.

    A file that cannot be read counts as one, so that its reader reports the fault.
    """
    try:
        with path.open("rb") as file:
            header = file.readline(1 << 20)
    except OSError:
        return True
    columns = [found for cell in cells_of(_text(header), ",") if (found := _AXIS.fullmatch(cell.strip()))]
    axes: dict[str, set[str]] = {}
    for found in columns:
        axes.setdefault(found[1], set()).add(found[2].lower())
    return any(len(found) == 3 for found in axes.values())


def positions_extent(path: Path) -> tuple[int, int, int]:
    """Return the frames and points of a file, and the memory that reading takes besides those of the points.

    Raises
    ------
    SourceError
        The file cannot be read.
    """
    ending = path.suffix.lower()
    if ending in (".csv", ".trc"):
        table = Table(path, *((",", 1) if ending == ".csv" else ("\t", 5)))
        columns = table.columns
        return table.rows, -(-columns // 3), 24 * table.rows + table.bytes
    shapes = array_shapes(path)
    size = sum(math.prod(shape) * kind.itemsize for name, (shape, kind) in shapes.items() if name in ("", *_READ))
    key = next((key for key in ("", *ARRAYS) if key in shapes), None)
    shape = shapes[key][0] if key is not None else ()
    if len(shape) != 3:
        return 0, 0, size
    return shape[0], shape[1], size + 72 * shape[1] * min(shape[0], _AT_ONCE)


def parse_csv(path: Path) -> Points:
    """Read a CSV file: a header with `<joint>_x`, `<joint>_y`, `<joint>_z` for every joint, then one row a frame.

    The columns may stand in any order. `frame` (whole numbers, one more in every row) and `time` (seconds) are
    optional; other columns are not used, and a warning names them. An empty cell or `nan` is a gap.
    """
    table = Table(path, ",", 1)
    header = [cell.strip() for cell in cells_of(table.head[0], ",")]
    columns: dict[str, dict[str, int]] = {}
    unused, seen = [], set[str]()
    for i, name in enumerate(header):
        found = _AXIS.fullmatch(name)
        if name in seen:
            raise SourceError(path, f"column '{name}' stands twice in the header", line=1)
        seen.add(name)
        if found:
            columns.setdefault(found[1], {})[found[2].lower()] = i
        elif name.lower() not in ("frame", "time"):
            unused.append(name or f"number {i + 1}")
    for joint, axes in columns.items():
        for axis in "xyz":
            if axis not in axes:
                raise SourceError(path, f"column '{joint}_{axis}' is missing in the header", line=1)
    _refuse_count(path, len(columns), "'<joint>_x', '<joint>_y' and '<joint>_z' for every joint", 1)
    order = [columns[joint][axis] for joint in columns for axis in "xyz"]
    lower = [name.lower() for name in header]
    others = [name for name in ("frame", "time") if name in lower]
    positions, found_others, where = table.points(header, order, [lower.index(name) for name in others])
    numbers = dict(zip(others, found_others, strict=True))
    if "frame" in numbers:
        _check_frames(path, numbers["frame"], where)
    clock = _clock(path, numbers["time"], where) if "time" in numbers else None
    warnings = [f"columns {', '.join(unused)} are not used"] if unused else []
    return Points(str(path), tuple(columns), positions, clock_hz=clock, warnings=warnings)


def parse_trc(path: Path) -> Points:
    """Read a TRC file (OpenSim, Pose2Sim and others): five lines of header with rate and unit, then one row a frame.

    An empty cell or `nan` is a gap; a point at 0, 0, 0 is one that stands there.
    """
    table = Table(path, "\t", 5)
    lines = table.head
    if not lines[0].startswith("PathFileType") or len(lines) < 5:
        raise SourceError(path, "expected a TRC header of five lines that begins with PathFileType", line=1)
    header_values = dict(zip(lines[1].split(), lines[2].split(), strict=False))
    rate_hz = _header_number(path, header_values, "DataRate")
    if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        raise SourceError(path, f"DataRate must be {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz, got {rate_hz:g}", line=3)
    unit = header_values.get("Units", "").lower()
    if unit not in _UNITS_M:
        raise SourceError(path, f"Units must be one of {', '.join(_UNITS_M)}, got {unit or 'nothing'!r}", line=3)
    cells = [cell.strip() for cell in lines[3].split("\t")]
    if [cell.lower() for cell in cells[:2]] != ["frame#", "time"]:
        raise SourceError(path, "expected 'Frame#', 'Time' and the names of the markers, tab by tab", line=4)
    names = [cell for cell in cells[2:] if cell]
    _refuse_count(path, len(names), "names of markers after 'Frame#' and 'Time'", 4)
    counts = Counter(names)
    twice = next((name for name in names if counts[name] > 1), None)
    if twice is not None:
        raise SourceError(path, f"two markers are named '{twice}'", line=4)
    header = ["Frame#", "Time", *(f"{name} {axis}" for name in names for axis in "XYZ")]
    positions, (numbers, times), where = table.points(header, range(2, len(header)), (0, 1))
    warnings = []
    for key, what, is_there in (("NumFrames", "frames", table.rows), ("NumMarkers", "markers", len(names))):
        claimed = _header_number(path, header_values, key)
        if claimed != is_there:
            warnings.append(f"the header states {claimed:g} {what}, the file holds {is_there}, which are kept")
    _check_frames(path, numbers, where)
    clock = _clock(path, times, where)
    return Points(str(path), tuple(names), positions, rate_hz, clock, _UNITS_M[unit], warnings)


def parse_arrays(path: Path) -> Points:
    """Read an NPZ file with positions (frames, joints, 3), perhaps names and a rate, or an NPY file of positions alone.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    SourceError
        The array is missing or has another shape.
    """
    if path.suffix.lower() == ".npy":
        arrays, others = {"positions": load_array(path)}, ["positions"]
    else:
        arrays, others = load_arrays(path, _READ)
    key = next((key for key in ARRAYS if key in arrays), None)
    if key is None:
        raise SourceError(path, f"has none of the arrays {', '.join(ARRAYS)}{did_you_mean('positions', others)}")
    array = arrays[key]
    if array.ndim != 3 or array.shape[2] != 3 or not array.size or array.dtype.kind not in "fiu":
        raise SourceError(
            path, f"'{key}' must be numbers of shape (frames, joints, 3), got {array.shape} of {array.dtype}"
        )
    _refuse_count(path, array.shape[1], "joints", None)
    names = _array_names(path, arrays, array.shape[1])
    rate = next((arrays[name] for name in RATES if name in arrays), None)
    rate_hz = None
    if rate is not None:
        if rate.size != 1 or rate.dtype.kind not in "fiu" or not SLOWEST_HZ <= float(rate.ravel()[0]) <= FASTEST_HZ:
            raise SourceError(path, f"the rate must be one number, {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz, got {rate}")
        rate_hz = float(rate.ravel()[0])
    positions = np.empty((*array.shape[1:], len(array)))
    for start in range(0, len(array), _AT_ONCE):
        positions[:, :, start : start + _AT_ONCE] = np.moveaxis(array[start : start + _AT_ONCE], 0, 2)
    if np.isinf(positions).any():
        raise SourceError(path, f"'{key}' has infinite numbers, the first in frame {_first(np.isinf(positions), 2)}")
    return Points(str(path), names, whole_points(positions), rate_hz)


def _array_names(path: Path, arrays: dict[str, Any], joints: int) -> tuple[str, ...]:
    key = next((key for key in NAMES if key in arrays), None)
    if key is None:
        return ()
    names = tuple(str(name) for name in arrays[key].ravel())
    if (
        len(names) != joints
        or len(set(names)) != joints
        or arrays[key].dtype.kind != "U"
        or not all(map(_is_text, names))
    ):
        raise SourceError(path, f"'{key}' must be {joints} different texts, one a joint, got {len(names)} values")
    return names


def _is_text(name: str) -> bool:
    """Return whether a name can be encoded; NumPy takes any four bytes for a letter."""
    try:
        return name.encode().decode() == name
    except UnicodeError:
        return False


def _text(data: bytes) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _header_number(path: Path, values: dict[str, str], key: str) -> float:
    if key not in values:
        raise SourceError(path, f"the header has no {key}{did_you_mean(key, values)}", line=2)
    value = parse_number(path, values[key], key, 3)
    if not np.isfinite(value):
        raise SourceError(path, f"{key} must be a number, got {values[key]!r}", line=3)
    return value


def _check_frames(path: Path, numbers: F64, where: Lines) -> None:
    """Refuse frame numbers that do not ascend by one: after a jump, all motion would come too early."""
    wrong = np.flatnonzero(~(np.diff(numbers) == 1.0))
    if len(wrong) or not np.isfinite(numbers[0]):
        at = int(wrong[0]) + 1 if len(wrong) else 0
        before = f"after frame {numbers[at - 1]:g} " if at else ""
        raise SourceError(
            path, f"expected the next frame's number {before}, got {numbers[at]:g}; frames may have gaps in their "
            "cells, but none may be left out", line=int(where[at]),
        )  # fmt: skip


def _clock(path: Path, times: F64, where: Lines) -> float | None:
    """Return the frames per second of a column of times; None for a single frame."""
    wrong = np.flatnonzero(~(np.diff(times) > 0.0))
    if len(wrong):
        raise SourceError(
            path, f"time {times[wrong[0] + 1]:g} does not come after the last", line=int(where[wrong[0] + 1])
        )
    return float((len(times) - 1) / (times[-1] - times[0])) if len(times) > 1 else None


def _first(mask: npt.NDArray[np.bool_], axis: int) -> int:
    return int(np.nonzero(mask)[axis].min())


def _refuse_count(path: Path, count: int, what: str, line: int | None) -> None:
    if not 0 < count <= MOST_POINTS:
        raise SourceError(path, f"expected 1 to {MOST_POINTS} {what}, found {count}", line=line)
