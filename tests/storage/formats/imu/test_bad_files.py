"""Sensor files that contradict themselves or are damaged: an error with line and way out, or a warning."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.configs import parse_yaml
from kinedex.catalog.sensorsets import SensorSet, parse_sensor_set
from kinedex.ops.errors import ConfigError, KinedexError, SourceError
from kinedex.ops.inertial.rotations import conjugate, distance_deg, exp, multiply, rotate
from kinedex.storage.formats.imu import recording
from kinedex.storage.formats.imu.recording import ENU, NED, NWU, read_recording
from tests.imu_files import Samples, csv_text, dot_text, mtmanager_text, mvnx_text, opal_text, turning, write_hdf5

KNOWN = turning()


def of(content: str) -> SensorSet:
    return parse_sensor_set(parse_yaml(content, "five.yaml"))


def write(folder: Path, samples: Samples, name: str = "a.csv") -> Path:
    path = folder / name
    path.write_text(csv_text(samples))
    return path


def edited(folder: Path, line: int, old: str, new: str, samples: Samples = KNOWN) -> Path:
    """A table of kinedex with a text of a line, from 1, replaced by another."""
    lines = csv_text(samples).splitlines()
    lines[line - 1] = re.sub(old, new, lines[line - 1], count=1)
    path = folder / "a.csv"
    path.write_text("\n".join(lines))
    return path


TURNED = conjugate(KNOWN.orientation)
SCALED = {
    # what is written, the file of sensors, what the error says, the way out
    "acc in g, stated as m/s²": (
        {"acc": KNOWN.acc / 9.80665}, "units: {acc: m/s2}", "1 m/s2, and gravity is 9.81", "units: {acc: g}",
    ),
    "acc without gravity": ({"acc": KNOWN.acc / 5}, "{}", "are these accelerations without gravity", None),
    "gyr in degrees": ({"gyr": np.degrees(KNOWN.gyr)}, "{}", "its unit is taken as rad/s", "units: {gyr: deg/s}"),
    "gyr in radians, stated as degrees": (
        {}, "units: {gyr: deg/s}", "its unit is taken as deg/s", "units: {gyr: rad/s}",
    ),
    "quaternions of the other direction": (
        {"orientation": TURNED}, "{}", "turn from the world to the sensor", "orientation: world_to_sensor",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SCALED)
def test_a_unit_or_direction_that_is_contradicted_is_refused_and_the_way_out_works(name: str, tmp_path: Path) -> None:
    values, stated, message, way_out = SCALED[name]
    path = write(tmp_path, replace(KNOWN, **values))
    with pytest.raises(SourceError, match=re.escape(message)) as fault:
        read_recording(path, sensor_set=of(stated))
    assert str(path) in str(fault.value)
    if way_out is None:
        return
    assert way_out in str(fault.value)
    (sensor,) = read_recording(path, sensor_set=of(way_out)).sensors
    np.testing.assert_allclose(sensor.acc, KNOWN.acc, atol=1e-6)
    np.testing.assert_allclose(sensor.gyr, KNOWN.gyr, atol=1e-6)
    assert distance_deg(sensor.orientation, KNOWN.orientation).max() < 1e-4


def test_gyr_in_degrees_is_noticed_by_gravity_where_there_are_no_quaternions(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(csv_text(replace(KNOWN, gyr=10 * KNOWN.gyr)).replace("q_", "other_"))
    with pytest.raises(SourceError, match="10 times as fast as gravity"):
        read_recording(path)


def test_a_sensor_that_never_rests_is_read_with_a_warning_at_most(tmp_path: Path) -> None:
    """The mean in the world is gravity whatever the sensor does; without orientations the median can be anything."""
    shaken = KNOWN.acc + rotate(conjugate(KNOWN.orientation), 17 * np.sin(9 * KNOWN.times)[:, None] * [1, 0, 0])
    assert np.median(np.linalg.norm(shaken, axis=1)) > 1.3 * 9.81
    path = write(tmp_path, replace(KNOWN, acc=shaken))
    assert read_recording(path).sensors[0].warnings == ()
    path.write_text(csv_text(replace(KNOWN, acc=shaken)).replace("q_", "other_"))
    (sensor,) = read_recording(path).sensors
    assert "moves fast all the time" in sensor.warnings[0]
    np.testing.assert_allclose(sensor.acc, shaken, atol=1e-6)


def test_acc_in_g_that_nobody_states_is_recognised(tmp_path: Path) -> None:
    (sensor,) = read_recording(write(tmp_path, replace(KNOWN, acc=KNOWN.acc / 9.80665))).sensors
    np.testing.assert_allclose(sensor.acc, KNOWN.acc, atol=1e-6)


@pytest.mark.parametrize(
    ("line", "old", "new", "message"),
    [
        (1, "acc_x", "ax", "has 'acc_y', 'acc_z' and lacks acc x"),
        (1, "acc_x,acc_y", "acc_x,acc_x", "has two columns for acc x"),
        (4, r"^0\.04", "0.01", "a.csv:4: sensor 'a': time must ascend, got 0.01 s after 0.02 s"),
        (4, r"^0\.04", "", "a.csv:4: sensor 'a': has no time"),
        (5, r",[^,]*$", ",0.9", "a.csv:5: sensor 'a': a quaternion has the length"),
        (5, r",[^,]*$", ",abc", "a.csv:5: column 'q_z' must be a number, got 'abc'"),
        (5, r",[^,]*$", ",inf", "a.csv:5: column 'q_z' must be a number, got 'inf'"),
        (9, r",.*$", ",1,2", "a.csv:9: has 3 cells, and the header has 14; is the line cut off?"),
        (9, r"$", ",1", "a.csv:9: has 15 cells, and the header has 14"),
    ],
)
def test_a_table_that_is_wrong_is_refused_with_its_line(
    line: int, old: str, new: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(SourceError, match=re.escape(message)):
        read_recording(edited(tmp_path, line, old, new))


def test_a_file_without_rate_says_what_to_give(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(csv_text(KNOWN).replace("time_s", "number"))
    with pytest.raises(SourceError, match="states no rate and no times") as fault:
        read_recording(path)
    assert "--rate" in str(fault.value)
    assert read_recording(path, rate_hz=50).sensors[0].times[-1] == pytest.approx(59 / 50)
    path.write_text(csv_text(replace(KNOWN, times=1e6 * KNOWN.times)))
    with pytest.raises(SourceError, match="state the unit of times"):
        read_recording(path)
    assert read_recording(path, sensor_set=of("units: {time: us}")).sensors[0].rate_hz == pytest.approx(50)


def test_short_runs_of_missing_samples_are_interpolated_and_long_ones_are_gaps(tmp_path: Path) -> None:
    samples = turning(400, rate_hz=200.0)
    acc, q = samples.acc.copy(), samples.orientation.copy()
    for rows in (slice(50, 57), slice(100, 120)):
        acc[rows], q[rows] = np.nan, np.nan
    q[300:302] = 0
    (sensor,) = read_recording(write(tmp_path, replace(samples, acc=acc, orientation=q))).sensors
    assert np.isnan(sensor.acc[100:120]).all()
    assert np.isnan(sensor.acc).sum() == 60
    assert np.isnan(sensor.orientation).sum() == 80
    assert distance_deg(sensor.orientation[50:57], samples.orientation[50:57]).max() < 0.5
    assert distance_deg(sensor.orientation[300:302], samples.orientation[300:302]).max() < 0.5
    assert sensor.gaps == ((pytest.approx(99 / 200), pytest.approx(0.6)),)


def test_a_slow_sensor_has_no_gaps_between_its_samples(tmp_path: Path) -> None:
    assert read_recording(write(tmp_path, turning(30, rate_hz=10.0))).sensors[0].gaps == ()


def test_the_field_shows_the_world_and_a_header_that_says_otherwise_is_a_warning(tmp_path: Path) -> None:
    enu = replace(KNOWN, orientation=multiply(exp(np.array([0, 0, np.pi / 2])), KNOWN.orientation))
    ned = replace(KNOWN, orientation=multiply(exp(np.array([np.pi, 0, 0])), KNOWN.orientation))
    for samples, world in ((KNOWN, NWU), (enu, ENU), (ned, NED)):
        (sensor,) = read_recording(write(tmp_path, samples)).sensors
        assert sensor.frame == world
        assert distance_deg(sensor.orientation, KNOWN.orientation).max() < 1e-4
        assert sensor.warnings == ()
    (sensor,) = read_recording(write(tmp_path, enu), sensor_set=of("frame: NWU")).sensors
    assert "the file of sensors states orientations in north-west-up" in sensor.warnings[0]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.txt", mtmanager_text(KNOWN, head="// DeviceId: 1\n"), "states no rate"),
        ("a.txt", mtmanager_text(KNOWN).replace("Mat[2][3]", "Other"), "lacks Mat[2][3]"),
        ("a.txt", mtmanager_text(KNOWN).replace("00020\t", "00019\t"), "a.txt:15: PacketCounter must ascend, got 19"),
        ("a.txt", "// only\n// comments, and a\nPacketCounter\n1\n", "no columns of a sensor"),
        ("a.csv", dot_text(KNOWN).replace("Quat_W", "Quat_Q"), "lacks Quat_W"),
        ("a.csv", opal_text(KNOWN).replace("Foot/Acceleration/Z", "Foot/Other/Z"), "sensor 'Foot' lacks acc Z"),
        ("a.csv", opal_text(KNOWN).replace("rad/s", "furlongs"), "has the unit 'furlongs', unknown"),
        ("a.csv", "Timestamp (us),W Element,X Element,Y Element,Z Element\n1,2\n", "a.csv:2: has 2 cells"),
        ("a.mvnx", mvnx_text(KNOWN)[:-60], "is no XML"),
        ("a.mvnx", mvnx_text(KNOWN).replace("sensorOrientation", "orientation"), "has no <sensorOrientation>"),
        ("a.csv", "one,two\n1,2\n", "has no columns of a sensor"),
        ("a.csv", "1,2\n1,2\n", "a.csv:1: has no header"),
        ("a.csv", "", "the file is empty"),
        ("a.parquet", "PAR1 and no more", "cannot be read as Parquet"),
        ("a.bin", "what is this", "is no file of inertial sensors"),
    ],
)
def test_a_damaged_file_of_any_format_is_refused(name: str, content: str, message: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(SourceError, match=re.escape(message)):
        read_recording(tmp_path / name)


def test_hdf5_files_that_are_damaged_are_refused_before_and_by_the_library(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path / "a.h5", KNOWN)
    whole = path.read_bytes()
    for data, message in (
        (whole[:-100], "is cut off"),
        (whole[:8] + b"\x09" + whole[9:], "has a damaged header, with the version 9"),
        (whole[:200] + b"\xff" * 600 + whole[800:], "is damaged"),
    ):
        path.write_bytes(data)
        with pytest.raises(SourceError, match=message):
            read_recording(path)


def test_without_the_package_an_hdf5_file_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_hdf5(tmp_path / "a.h5", KNOWN)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(KinedexError, match=r"pip install 'kinedex\[imu\]'"):
        read_recording(path)


def test_a_row_of_no_sensor_is_refused(tmp_path: Path) -> None:
    lines = csv_text(KNOWN).splitlines()
    rows = ["sensor," + lines[0], *("lhand," + line for line in lines[1:5]), "," + lines[5]]
    (tmp_path / "a.csv").write_text("\n".join(rows))
    with pytest.raises(SourceError, match=r"a.csv:6: row 4 \(from 0\) has no name"):
        read_recording(tmp_path / "a.csv")


def test_hdf5_does_not_read_other_files(tmp_path: Path) -> None:
    import h5py

    (tmp_path / "secret.bin").write_bytes(b"\0" * 1440)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        outside = [(str(tmp_path / "secret.bin"), 0, 1440)]
        file.create_dataset("imu_acc", (60, 3), "f8", external=outside)
        file["imu_gyr"] = h5py.ExternalLink(str(tmp_path / "b.h5"), "x")
    with pytest.raises(SourceError, match="has no columns of a sensor"):
        read_recording(tmp_path / "a.h5")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("sensors: {a: lshnk}", "no limb is called 'lshnk'; did you mean 'lshank'?"),
        ("sensors: {00571: lshank}", "put the number of a sensor in quotes"),
        ("axes: [x, y, -z]", "must be a turn"),
        ("units: {acc: ft}", "units.acc"),
        ("colums: {}", "did you mean 'columns'?"),
        ("columns: {acc: [a, b]}", "columns.acc"),
    ],
)
def test_a_file_of_sensors_that_is_wrong_is_refused_with_its_line(content: str, message: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(message)) as fault:
        of(content)
    assert "five.yaml:1" in str(fault.value)


def test_every_format_has_a_title() -> None:
    assert all(form.title for form in recording.FORMATS.values())


def test_a_rate_that_the_quaternions_contradict_is_warned_of(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text(mtmanager_text(turning(300)).replace("Update Rate: 50.0Hz", "Update Rate: 30.0Hz"))
    (sensor,) = read_recording(path).sensors
    assert any("gyr turns 1.67 times as fast" in one and "30 Hz right?" in one for one in sensor.warnings)


def test_times_that_jitter_make_the_mean_rate(tmp_path: Path) -> None:
    jittered = np.cumsum([0.0, *np.tile([0.018, 0.006, 0.006, 0.018, 0.002], 11), *[0.01] * 4])
    (sensor,) = read_recording(write(tmp_path, replace(KNOWN, times=jittered))).sensors
    assert sensor.rate_hz == pytest.approx(100.0, rel=0.02)
    gaps = np.arange(60) / 50 + np.repeat([0, 0.1, 0.2], 20)
    (sensor,) = read_recording(write(tmp_path, replace(KNOWN, times=gaps))).sensors
    assert sensor.rate_hz == pytest.approx(50.0)


def test_a_file_that_is_no_hdf5_is_named_so(tmp_path: Path) -> None:
    (tmp_path / "a.h5").write_bytes(np.random.default_rng(1).bytes(500))
    with pytest.raises(SourceError, match=r"is no HDF5 file, although its ending is \.h5"):
        read_recording(tmp_path / "a.h5")
