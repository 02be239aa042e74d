"""Write the files of simulated sensors (Parquet, NPZ, or text of MT Manager), and the README of a data set of them."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from kinedex.ops.arrays import F64
from kinedex.ops.inertial.sensor_model import Readings
from kinedex.ops.simulation.imu_sensors import SampledPiece

_COUNTER_WRAP = 65_536

CLOCKLESS = ("xsens-txt",)
"""Formats in which times are counted from the first sample."""

_FILES = {
    "parquet": "`recordings/TAKE/imu.parquet` | a row for each sample of each sensor: `sensor`, `time_s`, `acc_x` … "
    "`acc_z`, `gyr_x` …, `mag_x` …, `q_w` … `q_z`, `clipped`; lost samples are null",
    "npz": "`recordings/TAKE/imu.npz` | arrays `limbs` (L,), `time_s` and `take_time_s` (N,), `rate_hz`, `acc`, `gyr` "
    "and `mag` (L, N, 3), `orientation` (L, N, 4), `clipped` and `lost` (L, N); lost samples are NaN",
    "xsens-txt": "`recordings/TAKE/imu-LIMB.txt` | text in the form of MT Manager, a file for each sensor; lost "
    "samples have no row, `PacketCounter` counts them",
}
_READERS = {
    "parquet": """import polars as pl


def readings(file):
    \"\"\"Return sensors × samples × channels.\"\"\"
    sensors = pl.read_parquet(file).partition_by("sensor", maintain_order=True)
    return np.stack([sensor.select(CHANNELS).cast(pl.Float64).to_numpy() for sensor in sensors])
""",
    "npz": """

def readings(file):
    \"\"\"Return sensors × samples × channels.\"\"\"
    arrays = np.load(file)
    return np.concatenate([arrays["acc"], arrays["gyr"], arrays["mag"]], axis=2)
""",
    "xsens-txt": """from pathlib import Path


def readings(file):
    \"\"\"Return sensors × samples × channels; the sensors are those of all files of a piece, by name.\"\"\"
    first = Path(file)
    found = []
    for path in sorted(first.parent.glob(first.stem.rpartition("-")[0] + "-[!0-9]*.txt")):
        rows = np.loadtxt(path, skiprows=5, ndmin=2)
        found.append((np.unwrap(rows[:, 0], period=65536).astype(int), rows[:, 1:10]))
    values = np.full((len(found), max(counter[-1] for counter, _ in found) + 1, 9), np.nan)
    for sensor, (counter, rows) in enumerate(found):
        values[sensor, counter] = rows
    return values
""",
}
_TEXT = """# Simulated inertial sensors

kinedex computed from motion what sensors on the limbs of a person would have read. `dataset.yaml` records how: grade of
the sensors, seed, rate, magnetic field, limbs, takes and actors. The motion and its licence are those of the takes.

