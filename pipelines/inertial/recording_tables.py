"""Read the files of a recording, and make rows of `imu_recordings` and `imu_samples`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from kinedex.catalog.sensorsets import SensorSet, load_sensor_set
from kinedex.ops.errors import KinedexError, SourceError
from kinedex.ops.inertial.orientation_filter import estimate, estimate_calibrated
from kinedex.ops.inertial.packages import MissingPackageError
from kinedex.ops.inertial.rotations import interpolate
from kinedex.pipelines.inertial.recording_files import SensorRecording, rejection
from kinedex.pipelines.ingestion.failures import Failure
from kinedex.storage.formats.imu.recording import ImuRecording, ImuSensor, read_together
from kinedex.storage.snapshot.schemas import result_schema

F64 = npt.NDArray[np.float64]

_LONGEST_BRIDGE_S = 1.0
_LARGEST_OFFSET = 0.05  # share of the field that the offset of a calibrated magnetometer may have
_MOST_FILLED = 4
"""The largest number of samples of the even grid per sample of the file; with larger gaps a recording is rejected."""


@dataclass(frozen=True)
class ReadTask:
    """A task that reads one recording.

    Attributes
    ----------
    root : Path
        The folder of all recordings.
    recording : SensorRecording
        Its files.
    sensors : str or None
        The path of the file that describes the sensors.
    orientation : {"file", "estimate"}
        The source of orientations.
    rate_hz : float or None
        Samples per second of files that do not state their rate.
    fingerprint : str
        A hash of everything that determines the rows.
    run : str
        Id of the run.
    """

    root: Path
    recording: SensorRecording
    sensors: str | None
    orientation: Literal["file", "estimate"]
    rate_hz: float | None
    fingerprint: str
    run: str


@dataclass(frozen=True, eq=False)
class ReadRows:
    """The rows of one recording, or the reasons why it was rejected.

    Attributes
    ----------
    recording : SensorRecording
        Its files.
    tables : dict of str to pyarrow.Table
        Its results by kind; empty for a recording that was rejected.
    failures : tuple of Failure
        The reasons for the rejection, or for excluding a sensor.
    """

    recording: SensorRecording
    tables: dict[str, pa.Table]
    failures: tuple[Failure, ...] = ()


def sensor_set_of(name: str | None) -> SensorSet:
    """Return the description of sensors in a file; an empty description for None."""
    return SensorSet() if name is None else load_sensor_set(name)


def read_rows(task: ReadTask) -> ReadRows:
    """Read a recording; an error in a file rejects only this recording.

    Raises
    ------
    MissingPackageError
        Orientations are to be estimated, but the filter is not installed.
    """
    recording = task.recording
    try:
        chosen = sensor_set_of(task.sensors)
        found = read_together(recording.files, recording.name, rate_hz=task.rate_hz, sensor_set=chosen)
        files = {name: path.relative_to(task.root).as_posix() for name, path in found.files.items()}
        limbs = chosen.limbs(files)
        if not limbs:
            names = ", ".join(f"'{sensor.name}'" for sensor in found.sensors[:20])
            raise SourceError(recording.files[0], f"no limb claims a sensor of this recording; {_claim(names)}")
        with_orientation = {
            sensor.name: oriented(sensor, task.orientation) for sensor in found.sensors if sensor.name in limbs
        }
    except MissingPackageError:
        raise
    except KinedexError as fault:
        path = Path(fault.path) if isinstance(fault, SourceError) else recording.files[0]
        path = path if path in recording.files or path in recording.beside else recording.files[0]
        return ReadRows(recording, {}, (rejection(task.root, path, fault),))
    rows, samples, failures = [], [], []
    for sensor in found.sensors:
        path = found.files[sensor.name]
        if sensor.name not in limbs:
            left = SourceError(path, f"no limb claims the sensor '{sensor.name}', and it is left out; {_claim('it')}")
            failures.append(rejection(task.root, path, left))
            rows.append(_row(task, found, sensor, files[sensor.name], None, None))
            continue
        known, source = with_orientation[sensor.name]
        rows.append(_row(task, found, known, files[sensor.name], limbs[sensor.name], source))
        samples.append(_samples(task, known))
    tables = {
        "imu_recordings": pa.Table.from_pylist(rows, schema=result_schema("imu_recordings")),
        "imu_samples": pa.concat_tables(samples),
    }
    return ReadRows(recording, tables, tuple(failures))


def _claim(what: str) -> str:
    return f"name {what} in a file of sensors, as `sensors: {{'00B421ED': lshank}}`, and set `sensors` to it"


def oriented(sensor: ImuSensor, source: Literal["file", "estimate"]) -> tuple[ImuSensor, str]:
    """Return a sensor with its orientation, and the source of the orientation: file, 9D or 6D.

    Raises
    ------
    KinedexError
        There is neither an orientation nor data from which it can be estimated.
    MissingPackageError
        The filter is not installed.
    """
    if source == "file" and sensor.orientation is not None:
        return sensor, "file"
    if sensor.acc is None or sensor.gyr is None:
        has = ", ".join(sensor.channels)
        raise KinedexError(
            f"sensor '{sensor.name}' has {has}, and an orientation is estimated of acc and gyr; leave the sensor out "
            "of the file of sensors, or export its orientation"
        )
    found, warnings = estimated(sensor)
    warned = replace(sensor, orientation=found, frame="", warnings=(*sensor.warnings, *warnings))
    return warned, "6D" if sensor.mag is None else "9D"


def estimated(sensor: ImuSensor) -> tuple[F64, list[str]]:
    """Return orientations estimated from the readings, NaN in gaps, and warnings.

    The filter runs over an even grid at the sensor's rate. Gaps in the readings are interpolated linearly, so that the
    filter can continue after them; estimates within gaps are discarded.
    """
    assert sensor.acc is not None
    assert sensor.gyr is not None
    times = sensor.times
    count = round((float(times[-1]) - float(times[0])) * sensor.rate_hz) + 1
    if count > _MOST_FILLED * len(times) + 1000:
        raise KinedexError(
            f"sensor '{sensor.name}' has samples of a small part of its time; cut the recording into parts"
        )
    grid = times[0] + np.arange(count) / sensor.rate_hz
    acc, gyr = (_filled(times, values, grid) for values in (sensor.acc, sensor.gyr))
    mag = None if sensor.mag is None else _filled(times, sensor.mag, grid)
    if acc is None or gyr is None or (sensor.mag is not None and mag is None):
        raise KinedexError(f"sensor '{sensor.name}' has a channel without a single reading")
    warnings = []
    if mag is None:
        even = estimate(sensor.rate_hz, acc, gyr)
    else:
        even, offset = estimate_calibrated(sensor.rate_hz, acc, gyr, mag)
        warnings += _offset_warning(mag, offset)
    found, _ = interpolate(grid, even, np.clip(times, grid[0], grid[-1]), 2.0 / sensor.rate_hz)
    found[~(np.isfinite(sensor.acc).all(axis=1) & np.isfinite(sensor.gyr).all(axis=1))] = np.nan
    if mag is None and any(stop - start > _LONGEST_BRIDGE_S for start, stop in sensor.gaps):
        warnings.append("without magnetometer, the estimated heading jumps at a gap of more than a second")
    return found, warnings


def _offset_warning(mag: F64, offset: F64) -> list[str]:
    """Return a warning if a magnetometer is clearly not calibrated."""
    share = float(np.linalg.norm(offset) / np.median(np.linalg.norm(mag - offset, axis=1)))
    if share < _LARGEST_OFFSET:
        return []
    return [f"the magnetometer is off by {share:.0%} of the field, which was taken out before headings were estimated"]


def _filled(times: F64, values: F64, grid: F64) -> F64 | None:
    """Return readings interpolated linearly at the times of a grid; None if there are no known readings."""
    known = np.isfinite(values).all(axis=1)
    if not known.any():
        return None
    return np.stack([np.interp(grid, times[known], row) for row in values[known].T], axis=1)


def _row(
    task: ReadTask, found: ImuRecording, sensor: ImuSensor, file: str, limb: str | None, source: str | None
) -> dict[str, object]:
    channels = list(sensor.channels)
    if source in ("6D", "9D"):
        channels.remove("orientation")
    return {
        "run": task.run,
        "take_id": task.recording.take_id,
        "take": task.recording.take,
        "recording": task.recording.name,
        "sensor": sensor.name,
        "limb": limb,
        "file": file,
        "format": found.format,
        "rate_hz": sensor.rate_hz,
        "samples": len(sensor.times),
        "frame": sensor.frame or None,
        "channels": channels,
        "gaps": [{"last_s": start, "next_s": stop} for start, stop in sensor.gaps],
        "warnings": list(sensor.warnings),
        "orientation": source,
        "fingerprint": task.fingerprint,
    }


def _samples(task: ReadTask, sensor: ImuSensor) -> pa.Table:
    """Return the samples of a sensor as a table."""
    count = len(sensor.times)
    schema = result_schema("imu_samples")
    columns = {
        "run": pa.repeat(pa.scalar(task.run), count),
        "recording": pa.repeat(pa.scalar(task.recording.name), count),
        "sensor": pa.repeat(pa.scalar(sensor.name), count),
        "sample": pa.array(np.arange(count)),
        "t": pa.array(sensor.times),
    }
    for name in ("acc", "gyr", "mag", "orientation"):
        columns[name] = structures(getattr(sensor, name), schema.field(name).type, count)
    return pa.table([columns[name].cast(schema.field(name).type) for name in schema.names], schema=schema)


def structures(values: F64 | None, kind: pa.StructType, count: int) -> pa.Array:
    """Return an array (T, n) as structures; rows with a NaN are null, and so are all rows if `values` is None."""
    if values is None:
        return pa.nulls(count, kind)
    missing = ~np.isfinite(values).all(axis=1)
    parts = [pa.array(np.ascontiguousarray(column)) for column in np.nan_to_num(values).T]
    return pa.StructArray.from_arrays(parts, fields=list(kind), mask=pa.array(missing))
