"""Read files of joint positions as marker-less systems and kinedex itself write them: TRC, CSV, NPZ and NPY."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.catalog.skeletons.recognition.landmarks import load_landmarks
from kinedex.catalog.skeletons.recognition.points import recognise_points
from kinedex.catalog.skeletons.units import STATED_UNITS_M
from kinedex.ops.errors import SourceError, did_you_mean
from kinedex.storage.formats.csv_tables import csv_cells
from kinedex.storage.formats.motion.numpy_arrays import array_shapes, load_array, load_arrays
from kinedex.storage.formats.motion.points import Points, PointsReader, evidence_of
from kinedex.storage.formats.motion.position_tables import Lines, Table, whole_points
from kinedex.storage.formats.motion.reader import (
    FASTEST_HZ,
    MAX_POINTS,
    SLOWEST_HZ,
    Extent,
    MotionFile,
    ReadSettings,
)
from kinedex.storage.formats.motion.shared_labels import unique_names
from kinedex.storage.formats.motion.subjects import bodies_of, points_of_person
from kinedex.storage.formats.source_files import any_text, as_number, part_of

F64 = npt.NDArray[np.float64]

ARRAYS = ("positions", "joints", "keypoints", "keypoints_3d")
NAMES = ("names", "joint_names", "keypoint_names")
RATES = ("rate_hz", "fps", "mocap_framerate", "mocap_frame_rate")
"""Keys of an NPZ file: of the positions (frames, joints, 3), the joints' names, and the frames per second."""

_READ = (*ARRAYS, *NAMES, *RATES)
_BLOCK_FRAMES = 16_384  # frames converted at once
_TIMES = ("time", "times", "time (s)", "time(s)", "time_s", "time (seconds)")
_SHOWN = 12  # most columns named in a warning
_AXIS = re.compile(r"(.*?\S)(?:\s*+[_.:]\s*+|\s++)([xyzXYZ])")
_MIN_POINTS = 5  # points in columns such as `LKNE.x` or `LKNE X`; three such columns are a sensor's
_LONGEST_HEAD = 1 << 20  # bytes of a TRC header
_HEAD_LINES = 20
_ROUNDED = 3e-4  # relative error of a rate that follows from times of four digits; 59.94 Hz is not 60


