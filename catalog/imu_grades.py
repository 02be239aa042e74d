"""Read grades of simulated inertial sensors, which define the errors of readings, from shipped or users' files.

    name: my-sensor
    source: [data sheet, revision, page]
    acc: {unit: g, density: 0.0003, bias: 0.02, range: 16, resolution: 0.00048828125}    # unit: m/s2 (default) or g
    gyr: {density: 0.01, bias: 1.7, walk: 0.003, range: 2000}                     # unit: deg/s (default) or rad/s
    mag: {density: 0.05, bias: 0.3, resolution: 0.15}                                    # µT
    gaps: {per_minute: 2, longest_s: 0.1}
    clock: {offset_s: 2, ppm: 20}
    magnets: {per_minute: 1, field_ut: 30, seconds: 3}
    soft_tissue_deg: 2

Errors that a file does not name are 0.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.configs import Located, config_path, load_yaml
from kinedex.ops.inertial.sensor_model import ChannelErrors, Grade

_Size = Annotated[float, Field(ge=0.0, le=1e6, allow_inf_nan=False)]

STANDARD_GRAVITY = 9.80665
"""Standard gravity, the unit g, in metres per second squared."""


class Channel(BaseModel):
    """The error parameters of one channel of a sensor, such as acceleration or angular rate."""

    model_config = ConfigDict(extra="forbid")
    unit: Literal["m/s2", "g", "deg/s", "rad/s", "uT"] | None = Field(
        None, description="unit of the numbers: m/s2 or g, deg/s or rad/s, uT; the first of each unless given"
    )
    density: _Size = Field(0.0, description="noise density, units per √Hz: white noise of density · √(rate/2)")
    bias: _Size = Field(0.0, description="standard deviation of the bias at the start")
    walk: _Size = Field(0.0, description="walk of the bias, units per √s")
    scale_percent: _Size = Field(0.0, description="standard deviation of the factors' errors in percent")
    axis_deg: _Size = Field(0.0, description="standard deviation of the angles between axes and case, in degrees")
    range: _Size = Field(0.0, description="largest reading, beyond which readings are clipped and flagged; 0: none")
    resolution: _Size = Field(0.0, description="step of the readings; 0: none")

    def errors(self, factor: float) -> ChannelErrors:
        """Return the errors in the unit of the sensor model; `factor` converts the values of the file to it."""
        return ChannelErrors(
            factor * self.density, factor * self.bias, factor * self.walk, 0.01 * self.scale_percent, self.axis_deg,
            factor * self.range, factor * self.resolution,
        )  # fmt: skip


class Gaps(BaseModel):
    """The frequency and length of gaps in samples."""

    model_config = ConfigDict(extra="forbid")
    per_minute: _Size = Field(0.0, description="gaps in a minute, on average")
    longest_s: _Size = Field(0.0, description="seconds of the longest gap; they are evenly spread up to it")


class ClockErrors(BaseModel):
    """The offset and drift of a recording's clock."""

    model_config = ConfigDict(extra="forbid")
    offset_s: _Size = Field(0.0, description="largest offset from the take's time, in seconds, either way")
    ppm: _Size = Field(0.0, description="standard deviation of the drift in parts per million")


class Magnets(BaseModel):
    """Magnetic disturbances, as of magnets that pass the sensor."""

    model_config = ConfigDict(extra="forbid")
    per_minute: _Size = Field(0.0, description="passages in a minute, on average")
    field_ut: _Size = Field(0.0, description="largest field of one in µT")
    seconds: _Size = Field(0.0, description="duration of one in seconds")


class GradeFile(BaseModel):
    """The content of a file that defines a grade of sensors."""

    model_config = ConfigDict(extra="forbid")
    name: str
    description: str = ""
    source: list[str] = Field(default_factory=list, description="document, revision and page of the numbers")
    acc: Channel = Field(default_factory=lambda: Channel.model_validate({}))
    gyr: Channel = Field(default_factory=lambda: Channel.model_validate({}))
    mag: Channel = Field(default_factory=lambda: Channel.model_validate({}))
    gaps: Gaps = Field(default_factory=lambda: Gaps.model_validate({}))
    clock: ClockErrors = Field(default_factory=lambda: ClockErrors.model_validate({}))
    magnets: Magnets = Field(default_factory=lambda: Magnets.model_validate({}))
    soft_tissue_deg: _Size = Field(0.0, description="turns of the sensor against the bone, root mean square degrees")


_UNITS = {
    "acc": {"m/s2": 1.0, "g": STANDARD_GRAVITY},
    "gyr": {"deg/s": float(np.pi / 180.0), "rad/s": 1.0},
    "mag": {"uT": 1.0},
}
_DEFAULT = {"acc": "m/s2", "gyr": "deg/s", "mag": "uT"}


def load_grade(name_or_path: str | Path) -> Grade:
    """Read a grade from `configs/imu_grades/` or from a user's file.

    Parameters
    ----------
    name_or_path : str or Path
        A shipped name such as good or cheap, or the path of a .yaml file.

    Raises
    ------
    ConfigError
        There is no such grade, or the file is invalid; the message names line and key.
    """
    return parse_grade(load_yaml(config_path("imu_grades", name_or_path)))


def parse_grade(located: Located) -> Grade:
    """Return the grade of a parsed file; errors as for `load_grade`."""
    located.mapping()
    parsed = located.model(GradeFile)
    errors = {}
    for channel, units in _UNITS.items():
        own: Channel = getattr(parsed, channel)
        unit = own.unit or _DEFAULT[channel]
        if unit not in units:
            raise located.error(f"must be {' or '.join(units)}, got {unit}", channel, "unit")
        errors[channel] = own.errors(units[unit])
    return Grade(
        errors["acc"], errors["gyr"], errors["mag"],
        parsed.gaps.per_minute, parsed.gaps.longest_s,
        parsed.clock.offset_s, parsed.clock.ppm,
        parsed.magnets.per_minute, parsed.magnets.field_ut, parsed.magnets.seconds,
        parsed.soft_tissue_deg,
    )  # fmt: skip
