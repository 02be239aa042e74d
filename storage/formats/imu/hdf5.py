"""Read HDF5 files of sensors: those of Opal (APDM), and other files by the names of their data sets.

The data sets of Opal are `Sensors/<id>/Accelerometer`, `Gyroscope`, `Magnetometer` and `Time` (µs), and
`Processed/<id>/Orientation`; the name of a sensor is the attribute `Label 0` of its configuration. Older files
(versions 3 and 4) have `<id>/Calibrated/Accelerometers`, `Gyroscopes`, `Magnetometers`, `Orientation` and `<id>/Time`,
the rate in `SampleRate` of `<id>`, and the names in `MonitorLabelList` of the file, in the order of its `CaseIdList`.
Both layouts are taken from the manual and from published programs, without a sample file; data sets may be missing.

In other files, data sets are read like the columns of a table: a data set `imu_acc` with three columns is imu_acc/x,
imu_acc/y and imu_acc/z. The rate is an attribute `sampling_rate`, `sample_rate`, `rate_hz` or `fs` of the file or of a
group.
"""

from __future__ import annotations

import importlib.util
import io
import json
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import KinedexError, SourceError
from kinedex.storage.formats.imu.signals import NWU, RawSensor, UserStatements
from kinedex.storage.formats.imu.tables import MAX_ROWS, MAX_SENSORS, layout_of, sensors_of
from kinedex.storage.formats.source_files import file_size, part_of

SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""The first bytes of an HDF5 file."""

MAX_BYTES = 4 << 30
"""The largest memory of data sets that are read together, in bytes."""

_PROGRAM = "kinedex.storage.formats.imu.hdf5_child:main"
_CHILD = Path(__file__).with_name(_PROGRAM.partition(":")[0].rpartition(".")[2] + ".py")
_PLACES = {0: (13, 14, 24), 1: (13, 14, 28), 2: (9, 10, 12), 3: (9, 10, 12)}
_PATIENCE_S = 60
_BYTES_A_SECOND = 4 << 20


@dataclass(frozen=True)
class Dataset:
    """A data set, or a field of a compound data set.

    Attributes
    ----------
    shape : tuple of int
        The shape.
    kind : str
        The kind of the values' type, as in NumPy: f, i, u, b, S, O, …
    """

    shape: tuple[int, ...]
    kind: str


@dataclass(frozen=True)
class Hdf5Contents:
    """The data sets and attributes of a file.

    Attributes
    ----------
    datasets : dict of str to Dataset
        Path → data set; a field of a compound data set has the path `path/field`.
    attributes : dict of str to dict
        Path of a group or data set, or "" for the file → those of its attributes that are short texts, lists of texts,
        or single numbers.
    """

    datasets: dict[str, Dataset]
    attributes: dict[str, dict[str, Any]]


def hdf5_contents(path: Path) -> Hdf5Contents:
    """Return the data sets and attributes of an HDF5 file, without the values of the data sets.

    Raises
    ------
    SourceError
        The file is damaged.
    KinedexError
        The package h5py is not installed.
    """
    check_header(path)
    try:
        listing = json.loads(_run(path, ()))
    except ValueError:
        raise SourceError(path, "is damaged: the names of its data sets cannot be read") from None
    datasets = {}
    for name, item in listing["datasets"].items():
        shape = tuple(int(size) for size in item["shape"])
        for field, kind in zip(item["fields"] or [""], item["kinds"], strict=True):
            datasets[f"{name}/{field}" if field else name] = Dataset(shape, kind)
    return Hdf5Contents(datasets, listing["attributes"])


def hdf5_arrays(path: Path, contents: Hdf5Contents, names: Sequence[str]) -> list[npt.NDArray[Any]]:
    """Return data sets of a file; integers become int64 and other numbers float64.

    Raises
    ------
    SourceError
        A data set holds no numbers, the file is damaged, or the data sets are too large.
    """
    size = 0
    for name in names:
        dataset = contents.datasets[name]
        if dataset.kind not in "fiub":
            raise SourceError(path, f"data set '{name}' must hold numbers")
        size += 8 * prod(dataset.shape)
    if size > MAX_BYTES:
        most = f"{MAX_BYTES / 1e9:.1f} GB"
        raise SourceError(path, f"has {size / 1e9:.1f} GB in its data sets; divide it into files of at most {most}")
    try:
        with np.load(io.BytesIO(_run(path, tuple(names))), allow_pickle=False) as packed:
            found = [packed[str(i)] for i in range(len(names))]
    except (ValueError, OSError, KeyError, EOFError) as fault:
        raise SourceError(path, f"is damaged: {fault}") from None
    for name, values in zip(names, found, strict=True):
        if values.shape != contents.datasets[name].shape:
            raise SourceError(path, f"is damaged: data set '{name}' has the shape {values.shape}")
    return found


def check_header(path: Path) -> None:
    """Check that a file begins as HDF5 files do, and has the size that its header states.

    Raises
    ------
    SourceError
        The file is not HDF5, or is truncated.
    """
    head, size = part_of(path, 96), file_size(path)
    if not head.startswith(SIGNATURE):
        raise SourceError(path, "is no HDF5 file")
    version = head[8] if len(head) > 8 else -1
    if version not in _PLACES or len(head) < 60:
        raise SourceError(path, f"has a damaged header, with the version {version}; 0 to 3 are known")
    offsets, lengths, base = _PLACES[version]
    if head[offsets] != 8 or head[lengths] != 8:
        raise SourceError(path, "has a damaged header: offsets and sizes must have 8 bytes")
    start = int.from_bytes(head[base : base + 8], "little")
    end = int.from_bytes(head[base + 16 : base + 24], "little")
    if start != 0 or end > size:
        raise SourceError(path, f"is cut off: its header states {end:,} bytes, and it has {size:,}")


def _run(path: Path, names: tuple[str, ...]) -> bytes:
    """Return the output of the child process; raise SourceError if it failed, crashed or ran too long."""
    if importlib.util.find_spec("h5py") is None:
        raise KinedexError(f"{path}: HDF5 files are read by h5py, which is not installed: pip install 'kinedex[imu]'")
    patience = _PATIENCE_S + path.stat().st_size / _BYTES_A_SECOND
    # plugins that a file asks for are not loaded
    command = [sys.executable, "-P", str(_CHILD), str(path.resolve()), *names]
    try:
        done = subprocess.run(
            command, capture_output=True, timeout=patience, stdin=subprocess.DEVNULL, check=False,
            env=os.environ | {"HDF5_PLUGIN_PRELOAD": "::", "OMP_NUM_THREADS": "1"},
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise SourceError(path, f"is damaged: it was not read in {patience:.0f} s") from None
    except (OSError, ValueError) as fault:
        raise SourceError(path, f"cannot be read by a process with h5py, which did not start: {fault}") from None
    if done.returncode:
        lines = done.stderr.decode("utf-8", "replace").strip().splitlines()
        reason = lines[-1] if done.returncode == 1 and lines else "the HDF5 library ends on it"
        raise SourceError(path, f"is damaged: {reason}")
    return done.stdout


F64 = npt.NDArray[np.float64]

_OPAL = {"acc": ("Accelerometer", "Accelerometers"), "gyr": ("Gyroscope", "Gyroscopes"),
         "mag": ("Magnetometer", "Magnetometers")}  # fmt: skip
_OPAL_UNITS = {"acc": "m/s2", "gyr": "rad/s", "mag": "uT"}
_RATES = ("sampling_rate", "sample_rate", "sample rate", "samplingrate", "samplerate", "rate_hz", "fs")
_AXES = {3: "xyz", 4: "wxyz"}


class _Layout(NamedTuple):
    """Paths of a sensor in a file of Opal: a pattern that captures the sensor's number, and paths with {0} for it."""

    device: str
    readings: str
    time: str
    orientation: str