def parse_positions(path: Path) -> Points:
    """Read a file of joint positions by its extension: .trc, .csv, .npz or .npy.

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
    cells = [cell.strip() for cell in csv_cells(any_text(header, "utf-8-sig"), ",")]
    axes: dict[str, set[str]] = {}
    for found in filter(None, map(_AXIS.fullmatch, cells)):
        axes.setdefault(found[1], set()).add(found[2].lower())
    whole = [name for name, found in axes.items() if len(found) == 3]
    return len(whole) >= _MIN_POINTS or any(f"{name}_{axis}" in cells for name in whole for axis in "xX")


def positions_extent(path: Path) -> tuple[int, int, int]:
    """Return the frames and points of a file, and the bytes of memory for reading besides those of the points.

    Raises
    ------
    SourceError
        The file cannot be read.
    """
    ending = path.suffix.lower()
    if ending in (".csv", ".trc"):
        head = None if ending == ".csv" else trc_head(path)
        table = Table(path, ",", 1) if head is None else Table(path, head.separator, head.first)
        columns = table.columns if head is None else max(table.columns, head.cells)
        return table.rows, -(-columns // 3), 24 * table.rows + table.bytes
    shapes = array_shapes(path)
    size = sum(math.prod(shape) * kind.itemsize for name, (shape, kind) in shapes.items() if name in ("", *_READ))
    key = next((key for key in ("", *ARRAYS) if key in shapes), None)
    shape = shapes[key][0] if key is not None else ()
    if len(shape) != 3:
        return 0, 0, size
    return shape[0], shape[1], size + 72 * shape[1] * min(shape[0], _BLOCK_FRAMES)


def parse_csv(path: Path) -> Points:
    """Read a CSV file: a header with `<joint>_x`, `<joint>_y`, `<joint>_z` for every joint, then one row a frame.

    The columns may be in any order. `frame` (integers, one more in every row) and `time` (seconds) are optional; other
    columns are ignored with a warning. An empty cell or `nan` is a gap.
    """
    table = Table(path, ",", 1)
    header = [cell.strip() for cell in csv_cells(table.head[0], ",")]
    columns: dict[str, dict[str, int]] = {}
    unused, seen = [], set[str]()
    for i, name in enumerate(header):
        found = _AXIS.fullmatch(name)
        if name in seen:
            raise SourceError(path, f"column '{name}' stands twice in the header", line=1)
        seen.add(name)
        if found:
            columns.setdefault(found[1], {})[found[2].lower()] = i
        elif name.lstrip("# ").lower() not in ("frame", *_TIMES):
            unused.append(name or f"number {i + 1}")
    for joint, axes in columns.items():
        for axis in "xyz":
            if axis not in axes:
                raise SourceError(path, f"column '{joint}_{axis}' is missing in the header", line=1)
    _refuse_count(path, len(columns), "'<joint>_x', '<joint>_y' and '<joint>_z' for every joint", 1)
    order = [columns[joint][axis] for joint in columns for axis in "xyz"]
    lower = ["time" if (bare := name.lstrip("# ").lower()) in _TIMES else bare for name in header]
    others = [name for name in ("frame", "time") if name in lower]
    positions, found_others, where = table.points(header, order, [lower.index(name) for name in others])
    numbers = dict(zip(others, found_others, strict=True))
    if "frame" in numbers:
        _check_frames(path, numbers["frame"], where)
    clock = clock_rate(path, numbers["time"], where) if "time" in numbers else None
    more = f" and {len(unused) - _SHOWN} more" if len(unused) > _SHOWN else ""
    warnings = [f"columns {', '.join(unused[:_SHOWN])}{more} are not used"] if unused else []
    return Points(str(path), tuple(columns), positions, clock_hz=clock, warnings=warnings)


@dataclass(frozen=True)
class TrcHead:
    """The header of a TRC file.

    Attributes
    ----------
    separator : str
        The character between cells: a tab, or a comma in files that a spreadsheet wrote.
    values : dict of str to str
        The numbers and words of the header, by name in lower case.
    labels : tuple of str
        The names of the markers.
    line : int
        The line of the labels, from 1.
    first : int
        The number of lines before the first frame.
    cells : int
        Cells of the first frame.
    """

    separator: str
    values: dict[str, str]
    labels: tuple[str, ...]
    line: int
    first: int
    cells: int


def trc_head(path: Path) -> TrcHead:
    """Read the header of a TRC file, in which lines may be blank or missing.

    Raises
    ------
    SourceError
        The file cannot be read, or has no line that begins with Frame# and names the markers.
    """
    lines = any_text(part_of(path, _LONGEST_HEAD), "utf-8-sig").splitlines()
    at = next((i for i, line in enumerate(lines[:_HEAD_LINES]) if line.strip().lower().startswith("frame")), None)
    if at is None:
        raise SourceError(
            path,
            "expected a TRC header: a line PathFileType, one of names (DataRate, NumFrames, Units, …), one of their "
            "values, and one that begins with Frame#, Time and the names of the markers; write these above the numbers",
            line=1,
        )
    separator = "\t" if "\t" in lines[at] else ","
    cells = [cell.strip() for cell in lines[at].split(separator)]
    keys = next((i for i in range(at) if "datarate" in lines[i].lower()), None)
    values: dict[str, str] = {}
    if keys is not None:
        words = [[word for word in re.split(r"[\s,]+", line) if word] for line in lines[keys:at] if line.strip(" \t,")]
        values = dict(zip((word.lower() for word in words[0]), words[1] if len(words) > 1 else (), strict=False))
    labels = tuple(cell for cell in cells[2:] if cell)
    rows = [i for i in range(at + 1, len(lines)) if lines[i].strip(" \t,")]
    axes = bool(rows) and re.search(r"(?i)\bX\d*\b", lines[rows[0]]) is not None
    first = rows[axes] if len(rows) > axes else len(lines)
    numbers = lines[first].rstrip(" \t,") if first < len(lines) else ""
    return TrcHead(separator, values, labels, at + 1, first, len(csv_cells(numbers, separator)))


def parse_trc(path: Path) -> Points:
    """Read a TRC file (OpenSim, Pose2Sim and others): a header with rate, unit and labels, then one row a frame.

    An empty cell or `nan` is a gap; a point at 0, 0, 0 is a valid position. Markers without a label, which may stand
    after the labelled ones in some rows, are dropped; of markers with the same label see `unique_names`.
    """
    head = trc_head(path)
    table = Table(path, head.separator, head.first, unlabelled=True)
    names = list(head.labels)
    _refuse_count(path, len(names), "names of markers after 'Frame#' and 'Time'", head.line)
    warnings: list[str] = []
    header = ["Frame#", "Time", *(f"{name} {axis}" for name in names for axis in "XYZ")]
    positions, (numbers, times), where = table.points(header, range(2, len(header)), (0, 1))
    if table.dropped:
        varied = len(table.dropped) < table.rows or len(set(table.dropped)) > 1
        warnings.append(
            f"its rows have {'up to ' if varied else ''}{len(names) + max(table.dropped)} markers, its header names "
            f"{len(names)}; the others, {3 * sum(table.dropped)} cells in {len(table.dropped)} of {table.rows} rows, "
            "have no label and are dropped"
        )
    _check_frames(path, numbers, where)
    clock = clock_rate(path, times, where)
    warnings += _wrong_counts(head, table.rows, len(names))
    rate_hz, unit_m = _trc_rate(head, clock, warnings), _trc_unit(head, warnings)
    unique = unique_names(names, positions, unit_m, warnings)
    return Points(str(path), unique, positions, rate_hz, clock, unit_m, warnings)


def _wrong_counts(head: TrcHead, frames: int, markers: int) -> list[str]:
    """Return warnings about counts in the header that differ from the file's content."""
    found = []
    for key, what, there in (("numframes", "frames", frames), ("nummarkers", "markers", markers)):
        claimed = _number(head.values.get(key, ""))
        if claimed is not None and claimed != there:
            found.append(f"the header states {claimed:g} {what}, the file holds {there}, which are kept")
    return found


