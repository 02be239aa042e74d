"""Data sets of simulated inertial sensors: their files, labels, truth, cuts, and requests that mean nothing."""

from __future__ import annotations

import contextlib
import csv
import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from kinedex.catalog.sensorsets import load_sensor_set
from kinedex.commands.cli import app
from kinedex.ops.inertial.limb_motion import LimbMotion
from kinedex.ops.inertial.orientation_filter import estimate
from kinedex.ops.inertial.rotations import conjugate, distance_deg, interpolate, multiply
from kinedex.ops.simulation.imu_sensors import take_pieces
from kinedex.pipelines.inertial.limb_motion import stored_limbs
from kinedex.pipelines.simulation.imu_recordings import (
    ClassTime,
    ImuRequest,
    TakeToSimulate,
    Windowing,
    segment_rows,
    window_rows,
    write_data_set,
)
from kinedex.pipelines.stages.index import Index
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.pipelines.stages.limb_orientations import LimbOrientations
from kinedex.pipelines.stages.simulate_imu import SimulateImu
from kinedex.storage.formats.imu.recording import read_recording
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from tests.pipelines.archives import context, write_archive

pytest.importorskip("scipy")
LIMBS = ("--limb", "pelvis", "--limb", "lthigh", "--limb", "rthigh")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of two takes with classes, and the limbs of both."""
    folder = tmp_path_factory.mktemp("worn")
    source = write_archive(folder / "source", {"x_al_hop_1.amc": 600, "x_bo_sway_2.amc": 400})
    patterns = [r"x_(?P<actor>[a-z]+)_(?P<class>[a-z]+)_.*"]
    Ingest().run(context(folder / "store"), Ingest.parameters(source=str(source), patterns=patterns))
    Index().run(context(folder / "store", "index"), Index.parameters())
    LimbOrientations().run(context(folder / "store", "limb_orientations"), LimbOrientations.parameters())
    return folder / "store"


def simulate(store: Path, *arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["simulate", "imu", str(store), *map(str, arguments)])
    return result.exit_code, result.output


def content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def rows(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_a_recording_is_read_back_with_its_truth(store: Path, tmp_path: Path) -> None:
    code, output = simulate(store, "x_al_hop_1", "-o", tmp_path / "r", "--seed", 5, *LIMBS, "--json")
    assert code == 0, output
    document = json.loads(output[output.index("{") :])
    assert document["recordings"] == {"x_al_hop_1": ["recordings/x_al_hop_1/imu.parquet"]}
    recording = read_recording(tmp_path / "r" / "recordings" / "x_al_hop_1" / "imu.parquet")
    assert [sensor.name for sensor in recording.sensors] == ["pelvis", "lthigh", "rthigh"]
    (limbs,) = stored_limbs(open_store(store), "test/limb_orientations", ["x_al_hop_1"])
    for sensor, true in zip(recording.sensors, rows(tmp_path / "r" / "truth" / "sensors.csv"), strict=True):
        assert (true["sensor"], true["take"]) == (sensor.name, "x_al_hop_1")
        assert sensor.rate_hz == pytest.approx(100.0)
        assert sensor.warnings == ()
        q_global, q_mount = (np.array([float(true[f"{q}_{a}"]) for a in "wxyz"]) for q in ("q_global", "q_mount"))
        at = sensor.times - float(true["offset_s"])
        limb = limbs.limbs[sensor.name]
        q_take, known = interpolate(limb.times, limb.orientation, at)
        predicted = multiply(conjugate(q_global), multiply(q_take, q_mount))
        assert sensor.orientation is not None
        off = distance_deg(sensor.orientation, predicted)[known]
        assert np.sqrt(np.mean(off**2)) == pytest.approx(2.0, abs=0.8), "soft tissue of 2 degrees"


def test_hands_that_swing_are_read_by_the_file_of_sensors(store: Path, tmp_path: Path) -> None:
    code, output = simulate(store, "x_al_hop_1", "-o", tmp_path / "r", "--seed", 5, "--limb", "hands")
    assert code == 0, output
    path = tmp_path / "r" / "recordings" / "x_al_hop_1" / "imu.parquet"
    sensors = read_recording(path, sensor_set=load_sensor_set(tmp_path / "r" / "sensors.yaml")).sensors
    assert [sensor.name for sensor in sensors] == ["lhand", "rhand"]


def test_the_same_command_makes_the_same_bytes_and_seeds_differ(store: Path, tmp_path: Path) -> None:
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        code, output = simulate(store, "-o", tmp_path / name, "--seed", seed, "--where", "true", "--limb", "pelvis")
        assert code == 0, output
    assert content(tmp_path / "a") == content(tmp_path / "b")
    assert content(tmp_path / "a").keys() == content(tmp_path / "c").keys()
    assert (
        content(tmp_path / "a")["recordings/x_bo_sway_2/imu.parquet"]
        != content(tmp_path / "c")["recordings/x_bo_sway_2/imu.parquet"]
    )
    alone = simulate(store, "x_bo_sway_2", "-o", tmp_path / "d", "--seed", 1, "--limb", "pelvis", "--limb", "lthigh")
    assert alone[0] == 0
    first, second = (
        read_recording(tmp_path / folder / "recordings/x_bo_sway_2/imu.parquet").sensors[0] for folder in ("a", "d")
    )
    assert first.acc.tobytes() == second.acc.tobytes(), "other takes and sensors do not matter"


def test_all_forms_hold_the_same_readings(store: Path, tmp_path: Path) -> None:
    for form in ("parquet", "npz", "xsens-txt"):
        code, output = simulate(store, "x_al_hop_1", "-o", tmp_path / form, "--seed", 3, *LIMBS, "--format", form)
        assert code == 0, output
    table = read_recording(tmp_path / "parquet" / "recordings" / "x_al_hop_1" / "imu.parquet").sensors
    arrays = np.load(tmp_path / "npz" / "recordings" / "x_al_hop_1" / "imu.npz")
    texts = [
        read_recording(path).sensors[0]
        for path in sorted((tmp_path / "xsens-txt" / "recordings" / "x_al_hop_1").iterdir())
    ]
    assert arrays["limbs"].tolist() == ["pelvis", "lthigh", "rthigh"]
    assert {sensor.name for sensor in texts} == {"pelvis", "lthigh", "rthigh"}
    for i, sensor in enumerate(table):
        (text,) = (one for one in texts if one.name == sensor.name)
        np.testing.assert_array_equal(arrays["gyr"][i], sensor.gyr.astype(np.float32))
        np.testing.assert_allclose(text.gyr, sensor.gyr, atol=1e-7)
        np.testing.assert_allclose(text.acc, sensor.acc, atol=1e-6)
        assert distance_deg(text.orientation, sensor.orientation).max() < 1e-4
        assert text.times[0] == 0.0
    offsets = {one["sensor"]: float(one["offset_s"]) for one in rows(tmp_path / "xsens-txt" / "truth" / "sensors.csv")}
    assert offsets["pelvis"] == pytest.approx(0.0, abs=0.01), "samples are counted from the take's beginning"
    assert float(arrays["rate_hz"]) == 100.0
    windows = [loaded_windows(tmp_path / form) for form in ("parquet", "npz", "xsens-txt")]
    by_table, by_arrays, by_texts = (np.stack(found["x"]) for found in windows)
    assert by_table.shape == (3, 3, 200, 9)
    np.testing.assert_allclose(by_arrays, by_table, rtol=1e-6)
    order = np.argsort(["pelvis", "lthigh", "rthigh"])
    np.testing.assert_allclose(by_texts[..., :6], by_table[:, order, :, :6], atol=1e-6)
    assert {(*found["y"], *found["actors"]) for found in windows} == {("hop",) * 3 + ("al",) * 3}


def loaded_windows(folder: Path) -> dict[str, list[object]]:
    """Run the code of a data set's README in its folder."""
    readme = (folder / "README.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```python\n(.*?)^```", readme, re.DOTALL | re.MULTILINE)
    found: dict[str, list[object]] = {}
    with contextlib.chdir(folder):
        exec(compile(block, "README.md", "exec"), found)
    return found