_LAYOUTS = (
    _Layout(
        r"Sensors/([^/]+)/(?:Accelerometer|Gyroscope)s?", "Sensors/{0}", "Sensors/{0}/Time", "Processed/{0}/Orientation"
    ),
    _Layout(
        r"([^/]+)/Calibrated/(?:Accelerometer|Gyroscope)s?", "{0}/Calibrated", "{0}/Time", "{0}/Calibrated/Orientation"
    ),
)


def recognises(path: Path, head: bytes) -> bool:
    """Return True for an HDF5 file."""
    return head.startswith(SIGNATURE)


def read(path: Path, given: UserStatements) -> list[RawSensor]:
    """Read the sensors of a file.

    Raises
    ------
    SourceError
        The file is damaged, or has no data sets of a sensor.
    """
    contents = hdf5_contents(path)
    if given.sensor_set.entries.columns is None:
        for layout in _LAYOUTS:
            found = (re.fullmatch(layout.device, name) for name in contents.datasets)
            if devices := list(dict.fromkeys(match[1] for match in found if match)):
                return _opal(path, contents, devices, layout)
    return _by_columns(path, contents, given)


def _opal(path: Path, contents: Hdf5Contents, devices: list[str], layout: _Layout) -> list[RawSensor]:
    if len(devices) > MAX_SENSORS:
        raise SourceError(path, f"has {len(devices)} sensors, and {MAX_SENSORS} are read at most")
    names = {device: _label(contents, device) or device for device in devices}
    labels = Counter(names.values())
    found = []
    for device in devices:
        label = names[device]
        sensor = RawSensor(label if labels[label] == 1 else f"{label} {device}", units=dict(_OPAL_UNITS), frame=NWU)
        sensor.frame_assumed = True
        wanted = {"times": layout.time.format(device), "orientation": layout.orientation.format(device)}
        for channel, words in _OPAL.items():
            places = [f"{layout.readings.format(device)}/{word}" for word in words]
            wanted[channel] = next((place for place in places if place in contents.datasets), places[0])
        _set(path, sensor, contents, wanted)
        sensor.rate_hz = _rate(contents, f"Sensors/{device}/Configuration", f"Sensors/{device}", device, "")
        if sensor.times is not None:
            sensor.times, sensor.absolute = sensor.times * 1e-6, True
        found.append(sensor)
    return found


