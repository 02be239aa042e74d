"""Files of inertial sensors for tests: a sensor that turns smoothly, written in every format."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from kinedex.ops.inertial.rotations import conjugate, exp, log, matrix, multiply, rotate

F64 = np.ndarray

FIELD = np.array([20.0, 0.0, -43.0])
"""The magnetic field in µT: north is X."""


@dataclass(frozen=True, eq=False)
class Samples:
    """The readings of a sensor: seconds, m/s², rad/s, µT, sensor → F_GI."""

    times: F64
    acc: F64
    gyr: F64
    mag: F64
    orientation: F64

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return 1.0 / float(self.times[1] - self.times[0])


def turning(count: int = 60, rate_hz: float = 50.0, seed: int = 0) -> Samples:
    """A sensor that turns about all axes, at some radians a second, at one place."""
    phase = np.random.default_rng(seed).uniform(0, 6, 3)
    times = np.arange(count) / rate_hz
    q = exp(
        np.stack([0.9 * np.sin(2 * times + phase[0]), 0.8 * np.sin(3 * times + phase[1]), times + phase[2]], axis=1)
    )
    steps = log(multiply(conjugate(q[:-1]), q[1:])) * rate_hz
    gyr = np.vstack([steps[:1], 0.5 * (steps[:-1] + steps[1:]), steps[-1:]])
    still = np.array([0.0, 0.0, 9.81])
    return Samples(times, rotate(conjugate(q), still), gyr, rotate(conjugate(q), FIELD), q)


def columns(samples: Samples) -> dict[str, F64]:
    """The columns of kinedex's own tables."""
    found = {"time_s": samples.times}
    for name, values, axes in (
        ("acc", samples.acc, "xyz"), ("gyr", samples.gyr, "xyz"), ("mag", samples.mag, "xyz"),
        ("q", samples.orientation, "wxyz"),
    ):  # fmt: skip
        found |= {f"{name}_{axis}": values[:, i] for i, axis in enumerate(axes)}
    return found


def table_text(header: list[str], rows: F64, separator: str = ",") -> str:
    """A header and rows of numbers."""
    lines = [separator.join(header), *(separator.join(f"{cell:.9g}" for cell in row) for row in rows)]
    return "\n".join(lines) + "\n"


def csv_text(samples: Samples) -> str:
    """Kinedex's own table as CSV."""
    found = columns(samples)
    return table_text(list(found), np.stack(list(found.values()), axis=1))


def write_parquet(path: Path, sensors: dict[str, Samples]) -> Path:
    """Kinedex's own table of several sensors, below each other."""
    tables = [pa.table({"sensor": [name] * len(one.times), **columns(one)}) for name, one in sensors.items()]
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.concat_tables(tables), path)
    return path


def mtmanager_text(
    samples: Samples, *, first: int = 10, separator: str = "\t", rotations: str = "mat", head: str = ""
) -> str:
    """An export of MT Manager, with matrices, quaternions or Euler angles."""
    head = head or f"// Start Time: Unknown\n// Update Rate: {samples.rate_hz:.1f}Hz\n// Firmware Version: 4.0.2\n"
    header = ["PacketCounter", "SampleTimeFine", *(f"{name}_{axis}" for name in ("Acc", "Gyr") for axis in "XYZ")]
    parts = [samples.acc, samples.gyr]
    if rotations == "mat":
        header += [f"Mat[{row}][{column}]" for column in (1, 2, 3) for row in (1, 2, 3)]
        parts.append(matrix(samples.orientation).transpose(0, 2, 1).reshape(-1, 9))
    elif rotations == "quat":
        header += ["Quat_q0", "Quat_q1", "Quat_q2", "Quat_q3"]
        parts.append(samples.orientation)
    else:
        r = matrix(samples.orientation)
        header += ["Roll", "Pitch", "Yaw"]
        yaw, pitch = np.arctan2(r[:, 1, 0], r[:, 0, 0]), -np.arcsin(r[:, 2, 0])
        parts.append(np.degrees(np.stack([np.arctan2(r[:, 2, 1], r[:, 2, 2]), pitch, yaw], axis=1)))
    rows = np.concatenate(parts, axis=1)
    lines = [separator.join(header)]
    for i, row in enumerate(rows):
        lines.append(separator.join([f"{(first + i) % 65536:05d}", "", *(f"{cell:.6f}" for cell in row)]))
    return head + "\n".join(lines) + "\n"


