"""Find the sensor recordings below a folder: which files belong together, and to which take."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from kinedex.catalog.sensorsets import SensorSet
from kinedex.ops.errors import KinedexError, SourceError, did_you_mean
from kinedex.pipelines.inertial.recording_parameters import ReadImuParameters
from kinedex.pipelines.ingestion.failures import Failure
from kinedex.storage.formats.imu.recording import belongs_to, has_readings, session_of
from kinedex.storage.formats.motion.sources import readable

ENDINGS = (".txt", ".csv", ".tsv", ".parquet", ".h5", ".hdf5", ".mvnx")
"""The file extensions of sensor files."""


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
class FoundRecordings:
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
    """Return all files below a folder with the extension of a sensor file, without links that lead out of it."""
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
) -> FoundRecordings:
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
        folder with the name of such a recording belong to all of them.

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
    return FoundRecordings(root, recordings, failures, [readable(name) for name in passed_over])


def _with_made(
    groups: Mapping[tuple[str, str], list[Path]], made: Mapping[str, Sequence[str]]
) -> dict[tuple[str, str], list[Path]]:
    """Return a dict from (take, name) to files; takes of a camera recording without own folder get its files."""
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


def stamps(paths: Iterable[Path]) -> list[tuple[str, int, int]]:
    """Return path, size and modification time of files; raise a KinedexError for a file that cannot be read."""
    found = []
    for path in paths:
        try:
            state = path.stat()
        except OSError as fault:
            raise KinedexError(f"{path}: cannot be read: {fault.strerror}") from None
        found.append((str(path), state.st_size, state.st_mtime_ns))
    return found
