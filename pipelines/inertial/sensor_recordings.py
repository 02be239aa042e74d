"""Find the sensor recordings below a folder, read their files, and make rows of imu_recordings and imu_samples."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
import pyarrow as pa

from kinedex.catalog.sensorsets import SensorSet, load_sensor_set
from kinedex.ops.arrays import F64
from kinedex.ops.errors import KinedexError, SourceError, did_you_mean
from kinedex.ops.inertial.orientation_filter import estimate, estimate_calibrated
from kinedex.ops.inertial.rotations import interpolate
from kinedex.ops.packages import MissingPackageError
from kinedex.pipelines.inertial.limb_motion import struct_array
from kinedex.pipelines.inertial.parameters import ReadImuParameters
from kinedex.pipelines.ingestion.file_failures import Failure
from kinedex.storage.formats.imu.recording import (
    ImuRecording,
    ImuSensor,
    belongs_to,
    has_readings,
    read_together,
    session_of,
)
from kinedex.storage.formats.motion.scanned_files import readable
from kinedex.storage.snapshot.schemas import columns_table, result_schema, result_table

ENDINGS = (".txt", ".csv", ".tsv", ".parquet", ".h5", ".hdf5", ".mvnx")
"""The file extensions of sensor files."""

_LONGEST_BRIDGE_S = 1.0
_LARGEST_OFFSET = 0.05  # of a calibrated magnetometer, as a fraction of the field
_MAX_FILLED = 4
"""The largest ratio of samples on a regular time grid to samples in the file; above it, a recording is rejected."""


@dataclass(frozen=True)
class SensorRecording:
    """Sensor files that share a clock.

    Attributes
    ----------
    name : str
        Its name: the path of its file below the source, without the part that names the sensor.
    take : str
        The take during which it was recorded.
    take_id : int
        The id of the take.
    files : tuple of Path
        The files that are read.
    beside : tuple of Path
        Further files, which are read together with `files`.
    """

    name: str
    take: str
    take_id: int
    files: tuple[Path, ...]
    beside: tuple[Path, ...] = ()


@dataclass(frozen=True)
class RecordingsBelow:
    """The recordings below a folder.

    Attributes
    ----------
    root : Path
        The folder.
    recordings : list of SensorRecording
        The recordings, by name.
    failures : list of Failure
        Files that belong to no take, or are not sensor files.
    passed_over : list of str
        Tables without columns of sensor data, which were skipped.
    """

    root: Path
    recordings: list[SensorRecording]
    failures: list[Failure]
    passed_over: list[str]


def source_root(source: str) -> Path:
    """Return the folder of recordings as an absolute path; raise a KinedexError if it does not exist."""
    root = Path(os.path.realpath(Path(source).expanduser()))
    if not root.is_dir():
        raise KinedexError(f"source '{readable(source)}' is no folder: give the folder that holds the sensors' files")
    return root


def sensor_files(root: Path) -> list[Path]:
    """Return the files below a folder with a sensor file's extension, without hidden ones and links that lead out."""
    found = []
    for folder, folders, names in os.walk(root):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in sorted(names):
            path = Path(folder, name)
            if path.suffix.lower() not in ENDINGS or name.startswith("."):
                continue
            if path.is_file() and (not path.is_symlink() or Path(os.path.realpath(path)).is_relative_to(root)):
                found.append(path)
    return found