def test_short_windows_keep_short_pieces_and_takes_without_class_are_reported(store: Path, tmp_path: Path) -> None:
    short = limb((150, 151), frames=300)
    assert len(take_pieces({"torso": short}, ("torso",), True).pieces) == 0
    assert (
        len(take_pieces({"torso": short}, ("torso",), True, ImuRequest(windowing=Windowing(1.0)).least_seconds).pieces)
        == 2
    )
    assert ImuRequest(windowing=Windowing(0.1)).least_seconds == 0.5
    assert ImuRequest(windowing=Windowing(30.0)).least_seconds == 2.0
    takes = [TakeToSimulate("hop", None, {"torso": short}, 100.0)]
    (tmp_path / "r").mkdir()
    request = ImuRequest(("torso",), windowing=Windowing(1.0))
    made = write_data_set(
        tmp_path / "r", ["hop"], takes, request, lambda *_: contextlib.nullcontext(SimpleNamespace(advance=id))
    )
    assert (made.windows, made.classes) == (2, {})
    assert "2 windows, none with a class" in made.remarks()[-1]
    assert yaml.safe_load((tmp_path / "r" / "dataset.yaml").read_text())["windows_of_classes"] == {}


def test_actors_rest_before_and_after_where_they_are_asked_to(store: Path, tmp_path: Path) -> None:
    code, output = simulate(
        store, "x_al_hop_1", "-o", tmp_path / "r", "--seed", 2, "--limb", "pelvis", "--grade", "perfect", "--stand", 3
    )
    assert code == 0, output
    (sensor,) = read_recording(tmp_path / "r" / "recordings" / "x_al_hop_1" / "imu.parquet").sensors
    assert (sensor.times[0], sensor.times[-1]) == pytest.approx((-3.0, 599 / 120 + 3.0), abs=0.011)
    still = (sensor.times < -0.5) | (sensor.times > 599 / 120 + 0.5)
    assert np.linalg.norm(sensor.gyr[still], axis=1).max() < 0.05
    np.testing.assert_allclose(np.linalg.norm(sensor.acc[still], axis=1), 9.81, atol=0.05)
    assert {row["class"] for row in rows(tmp_path / "r" / "windows.csv")} == {"", "hop"}