def _trc_rate(head: TrcHead, clock_hz: float | None, warnings: list[str]) -> float | None:
    """Return the stated rate if it is valid, else the rate of the times."""
    stated = _number(head.values.get("datarate", ""))
    if stated is not None and SLOWEST_HZ <= stated <= FASTEST_HZ:
        return stated
    if clock_hz is None or not SLOWEST_HZ <= clock_hz <= FASTEST_HZ:
        return None
    called = "no DataRate" if stated is None else f"a DataRate of {stated:g}"
    warnings.append(f"the header has {called}; by its times it is {clock_hz:.6g} Hz, which counts")
    return clock_hz


def _trc_unit(head: TrcHead, warnings: list[str]) -> float | None:
    """Return the metres per stated unit; None if it is missing or unknown."""
    unit = head.values.get("units", "").lower()
    if unit not in STATED_UNITS_M:
        warnings.append(f"its header has no unit of {', '.join(STATED_UNITS_M)}" + (f", but {unit!r}" if unit else ""))
    return STATED_UNITS_M.get(unit)


def _number(text: str) -> float | None:
    value = as_number(text)
    return value if value is not None and math.isfinite(value) else None


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
    for start in range(0, len(array), _BLOCK_FRAMES):
        positions[:, :, start : start + _BLOCK_FRAMES] = np.moveaxis(array[start : start + _BLOCK_FRAMES], 0, 2)
    if np.isinf(positions).any():
        raise SourceError(
            path, f"'{key}' has infinite numbers, the first in frame {np.nonzero(np.isinf(positions))[2].min()}"
        )
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
    """Return whether a name is valid Unicode; NumPy accepts any four bytes as a character."""
    try:
        return name.encode().decode() == name
    except UnicodeError:
        return False


