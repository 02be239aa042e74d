"""Write the README of a data set of simulated inertial sensors: files, units, and code that loads windows."""

from __future__ import annotations

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


def readme(form: str) -> str:
    """Return the README of a data set.

    Parameters
    ----------
    form : str
        The format: parquet, npz or xsens-txt.
    """
    mag = "units of the local field" if form == "xsens-txt" else "µT"
    return _TEXT.format(files=_FILES[form], mag=mag, reader=_READERS[form].rstrip("\n"))
