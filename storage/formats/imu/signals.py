"""Define the samples of a sensor, both as read from a file and in SI units with orientations in one world."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from kinedex.catalog.sensorsets import SensorSet

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

GRAVITY = 9.80665
"""Standard gravity in metres per second squared."""

UNITS = {
    "acc": {"m/s2": 1.0, "g": GRAVITY, "mg": GRAVITY / 1000},
    "gyr": {"rad/s": 1.0, "deg/s": np.pi / 180, "mdeg/s": np.pi / 180_000},
    "mag": {"uT": 1.0, "nT": 0.001, "mT": 1000.0, "gauss": 100.0, "mgauss": 0.1, "1": 1.0},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
}
"""A dict from each quantity to a dict from unit to its size in m/s², rad/s, µT or s.

The unit 1 of the magnetic field is the local field.
"""

_SPELLINGS = {
    "m/s^2": "m/s2", "m/(s^2": "m/s2", "m/s²": "m/s2", "m/s/s": "m/s2", "m s-2": "m/s2",
    "m*s^-2": "m/s2", "ms^-2": "m/s2",
    "°/s": "deg/s", "dps": "deg/s", "degree/s": "deg/s", "degrees/s": "deg/s", "deg*s^-1": "deg/s", "mdps": "mdeg/s",
    "rad/sec": "rad/s", "rad*s^-1": "rad/s", "rps": "rad/s", "deg/sec": "deg/s", "milli-g": "mg",
    "µt": "uT", "μt": "uT", "ut": "uT", "microtesla": "uT", "nt": "nT", "mt": "mT", "ga": "gauss", "mga": "mgauss",
    "a.u.": "1", "au": "1", "arbitrary": "1", "sec": "s", "seconds": "s", "msec": "ms", "µs": "us", "μs": "us",
    "usec": "us", "nsec": "ns",
}  # fmt: skip


def unit_name(text: str, quantity: str) -> str | None:
    """Return the key of a unit in `UNITS`; "" for an empty text, None for a unit that is unknown for the quantity."""
    plain = text.strip().strip("()[]").strip().lower()
    plain = _SPELLINGS.get(plain, plain)
    return plain if plain == "" or plain in UNITS[quantity] else None


NWU, ENU, NED = "north-west-up", "east-north-up", "north-east-down"
"""World frames of orientations, named by their axes X, Y and Z; `ImuSensor.orientation` uses the first, F_GI."""


@dataclass(frozen=True, eq=False)
class ImuSensor:
    """The samples of one inertial sensor.

    Attributes
    ----------
    name : str
        The sensor's name or number in the file.
    times : float64 array (T,)
        Seconds on the recording's clock, ascending; missing samples leave a gap.
    rate_hz : float
        Samples per second.
    acc : float64 array (T, 3) or None
        Specific force in m/s², NaN where nothing was measured; None for a sensor without accelerations.
    gyr : float64 array (T, 3) or None
        Angular velocity in rad/s, in the sensor's axes.
    mag : float64 array (T, 3) or None
        Magnetic field, in µT where the file states its unit.
    orientation : float64 array (T, 4) or None
        Unit quaternions w x y z from the sensor to F_GI, which were computed by the sensor.
    frame : str
        The world of the quaternions in the file, `NWU`, `ENU` or `NED`; empty if there are none.
    gaps : tuple of (float, float)
        Intervals of more than 50 ms without samples: the time of the last sample before and of the first one after the
        gap, in seconds.
    warnings : tuple of str
        Sentences for the user about irregularities.
    frame_assumed : bool
        True if `frame` is only assumed: user and file do not state it, the magnetic field does not show it, and no real
        file of the format has confirmed it.
    """

    name: str
    times: F64
    rate_hz: float
    acc: F64 | None = None
    gyr: F64 | None = None
    mag: F64 | None = None
    orientation: F64 | None = None
    frame: str = ""
    gaps: tuple[tuple[float, float], ...] = ()
    warnings: tuple[str, ...] = ()
    frame_assumed: bool = False

    @property
    def channels(self) -> tuple[str, ...]:
        """The names of the channels that the sensor has, among acc, gyr, mag and orientation."""
        return tuple(name for name in ("acc", "gyr", "mag", "orientation") if getattr(self, name) is not None)


@dataclass(frozen=True)
class UserStatements:
    """The user's statements about a file.

    Attributes
    ----------
    rate_hz : float or None
        Samples per second of a file that states neither its rate nor times.
    sensor_set : SensorSet
        Limbs, units, axes, worlds and columns.
    """

    rate_hz: float | None = None
    sensor_set: SensorSet = field(default_factory=SensorSet)


@dataclass(eq=False)
class RawSensor:
    """A sensor as read from a file, before units are converted and values are checked.

    Attributes
    ----------
    name : str
        The sensor's name or number.
    acc, gyr, mag : float64 array (T, 3) or None
        The readings; NaN for empty cells.
    orientation : float64 array (T, 4) or None
        Quaternions w x y z.
    times : float64 array (T,) or None
        Times in seconds; None if they follow from the counter and the rate.
    absolute : bool
        True if the clock started before the recording; times are then shifted to begin with the first sample.
    steps : int64 array (T,) or None
        The number of each sample, ascending; None if no sample is missing.
    wrap : int
        The number at which the counter of `steps` wraps; 0 if it does not.
    rate_hz : float or None
        The rate that the file states.
    units : dict of str to str
        Quantity → the unit that the file or its format states, a key of `UNITS`; absent if neither states one.
    frame : str
        The world of the quaternions according to the file or its format; empty if neither states it.
    frame_assumed : bool
        True if `frame` is taken from a manual or another program, and no real file has confirmed it.
    lines : int64 array (T,) or None
        The line of each sample, for messages; None for files without lines.
    warnings : list of str
        Sentences about irregularities.
    """

    name: str
    acc: F64 | None = None
    gyr: F64 | None = None
    mag: F64 | None = None
    orientation: F64 | None = None
    times: F64 | None = None
    absolute: bool = False
    steps: I64 | None = None
    wrap: int = 0
    rate_hz: float | None = None
    units: dict[str, str] = field(default_factory=dict)
    frame: str = ""
    frame_assumed: bool = False
    lines: I64 | None = None
    warnings: list[str] = field(default_factory=list)

    @property
    def samples(self) -> int:
        """The number of samples."""
        return next(
            len(part) for part in (self.acc, self.gyr, self.mag, self.orientation, self.times) if part is not None
        )

    def at(self, row: int) -> int | None:
        """Return the line of the file that holds a sample; None for a format without lines."""
        return None if self.lines is None else int(self.lines[row])

    def where(self, row: int) -> str:
        """Return the position of a sample in words, for messages about files without lines."""
        return "" if self.lines is not None else f"sample {row} (from 0): "
