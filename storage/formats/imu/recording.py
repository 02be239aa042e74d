"""Read a recording of inertial sensors, in SI units and with all orientations in one world.

Tables that kinedex itself writes (`kinedex simulate imu`), in Parquet, CSV or HDF5, are read without a description of
their columns. Such a table has one row for each sample of each sensor, and the columns

    sensor                            the sensor's name; absent in a table of one sensor
    time_s                            seconds on the sensor's clock
    acc_x acc_y acc_z                 specific force, m/s²
    gyr_x gyr_y gyr_z                 angular velocity, rad/s, in the sensor's axes
    mag_x mag_y mag_z                 magnetic field, µT
    q_w q_x q_y q_z                   orientation, sensor → F_GI (X magnetic north, Y west, Z up)

of which `time_s` and one of the other groups are required. An empty or NaN cell is a value that was not measured. The
names `acc`, `gyr`, `mag` and `orientation` for columns of structures (x, y, z) or (w, x, y, z), and `t` for times, are
recognised as well. A sensor with the name of a limb is worn on that limb.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from kinedex.catalog.sensorsets import SensorSet
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.imu import dot, hdf5, mtmanager, mvnx, opal, tables, xio
from kinedex.storage.formats.imu.sensor_checks import checked_sensor
from kinedex.storage.formats.imu.signals import ENU, NED, NWU, ImuSensor, RawSensor, UserStatements
from kinedex.storage.formats.source_files import part_of, source_bytes

__all__ = ["ENU", "FORMATS", "NED", "NWU", "ImuRecording", "ImuSensor", "read_recording", "recognised"]


@dataclass(frozen=True, eq=False)
class ImuRecording:
    """Inertial sensors that measured at the same time.

    Attributes
    ----------
    name : str
        The name of the recording, which is that of its file.
    sensors : list of ImuSensor
        The sensors, in the order of the file.
    format : str
        The format of the file, a key of `FORMATS`.
    files : dict of str to Path
        The name of each sensor → its file.
    """

    name: str
    sensors: list[ImuSensor]
    format: str
    files: dict[str, Path]


@dataclass(frozen=True)
class ImuFormat:
    """A format of sensor files.

    Attributes
    ----------
    title : str
        The name that is shown to users.
    recognises : callable
        Returns True for a file of the format, given its path and its first bytes.
    read : callable
        Returns the sensors of a file, given its path and the user's statements about it.
    """

    title: str
    recognises: Callable[[Path, bytes], bool]
    read: Callable[[Path, UserStatements], list[RawSensor]]


FORMATS = {
    "hdf5": ImuFormat("HDF5 (Opal, or by the names of data sets)", hdf5.recognises, hdf5.read),
    "mvnx": ImuFormat("MVNX (Xsens MVN)", mvnx.recognises, mvnx.read),
    "mtmanager": ImuFormat("MT Manager TXT (Xsens)", mtmanager.recognises, mtmanager.read),
    "dot": ImuFormat("DOT CSV (Xsens, Movella)", dot.recognises, dot.read),
    "opal": ImuFormat("Opal CSV (APDM)", opal.recognises, opal.read),
    "xio": ImuFormat("x-io CSV (x-IMU3, NGIMU)", xio.recognises, xio.read),
    "table": ImuFormat("table (CSV or Parquet)", tables.recognises, tables.read),
}
"""A dict from name to format; the format of a file is the first one that recognises the file."""

HDF5_ENDINGS = (".h5", ".hdf5")
"""Endings of HDF5 files."""

_HEAD = 1 << 16
_WHOLE = ("hdf5", "mvnx")  # formats of which a truncated file cannot be read


def read_recording(
    path: str | Path, *, rate_hz: float | None = None, sensor_set: SensorSet | None = None
) -> ImuRecording:
    """Read the sensors of a file.

    Parameters
    ----------
    path : path
        The file.
    rate_hz : float, optional
        Samples per second, for a file that states neither its rate nor times.
    sensor_set : SensorSet, optional
        Units, axes, world and columns, if the file does not state them or states them wrongly.

    Returns
    -------
    ImuRecording
        The sensors of the file.

    Raises
    ------
    SourceError
        The file is damaged, of an unknown format, or contradicts itself; the message names the line or the column.
    """
    return read_together([Path(path)], rate_hz=rate_hz, sensor_set=sensor_set)


def read_together(
    paths: Sequence[Path], name: str = "", *, rate_hz: float | None = None, sensor_set: SensorSet | None = None
) -> ImuRecording:
    """Read files of sensors that share a clock, such as those of one session of MT Manager.

    Parameters
    ----------
    paths : sequence of Path
        The files, at least one.
    name : str, optional
        The name of the recording; by default that of the first file.
    rate_hz, sensor_set : optional
        See `read_recording`.

    Returns
    -------
    ImuRecording
        The sensors of all files. If their clock does not start at 0, times are relative to the first sample of any
        sensor.

    Raises
    ------
    SourceError
        A file is damaged, or two files have a sensor of the same name.
    """
    given = UserStatements(rate_hz, sensor_set or SensorSet())
    raw: list[tuple[Path, RawSensor]] = []
    formats = []
    for path in paths:
        formats.append(recognised(path))
        own = FORMATS[formats[-1]].read(path, given)
        if formats[-1] not in _WHOLE and (warning := _unfinished(path)):
            for sensor in own:
                sensor.warnings.append(warning)
        raw.extend((path, sensor) for sensor in own)
    seen: dict[str, Path] = {}
    for path, sensor in raw:
        if sensor.name in seen:
            other = "twice" if seen[sensor.name] == path else f"as {seen[sensor.name].name} has"
            raise SourceError(path, f"has the sensor '{sensor.name}' {other}; sensors need different names")
        seen[sensor.name] = path
    _share_clock([sensor for _, sensor in raw])
    sensors = [checked_sensor(path, sensor, given) for path, sensor in raw]
    return ImuRecording(name or paths[0].stem, sensors, formats[0], dict(seen))


def _unfinished(path: Path) -> str:
    """Return a warning for a text file that ends within a line; empty for any other file."""
    with path.open("rb") as file:
        if file.read(4) == b"PAR1":
            return ""
        file.seek(-1, os.SEEK_END)
        if file.read(1) in b"\r\n\0":
            return ""
    return (
        "the file ends without a line break: if it was cut off there, the last number of its last sample is not whole"
    )


def _share_clock(sensors: Sequence[RawSensor]) -> None:
    """Shift counters and absolute clocks so that the earliest sample of all sensors is at 0."""
    starts: list[int] = []
    counted = [(sensor, sensor.steps) for sensor in sensors if sensor.steps is not None and len(sensor.steps)]
    for sensor, steps in counted:
        start = int(steps[0])
        if sensor.wrap and starts:  # another sensor's counter may have wrapped before its first sample
            start += sensor.wrap * round((starts[0] - start) / sensor.wrap)
        starts.append(start)
    for (sensor, steps), start in zip(counted, starts, strict=True):
        sensor.steps = steps - steps[0] + (start - min(starts))
    timed = [(sensor, sensor.times) for sensor in sensors if sensor.absolute and sensor.times is not None]
    first = min((float(times[0]) for _, times in timed if len(times)), default=0.0)
    for sensor, times in timed:
        sensor.times = times - first


def recognised(path: Path) -> str:
    """Return the format of a file, a key of `FORMATS`.

    Raises
    ------
    SourceError
        The file cannot be read, or has no known format.
    """
    head = beginning(path)
    for name, form in FORMATS.items():
        if form.recognises(path, head):
            return name
    if path.suffix.lower() in HDF5_ENDINGS:
        raise SourceError(
            path, f"is no HDF5 file, although its ending is {path.suffix}; export or copy it again, or correct "
            "its ending"
        )  # fmt: skip
    known = ", ".join(form.title for form in FORMATS.values())
    raise SourceError(path, f"is no file of inertial sensors that is known; known: {known}")


def is_sensor_file(path: Path) -> bool:
    """Return True for a file of sensors, not of motion; MVNX counts as motion, tables are judged by their columns."""
    try:
        name = recognised(path)
    except SourceError:
        return False
    return name != "mvnx" and (name != "table" or tables.has_readings(path))


def belongs_to(path: Path) -> Path | None:
    """Return the file with which a file must be read, such as readings for quaternions; None if there is none."""
    main = xio.beside(path)
    try:
        return main if main is not None and recognised(path) == "xio" else None
    except SourceError:
        return None


def session_of(file: Path, path: str) -> str:
    """Return the name of the recording of a file: its path, without the sensor number that MT Manager appends.

    Parameters
    ----------
    file : Path
        The file.
    path : str
        The path from which the name is made, with "/" between folders.
    """
    return mtmanager.session_of(path, beginning(file)) if recognised(file) == "mtmanager" else path


def has_readings(path: Path, sensor_set: SensorSet) -> bool:
    """Return True unless the file is a table without sensor columns, such as a table that describes recordings."""
    if sensor_set.entries.columns is not None or recognised(path) != "table":
        return True
    return tables.has_readings(path, ("acc", "gyr", "orientation"))


def beginning(path: Path) -> bytes:
    """Return the first bytes of a file; raise SourceError if it is empty or cannot be read."""
    return source_bytes(path, part_of(path, _HEAD))
