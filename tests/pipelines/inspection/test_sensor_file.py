"""`kinedex inspect` of sensor files: format, rates, units against gravity and orientations, rests and gaps."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from kinedex.commands.cli import app
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.imu.recording import read_recording
from tests.imu_files import csv_text, dot_text, mtmanager_text, mvnx_text, turning, write_hdf5, write_parquet


def inspected(*arguments: object) -> str:
    done = CliRunner().invoke(app, ["inspect", *map(str, arguments)], env={"COLUMNS": "200"})
    assert done.exit_code == 0, done.output
    return done.output


def test_a_sensor_file_is_recognised_and_described(tmp_path: Path) -> None:
    lines = mtmanager_text(turning(120)).splitlines(keepends=True)
    path = tmp_path / "MT_00B421ED.txt"
    path.write_text("".join(lines[:40] + lines[50:]))
    (tmp_path / "five.yaml").write_text("sensors: {'00B421ED': lshank}")
    shown = inspected(path, "--sensors", tmp_path / "five.yaml")
    for part in (
        "MT Manager TXT (Xsens), 1 sensor", "00B421ED, worn on lshank: acc, gyr, orientation",
        "50 Hz, 110 samples (10 more are lost), 2.38 s",
        "median 9.81: as gravity", "correlates at 1.00", "1.00 times as large", "sensor to north-west-up",
        "1, 0.22 s: 0.70 to 0.92 s", "none of a second or more",
    ):  # fmt: skip
        assert part in shown
    document = json.loads(inspected(path, "--json"))
    (sensor,) = document["sensors"]
    assert sensor["gyr_ratio"] == pytest.approx(1, abs=0.02)
    assert sensor["limb"] is None
    assert sensor["lost"] == 10
    assert sensor["gaps"] == [[pytest.approx(0.7), pytest.approx(0.92)]]


def test_rests_are_found_and_every_form_of_table_is_recognised(tmp_path: Path) -> None:
    known = turning(300)
    known.gyr[100:200], known.acc[100:200] = 0, [0, 0, 9.81]
    (tmp_path / "a.csv").write_text(csv_text(known).replace("q_", "other_"))
    (tmp_path / "b.csv").write_text(csv_text(turning()))
    for path in (tmp_path / "a.csv", tmp_path / "b.csv", write_parquet(tmp_path / "c.parquet", {"lhand": turning()}),
                 write_hdf5(tmp_path / "d.h5", turning())):  # fmt: skip
        assert "acc, gyr" in inspected(path)
    (sensor,) = json.loads(inspected(tmp_path / "a.csv", "--json"))["sensors"]
    ((start, stop),) = sensor["rests"]
    assert np.allclose([start, stop], [2.0, 4.0], atol=0.5)


def test_a_file_of_positions_stays_motion_and_a_wrong_sensor_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time,lwrist_x,lwrist_y,lwrist_z\n0,1,2,3\n0.1,1,2,3\n")
    done = CliRunner().invoke(app, ["inspect", str(tmp_path / "a.csv")])
    assert "positions" in done.output
    (tmp_path / "b.csv").write_text(csv_text(turning()).replace("time_s", "number"))
    done = CliRunner().invoke(app, ["inspect", str(tmp_path / "b.csv")])
    assert done.exit_code
    assert "--rate HZ" in str(done.output) + str(done.exception)
    assert "50 Hz" in inspected(tmp_path / "b.csv", "--rate", 50)


def test_a_world_that_nothing_shows_is_named_as_assumed(tmp_path: Path) -> None:
    lines = [line.split(",") for line in csv_text(turning()).splitlines()]
    kept = [k for k, name in enumerate(lines[0]) if not name.startswith("mag")]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(",".join(line[k] for k in kept) for line in lines) + "\n")
    shown = " ".join(inspected(path).split())
    assert "sensor to north-west-up, which is assumed" in shown
    assert "`frame: NWU`, `ENU` or `NED`" in shown
    assert json.loads(inspected(path, "--json"))["sensors"][0]["frame_assumed"]
    (tmp_path / "five.yaml").write_text("frame: NWU\n")
    assert "assumed" not in inspected(path, "--sensors", tmp_path / "five.yaml")
    (tmp_path / "b.csv").write_text(csv_text(turning()))
    assert "assumed" not in inspected(tmp_path / "b.csv"), "the field shows the world"


def test_the_world_of_a_format_that_no_real_file_has_shown_is_assumed(tmp_path: Path) -> None:
    without = re.sub(r"<sensorMagneticField>.*?</sensorMagneticField>", "", mvnx_text(turning()), flags=re.DOTALL)
    (tmp_path / "a.mvnx").write_text(without)
    assert all(one.frame_assumed for one in read_recording(tmp_path / "a.mvnx").sensors)
    (tmp_path / "a.csv").write_text(dot_text(turning()))
    assert "sensor to east-north-up, which is assumed" in " ".join(inspected(tmp_path / "a.csv").split())


def test_a_text_that_ends_within_a_line_is_warned_of(tmp_path: Path) -> None:
    text = csv_text(turning(60))
    (tmp_path / "a.csv").write_text(text[:-3])
    shown = " ".join(inspected(tmp_path / "a.csv").split())
    assert "ends without a line break: if it was cut off there, the last number of its last sample is not" in shown
    (tmp_path / "a.csv").write_text(text[: text.rindex(",")])
    with pytest.raises(SourceError, match="is the line cut off"):
        read_recording(tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("notes.txt", "Sensor 1 was on the left shank.\n", r"holds no readings of inertial sensors.*--sensors FILE"),
        ("garbage.h5", "no HDF5 file", r"holds no readings of inertial sensors.*Opal.*--sensors FILE"),
        ("empty.txt", "", "the file is empty"),
        ("own.csv", "a,b,c\n1,2,3\n1,2,3\n", r"joint.*if it holds readings of inertial sensors.*--sensors FILE"),
    ],
)
def test_a_file_without_known_readings_leads_to_the_file_of_sensors(
    tmp_path: Path, name: str, content: str, message: str
) -> None:
    (tmp_path / name).write_text(content)
    done = CliRunner().invoke(app, ["inspect", str(tmp_path / name)], env={"COLUMNS": "200"})
    assert done.exit_code
    assert re.search(message, " ".join(f"{done.output} {done.exception}".split()))
