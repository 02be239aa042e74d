"""Read files that describe a set of sensors: the limb that wears each sensor, and facts that data files do not state.

    sensors:                      # number, name or file pattern of a sensor: limb
      00B421ED: lshank
      "*_right.csv": rshank
    units: {acc: g, gyr: deg/s}   # where the files do not state them, or state them wrongly
    frame: ENU                    # the world of the files' orientations: NWU, ENU or NED
    axes: [-y, x, z]              # the sensor's x, y and z, each as an axis of the file
    columns: {time: t, acc: [ax, ay, az], gyr: [gx, gy, gz]}      # of tables with other names

A sensor that has a limb's name is worn on that limb, so that simulated recordings need no file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.configs import Located, config_path, load_yaml
from kinedex.catalog.limbs import LIMB_NAMES
from kinedex.ops.arrays import F64
from kinedex.ops.errors import ConfigError, KinedexError, did_you_mean

FASTEST_HZ = 20_000.0
SLOWEST_HZ = 1.0
"""Bounds of the rate of sensors in samples per second; a rate outside them means that the unit of time is wrong."""

_Axis = Literal["x", "y", "z", "-x", "-y", "-z"]
_Name = Annotated[str, Field(min_length=1, max_length=500)]
_Three = Annotated[list[_Name], Field(min_length=3, max_length=3)]
_Four = Annotated[list[_Name], Field(min_length=4, max_length=4)]


class Units(BaseModel):
    """The units that a user gives for sensor files that state no units or wrong ones."""

    model_config = ConfigDict(extra="forbid", coerce_numbers_to_str=True)
    acc: Literal["m/s2", "g", "mg"] | None = Field(None, description="unit of accelerations")
    gyr: Literal["rad/s", "deg/s", "mdeg/s"] | None = Field(None, description="unit of angular velocities")
    mag: Literal["uT", "nT", "mT", "gauss", "mgauss", "1"] | None = Field(
        None, description="unit of the magnetic field; 1 for units of the local field"
    )
    time: Literal["s", "ms", "us", "ns"] | None = Field(None, description="unit of times")


class Columns(BaseModel):
    """The columns of a table, or the data sets of an HDF5 file."""

    model_config = ConfigDict(extra="forbid")
    time: _Name | None = Field(None, description="times; without it, samples are counted at `rate_hz`")
    sensor: _Name | None = Field(None, description="the column that names the sensor of each row")
    acc: _Name | _Three | None = Field(None, description="x, y and z, or one data set of three columns")
    gyr: _Name | _Three | None = Field(None, description="as `acc`")
    mag: _Name | _Three | None = Field(None, description="as `acc`")
    orientation: _Name | _Four | None = Field(
        None, description="w, x, y and z, or one data set of four columns. `{sensor}` in a name stands for every sensor"
    )

    def names(self, channel: str) -> tuple[str, ...]:
        """Return the names of the columns of a channel; empty if the channel is absent."""
        given = getattr(self, channel)
        return () if given is None else (given,) if isinstance(given, str) else tuple(given)


class SensorEntries(BaseModel):
    """The content of a file of sensors."""

    model_config = ConfigDict(extra="forbid")
    sensors: dict[str, str] = Field({}, description="name or number of a sensor, or a pattern of its file → limb")
    units: Units | None = Field(None, description="units, where the files do not state them, or state them wrongly")
    frame: Literal["NWU", "ENU", "NED"] | None = Field(None, description="the world of the files' orientations")
    orientation: Literal["sensor_to_world", "world_to_sensor"] | None = Field(
        None, description="the direction of the files' quaternions; the second is the conjugate"
    )
    axes: Annotated[list[_Axis], Field(min_length=3, max_length=3)] | None = Field(
        None, description="the sensor's x, y and z, each as an axis of the file, such as [-y, x, z]"
    )
    rate_hz: float | None = Field(
        None,
        ge=SLOWEST_HZ,
        le=FASTEST_HZ,
        allow_inf_nan=False,
        description="samples per second of files that state neither them nor times",
    )
    header_rows: int | None = Field(
        None, ge=1, le=20, description="rows before the numbers of a CSV file, where they look like numbers"
    )
    columns: Columns | None = Field(None, description="the columns of tables with other names than those of kinedex")


@dataclass(frozen=True, eq=False)
class SensorSet:
    """Sensors, the limbs that wear them, and facts that their data files do not state.

    Attributes
    ----------
    entries : SensorEntries
        The content of the file; empty if there is no file.
    located : Located or None
        The file, with the lines of its keys; None if there is no file.
    """

    entries: SensorEntries = field(default_factory=lambda: SensorEntries.model_validate({}))
    located: Located | None = None

    def unit(self, quantity: str) -> str | None:
        """Return the unit that the user gives for acc, gyr, mag or time; None if the user gives none."""
        unit: str | None = getattr(self.entries.units, quantity, None)
        return unit

    def limb(self, sensor: str, file: str = "") -> str | None:
        """Return the limb that wears a sensor; None for a sensor that is assigned to no limb.

        An entry with the sensor's name takes precedence over patterns of file names; the first matching pattern is
        used. If the set lists no sensors, a sensor with the name of a limb is worn on that limb.

        Parameters
        ----------
        sensor : str
            The name or number of the sensor.
        file : str, optional
            The path of the sensor's file, relative to the folder of the recordings, with "/" between folders.
        """
        worn = self.entries.sensors
        if sensor in worn:
            return worn[sensor]
        for pattern, limb in worn.items():
            if fnmatchcase(file, pattern) or fnmatchcase(file.rpartition("/")[2], pattern):
                return limb
        return sensor if not worn and sensor in LIMB_NAMES else None

    def limbs(self, sensors: Mapping[str, str]) -> dict[str, str]:
        """Return a dict from sensor to limb for the sensors of a recording that are assigned to a limb.

        Parameters
        ----------
        sensors : mapping of str to str
            The path of each sensor's file, by the name of the sensor.

        Raises
        ------
        KinedexError
            Two sensors are worn on one limb.
        """
        found: dict[str, str] = {}
        for sensor, file in sensors.items():
            limb = self.limb(sensor, file)
            if limb is None:
                continue
            other = next((name for name, one in found.items() if one == limb), None)
            if other is not None:
                raise self.error(
                    f"the sensors '{other}' and '{sensor}' of one recording are both worn on {limb}; give each a limb "
                    "of its own, and leave out a sensor that is not to be used",
                )  # fmt: skip
            found[sensor] = limb
        return found

    def matrix(self) -> F64 | None:
        """Return the rotation (3, 3) from the file's axes to the sensor's; None if the axes are the same."""
        if self.entries.axes is None:
            return None
        matrix = np.zeros((3, 3))
        for row, axis in enumerate(self.entries.axes):
            matrix[row, "xyz".index(axis[-1])] = -1.0 if axis[0] == "-" else 1.0
        return matrix

    def error(self, message: str, *key: str | int) -> KinedexError:
        """Return an error; it names the file and the line of the key if the set was read from a file."""
        return KinedexError(message) if self.located is None else self.located.error(message, *(key or ("sensors",)))


def load_sensor_set(name: str | Path) -> SensorSet:
    """Read a file of sensors.

    Parameters
    ----------
    name : path
        The path of a YAML file, or the name of one that comes with kinedex.

    Raises
    ------
    ConfigError
        The file is invalid; the message names the line, the key and what was expected.
    """
    return parse_sensor_set(load_yaml(config_path("sensors", name)))


def parse_sensor_set(located: Located) -> SensorSet:
    """Return the sensors of a parsed file.

    Raises
    ------
    ConfigError
        The file is invalid; the message names the line, the key and what was expected.
    """
    content = located.mapping()
    listed = content.get("sensors")
    if isinstance(listed, dict):
        _refuse_numbers(located, listed)
    entries = located.model(SensorEntries)
    for sensor, limb in entries.sensors.items():
        if limb not in LIMB_NAMES:
            near = did_you_mean(limb, LIMB_NAMES)
            raise located.error(f"no limb is called '{limb}'{near}", "sensors", sensor)
    found = SensorSet(entries, located)
    matrix = found.matrix()
    if matrix is not None and round(float(np.linalg.det(matrix))) != 1:
        raise located.error(
            f"must be a turn, each of x, y and z once and right-handed, got {', '.join(entries.axes or ())}; "
            "try the other sign of one axis", "axes",
        )  # fmt: skip
    return found


def _refuse_numbers(located: Located, listed: Mapping[object, object]) -> None:
    """Raise an error for sensor ids that YAML has parsed as numbers, since it reads 00571 as the octal number 377."""
    for sensor in listed:
        if not isinstance(sensor, str):
            raise ConfigError(
                located.path, f"put the number of a sensor in quotes: YAML reads it as {sensor!r}",
                line=located.line("sensors", str(sensor)), key="sensors",
            )  # fmt: skip
