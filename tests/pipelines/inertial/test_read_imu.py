"""The stage read_imu: recordings tied to takes and limbs; what is wrong with one does not stop the others."""

from __future__ import annotations

import io
import os
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import yaml
from rich.console import Console

from kinedex.catalog.sensorsets import SensorSet
from kinedex.console.terminal import Terminal
from kinedex.ops.errors import KinedexError
from kinedex.ops.inertial.rotations import distance_deg
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.inertial.parameters import ReadImuParameters
from kinedex.pipelines.inertial.sensor_recordings import find_recordings
from kinedex.storage.store.limb_checks import imu_problems
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import verify
from tests.imu_files import mtmanager_text, turning, write_hdf5, write_parquet, write_xio
from tests.pipelines.archives import write_archive

SET = {"sensors": {"00B421ED": "lshank", "00B421EE": "rshank", "lhand": "lhand", "*/a_*.csv": "torso"}}


class Line:
    """An archive of two takes, a folder of recordings, and a pipeline over both."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.imu = folder, folder / "imu"
        self.source = write_archive(folder / "source", {"x_kick.amc": 60, "x_walk.amc": 60})
        self.sensors = folder / "five.yaml"
        self.sensors.write_text(yaml.safe_dump(SET))
        self.params: dict[str, object] = {"sensors": str(self.sensors)}

    def run(self) -> tuple[Store, str]:
        """Run the pipeline; the store, and what was printed."""
        file, message = self.folder / "line.yaml", io.StringIO()
        stages = {"ingest": {"source": str(self.source)}, "read_imu": {"source": str(self.imu), **self.params}}
        content = {"name": "line", "stages": {name: {"params": params} for name, params in stages.items()}}
        file.write_text(yaml.safe_dump(content, sort_keys=False))
        terminal = Terminal(Console(file=message, width=400))
        run_pipeline(file, self.folder / "store", terminal=terminal, executor="serial")
        return open_store(self.folder / "store"), message.getvalue()


def recordings(store: Store) -> dict[tuple[str, str], dict[str, object]]:
    return {(row["recording"], row["sensor"]): row for row in store.result("imu_recordings").to_pylist()}


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Line:
    """The recordings of two takes: two sensors of MT Manager that begin apart, an x-IMU3, and a table."""
    line = Line(tmp_path_factory.mktemp("line"))
    (line.imu / "x_kick").mkdir(parents=True)
    (line.imu / "x_kick" / "MT_01_00B421ED.txt").write_text(mtmanager_text(turning(), first=65530))
    (line.imu / "x_kick" / "MT_01_00B421EE.txt").write_text(mtmanager_text(turning(seed=1), first=4))
    write_xio(line.imu / "x_kick", turning())
    for left in ("a_sensors.csv", "a_quaternion.csv"):
        (line.imu / "x_kick" / left).unlink()
    write_parquet(line.imu / "x_walk" / "sim.parquet", {"lhand": turning(), "other": turning()})
    line.run()
    return line


def test_a_recording_is_tied_to_its_take_and_its_limbs(line: Line) -> None:
    store = open_store(line.folder / "store")
    rows = recordings(store)
    found = {key: (row["take"], row["limb"], row["format"], row["orientation"]) for key, row in rows.items()}
    assert found == {
        ("x_kick/MT_01", "00B421ED"): ("x_kick", "lshank", "mtmanager", "file"),
        ("x_kick/MT_01", "00B421EE"): ("x_kick", "rshank", "mtmanager", "file"),
        ("x_kick/a_Inertial.csv", "a"): ("x_kick", "torso", "xio", "file"),
        ("x_walk/sim.parquet", "lhand"): ("x_walk", "lhand", "table", "file"),
        ("x_walk/sim.parquet", "other"): ("x_walk", None, "table", None),
    }
    samples = store.result("imu_samples").to_pylist()
    of = {key: [row for row in samples if (row["recording"], row["sensor"]) == key] for key in found}
    assert [len(of[key]) for key in found] == [60, 60, 60, 60, 0]
    # the counters of one session start apart, and one of them wraps
    assert of["x_kick/MT_01", "00B421ED"][0]["t"] == 0
    assert of["x_kick/MT_01", "00B421EE"][0]["t"] == pytest.approx(10 / 50)
    q = np.array([list(row["orientation"].values()) for row in of["x_walk/sim.parquet", "lhand"]])
    assert distance_deg(q, turning().orientation).max() < 1e-6


def test_verify_compares_sensors_with_their_samples(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    store = open_store(line.folder / "store")
    assert verify(store) == []
    whole = store.result("imu_samples")
    numbers = whole.column("sample").to_numpy()
    changed = {
        "has 59 samples": whole.slice(0, whole.num_rows - 1),
        "must be numbered": whole.set_column(3, "sample", pa.array(numbers[::-1])),
        "times must ascend": whole.set_column(4, "t", pa.array(np.zeros(len(numbers)))),
    }
    pieces = type(store).result_pieces
    for message, table in changed.items():

        def changed_pieces(self: Store, kind: str, *rest: object, table: pa.Table = table) -> object:
            return iter([table]) if kind == "imu_samples" else pieces(self, kind, *rest)

        monkeypatch.setattr(type(store), "result_pieces", changed_pieces)
        ((_, problem),) = imu_problems(store)
        assert message in problem


def test_a_sensor_that_no_limb_claims_is_a_row_of_the_log(line: Line) -> None:
    rows = open_store(line.folder / "store").result("ingest_log").to_pylist()
    assert [(row["source"], row["stage"]) for row in rows] == [("x_walk/sim.parquet", "read_imu")]
    assert "no limb claims the sensor 'other'" in rows[0]["message"]
    assert open_store(line.folder / "store").sql("SELECT source FROM ingest_log").num_rows == 1


def test_what_is_wrong_does_not_stop_the_others_and_unchanged_recordings_stay(line: Line) -> None:
    folder = line.imu / "x_kick"
    table = mtmanager_text(turning()).splitlines()
    table[20] = table[20].replace("0", "x", 1) + "zz"
    (folder / "bad_00000001.txt").write_text("\n".join(table))
    (line.imu / "nobody").mkdir()
    (line.imu / "nobody" / "a.csv").write_text("time_s,acc_x,acc_y,acc_z\n0,0,0,9.81\n")
    (line.imu / "x_kick" / "notes.txt").write_text("nothing but words")
    broken = write_hdf5(line.imu / "x_walk" / "b.h5", turning())
    broken.write_bytes(broken.read_bytes()[:-500])
    twice = folder / "two" / "MT_00B421ED.txt"
    twice.parent.mkdir()
    os.link(folder / "MT_01_00B421EE.txt", twice)
    store, message = line.run()
    rows = {row["source"]: row for row in store.result("ingest_log").to_pylist()}
    assert rows["x_kick/bad_00000001.txt"]["line"] == 21
    assert "no take is called 'nobody'" in rows["nobody/a.csv"]["message"]
    assert "cut off" in rows["x_walk/b.h5"]["message"]
    assert {"x_walk/sim.parquet", "x_kick/two/MT_00B421ED.txt"} < set(rows)
    assert len(rows) == 5
    assert "passed over, without columns of a sensor that are known: 1 file: x_kick/notes.txt" in message
    assert "of 2 takes (3 unchanged, not read again): 4 sensors, 240 samples; orientations of the files" in message
    assert len(recordings(store)) == 5
    # a file of sensors that changes changes all; what is gone goes
    (folder / "a_Inertial.csv").unlink()
    line.sensors.write_text(yaml.safe_dump({"sensors": SET["sensors"] | {"other": "rhand"}}))
    store, message = line.run()
    assert "unchanged" not in message
    rows2 = recordings(store)
    assert rows2["x_walk/sim.parquet", "other"]["limb"] == "rhand"
    assert ("x_kick/a_Inertial.csv", "a") not in rows2


def test_two_sensors_on_one_limb_and_a_pattern_without_takes_are_refused(tmp_path: Path) -> None:
    line = Line(tmp_path)
    write_parquet(line.imu / "x_walk" / "sim.parquet", {"lhand": turning(), "00B421ED": turning()})
    line.sensors.write_text(yaml.safe_dump({"sensors": {"lhand": "lhand", "00B421ED": "lhand"}}))
    with pytest.raises(KinedexError, match="no recording could be read"):
        line.run()
    line.params["match"] = "(?P<tke>.+)/"
    with pytest.raises(KinedexError, match="group `take`"):
        line.run()
    line.params["match"] = r"(?P<take>[^/]+)\.csv$"
    with pytest.raises(KinedexError, match="no recording could be read"):
        line.run()


def test_orientations_are_estimated_where_they_are_asked_for_or_missing(tmp_path: Path) -> None:
    line = Line(tmp_path)
    line.params = {"orientation": "estimate"}
    known = turning(1500)
    write_parquet(line.imu / "x_walk" / "sim.parquet", {"lhand": known})
    store, _ = line.run()
    (row,) = recordings(store).values()
    assert (row["orientation"], row["frame"], row["channels"]) == ("9D", None, ["acc", "gyr", "mag"])
    found = np.array([list(one["orientation"].values()) for one in store.result("imu_samples").to_pylist()])
    assert np.median(distance_deg(found, known.orientation)) < 3


def test_sensors_of_a_filmed_recording_judge_all_takes_that_were_made_of_it(tmp_path: Path) -> None:
    for take in ("walk", "walk_stabilised", "jump", "jump_tracked"):
        write_parquet(tmp_path / take / "imu.parquet", {"lhand": turning()})
    takes = {"walk_tracked": 1, "walk_stabilised": 2, "jump": 3, "jump_tracked": 4, "jump_stabilised": 5}
    made = {"walk": ["walk_tracked", "walk_stabilised"], "jump": ["jump_tracked", "jump_stabilised"]}
    found = find_recordings(ReadImuParameters(source=str(tmp_path)), takes, SensorSet(), made)
    assert found.failures == []
    assert [(one.name, one.take, one.take_id, one.files[0].parent.name) for one in found.recordings] == [
        ("jump/imu.parquet", "jump", 3, "jump"),
        ("jump_stabilised/imu.parquet", "jump_stabilised", 5, "jump"),
        ("jump_tracked/imu.parquet", "jump_tracked", 4, "jump_tracked"),
        ("walk_stabilised/imu.parquet", "walk_stabilised", 2, "walk_stabilised"),
        ("walk_tracked/imu.parquet", "walk_tracked", 1, "walk"),
    ]
    (without,) = find_recordings(ReadImuParameters(source=str(tmp_path)), {"jump": 3}, SensorSet()).recordings
    assert without.take == "jump"
