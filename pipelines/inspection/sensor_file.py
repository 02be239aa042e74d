"""Inspect a file of inertial sensors: format, rates, channels, gaps, units checked against gravity, and rests."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinedex.catalog.sensorsets import SensorSet
from kinedex.ops.inertial.readings import compare_with_orientation, rests, typical_length
from kinedex.ops.wording import counted
from kinedex.pipelines.inspection.motion_file import Inspection
from kinedex.storage.formats.imu.recording import FORMATS, ImuRecording, ImuSensor, read_recording
from kinedex.storage.formats.imu.signals import GRAVITY

_SHOWN = 5
_TURNING_RAD_S = 0.1  # a sensor that turns more slowly shows mainly its noise


@dataclass(frozen=True)
class InspectedSensor:
    """The measurements of a sensor; those that its channels do not determine are None.

    Attributes
    ----------
    sensor : str
        Its name.
    limb : str or None
        The limb to which the sensor description assigns it.
    channels : tuple of str
        The channels among acc, gyr, mag and orientation.
    rate_hz : float
        Samples per second.
    samples : int
        The number of samples.
    lost : int
        The number of samples that are missing, according to the rate.
    seconds : float
        The duration from the first to the last sample.
    frame : str or None
        The world frame of the file's own orientations.
    frame_assumed : bool
        True if the world frame is a guess, shown neither by the file, the magnetic field, a verified format, nor the
        sensor description.
    mean_acc_m_s2 : float or None
        The mean of |acc|.
    median_acc_m_s2 : float or None
        The median of |acc|, which is compared with gravity.
    gyr_correlation, gyr_ratio : float or None
        Correlation and ratio of gyr and the angular rate of the orientations; both are 1 if both channels are right.
    gaps : tuple of (float, float)
        Intervals of more than 50 ms without samples, as times in seconds.
    rests : tuple of (float, float)
        Intervals of a second or more at rest, as times in seconds.
    warnings : tuple of str
        Warnings about implausible values.
    """

    sensor: str
    limb: str | None
    channels: tuple[str, ...]
    rate_hz: float
    samples: int
    lost: int
    seconds: float
    frame: str | None
    frame_assumed: bool
    mean_acc_m_s2: float | None
    median_acc_m_s2: float | None
    gyr_correlation: float | None
    gyr_ratio: float | None
    gaps: tuple[tuple[float, float], ...]
    rests: tuple[tuple[float, float], ...]
    warnings: tuple[str, ...]

    def document(self) -> dict[str, Any]:
        """Return the measurements as a JSON object."""
        return asdict(self)


def inspect_sensor_file(
    file: Path, sensor_set: SensorSet, rate_hz: float | None = None
) -> tuple[Inspection, list[InspectedSensor]]:
    """Collect the facts about a file of sensors.

    Parameters
    ----------
    file : Path
        The file.
    sensor_set : SensorSet
        The sensor description: limbs, units, world and columns.
    rate_hz : float, optional
        Samples per second, for a file that states neither its rate nor times.

    Returns
    -------
    tuple of (Inspection, list of InspectedSensor)
        The facts as text, and the measurements of each sensor.

    Raises
    ------
    KinedexError
        The file cannot be read, or contradicts itself.
    """
    recording = read_recording(file, rate_hz=rate_hz, sensor_set=sensor_set)
    sensors = [_inspected(sensor, recording, sensor_set) for sensor in recording.sensors]
    found = Inspection()
    found.add("file", f"{file} ({file.stat().st_size / 1e6:.2f} MB)")
    found.add("format", f"{FORMATS[recording.format].title}, {counted(len(sensors), 'sensor')}")
    for sensor in sensors:
        _add_sensor(found, sensor)
    return found, sensors


def _inspected(sensor: ImuSensor, recording: ImuRecording, sensor_set: SensorSet) -> InspectedSensor:
    correlation = ratio = None
    if sensor.gyr is not None and sensor.orientation is not None:
        found = compare_with_orientation(sensor.times, sensor.gyr, sensor.orientation)
        if found[2] > _TURNING_RAD_S:
            correlation, ratio = _number(found[0]), _number(found[1])
    lengths = np.full(1, np.nan) if sensor.acc is None else np.linalg.norm(sensor.acc, axis=1)
    known = lengths[np.isfinite(lengths)]
    seconds = float(sensor.times[-1] - sensor.times[0])
    lost = max(round(seconds * sensor.rate_hz) + 1 - len(sensor.times), 0)
    return InspectedSensor(
        sensor.name, sensor_set.limb(sensor.name, recording.files[sensor.name].name), sensor.channels, sensor.rate_hz,
        len(sensor.times), lost, seconds, sensor.frame or None, sensor.frame_assumed,
        _number(float(known.mean())) if len(known) else None,
        None if sensor.acc is None else _number(typical_length(sensor.acc)), correlation, ratio, sensor.gaps,
        tuple(rests(sensor.times, sensor.rate_hz, sensor.acc, sensor.gyr)), sensor.warnings,
    )  # fmt: skip


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _add_sensor(found: Inspection, sensor: InspectedSensor) -> None:
    """Add the facts about a sensor."""
    worn = f", worn on {sensor.limb}" if sensor.limb else ""
    found.add("sensor", f"{sensor.sensor}{worn}: {', '.join(sensor.channels)}")
    lost = f" ({sensor.lost:,} more are lost)" if sensor.lost else ""
    found.add("rate", f"{sensor.rate_hz:.6g} Hz, {counted(sensor.samples, 'sample')}{lost}, {sensor.seconds:.2f} s")
    if sensor.median_acc_m_s2 is not None and sensor.mean_acc_m_s2 is not None:
        off = sensor.median_acc_m_s2 / GRAVITY - 1
        fits = "as gravity" if abs(off) < 0.1 else f"{abs(off):.0%} {'above' if off > 0 else 'below'} gravity"
        found.add("|acc|", f"mean {sensor.mean_acc_m_s2:.2f} m/s², median {sensor.median_acc_m_s2:.2f}: {fits}")
    if sensor.gyr_correlation is not None and sensor.gyr_ratio is not None:
        found.add(
            "gyr", f"correlates at {sensor.gyr_correlation:.2f} with the file's orientations, {sensor.gyr_ratio:.2f} "
            "times as large",
        )  # fmt: skip
    if sensor.frame:
        assumed = (
            ", which is assumed: nothing in this file shows it, nor did a real file of its format; `frame: NWU`, "
            "`ENU` or `NED` in a file of sensors (--sensors) states it"
        )
        found.add("orientation", f"sensor to {sensor.frame}{assumed if sensor.frame_assumed else ''}")
    found.add("gaps", _intervals(sensor.gaps) or "none above 50 ms")
    found.add("rests", _intervals(sensor.rests) or "none of a second or more")
    found.add_all("warnings", sensor.warnings)


def _intervals(intervals: tuple[tuple[float, float], ...]) -> str:
    if not intervals:
        return ""
    shown = ", ".join(f"{start:.2f} to {stop:.2f} s" for start, stop in intervals[:_SHOWN])
    more = f" and {len(intervals) - _SHOWN} more" if len(intervals) > _SHOWN else ""
    return f"{len(intervals)}, {sum(stop - start for start, stop in intervals):.2f} s: {shown}{more}"