def find_recordings(
    params: ReadImuParameters,
    takes: Mapping[str, int],
    sensor_set: SensorSet,
    made: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> RecordingsBelow:
    """Find the recordings below the source of a stage.

    Parameters
    ----------
    params : ReadImuParameters
        The source, and the pattern of paths.
    takes : mapping of str to int
        The takes of the store, name → id.
    sensor_set : SensorSet
        The description of the sensors.
    made : mapping of str to sequence of str
        The takes that were made from camera recordings: name of the recording → names of the takes. Sensors in a
        folder with the name of such a recording belong to all of its takes.

    Raises
    ------
    KinedexError
        The source is not a folder, or has no sensor files.
    """
    root = source_root(params.source)
    paths = sensor_files(root)
    if not paths:
        raise KinedexError(f"no sensor files ({', '.join(ENDINGS)}) below {params.source}; is this the right folder?")
    pattern = re.compile(params.match)
    failures: list[Failure] = []
    passed_over: list[str] = []
    groups: dict[tuple[str, str], list[Path]] = {}
    beside: dict[Path, list[Path]] = {}
    for path in paths:
        if (main := belongs_to(path)) is not None:
            beside.setdefault(main, []).append(path)
            continue
        relative = path.relative_to(root).as_posix()
        try:
            if not has_readings(path, sensor_set):
                passed_over.append(relative)
                continue
            take, name = _named(path, relative, pattern, {**made, **takes})
        except KinedexError as fault:
            failures.append(rejection(root, path, fault))
            continue
        groups.setdefault((take, name), []).append(path)
    groups = _with_made(groups, made)
    recordings = [
        SensorRecording(
            name, take, takes[take], tuple(files), tuple(one for file in files for one in beside.get(file, ()))
        )
        for (take, name), files in sorted(groups.items(), key=lambda group: group[0][1])
        if take in takes
    ]
    return RecordingsBelow(root, recordings, failures, [readable(name) for name in passed_over])


def _with_made(
    groups: Mapping[tuple[str, str], list[Path]], made: Mapping[str, Sequence[str]]
) -> dict[tuple[str, str], list[Path]]:
    """Return the files by take and recording, with entries added for takes that were made from camera recordings.

    Such a take has the files of the recording, unless it has files in a folder with its own name.
    """
    own = {take for take, _ in groups}
    found = dict(groups)
    for (take, name), files in groups.items():
        for other in made.get(take, ()):
            if other not in own:
                found[other, f"{other}/{name.removeprefix(f'{take}/')}"] = files
    return found


def _named(path: Path, relative: str, pattern: re.Pattern[str], takes: Mapping[str, object]) -> tuple[str, str]:
    """Return the take of a file and the name of its recording, from its path below the source."""
    found = pattern.search(relative)
    if found is None or not found["take"]:
        raise KinedexError(
            f"the pattern `match`, {pattern.pattern}, finds no take in this path; put the file into a folder with the "
            "name of its take, or set `match` to another pattern"
        )
    take = found["take"]
    if take not in takes and (last := take.rpartition("/")[2]) in takes:
        take = last
    if take not in takes:
        near = did_you_mean(take, takes)
        raise KinedexError(f"no take is called '{readable(take)}'{near}; name the folder after a take, or set `match`")
    own = found.groupdict().get("recording")
    return take, readable(f"{take}/{own}" if own else session_of(path, relative))


def rejection(root: Path, path: Path, fault: Exception) -> Failure:
    """Return the failure of a file that was not read, for `ingest_log`."""
    source, file = readable(path.relative_to(root).as_posix()), readable(str(path))
    line = fault.line if isinstance(fault, SourceError) else None
    message = str(fault) if isinstance(fault, SourceError) else f"{file}: {fault}"
    return Failure(source, type(fault).__name__, readable(message), file, line)


def file_stamps(paths: Iterable[Path]) -> list[tuple[str, int, int]]:
    """Return path, size and modification time of files; raise a KinedexError for a file that cannot be read."""
    found = []
    for path in paths:
        try:
            state = path.stat()
        except OSError as fault:
            raise KinedexError(f"{path}: cannot be read: {fault.strerror}") from None
        found.append((str(path), state.st_size, state.st_mtime_ns))
    return found


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
            sensor.name: oriented_sensor(sensor, task.orientation) for sensor in found.sensors if sensor.name in limbs
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
        "imu_recordings": result_table("imu_recordings", rows, task.run),
        "imu_samples": pa.concat_tables(samples),
    }
    return ReadRows(recording, tables, tuple(failures))


def _claim(what: str) -> str:
    return f"name {what} in a file of sensors, as `sensors: {{'00B421ED': lshank}}`, and set `sensors` to it"


def oriented_sensor(sensor: ImuSensor, source: Literal["file", "estimate"]) -> tuple[ImuSensor, str]:
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
    found, warnings = estimated_orientations(sensor)
    warned = replace(sensor, orientation=found, frame="", warnings=(*sensor.warnings, *warnings))
    return warned, "6D" if sensor.mag is None else "9D"


def estimated_orientations(sensor: ImuSensor) -> tuple[F64, list[str]]:
    """Return orientations (N, 4) estimated from the readings, NaN where readings are missing, and warnings.

    The filter runs on a regular time grid at the sensor's rate. Gaps in the readings are interpolated linearly, so that
    the filter can continue after them; estimates within gaps are discarded.
    """
    assert sensor.acc is not None
    assert sensor.gyr is not None
    times = sensor.times
    count = round((float(times[-1]) - float(times[0])) * sensor.rate_hz) + 1
    if count > _MAX_FILLED * len(times) + 1000:
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
    schema, count = result_schema("imu_samples"), len(sensor.times)
    columns = {"sample": pa.array(np.arange(count)), "t": pa.array(sensor.times)}
    for name in ("acc", "gyr", "mag", "orientation"):
        values, axes = getattr(sensor, name), "wxyz" if name == "orientation" else "xyz"
        columns[name] = pa.nulls(count, schema.field(name).type) if values is None else struct_array(values, axes)
    return columns_table("imu_samples", columns, run=task.run, recording=task.recording.name, sensor=sensor.name)
