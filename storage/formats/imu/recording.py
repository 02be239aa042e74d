"""A recording of inertial sensors: its files read together, in SI units, with orientations in one world.

The table that kinedex itself writes (`kinedex simulate imu`) is read back without any description, as Parquet, CSV or
HDF5. It has one row for each sample of each sensor and the columns

    sensor                            the sensor's name; absent in a table of one sensor
    time_s                            seconds on the sensor's clock
    acc_x acc_y acc_z                 specific force, m/s²
    gyr_x gyr_y gyr_z                 angular velocity, rad/s, in the sensor's axes
    mag_x mag_y mag_z                 magnetic field, µT
    q_w q_x q_y q_z                   orientation, sensor → F_GI (X magnetic north, Y west, Z up)

of which `time_s` and one group are required, and an empty or NaN cell is a value that was not measured. The columns
`acc`, `gyr`, `mag` and `orientation` of structures (x, y, z) and (w, x, y, z), and `t`, are the same. A sensor that has
a limb's name is worn on that limb.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from kinedex.catalog.sensorsets import SensorSet
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.imu import tables
from kinedex.storage.formats.imu.sensor_checks import checked
from kinedex.storage.formats.imu.signals import ENU, NED, NWU, Given, ImuSensor, RawSensor

__all__ = ["ENU", "FORMATS", "NED", "NWU", "ImuRecording", "ImuSensor", "read_recording", "recognised"]


@dataclass(frozen=True, eq=False)
class ImuRecording:
    """What sensors measured at one time.

    Attributes
    ----------
    name : str
        Its name: that of its file.
    sensors : list of ImuSensor
        The sensors, in the order of the file.
    format : str
        The format of the file, a key of `FORMATS`.
    """

    name: str
    sensors: list[ImuSensor]
    format: str


@dataclass(frozen=True)
class ImuFormat:
    """A format of sensor files.

    Attributes
    ----------
    title : str
        Its name for people.
    recognises : callable
        Returns True for a file of the format, given its path and its first bytes.
    read : callable
        Returns the sensors of a file, given its path and what the user states about it.
    """

    title: str
    recognises: Callable[[Path, bytes], bool]
    read: Callable[[Path, Given], list[RawSensor]]


FORMATS = {
    "table": ImuFormat("table (CSV, Parquet or HDF5)", tables.recognises, tables.read),
}
"""Name → format; a file is of the first whose reader recognises it."""

_HEAD = 1 << 16


def read_recording(
    path: str | Path, *, rate_hz: float | None = None, sensor_set: SensorSet | None = None
) -> ImuRecording:
    """Read the sensors of a file.

    Parameters
    ----------
    path : path
        The file.
    rate_hz : float, optional
        Samples per second, for a file that does not state them; of a file that does, the sensor set's or this one is
        used in the place of the file's.
    sensor_set : SensorSet, optional
        Units, axes, world and columns, where the file does not state them or states them wrongly.

    Returns
    -------
    ImuRecording
        Its sensors.

    Raises
    ------
    SourceError
        The file is damaged, of an unknown format, or contradicts itself; the message names the line or the column.
    """
    path = Path(path)
    given = Given(rate_hz, sensor_set or SensorSet())
    name = recognised(path)
    raw = FORMATS[name].read(path, given)
    if not raw:
        raise SourceError(path, "has no sensors")
    return ImuRecording(path.stem, [checked(path, sensor, given) for sensor in raw], name)


def recognised(path: Path) -> str:
    """Return the format of a file, a key of `FORMATS`.

    Raises
    ------
    SourceError
        The file cannot be read, or is of no format.
    """
    head = beginning(path)
    for name, form in FORMATS.items():
        if form.recognises(path, head):
            return name
    known = ", ".join(form.title for form in FORMATS.values())
    raise SourceError(path, f"is no file of inertial sensors that is known; known: {known}")


def beginning(path: Path) -> bytes:
    """Return the first bytes of a file; a SourceError reports that it cannot be read, or is empty."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError as fault:
        raise SourceError(path, f"cannot be read: {fault.strerror}") from fault
    if not head or head.isspace():
        raise SourceError(path, "the file is empty")
    return head