| file | content |
|---|---|
| {files} |
| `windows.csv` | windows as samples [start, stop) of each sensor of `file`, with the class that covers more than half \
of each (else empty), its share, and the actor |
| `segments.csv` | the segments that the classes are from, as samples; `origin` is label (of a person), annotation (of \
a method) or take (the class of the whole take) |
| `sensors.yaml` | limbs and units |
| `truth/sensors.csv` | mounts (sensor to limb), worlds (inertial to the take's), offset and drift of clocks; \
quaternions w, x, y, z |

A take that was cut has a file for each piece: `imu-1`, `imu-2`, … Values are in the sensor's axes: `acc` in m/s²,
gravity included (a sensor at rest reads 9.81 upwards), `gyr` in rad/s, `mag` in {mag}. A sample of `gyr` is
the turn since the sample before, and the first of a file is at rest. Orientations are unit quaternions from the sensor
to X magnetic north, Y west, Z up. They are the true ones: those of a filter have errors.

`mount` in `dataset.yaml` is `random` where each sensor has an arbitrary turn against its limb, another one for each
actor: a model that learns from such data cannot rely on axes. It is `limb` where the axes are those of the limb, as the
skeleton of the take has them.

## Load the windows

```python
import csv

import numpy as np
{reader}

CHANNELS = [f"{{channel}}_{{axis}}" for channel in ("acc", "gyr", "mag") for axis in "xyz"]

with open("windows.csv", newline="", encoding="utf-8") as file:
    windows = [row for row in csv.DictReader(file) if row["class"]]
recordings = {{name: readings(name) for name in dict.fromkeys(row["file"] for row in windows)}}
x = [recordings[row["file"]][:, int(row["start"]) : int(row["stop"])] for row in windows]
y = [row["class"] for row in windows]
actors = [row["actor"] for row in windows]  # leave one out to test on a person who was never seen
```

`x` has an array (sensors, samples, channels) for each window. `np.stack(x)` makes one array of all where each take has
the same limbs; takes of skeletons that lack a limb have fewer.
"""


def write_parquet(stem: Path, sampled: SampledPiece, rate_hz: float, field_ut: float) -> list[Path]:
    """Write a piece as one table for `read_recording`, with a row for each sample of each sensor."""
    tables = [_table(limb, sampled.times, read) for limb, read in sampled.readings.items()]
    path = stem.with_name(f"{stem.name}.parquet")
    pq.write_table(pa.concat_tables(tables), path, compression="zstd", store_schema=False)
    return [path]


def _table(limb: str, times: F64, read: Readings) -> pa.Table:
    columns: dict[str, pa.Array] = {
        "sensor": pa.array([limb]).take(pa.array(np.zeros(len(times), np.int32))),
        "time_s": pa.array(times),
    }
    for name, values, axes in (
        ("acc", read.acc, "xyz"), ("gyr", read.gyr, "xyz"), ("mag", read.mag, "xyz"), ("q", read.orientation, "wxyz"),
    ):  # fmt: skip
        lost = ~np.isfinite(values).all(axis=1)
        for i, axis in enumerate(axes):
            columns[f"{name}_{axis}"] = pa.array(values[:, i], mask=lost)
    columns["clipped"] = pa.array(read.clipped)
    return pa.table(columns)


def write_npz(stem: Path, sampled: SampledPiece, rate_hz: float, field_ut: float) -> list[Path]:
    """Write a piece as arrays: limbs (L,), time_s (N,), acc, gyr and mag (L, N, 3), orientation (L, N, 4), flags."""
    reads = list(sampled.readings.values())
    arrays = {
        "limbs": np.array(list(sampled.readings)),
        "time_s": sampled.times,
        "take_time_s": sampled.take_times,
        "rate_hz": np.array(rate_hz),
        "acc": np.stack([one.acc for one in reads]).astype(np.float32),
        "gyr": np.stack([one.gyr for one in reads]).astype(np.float32),
        "mag": np.stack([one.mag for one in reads]).astype(np.float32),
        "orientation": np.stack([one.orientation for one in reads]),
        "clipped": np.stack([one.clipped for one in reads]),
        "lost": np.stack([one.lost for one in reads]),
    }
    path = stem.with_name(f"{stem.name}.npz")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.asarray(array, order="C"), allow_pickle=False)
            # a fixed time for every entry, so that the same readings make the same bytes
            archive.writestr(zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0)), buffer.getvalue())
    return [path]


def write_xsens(stem: Path, sampled: SampledPiece, rate_hz: float, field_ut: float) -> list[Path]:
    """Write a piece as text files in the format of MT Manager, one for each sensor; lost samples have no row.

    The magnetic field is in units of the local field. These files have no clock but count samples.
    """
    names = [f"{channel}_{axis}" for channel in ("Acc", "Gyr", "Mag") for axis in "XYZ"]
    paths = []
    for limb, read in sampled.readings.items():
        head = [
            "// Written by kinedex: simulated sensors in the form of MT Manager",
            f"// DeviceId: {limb}",
            f"// Update Rate: {rate_hz!r}Hz",
            "// Coordinate system: NWU",
            "\t".join(["PacketCounter", *names, "Quat_q0", "Quat_q1", "Quat_q2", "Quat_q3"]),
        ]
        kept = np.flatnonzero(~read.lost)
        numbers = np.concatenate([read.acc, read.gyr, read.mag / field_ut, read.orientation], axis=1)[kept]
        rows = [
            "\t".join([str(int(count) % _COUNTER_WRAP), *(f"{value:.9g}" for value in row)])
            for count, row in zip(kept, numbers.tolist(), strict=True)
        ]
        path = stem.with_name(f"{stem.name}-{limb}.txt")
        path.write_bytes(("\n".join([*head, *rows]) + "\n").encode())
        paths.append(path)
    return paths


WRITERS: dict[str, Callable[[Path, SampledPiece, float, float], list[Path]]] = {
    "parquet": write_parquet,
    "npz": write_npz,
    "xsens-txt": write_xsens,
}
"""The writers by format; each writes a piece to files whose names begin with a stem, and returns their paths."""


def readme(form: str) -> str:
    """Return the README of a data set.

    Parameters
    ----------
    form : str
        The format: parquet, npz or xsens-txt.
    """
    mag = "units of the local field" if form == "xsens-txt" else "µT"
    return _TEXT.format(files=_FILES[form], mag=mag, reader=_READERS[form].rstrip("\n"))