def _set(path: Path, sensor: RawSensor, contents: Hdf5Contents, wanted: Mapping[str, str]) -> None:
    """Set the channels and times that the file has for a sensor; all must have equal lengths."""
    present = {key: name for key, name in wanted.items() if name in contents.datasets}
    width = {"orientation": 4, "times": None}
    for key, name in present.items():
        shape, columns = contents.datasets[name].shape, width.get(key, 3)
        if shape[1:] != (() if columns is None else (columns,)):
            raise SourceError(path, f"data set '{name}' must have {columns or 1} columns, got the shape {shape}")
        if shape[0] > MAX_ROWS or shape[0] != contents.datasets[next(iter(present.values()))].shape[0]:
            raise SourceError(
                path, f"data set '{name}' must be as long as the others of its sensor, got {shape[0]:,} rows"
            )
    arrays: list[npt.NDArray[Any]] = hdf5_arrays(path, contents, list(present.values()))
    for key, values in zip(present, arrays, strict=True):
        setattr(sensor, key, np.asarray(values, np.float64))


def _label(contents: Hdf5Contents, device: str) -> str | None:
    """Return the name of an Opal, from the attribute `Label 0` of its groups or the list of labels; None if unknown."""
    for group in (f"Sensors/{device}/Configuration", f"Sensors/{device}", f"Processed/{device}"):
        label = contents.attributes.get(group, {}).get("Label 0")
        if isinstance(label, str) and label.strip():
            return label.strip()
    lists = [contents.attributes.get("", {}).get(name) for name in ("CaseIdList", "MonitorLabelList")]
    numbers, labels = ([one] if isinstance(one, str) else one for one in lists)
    if isinstance(numbers, list) and isinstance(labels, list):
        for number, label in zip(numbers, labels, strict=False):
            if number.strip() == device and label.strip():
                return str(label.strip())
    return None


def _rate(contents: Hdf5Contents, *groups: str) -> float | None:
    """Return the samples per second that an attribute of one of the groups states; None if there is none."""
    for group in groups:
        for key, value in contents.attributes.get(group, {}).items():
            if key.lower() in _RATES and isinstance(value, float) and np.isfinite(value) and value > 0:
                return value
    return None


def _by_columns(path: Path, contents: Hdf5Contents, given: UserStatements) -> list[RawSensor]:
    """Read the data sets that are named like the columns of a table, which must have equal lengths."""
    header: list[str] = []
    parts: list[tuple[str, int | None]] = []
    for name, dataset in contents.datasets.items():
        if dataset.kind not in "fiub" or not 1 <= len(dataset.shape) <= 2 or len(name) > 500:
            continue
        if len(dataset.shape) == 1 or dataset.shape[1] == 1:
            header.append(name)
            parts.append((name, None))
        elif dataset.shape[1] in _AXES:
            for column, axis in enumerate(_AXES[dataset.shape[1]]):
                header.append(f"{name}/{axis}")
                parts.append((name, column))
    layout = layout_of(path, header, given)
    if layout.sensor is not None:
        raise SourceError(path, "has a column of sensors; in HDF5 files, write separate data sets for each sensor")
    names = list(dict.fromkeys(parts[place][0] for place in layout.columns()))
    lengths = {name: contents.datasets[name].shape[0] for name in names}
    if len(set(lengths.values())) > 1 or max(lengths.values()) > MAX_ROWS:
        listed = ", ".join(f"'{name}' {length:,}" for name, length in lengths.items())[:300]
        raise SourceError(path, f"must have data sets of one length, at most {MAX_ROWS:,} rows, got {listed}")
    arrays = dict(zip(names, hdf5_arrays(path, contents, names), strict=True))
    columns = {}
    for place in layout.columns():
        name, at = parts[place]
        values = np.asarray(arrays[name], np.float64).reshape(lengths[name], -1)
        columns[place] = values[:, at or 0]
    found = sensors_of(path, layout, given, columns)
    rate = _rate(contents, "", *sorted({name.rpartition("/")[0] for name in names}), *names)
    for sensor in found:
        sensor.rate_hz = rate
    return found