def test_sensors_have_the_axes_of_their_limbs_where_they_are_asked_to(store: Path, tmp_path: Path) -> None:
    given = ("--limb", "pelvis", "--grade", "perfect", "--mount", "limb")
    code, output = simulate(store, "x_al_hop_1", "-o", tmp_path / "r", "--seed", 2, *given)
    assert code == 0, output
    (true,) = rows(tmp_path / "r" / "truth" / "sensors.csv")
    assert [float(true[f"q_mount_{axis}"]) for axis in "wxyz"] == [1.0, 0.0, 0.0, 0.0]
    assert yaml.safe_load((tmp_path / "r" / "dataset.yaml").read_text())["mount"] == "limb"


def test_windows_have_the_class_of_their_take(store: Path, tmp_path: Path) -> None:
    code, output = simulate(
        store, "--where", "true", "-o", tmp_path / "r", "--seed", 0, "--limb", "pelvis", "--window", 1, "--step", 0.5
    )
    assert code == 0, output
    windows = rows(tmp_path / "r" / "windows.csv")
    assert {(row["take"], row["class"]) for row in windows} == {("x_al_hop_1", "hop"), ("x_bo_sway_2", "sway")}
    assert [(row["start"], row["stop"]) for row in windows[:2]] == [("0", "100"), ("50", "150")]
    (first, _) = rows(tmp_path / "r" / "segments.csv")
    assert (first["origin"], first["class"], first["start"]) == ("take", "hop", "0")
    described = yaml.safe_load((tmp_path / "r" / "dataset.yaml").read_text())
    assert (described["grade"], described["takes"]["x_al_hop_1"]["actor"]) == ("good", "al")


def test_windows_count_what_covers_them() -> None:
    segments = [ClassTime("label", "walk", 0.0, 1.2), ClassTime("label", "turn", 1.2, 2.0)]
    times = np.arange(30) / 10
    found = segment_rows(segments, times)
    assert found == [("label", "walk", 0, 12), ("label", "turn", 12, 20)]
    windows = window_rows(found, 30, 10.0, Windowing(1.0, 1.0))
    assert windows == [(0, 10, "walk", 1.0), (10, 20, "turn", 0.8), (20, 30, "", 0.0)]
    assert window_rows([], 30, 10.0, Windowing(5.0, 1.0)) == []