def _check_frames(path: Path, numbers: F64, where: Lines) -> None:
    """Raise an error for frame numbers that do not ascend by one: after a jump, all motion would be too early."""
    wrong = np.flatnonzero(~(np.diff(numbers) == 1.0))
    if len(wrong) or not np.isfinite(numbers[0]):
        at = int(wrong[0]) + 1 if len(wrong) else 0
        before = f"after frame {numbers[at - 1]:g} " if at else ""
        raise SourceError(
            path, f"expected the next frame's number {before}, got {numbers[at]:g}; frames may have gaps in their "
            "cells, but none may be left out", line=int(where[at]),
        )  # fmt: skip


def clock_rate(path: Path, times: F64, where: Lines) -> float | None:
    """Return the frames per second of a column of times, an integer if rounding allows it; None for a single frame."""
    wrong = np.flatnonzero(~(np.diff(times) > 0.0))
    if len(wrong):
        raise SourceError(
            path, f"time {times[wrong[0] + 1]:g} does not come after the last", line=int(where[wrong[0] + 1])
        )
    if len(times) < 2:
        return None
    rate_hz = float((len(times) - 1) / (times[-1] - times[0]))
    return float(round(rate_hz)) if abs(rate_hz - round(rate_hz)) < _ROUNDED * rate_hz else rate_hz


def _refuse_count(path: Path, count: int, what: str, line: int | None) -> None:
    if not 0 < count <= MAX_POINTS:
        raise SourceError(path, f"expected 1 to {MAX_POINTS} {what}, found {count}", line=line)


class PositionsReader(PointsReader):
    """Reads files of joint positions; a .csv file counts as one if its header names joints."""

    endings: ClassVar[tuple[str, ...]] = (".trc", ".csv", ".npz", ".npy")

    def sniff(self, path: Path) -> bool:
        """Return whether a .csv has the header of joint positions; for other extensions return True."""
        return path.suffix.lower() != ".csv" or is_positions_csv(path)

    def size(self, file: MotionFile) -> tuple[int, int, int]:
        """Return frames and points, by the rows of a table or the header of an array, and the bytes for reading."""
        return positions_extent(file.path)

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Return the frames, the memory of all points, and the user's rate or None: the files' own is not read here."""
        found = super().extent(file, joints, settings)
        return replace(found, rate_hz=settings.override_rate_hz or settings.rate_hz)

    def points(self, file: MotionFile, settings: ReadSettings) -> Points:
        """Read the points of one person (TRC, CSV, NPZ, NPY)."""
        return points_of_person(parse_positions(file.path), file.person)

    def named(self, points: Points, mappings: Mappings) -> Points:
        """Return the points with names; points of an array without names are named by the likeliest order of joints."""
        if points.names:
            return points
        called, names = _names_in_order(points, mappings)
        remark = f"the file does not name its joints; they are read in the order of {called}"
        return replace(points, names=names, warnings=[*points.warnings, remark])

    def persons(self, file: MotionFile, mappings: Mappings) -> tuple[str, ...]:
        """Return the subjects of the labels of a TRC file that have the landmarks of a body, if there are several."""
        return tuple(bodies_of(trc_head(file.path).labels)) if file.path.suffix.lower() == ".trc" else ()


def _names_in_order(points: Points, mappings: Mappings) -> tuple[str, tuple[str, ...]]:
    """Return the name and the joints of the order, among those with this number of points, that is most like a body."""
    count = len(points.positions)
    orders = {f"mapping '{each.name}'": each.order for each in mappings.of("positions") if len(each.order) == count}
    if "positions" not in mappings.forced:
        orders |= {name: order for name, order in load_landmarks().orders.items() if len(order) == count}
    if len(orders) < 2:
        name, names = next(iter(orders.items()), None) or mappings.names_in_order(points.path, count)
        return name, names
    return max(orders.items(), key=lambda item: _likeness(points, item[1], mappings.joints))


def _likeness(points: Points, order: tuple[str, ...], joints: tuple[str, ...]) -> float:
    """Return the confidence, from 0 to 1, that points in an order form a body."""
    try:
        return recognise_points(points.path, evidence_of(replace(points, names=order)), joints).confidence
    except SourceError:
        return 0.0
