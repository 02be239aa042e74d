"""Files of inertial sensors for the fuzzer: small valid ones of every format, and what must hold of what is read."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from kinedex.catalog.sensorsets import FASTEST_HZ, SLOWEST_HZ, load_sensor_set
from kinedex.storage.formats.imu.recording import read_recording
from tests.fuzz.hdf5_worker import by_worker
from tests.imu_files import (
    csv_text,
    dot_text,
    mtmanager_text,
    mvnx_text,
    opal7_text,
    opal_text,
    turning,
    write_hdf5,
    write_opal4,
    write_parquet,
    write_xio,
)

KNOWN = turning(24)
XSENS_WORDS = (
    b"// Update Rate: 0Hz\n", b"// Update Rate: 1e9Hz\n", b"// Coordinate system: NED\n", b"// DeviceId: ../../x\n",
    b"Mat[1][1]", b"Quat_q0", b"Roll", b"PacketCounter", b"Counter", b"Mag_X\tMag_Y\tMag_Z", b"NaN\t", b"65535\t",
    b"SampleTimeFine", b"sep=;\n", b"DeviceTag:,=1+1\n", b"OutputRate:,1.2.3Hz\n",
)  # fmt: skip
COLUMN_WORDS = (
    b"sensor,", b"time_ms,", b"Timestamp (us),", b"acc_x,", b"gyr_x (deg/s),", b"mag_x [gauss],", b"q_w,",
    b"Format=7,1,,,a,",
    b"Sample Rate:,0,Hz\n", b"m/s^2,", b"uT,", b"/Acceleration/X,", b"Orientation,", b"W,X,Y,Z\n", b"sep=\t\n",
)  # fmt: skip


def mtmanager() -> dict[str, bytes]:
    """All orientations and separators."""
    forms = (("mat", "\t"), ("quat", ";"), ("euler", " "))
    return {
        rotations: mtmanager_text(KNOWN, rotations=rotations, separator=separator).encode()
        for rotations, separator in forms
    }


def dot() -> dict[str, bytes]:
    """An export of DOT."""
    return {"dot": dot_text(KNOWN).encode()}


def opal() -> dict[str, bytes]:
    """Both forms."""
    return {"names": opal_text(KNOWN).encode(), "seven": opal7_text(KNOWN).encode()}


def xio() -> dict[str, bytes]:
    """Readings of both devices, and quaternions alone."""
    with tempfile.TemporaryDirectory() as folder:
        write_xio(Path(folder), KNOWN)
        return {path.stem: path.read_bytes() for path in sorted(Path(folder).iterdir())}


def mvnx() -> dict[str, bytes]:
    """Two sensors."""
    return {"two": mvnx_text(KNOWN).encode()}


def tables() -> dict[str, bytes]:
    """Kinedex's own table, and one with two header rows."""
    two = "s,a,a,a\naxis,acc_x,acc_y,acc_z\n" + "\n".join(f"{i},{x},{y},{z}" for i, (x, y, z) in enumerate(KNOWN.acc))
    return {"own": csv_text(KNOWN).encode(), "two": two.encode(), "excel": csv_text(KNOWN).replace(",", ";").encode()}


def parquet() -> dict[str, bytes]:
    """Two sensors below each other."""
    with tempfile.TemporaryDirectory() as folder:
        return {"long": write_parquet(Path(folder) / "a.parquet", {"a": KNOWN, "b": KNOWN}).read_bytes()}


def hdf5() -> dict[str, bytes]:
    """Files of Opal in both layouts, and one of data sets by name."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.h5"
        found = {name: write_hdf5(path, KNOWN, opal=name == "opal").read_bytes() for name in ("opal", "names")}
        return found | {"opal4": write_opal4(path, KNOWN).read_bytes()}


def sensor_sets() -> dict[str, bytes]:
    """A file of sensors with everything in it."""
    text = (
        "sensors: {'00B421ED': lshank, '*_right.csv': rshank}\nunits: {acc: g, gyr: deg/s, mag: gauss, time: ms}\n"
        "frame: ENU\norientation: world_to_sensor\naxes: [-y, x, z]\nrate_hz: 100\nheader_rows: 2\n"
        "columns: {time: t, sensor: s, acc: [a, b, c], gyr: '{sensor}/gyr', orientation: [w, x, y, z]}\n"
    )
    return {"all": text.encode()}


def check_recording(path: Path) -> None:
    """Sensors have ascending times, readings that no sensor exceeds, and unit quaternions."""
    found = read_recording(path, rate_hz=100.0)
    for sensor in found.sensors:
        assert SLOWEST_HZ <= sensor.rate_hz <= FASTEST_HZ
        assert np.isfinite(sensor.times).all()
        assert (np.diff(sensor.times) > 0).all()
        assert sensor.channels
        for name in sensor.channels:
            part = getattr(sensor, name)
            assert part.shape == (len(sensor.times), 4 if name == "orientation" else 3)
            assert not np.isinf(part).any()
        if sensor.orientation is not None:
            lengths = np.linalg.norm(sensor.orientation, axis=1)
            assert (np.isnan(lengths) | (np.abs(lengths - 1) < 1e-6)).all()
        "\n".join([sensor.name, sensor.frame, *sensor.warnings]).encode()


def check_hdf5(path: Path) -> None:
    """An HDF5 file is as any other, and read by a process that serves many of them."""
    with by_worker():
        check_recording(path)


def check_sensor_set(path: Path) -> None:
    """A file of sensors has limbs and turns."""
    found = load_sensor_set(path)
    found.limb("a", "b/c.csv")
    matrix = found.matrix()
    assert matrix is None or abs(float(np.linalg.det(matrix)) - 1) < 1e-9