def test_perfect_sensors_lead_a_filter_back_to_the_limb(store: Path, tmp_path: Path) -> None:
    pytest.importorskip("vqf")
    code, output = simulate(
        store, "x_al_hop_1", "-o", tmp_path / "r", "--seed", 2, "--limb", "pelvis", "--grade", "perfect"
    )
    assert code == 0, output
    (sensor,) = read_recording(tmp_path / "r" / "recordings" / "x_al_hop_1" / "imu.parquet").sensors
    found = estimate(sensor.rate_hz, sensor.acc, sensor.gyr, sensor.mag)
    assert np.median(distance_deg(found, sensor.orientation)) < 4.0


def test_the_stage_writes_what_the_command_writes(store: Path, tmp_path: Path) -> None:
    made = SimulateImu().run(stage_context(store), SimulateImu.parameters(limbs=["lthigh", "rthigh", "pelvis"], seed=5))
    assert made["takes"] == 2
    folder = store / "results" / "reports" / "test" / "imu"
    assert simulate(store, "--where", "true", "-o", tmp_path / "r", "--seed", 5, *LIMBS)[0] == 0
    assert content(folder) == content(tmp_path / "r")
    again = SimulateImu().run(stage_context(store), SimulateImu.parameters(limbs=["torso"], seed=6))
    assert {Path(str(file)).name for file in again["files"]} >= {"dataset.yaml", "windows.csv", "imu.parquet"}
    assert verify(open_store(store)) == []


def stage_context(store: Path):
    from dataclasses import replace

    return replace(context(store, "simulate_imu"), uses="simulate_imu", inputs={"limbs": "limb_orientations"})


def limb(
    jumps: tuple[int, ...] = (), steps: tuple[int, ...] = (), basis: str = "full", frames: int = 900
) -> LimbMotion:
    times = np.arange(frames) / 100
    position = np.stack([np.sin(times), times * 0, times * 0], axis=1)
    for step in steps:
        position[step:] += 1.0
    jump = np.zeros(frames, bool)
    jump[list(jumps)] = True
    q = np.tile([1.0, 0, 0, 0], (frames, 1))
    return LimbMotion("torso", basis, times, q, position, position, np.ones(frames, bool), jump)


def test_takes_are_cut_where_they_jump() -> None:
    found = take_pieces({"torso": limb((300, 301), (600,))}, ("torso",), True)
    assert [(one.start, one.stop) for one in found.pieces] == [(0, 300), (302, 599), (601, 900)]
    found = take_pieces({"torso": limb((150, 151), (600,))}, ("torso",), True)
    assert [(one.start, one.stop) for one in found.pieces] == [(152, 599), (601, 900)]
    assert (found.short, found.lost_frames) == (1, 154)


def test_limbs_without_orientation_wear_no_sensor() -> None:
    none = take_pieces({"torso": limb(basis="none")}, ("torso", "head"), True)
    assert none.pieces == ()
    assert none.without == {
        "torso": "only its long axis is known, and a sensor turns about it, too",
        "head": "the skeleton does not have it",
    }
    gap = limb()
    gap.valid[400:408] = False
    gap.valid[600:640] = False
    gap.orientation[~gap.valid] = np.nan
    found = take_pieces({"torso": gap}, ("torso",), False)
    assert [(one.start, one.stop) for one in found.pieces] == [(0, 600), (640, 900)]


def test_requests_that_mean_nothing_are_refused(store: Path, tmp_path: Path) -> None:
    for arguments, message in (
        (("--limb", "lhnad"), "did you mean 'lhand'"),
        (("--grade", "goood"), "did you mean 'good'"),
        (("--format", "csv"), "parquet, npz, xsens-txt"),
        (("--window", "0"), "positive number of seconds"),
        (("--mount", "skin"), "mount must be one of random, limb"),
    ):
        code, output = simulate(store, "x_al_hop_1", "-o", tmp_path / "r", "--seed", 1, *arguments)
        assert code != 0
        assert message in " ".join(output.split())
        assert not (tmp_path / "r").exists()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("x")
    code, output = simulate(store, "x_al_hop_1", "-o", tmp_path / "full", "--seed", 1)
    assert code != 0
    assert "not empty" in output
    assert str(tmp_path / "full-2") in "".join(output.split())