def dot_text(samples: Samples) -> str:
    """An export of DOT, as its manual describes it."""
    head = ["sep=,", "DeviceTag:,left", "FirmwareVersion:,2.0.0", f"OutputRate:,{samples.rate_hz:.0f}Hz", ""]
    header = ["PacketCounter", "SampleTimeFine", "Quat_W", "Quat_X", "Quat_Y", "Quat_Z", "FreeAcc_X", "FreeAcc_Y",
              "FreeAcc_Z", "Gyr_X", "Gyr_Y", "Gyr_Z"]  # fmt: skip
    # the clock wraps in the middle; the world is east-north-up
    clock = ((1 << 32) - 500_000 + np.rint(samples.times * 1e6).astype(np.int64)) % (1 << 32)
    enu = multiply(exp(np.array([0.0, 0.0, np.pi / 2])), samples.orientation)
    rows = np.column_stack([enu, 0 * samples.acc, np.degrees(samples.gyr)])
    lines = [f"{i},{clock[i]}," + ",".join(f"{cell:.7f}" for cell in row) for i, row in enumerate(rows)]
    return "\n".join([*head, ",".join(header), *lines]) + "\n"


def opal_text(samples: Samples, labels: tuple[str, ...] = ("Lumbar", "Foot")) -> str:
    """An export of Opal with names and units."""
    quantities = (("Acceleration", "m/s^2"), ("Angular Velocity", "rad/s"), ("Magnetic Field", "uT"))
    header = ["Time"] + [
        name
        for label in labels
        for name in (
            *(f"{label}/{quantity}/{axis}" for quantity, _ in quantities for axis in "XYZ"),
            *(f"{label}/Orientation/{axis}" for axis in ("Scalar", "X", "Y", "Z")),
        )
    ]
    units = ["s"] + [unit for _ in labels for unit in (*(unit for _, unit in quantities for _ in range(3)), *[""] * 4)]
    own = [samples.acc, samples.gyr, samples.mag, samples.orientation]
    rows = np.column_stack([samples.times, *[part for _ in labels for part in own]])
    body = table_text(header, rows).splitlines()
    above = [f"Test Name:,Trial{',' * len(header)}", f"Sample Rate:,{samples.rate_hz:.0f},Hz{',' * len(header)}"]
    return "\n".join([*above, body[0], ",".join(units), *body[1:]]) + "\n"


def opal7_text(samples: Samples) -> str:
    """An export of Opal of the format 7, of two sensors."""
    above = "Format=7," + ",".join(f"{number},,,{name},,,,,,,,," for number, name in ((5718, "Lumbar"), (5778, "Foot")))
    quantities = "Time," + ",".join(["Accelerometer,,,Gyroscope,,,Magnetometer,,,Barometer,Orientation,,,"] * 2)
    axes = "," + ",".join(["X,Y,Z,X,Y,Z,X,Y,Z,,S,X,Y,Z"] * 2)
    own = [samples.acc, samples.gyr, samples.mag, 0 * samples.times[:, None], samples.orientation]
    rows = np.column_stack([part for _ in range(2) for part in own])
    start = 1_550_879_504_438_281
    clock = [start + round(1e6 * time) for time in samples.times]
    lines = [f"{clock[i]}," + ",".join(f"{cell:.6f}" for cell in row) for i, row in enumerate(rows)]
    return "\n".join([above, quantities, axes, *lines]) + "\n"


