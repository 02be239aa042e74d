"""Every format of sensor files: one motion, written in all of them, is read as the same readings and orientations."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from kinedex.catalog.configs import parse_yaml
from kinedex.catalog.sensorsets import SensorSet, load_sensor_set, parse_sensor_set
from kinedex.ops.inertial.orientation_filter import estimate
from kinedex.ops.inertial.rotations import distance_deg, rotate
from kinedex.storage.formats.imu.number_rows import _Table
from kinedex.storage.formats.imu.recording import ENU, NWU, ImuSensor, read_recording, read_together
from kinedex.storage.formats.imu.xsens_columns import PACKETS
from tests.imu_files import (
    Samples,
    columns,
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

KNOWN = turning()


def text(written: str, name: str = "a.txt") -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        path = folder / name
        path.write_text(written)
        return path

    return write


def of(content: str) -> SensorSet:
    return parse_sensor_set(parse_yaml(content, "five.yaml"))


def spoken(table: str) -> str:
    """Return a table whose names have blanks and units, as those of phones have."""
    words = {"acc": "Acceleration", "gyr": "Gyroscope", "mag": "Magnetic field", "q": "Orientation"}
    units = {"acc": " (m/s^2)", "gyr": " (rad/s)", "mag": " (µT)", "q": ""}
    header, _, rows = table.partition("\n")
    names = [name.split("_") for name in header.split(",")]
    given = ['"Time (s)"' if one[0] == "time" else f'"{words[one[0]]} {one[1]}{units[one[0]]}"' for one in names]
    return ",".join(given) + "\n" + rows


FILES: dict[str, tuple[Callable[[Path], Path], str, list[str], str]] = {
    "mtmanager, matrices": (text(mtmanager_text(KNOWN), "MT_01_00B421ED.txt"), "mtmanager", ["00B421ED"], "agq"),
    "mtmanager, quaternions": (text(mtmanager_text(KNOWN, separator=" ", rotations="quat")), "mtmanager", ["a"], "agq"),
    "mtmanager, Euler angles": (text(mtmanager_text(KNOWN, separator=";", rotations="euler")), "mtmanager", ["a"],
    "agq"),
    "dot": (text(dot_text(KNOWN), "a.csv"), "dot", ["left"], "gq"),
    "opal": (text(opal_text(KNOWN), "a.csv"), "opal", ["Lumbar", "Foot"], "agmq"),
    "opal, format 7": (text(opal7_text(KNOWN), "a.csv"), "opal", ["Lumbar", "Foot"], "agmq"),
    "opal, HDF5, version 4": (
        lambda folder: write_opal4(folder / "a.h5", KNOWN), "hdf5", ["Lumbar", "Left Foot"], "agmq",
    ),
    "opal, HDF5": (lambda folder: write_hdf5(folder / "a.h5", KNOWN, opal=True), "hdf5", ["Lumbar"], "agmq"),
    "x-IMU3": (lambda folder: write_xio(folder, KNOWN)[0], "xio", ["a"], "agq"),
    "NGIMU": (lambda folder: write_xio(folder, KNOWN)[1], "xio", ["a"], "agmq"),
    "mvnx": (text(mvnx_text(KNOWN), "a.mvnx"), "mvnx", ["Pelvis", "LeftLowerLeg"], "q"),
    "table, CSV": (text(csv_text(KNOWN), "a.csv"), "table", ["a"], "agmq"),
    "table, CSV of a phone": (text(spoken(csv_text(KNOWN)), "a.csv"), "table", ["a"], "agmq"),
    "table, CSV of Excel": (text(csv_text(KNOWN).replace(",", ";").replace(".", ",")), "table", ["a"], "agmq"),
    "table, Parquet": (
        lambda folder: write_parquet(folder / "a.parquet", {"lhand": KNOWN, "rhand": KNOWN}),
        "table", ["lhand", "rhand"], "agmq",
    ),
}  # fmt: skip


def same(sensor: ImuSensor, known: Samples, channels: str) -> None:
    """Compare the readings of a sensor with what was written."""
    assert "".join("q" if name == "orientation" else name[0] for name in sensor.channels) == channels
    np.testing.assert_allclose(sensor.times, known.times, atol=1e-6)
    assert sensor.rate_hz == pytest.approx(50.0, rel=1e-5)
    assert sensor.gaps == ()
    assert sensor.warnings == ()
    for name in ("acc", "gyr", "mag"):
        if name[0] in channels:
            np.testing.assert_allclose(getattr(sensor, name), getattr(known, name), atol=2e-5)
    if sensor.orientation is not None:
        assert distance_deg(sensor.orientation, known.orientation).max() < 1e-3


@pytest.mark.parametrize("name", FILES)
def test_a_format_is_read_as_what_was_measured(name: str, tmp_path: Path) -> None:
    write, form, sensors, channels = FILES[name]
    found = read_recording(write(tmp_path))
    assert found.format == form
    assert [sensor.name for sensor in found.sensors] == sensors
    for sensor in found.sensors:
        same(sensor, KNOWN, channels)


def test_a_table_with_two_header_rows_is_read_by_sensor(tmp_path: Path) -> None:
    rows = np.column_stack([np.arange(60), KNOWN.acc, np.degrees(KNOWN.gyr), KNOWN.acc])
    body = "\n".join(",".join(f"{cell:.7f}" for cell in row) for row in rows)
    head = "sensor," + "left," * 6 + "right,right,right\naxis,acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z,acc_x,acc_y,acc_z\n"
    path = text(head + body + "\n", "a.csv")(tmp_path)
    found = read_recording(path, sensor_set=of("{units: {gyr: deg/s}, rate_hz: 50}"))
    assert [(one.name, one.channels) for one in found.sensors] == [("left", ("acc", "gyr")), ("right", ("acc",))]
    same(found.sensors[0], KNOWN, "ag")


def test_hdf5_is_read_by_the_names_of_data_sets(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path / "trial.h5", KNOWN)
    (known,) = read_recording(path).sensors
    assert known.name == "imu"
    (named,) = read_recording(path, sensor_set=load_sensor_set("broad")).sensors
    assert named.name == "trial"
    for sensor in (known, named):
        same(sensor, KNOWN, "agm")


def test_columns_of_other_names_are_read_by_a_file_of_sensors(tmp_path: Path) -> None:
    table = pa.table({f"s1 {name}": values for name, values in columns(KNOWN).items()})
    pq.write_table(table.append_column("t", pa.array(1000 * KNOWN.times)), tmp_path / "a.parquet")
    chosen = of(
        "{units: {time: ms}, columns: {time: t, acc: ['{sensor} acc_x', '{sensor} acc_y', '{sensor} acc_z'],"
        " gyr: ['{sensor} gyr_x', '{sensor} gyr_y', '{sensor} gyr_z']}}"
    )
    (sensor,) = read_recording(tmp_path / "a.parquet", sensor_set=chosen).sensors
    assert sensor.name == "s1"
    same(sensor, KNOWN, "ag")


def test_structures_as_the_store_has_them_are_read(tmp_path: Path) -> None:
    parts = {"acc": KNOWN.acc, "gyr": KNOWN.gyr}
    table = {key: [dict(zip("xyz", row, strict=True)) for row in part.tolist()] for key, part in parts.items()}
    table["orientation"] = [dict(zip("wxyz", row, strict=True)) for row in KNOWN.orientation.tolist()]
    pq.write_table(pa.table({"t": KNOWN.times, **table}), tmp_path / "a.parquet")
    same(read_recording(tmp_path / "a.parquet").sensors[0], KNOWN, "agq")


def test_a_counter_wraps_and_tells_gaps_and_files_of_a_session_share_it(tmp_path: Path) -> None:
    lines = mtmanager_text(KNOWN, first=PACKETS - 5).splitlines(keepends=True)
    late = text(mtmanager_text(KNOWN, first=2), "MT_00000002.txt")(tmp_path)
    lacking = text("".join(lines[:24] + lines[28:]), "MT_00000001.txt")(tmp_path)
    first, second = read_together([lacking, late], "MT").sensors
    assert len(first.times) == 56
    assert first.times[0] == 0
    assert first.times[-1] == pytest.approx(59 / 50)
    assert first.gaps == ((pytest.approx(19 / 50), pytest.approx(24 / 50)),)
    assert second.times[0] == pytest.approx(7 / 50)


def test_axes_turn_readings_and_orientations_alike(tmp_path: Path) -> None:
    path = write_parquet(tmp_path / "a.parquet", {"lhand": KNOWN})
    (sensor,) = read_recording(path, sensor_set=of("axes: [-y, x, z]")).sensors
    np.testing.assert_allclose(sensor.acc[:, 0], -KNOWN.acc[:, 1])
    world = rotate(sensor.orientation, sensor.acc)
    np.testing.assert_allclose(world, np.tile([0, 0, 9.81], (60, 1)), atol=1e-9)


@pytest.mark.shared
def test_all_real_files_are_read(shared: Path) -> None:
    folder = shared / "data" / "imu"
    files = [*folder.glob("xsens/**/*.txt"), *folder.glob("apdm/*.csv"), *folder.glob("xio/*.csv")]
    assert len(files) == 27
    sensors = {}
    for path in files:
        found = read_recording(path, rate_hz=100.0)
        sensors[path.name] = found.sensors
        for sensor in found.sensors:
            if sensor.acc is not None and sensor.orientation is not None:
                # gravity is the median of what anybody does, and points upwards; one file is of a foot in the air
                mean = np.nanmedian(rotate(sensor.orientation, sensor.acc), axis=0)
                assert mean[2] > 0.88 * np.linalg.norm(mean)
    (warned,) = sensors["MT_01200454_000-000_00B40DE4.txt"]
    assert warned.frame == NWU
    assert "states orientations in east-north-up" in warned.warnings[0]
    (gaps,) = sensors["MT_012005D6-000_sit_to_stand-000_00B421ED.txt"]
    assert (len(gaps.times), len(gaps.gaps), gaps.rate_hz) == (1459, 3, 40.0)
    (incomplete,) = sensors["MT2022_ACC_GYRO_ROT_ALL_TAB_NAN_00B42D4B.txt"]
    assert incomplete.frame == ENU
    assert np.isnan(incomplete.acc[0]).all()
    assert np.isfinite(incomplete.acc[1:]).all()
    walking = read_together(sorted(folder.glob("xsens/walking/*.txt"))).sensors
    assert [sensor.times[0] for sensor in walking] == [0.0] * 8


@pytest.mark.shared
def test_real_orientations_are_those_of_the_filter(shared: Path) -> None:
    folder = shared / "data" / "imu"
    for name in ("xsens/counter_50hz_with_quaternion.txt", "apdm/imuData01.csv", "xio/data_ngimu_sensors.csv"):
        for sensor in read_recording(folder / name).sensors:
            found = estimate(sensor.rate_hz, sensor.acc, sensor.gyr, sensor.mag)
            middle = slice(len(found) // 4, -len(found) // 4)
            error = distance_deg(found[middle], sensor.orientation[middle])
            assert np.median(error) < 20, (name, sensor.name)


@pytest.mark.shared
def test_real_tables_are_read_by_the_shipped_files_of_sensors(shared: Path) -> None:
    folder = shared / "data" / "imu"
    feet = read_recording(folder / "feet" / "imu.csv", sensor_set=load_sensor_set("gaitmap"))
    assert [(one.name, len(one.times), one.rate_hz) for one in feet.sensors] == [
        ("left_sensor", 7928, 204.8), ("right_sensor", 7928, 204.8),
    ]  # fmt: skip
    assert 5 < np.linalg.norm(feet.sensors[0].gyr, axis=1).max() < 35
    trial = next(folder.glob("broad/07*.hdf5"))
    (sensor,) = read_recording(trial, sensor_set=load_sensor_set("broad")).sensors
    assert (len(sensor.times), round(sensor.rate_hz, 3), sensor.channels) == (52518, 285.714, ("acc", "gyr", "mag"))


def test_plain_rows_are_the_same_numbers_as_cell_by_cell(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    rows = [[repr(float(cell)) for cell in rng.normal(0, 10.0**k, 4)] for k in range(-8, 9)]
    rows[3][0], rows[4][1] = " +1.5e-3 ", "-0"
    lines = ["a,b,c,d", *(",".join(row) for row in rows)]
    table = _Table(tmp_path, ",", lines[0].split(","), [3, 0, 1], [])
    plain = table.plain_numbers(lines[1:])
    assert plain is not None
    slow = table.numbers([line.split(",") for line in lines[1:]], list(range(2, len(lines) + 1)))
    assert plain.tobytes() == slow.tobytes()
    for odd in ("1,2,3", "1,2,3,4,5", ",2,3,4", "x,2,3,4", '"1",2,3,4', "1e300,2,3,4"):
        assert table.plain_numbers([*lines[1:], odd]) is None
