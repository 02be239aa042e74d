"""The stages synchronise and calibrate_sensors: clocks and mounts of simulated sensors on stored takes."""

from __future__ import annotations

import dataclasses
import io
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from rich.console import Console

from kinedex.console.terminal import Terminal
from kinedex.ops.errors import KinedexError
from kinedex.ops.inertial import rotations as r
from kinedex.ops.inertial.limb_motion import LimbMotion
from kinedex.ops.inertial.rotations import Z_TO_Y
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.inertial.limb_motion import limb_table, stored_limbs, struct_array
from kinedex.pipelines.inertial.worn_sensors import WornTakes
from kinedex.pipelines.stages.calibrate_sensors import CalibrateSensors
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.pipelines.stages.limb_orientations import LimbOrientations
from kinedex.pipelines.stages.synchronise import Synchronise
from kinedex.storage.snapshot.row_groups import RowGroups
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store import reused_results
from kinedex.storage.store.limb_checks import limb_problems
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from tests.pipelines.archives import context, write_archive

TAKES = {"x_al_hop_1.amc": 1500, "x_al_hop_2.amc": 1200, "x_bo_sway_1.amc": 900}
OFFSETS = {"x_al_hop_1": 0.731, "x_al_hop_2": -1.204, "x_bo_sway_1": 3.5}
LIMBS = ("lshank", "rhand", "torso")
MOUNTS = dict(zip(LIMBS, r.exp(np.random.default_rng(5).normal(0, 1, (3, 3))), strict=True))
WORLDS = {take: r.multiply(Z_TO_Y, r.exp(np.array([0, 0, 0.7 * i]))) for i, take in enumerate(OFFSETS)}
INPUTS = {"sensors": "read_imu", "limbs": "limb_orientations", "clocks": "synchronise"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store with takes, limbs, and samples of perfect sensors; one sensor is worn on a limb that no take has."""
    made = tmp_path_factory.mktemp("sensors")
    write_archive(made / "source", TAKES)
    pattern = [r"x_(?P<actor>[a-z]+)_(?P<class>[a-z]+)_\d"]
    Ingest().run(context(made / "store"), Ingest.parameters(source=str(made / "source"), patterns=pattern))
    given = LimbOrientations.parameters(limbs=["legs", "hands", "torso"])
    LimbOrientations().run(context(made / "store", "limb_orientations"), given)
    put_sensors(made)
    return made


def put_sensors(made: Path, still: str = "", store: str = "store") -> None:
    """Store the readings of sensors on three limbs of each take, as `read_imu` does; in one take they may lie still."""
    place = context(made / store, "read_imu")
    sensors: list[dict[str, Any]] = []
    samples: list[pa.Table] = []
    for found in stored_limbs(open_store(made / store, at="newest"), "test/limb_orientations"):
        for limb in (*LIMBS, "head"):
            channels = ["gyr", "mag", "orientation"]
            names = {"take": found.take, "recording": f"{found.take}.csv", "sensor": f"s-{limb}", "limb": limb}
            if limb in LIMBS:
                samples.append(samples_of(found.limbs[limb], found.take, found.take == still))
            count = samples[-1].num_rows if limb in LIMBS else 0
            row = {"run": "run-1", "take_id": found.take_id, "channels": channels, "samples": count, "fingerprint": "f"}
            sensors.append(row | names)
    with place.writer() as writer:
        recordings = pa.Table.from_pylist(sensors, schema=result_schema("imu_recordings"))
        writer.put_results("imu_recordings", recordings, stage="test/read_imu", run="run-1")
        writer.put_results("imu_samples", iter(samples), stage="test/read_imu", run="run-1")
        writer.commit()


def samples_of(limb: LimbMotion, take: str, still: bool) -> pa.Table:
    """Return the samples of a sensor at 100 Hz."""
    times = np.arange(0.004, limb.times[-1], 0.01)
    track, _ = r.interpolate(limb.times, limb.orientation, times)
    orientation = r.multiply(r.multiply(r.conjugate(WORLDS[take]), track), MOUNTS[limb.limb])
    if still:
        orientation[:] = orientation[0]
    rate = r.log(r.multiply(r.conjugate(orientation[:-1]), orientation[1:])) * 100.0
    count, schema = len(times), result_schema("imu_samples")
    columns = {
        "run": ["run-1"] * count,
        "recording": [f"{take}.csv"] * count,
        "sensor": [f"s-{limb.limb}"] * count,
        "sample": np.arange(count),
        "t": times + OFFSETS[take],
        "gyr": struct_array(np.concatenate([np.zeros((1, 3)), rate]), "xyz"),
        "orientation": struct_array(orientation, "wxyz"),
    }
    arrays = [columns.get(name, pa.nulls(count, schema.field(name).type)) for name in schema.names]
    return pa.table([pa.array(one) if not isinstance(one, pa.Array) else one for one in arrays], schema=schema)


def stage_context(folder: Path, stage: str) -> StageContext:
    return dataclasses.replace(context(folder / "store", stage), inputs=INPUTS)


def synchronise(folder: Path, **params: object) -> list[dict[str, Any]]:
    Synchronise().run(stage_context(folder, "synchronise"), Synchronise.parameters(**params))
    return open_store(folder / "store", at="newest").result("sensor_sync").to_pylist()


def calibrate(folder: Path, **params: object) -> list[dict[str, Any]]:
    CalibrateSensors().run(stage_context(folder, "calibrate_sensors"), CalibrateSensors.parameters(**params))
    return open_store(folder / "store", at="newest").result("sensor_calibration").to_pylist()


@pytest.fixture(scope="module")
def synchronised(folder: Path) -> Path:
    synchronise(folder)
    return folder


def off_deg(row: dict[str, Any], mount: bool) -> float:
    """Return by how much a stored rotation is off the true one."""
    found = np.array(list(row["q_mount" if mount else "q_global"].values()))
    return float(r.distance_deg(found, MOUNTS[row["limb"]] if mount else WORLDS[row["take"]]))


def test_clocks_are_found_to_a_tenth_of_a_millisecond(synchronised: Path) -> None:
    store = open_store(synchronised / "store", at="newest")
    rows = store.sql("SELECT * FROM sensor_sync ORDER BY take").to_pylist()
    assert [row["take"] for row in rows] == sorted(OFFSETS)
    for row in rows:
        assert row["offset_s"] == pytest.approx(OFFSETS[row["take"]], abs=1e-4)
        assert row["correlation"] > 0.95
        assert (row["ppm"], row["limbs"], row["refined"], row["left_out"]) == (0.0, 3, True, None)
    assert verify(store) == []


@pytest.mark.parametrize("params", [{}, {"global": "per_sensor", "heading": "drift"}, {"vertical": "free"}])
def test_mounts_are_found_take_by_take(synchronised: Path, params: dict[str, str]) -> None:
    rows = calibrate(synchronised, **params)
    found = [row for row in rows if row["left_out"] is None]
    assert {(row["take"], row["limb"]) for row in found} == {(take, limb) for take in OFFSETS for limb in LIMBS}
    for row in found:
        assert max(off_deg(row, True), off_deg(row, False)) < 0.5, row
        assert (row["basis"], row["inliers"]) == ("full", 1.0)
        assert bool(row["drift"]) == ("heading" in params)
    assert {row["left_out"] for row in rows if row["limb"] == "head"} == {f"{take} has no head" for take in OFFSETS}


def test_takes_of_one_actor_share_mounts(synchronised: Path) -> None:
    rows = calibrate(synchronised, **{"from": "actor", "global": "per_sensor"})
    mounts = {(row["take"], row["limb"]): row["q_mount"] for row in rows if row["left_out"] is None}
    for limb in LIMBS:
        assert mounts["x_al_hop_1", limb] == mounts["x_al_hop_2", limb] != mounts["x_bo_sway_1", limb]


@pytest.mark.slow
def test_processes_find_the_same(synchronised: Path) -> None:
    alone = {(row["take"], row["limb"]): row["q_mount"] for row in calibrate(synchronised)}
    place = dataclasses.replace(context(synchronised / "store", "calibrate_sensors", "processes"), inputs=INPUTS)
    CalibrateSensors().run(place, CalibrateSensors.parameters())
    place.executor.close()
    rows = open_store(synchronised / "store", at="newest").result("sensor_calibration").to_pylist()
    assert {(row["take"], row["limb"]): row["q_mount"] for row in rows} == alone


def test_a_calibration_take_gives_its_mounts_to_its_wearing(synchronised: Path) -> None:
    rows = calibrate(synchronised, **{"from": "x_al_hop_1", "global": "per_sensor"})
    other = [row for row in rows if row["take"] == "x_al_hop_2" and row["left_out"] is None]
    first = {row["limb"]: row["q_mount"] for row in rows if row["take"] == "x_al_hop_1"}
    assert [row["q_mount"] for row in other] == [first[row["limb"]] for row in other]
    assert len(other) == 3
    assert all(off_deg(row, False) < 0.5 for row in other)
    foreign = {row["left_out"] for row in rows if row["take"] == "x_bo_sway_1" and row["limb"] != "head"}
    assert foreign == {"x_al_hop_1, which `from` names, is of another wearing"}
    with pytest.raises(KinedexError, match=r"no take with sensors is named 'x_al_hop'; did you mean 'x_al_hop_"):
        calibrate(synchronised, **{"from": "x_al_hop"})
    with pytest.raises(KinedexError, match="takes have no column 'actr'; did you mean 'actor'"):
        calibrate(synchronised, wearing=["actr"])


def test_a_limb_of_which_only_the_axis_is_known_gets_a_direction(synchronised: Path, tmp_path: Path) -> None:
    shutil.copytree(synchronised / "store", tmp_path / "store")
    tables = []
    for found in stored_limbs(open_store(tmp_path / "store", at="newest"), "test/limb_orientations"):
        hand = dataclasses.replace(found.limbs["rhand"], basis="none")
        hand.orientation[:] = np.nan
        tables.append(limb_table(found.take_id, found.take, {**found.limbs, "rhand": hand}, "run-2"))
    with context(tmp_path / "store").writer() as writer:
        writer.put_results("limb_orientations", iter(tables), stage="test/limb_orientations", run="run-2")
        writer.commit()
    assert all(row["limbs"] == 2 for row in synchronise(tmp_path))
    hands = [row for row in calibrate(tmp_path) if row["limb"] == "rhand"]
    for row in hands:
        assert (row["left_out"], row["q_mount"], row["basis"]) == (None, None, "none")
        assert sum(value**2 for value in row["direction"].values()) == pytest.approx(1.0)
    hands = [row for row in calibrate(tmp_path, **{"global": "per_sensor"}) if row["limb"] == "rhand"]
    assert all("needs another limb with an orientation and `global: shared`" in row["left_out"] for row in hands)


def test_a_take_without_a_clock_is_left_out_and_the_others_go_on(synchronised: Path, tmp_path: Path) -> None:
    shutil.copytree(synchronised / "store", tmp_path / "store")
    put_sensors(tmp_path, still="x_bo_sway_1")
    reasons = {row["take"]: row["left_out"] for row in synchronise(tmp_path)}
    assert "overlap by less than 3 s of movement" in reasons.pop("x_bo_sway_1")
    assert set(reasons.values()) == {None}
    left = {row["take"]: row["left_out"] for row in calibrate(tmp_path) if row["limb"] == "lshank"}
    assert left["x_bo_sway_1"] == "the clock of the recording was not found"
    assert left["x_al_hop_1"] is None
    assert {row["offset_s"] for row in synchronise(tmp_path, offset_s=0.25)} == {0.25}


def printed(folder: Path, stage: Synchronise | CalibrateSensors, **params: object) -> str:
    """Return what a stage prints, on one line."""
    out = io.StringIO()
    place = dataclasses.replace(stage_context(folder, stage.name), terminal=Terminal(Console(file=out, width=400)))
    stage.run(place, stage.parameters(**params))
    return " ".join(out.getvalue().split())


def test_a_recording_that_is_left_out_is_named_once(synchronised: Path, tmp_path: Path) -> None:
    shutil.copytree(synchronised / "store", tmp_path / "store")
    put_sensors(tmp_path, still="x_bo_sway_1")
    shown = printed(tmp_path, Synchronise(), clock="drift")
    assert "clock: drift: constant in 2 recordings" in shown
    assert "share 5 minutes" in shown
    assert "x_al_hop_1.csv, x_al_hop_2.csv" in shown
    shown = printed(tmp_path, CalibrateSensors())
    reason = "the clock of the recording was not found"
    assert shown.count(reason) == 1
    assert f"x_bo_sway_1, x_bo_sway_1.csv: 3 sensors: left out: {reason}" in shown
    assert "6 calibrations: 3 sensors in 2 recordings; 6 left out" in shown
    assert "-0.0000" not in printed(tmp_path, Synchronise(), offset_s=-0.00001)


def test_limbs_are_read_of_the_takes_that_wear_sensors(synchronised: Path, tmp_path: Path) -> None:
    shutil.copytree(synchronised, tmp_path, dirs_exist_ok=True)
    rows = open_store(tmp_path / "store", at="newest").result("imu_recordings")
    own = pa.Table.from_pylist(
        [row for row in rows.to_pylist() if row["take"] == "x_al_hop_2"], schema=result_schema("imu_recordings")
    )
    with context(tmp_path / "store").writer() as writer:
        writer.put_results("imu_recordings", own, stage="test/read_imu", run="run-1")
        writer.commit()
    stage, place = LimbOrientations(), stage_context(tmp_path, "limb_orientations")
    assert stage.run(place, stage.parameters(limbs=["legs"]))["takes"] == 1
    assert stage.run(place, stage.parameters(limbs=["legs"], where="true"))["takes"] == 3
    without = context(tmp_path / "store", "limb_orientations")
    assert stage.run(without, stage.parameters(limbs=["legs"]))["takes"] == 3


def changed(**values: object) -> Callable[[list[dict[str, Any]]], None]:
    """Return what changes values of the first row."""
    return lambda rows: rows[0].update(values)


CONTRADICTIONS: list[tuple[str, str, Callable[[list[dict[str, Any]]], object], str]] = [
    ("sensor_sync", "synchronise", changed(offset_s=None), "has neither a clock nor the reason"),
    ("sensor_sync", "synchronise", changed(correlation=1.5), "has a correlation beyond -1 and 1"),
    ("sensor_calibration", "calibrate_sensors", changed(q_mount=None), "has neither a mount nor the reason"),
    ("sensor_calibration", "calibrate_sensors", changed(left_out="why"), "or both"),
    ("sensor_calibration", "calibrate_sensors", changed(inliers=1.5), "has a share beyond 0 and 1"),
    ("sensor_calibration", "calibrate_sensors", changed(q_global=dict.fromkeys("wxyz", 1.0)), "not of length 1"),
    (
        "limb_orientations",
        "limb_orientations",
        changed(orientation=dict.fromkeys("wxyz", 1.0)),
        "has an orientation",
    ),
    ("limb_orientations", "limb_orientations", changed(orientation=None), "frame 0 is valid without its orientation"),
    ("limb_orientations", "limb_orientations", changed(source_frame=1), "frame 1 is there twice"),
]


def test_what_contradicts_itself_is_found(synchronised: Path, tmp_path: Path) -> None:
    calibrate(synchronised)
    shutil.copytree(synchronised / "store", tmp_path / "store")
    whole = open_store(tmp_path / "store", at="newest")
    assert list(limb_problems(whole)) == []
    for kind, stage, change, message in CONTRADICTIONS:
        before = whole.result(kind, stage=f"test/{stage}")
        rows = before.slice(0, 20).to_pylist()
        change(rows)
        after = pa.concat_tables([pa.Table.from_pylist(rows, schema=before.schema), before.slice(20)])
        with context(tmp_path / "store").writer() as writer:
            writer.put_results(kind, after, stage=f"test/{stage}", run="run-1")
            writer.commit()
            ((_, problem),) = limb_problems(writer.store)
            assert message in problem
            writer.put_results(kind, before, stage=f"test/{stage}", run="run-1")
            writer.commit()


def test_rows_are_found_by_the_value_of_a_column(synchronised: Path) -> None:
    store = open_store(synchronised / "store", at="newest")
    groups = RowGroups(store, "imu_samples", "test/read_imu", "recording")
    assert sorted(map(str, groups.values)) == [f"{take}.csv" for take in sorted(OFFSETS)]
    own = groups.rows("x_al_hop_1.csv")
    assert set(own.column("recording").to_pylist()) == {"x_al_hop_1.csv"}
    assert groups.rows("nothing").num_rows == 0
    assert len(WornTakes(store, "test/limb_orientations", "test/read_imu")) == 3


def test_limbs_of_a_long_take_are_read_without_the_others(
    synchronised: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(synchronised, tmp_path, dirs_exist_ok=True)
    monkeypatch.setattr(reused_results, "MIN_ROWS", 1000)
    given = LimbOrientations.parameters(limbs=["legs", "hands", "torso"])
    LimbOrientations().run(stage_context(tmp_path, "limb_orientations"), given)
    whole, divided = (
        RowGroups(open_store(made / "store", at="newest"), "limb_orientations", "test/limb_orientations", "take_id")
        for made in (synchronised, tmp_path)
    )
    for take_id in whole.values:
        assert divided.rows(take_id).equals(whole.rows(take_id))
        wanted = whole.rows(take_id, "limb", {"rhand"})
        assert set(wanted.column("limb").to_pylist()) == {"rhand"}
        assert divided.rows(take_id, "limb", {"rhand"}).equals(wanted)
    places = divided._places[whole.values[0]]
    assert len(places) > 1
    assert sum(divided._may_hold(place, "limb", {"rhand"}) for place in places) < len(places)