def write_xio(folder: Path, samples: Samples, name: str = "a") -> tuple[Path, Path]:
    """Files of an x-IMU3 and of an NGIMU, whose quaternions are conjugates; the paths of their readings."""
    folder.mkdir(parents=True, exist_ok=True)
    gyr, acc = (
        [f"{word} {axis} ({unit})" for axis in "XYZ"] for word, unit in (("Gyroscope", "deg/s"), ("Accelerometer", "g"))
    )
    readings = np.column_stack([np.degrees(samples.gyr), samples.acc / 9.80665])
    clock = np.rint(392e6 + 1e6 * samples.times)
    new, old = folder / f"{name}_Inertial.csv", folder / f"{name}_sensors.csv"
    q = samples.orientation
    new.write_text(table_text(["Timestamp (us)", *gyr, *acc], np.column_stack([clock, readings])))
    header = ["Timestamp (us)", "W Element", "X Element", "Y Element", "Z Element"]
    (folder / f"{name}_Quaternion.csv").write_text(table_text(header, np.column_stack([clock, q])))
    mag = [f"Magnetometer {axis} (uT)" for axis in "XYZ"]
    old.write_text(table_text(["Time (s)", *gyr, *acc, *mag], np.column_stack([samples.times, readings, samples.mag])))
    rows = np.column_stack([samples.times, conjugate(q)])
    (folder / f"{name}_quaternion.csv").write_text(table_text(["Time (s)", "W", "X", "Y", "Z"], rows))
    return new, old


def write_hdf5(path: Path, samples: Samples, *, opal: bool = False) -> Path:
    """An HDF5 file: of Opal, as its manual describes it, or with data sets by name and a rate."""
    import h5py

    path.parent.mkdir(parents=True, exist_ok=True)
    with h5py.File(path, "w") as file:
        if opal:
            group = file.create_group("Sensors/5718")
            group.create_group("Configuration").attrs["Label 0"] = np.bytes_("Lumbar")
            group["Accelerometer"], group["Gyroscope"], group["Magnetometer"] = samples.acc, samples.gyr, samples.mag
            group["Time"] = 1_550_879_504_438_281 + np.rint(samples.times * 1e6).astype(np.uint64)
            file["Processed/5718/Orientation"] = samples.orientation
        else:
            file["imu_acc"], file["imu_gyr"], file["imu_mag"] = samples.acc, samples.gyr, samples.mag
            file.attrs["sampling_rate"] = samples.rate_hz
    return path


def write_opal4(path: Path, samples: Samples) -> Path:
    """An HDF5 file of Opal in its fourth version, as others read it."""
    import h5py

    with h5py.File(path, "w") as file:
        file.attrs["FileFormatVersion"] = 4
        file.attrs["CaseIdList"] = np.array([b"SI-000738", b"SI-000739"])
        file.attrs["MonitorLabelList"] = np.array([b"Lumbar\0\0", b"Left Foot"])
        for number in ("SI-000738", "SI-000739"):
            group = file.create_group(number)
            group.attrs["SampleRate"] = np.int32(samples.rate_hz)
            group["Time"] = 1_350_879_504_438_281 + np.rint(samples.times * 1e6).astype(np.uint64)
            for name, values in (("Accelerometers", samples.acc), ("Gyroscopes", samples.gyr),
                                 ("Magnetometers", samples.mag), ("Orientation", samples.orientation)):  # fmt: skip
                group[f"Calibrated/{name}"], group[f"Raw/{name}"] = values, values * 1000
    return path


def mvnx_text(samples: Samples) -> str:
    """An MVNX file with the orientations of two sensors."""
    frames = [
        f'<frame time="{20 * i}" index="{i}" type="normal"><sensorOrientation>'
        + " ".join(f"{cell:.7f}" for cell in np.tile(q, 2))
        + "</sensorOrientation></frame>"
        for i, q in enumerate(samples.orientation)
    ]
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<mvnx version="4">'
        f'<subject label="Ann" frameRate="{samples.rate_hz:.0f}" segmentCount="0"><segments></segments>'
        '<sensors><sensor label="Pelvis"/><sensor label="LeftLowerLeg"/></sensors>\n<frames>\n'
        + "\n".join(frames)
        + "\n</frames></subject></mvnx>\n"
    )
