"""Read CSV files of the sensors of x-io: x-IMU3 (Inertial, Quaternion, Magnetometer) and NGIMU (sensors, quaternion).

Readings are in degrees per second and g; quaternions are in a separate file and are joined by time.
The quaternion of x-IMU3 rotates from the sensor to the world, as usual; that of NGIMU is the conjugate, from the world
to the sensor.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import SourceError
from kinedex.ops.inertial.rotations import conjugate, interpolate
from kinedex.storage.formats.imu.number_rows import NumberRows, cells_of, number_rows, text_lines
from kinedex.storage.formats.imu.signals import NWU, RawSensor, UserStatements

F64 = npt.NDArray[np.float64]

_CLOCKS = {"timestamp (us)": 1e-6, "time (s)": 1.0}
_QUATERNIONS = (("w element", "x element", "y element", "z element"), ("w", "x", "y", "z"))
_GYR, _ACC, _MAG = ("gyroscope {} (deg/s)", "accelerometer {} (g)", "magnetometer {} ({})")
_WORDS = {"Inertial": ("Quaternion", "Magnetometer"), "sensors": ("quaternion",)}
"""A dict from the word in the name of a file of readings to the words in the names of the accompanying files."""


@dataclass(frozen=True)
class _Table:
    """A file and its columns by name, in lower case."""

    path: Path
    header: Sequence[str]
    rows: NumberRows
    tick_s: float

    @property
    def times(self) -> F64:
        return self.rows.numbers[:, 0] * self.tick_s

    def columns(self, names: Sequence[str]) -> F64 | None:
        """Return columns by their names; None unless all of them exist."""
        if not set(names) <= set(self.header):
            return None
        return self.rows.numbers[:, [self.header.index(name) for name in names]]


def recognises(path: Path, head: bytes) -> bool:
    """Return True for a header that begins with a time and then a gyroscope, a quaternion or a magnetometer."""
    first = head.split(b"\n", 1)[0].decode("utf-8", "replace").strip("\ufeff\r ").lower()
    clock, _, rest = first.partition(",")
    starts = ("gyroscope x (deg/s)", "w element,", "w,x,y,z", "magnetometer x (")
    return clock in _CLOCKS and rest.startswith(starts)


def beside(path: Path) -> Path | None:
    """Return the file of readings that a file of quaternions or fields accompanies; None if there is none."""
    for word, others in _WORDS.items():
        for other in others:
            if other in path.stem:
                found = path.with_name(path.name.replace(other, word))
                return found if found.is_file() else None
    return None


def read(path: Path, given: UserStatements) -> list[RawSensor]:
    """Read a sensor from a file of readings and the files that accompany it, or from a file of quaternions alone.

    Raises
    ------
    SourceError
        A file is damaged; the message names line and column.
    """
    main = beside(path) or path
    table = _table(main)
    sensor = RawSensor(_name(main), lines=table.rows.lines, frame=NWU)
    sensor.times, sensor.absolute = table.times, table.tick_s != 1.0
    sensor.units = {"gyr": "deg/s", "acc": "g", "mag": "uT"}
    sensor.gyr = table.columns([_GYR.format(axis) for axis in "xyz"])
    sensor.acc = table.columns([_ACC.format(axis) for axis in "xyz"])
    _set_field(sensor, table, table)
    sensor.orientation = _quaternions(table)
    for word, others in _WORDS.items():
        for other in others if word in main.stem else ():
            near = main.with_name(main.name.replace(word, other))
            if near.is_file():
                _join(sensor, table, _table(near))
    if sensor.acc is None and sensor.gyr is None and sensor.orientation is None:
        raise SourceError(main, "has no readings; a file of fields is read with the file of inertial data beside it")
    return [sensor]


def _join(sensor: RawSensor, table: _Table, near: _Table) -> None:
    """Add the quaternions or magnetic fields of another file to a sensor, joined by time."""
    if not (np.diff(near.times) > 0).all():
        row = int(np.argmin(np.diff(near.times) > 0)) + 1
        raise SourceError(near.path, "the time must ascend", line=int(near.rows.lines[row]))
    if (found := _quaternions(near)) is not None:
        lengths = np.linalg.norm(found, axis=1)
        off = np.flatnonzero(np.abs(lengths - 1) > 0.01)
        if len(off):
            row = int(off[0])
            line = int(near.rows.lines[row])
            raise SourceError(near.path, f"a quaternion has the length {lengths[row]:.3g}, expected 1", line=line)
        sensor.orientation, _ = interpolate(near.times, found, table.times)
    _set_field(sensor, table, near)


def _set_field(sensor: RawSensor, table: _Table, near: _Table) -> None:
    """Set the magnetic field, at the times of the readings."""
    for unit, name in (("uT", "ut"), ("1", "a.u.")):
        found = near.columns([_MAG.format(axis, name) for axis in "xyz"])
        if found is not None:
            if near is not table:
                found = np.stack([np.interp(table.times, near.times, row) for row in found.T], axis=1)
            sensor.mag, sensor.units["mag"] = found, unit


def _quaternions(table: _Table) -> F64 | None:
    """Return quaternions from sensor to world, or None; those of NGIMU, which rotate to the sensor, are conjugated."""
    for names in _QUATERNIONS:
        if (found := table.columns(names)) is not None:
            return conjugate(found) if names == _QUATERNIONS[1] else found
    return None


def _table(path: Path) -> _Table:
    lines = text_lines(path)
    header = [cell.lower() for cell in cells_of(lines[0].strip("\ufeff"), ",")]
    if header[0] not in _CLOCKS:
        raise SourceError(
            path, f"must begin with the column Timestamp (us) or Time (s), got {header[0][:50]!r}", line=1
        )
    rows = number_rows(path, lines, 1, ",", header, range(len(header)))
    return _Table(path, header, rows, _CLOCKS[header[0]])


def _name(path: Path) -> str:
    """Return the name of a device: the file's name without the word for its contents, or that of the folder."""
    words = "|".join(("Inertial", "Quaternion", "Magnetometer", "sensors", "quaternion"))
    return re.sub(rf"[ _-]*(?:{words})$", "", path.stem) or path.resolve().parent.name
