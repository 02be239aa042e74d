"""Write the files of simulated sensors: Parquet, NPZ, or text in the format of MT Manager."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from kinedex.ops.inertial.noise import Readings
from kinedex.pipelines.simulation.imu_sensors import SampledPiece

F64 = npt.NDArray[np.float64]

_COUNTER_WRAP = 65_536


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
"""A dict from format to the function that writes a piece to files whose names begin with a stem, and returns their
paths.
"""

CLOCKLESS = ("xsens-txt",)
"""Formats in which times are counted from the first sample."""
