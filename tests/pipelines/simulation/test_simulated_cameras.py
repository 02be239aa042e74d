"""`kinedex simulate cameras`: files that name each other, truth apart, the same bytes, and nothing half done."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from PIL import Image
from typer.testing import CliRunner

import kinedex
from kinedex.catalog.camera_recordings import load_recordings
from kinedex.catalog.keypoint_sets import KeypointPlace, KeypointSet, load_keypoint_set
from kinedex.commands.cli import app
from kinedex.ops.errors import KinedexError
from kinedex.ops.tracking.triangulation import triangulate
from kinedex.pipelines.simulation.recording_folder import recording_names
from kinedex.pipelines.simulation.simulated_cameras import limbs_of
from kinedex.pipelines.stages.index import Index
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.formats.cameras.recording import read_recording
from tests.pipelines.archives import context, write_archive

TAKES = {"x_al_hop_1.amc": 90, "x_bo_hop_2.amc": 60}


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of two takes."""
    folder = tmp_path_factory.mktemp("simulated")
    source = write_archive(folder / "source", TAKES)
    Ingest().run(context(folder / "store"), Ingest.parameters(source=str(source), patterns=[r"x_(?P<actor>[a-z]+)_.*"]))
    Index().run(context(folder / "store", "index"), Index.parameters())
    return folder / "store"


def simulate(store: Path, *arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["simulate", "cameras", str(store), *map(str, arguments)])
    return result.exit_code, result.output


def content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_recordings_name_their_files_and_the_truth_is_apart(store: Path, tmp_path: Path) -> None:
    code, output = simulate(store, "x_al_hop_1", "-o", tmp_path / "r", "--seed", 5, "--failures", 4, "--json")
    assert code == 0, output
    document = json.loads(output[output.index("{") :])  # a slow machine shows its progress before
    assert document["recordings"] == {"x_al_hop_1": "x_al_hop_1"}
    entries = yaml.safe_load((tmp_path / "r" / "recordings.yaml").read_text())["recordings"]
    entry = entries["x_al_hop_1"]
    assert entry["rate_hz"] == 30
    for key in ("cameras", "keypoints", "truth"):
        assert (tmp_path / "r" / entry[key]).is_file()
    assert not any("truth" in str(value) for key, value in entry.items() if key != "truth")
    rows = pq.read_table(tmp_path / "r" / entry["keypoints"])
    true = kinedex.read(tmp_path / "r" / entry["truth"])
    stored = kinedex.open_store(store)
    np.testing.assert_allclose(true.positions, stored.positions("x_al_hop_1"), atol=1e-5)
    assert rows.num_rows == len(true) * 4 * 19
    with (tmp_path / "r" / "truth" / "failures.csv").open() as file:
        failures = list(csv.DictReader(file))
    assert len(failures) == document["failures"] == round(4 * len(true) / 30)


@pytest.mark.parametrize("form", ["parquet", "openpose"])
def test_recordings_are_read_as_they_were_made(store: Path, tmp_path: Path, form: str) -> None:
    made = simulate(store, "x_bo_hop_2", "-o", tmp_path / "r", "--seed", 1, "--format", form, "--failures", 2)
    assert made[0] == 0, made[1]
    recording = read_recording(load_recordings(tmp_path / "r" / "recordings.yaml"), "x_bo_hop_2")
    positions = kinedex.open_store(store).positions("x_bo_hop_2")
    assert recording.pixels.shape == (len(positions), 4, 19, 2)
    assert recording.keypoints == load_keypoint_set("coco-17-toes").order
    points, _ = triangulate(recording.rays())
    joints = kinedex.open_store(store)["x_bo_hop_2"].joints
    for keypoint, joint in (("left_hip", "lhip"), ("right_knee", "rknee"), ("left_wrist", "lwrist")):
        away = points[:, recording.keypoints.index(keypoint)] - positions[:, joints.index(joint)]
        assert np.nanmedian(np.linalg.norm(away, axis=1)) < 0.06


def test_the_same_command_makes_the_same_bytes_and_another_seed_others(store: Path, tmp_path: Path) -> None:
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        assert simulate(store, "--where", "actor = 'bo'", "-o", tmp_path / name, "--seed", seed)[0] == 0
    assert content(tmp_path / "a") == content(tmp_path / "b") != content(tmp_path / "c")


def test_keypoints_of_openpose_and_masks_have_a_folder_for_each_camera(store: Path, tmp_path: Path) -> None:
    arguments = ("x_bo_hop_2", "-o", tmp_path / "r", "--seed", 1, "--cameras", 2, "--failures", 0)
    more = ("--format", "openpose", "--keypoints", "halpe-26", "--silhouettes")
    assert simulate(store, *arguments, *more)[0] == 0
    home = tmp_path / "r" / "x_bo_hop_2"
    frames = len(kinedex.open_store(store)["x_bo_hop_2"])
    for camera in ("cam1", "cam2"):
        files = sorted((home / "keypoints" / camera).iterdir())
        assert len(files) == frames
        (person,) = json.loads(files[0].read_text())["people"]
        points = np.array(person["pose_keypoints_2d"]).reshape(26, 3)
        masks = sorted((home / "masks" / camera).iterdir())
        assert len(masks) == frames
        mask = np.array(Image.open(masks[0]))
        assert mask.shape == (480, 640)
        x, y = (points[[11, 12], :2].mean(axis=0) / 2).astype(int)  # between the hips
        assert mask[y, x] == 255
        assert set(np.unique(mask)) == {0, 255}


def test_one_camera_is_refused_before_anything_is_written(store: Path, tmp_path: Path) -> None:
    code, output = simulate(store, "x_bo_hop_2", "-o", tmp_path / "r", "--seed", 1, "--cameras", 1)
    assert code == 1
    assert "cameras must be at least 2: tracking triangulates joints, got 1" in output
    assert not list(tmp_path.iterdir())


def test_a_folder_with_files_is_never_overwritten(store: Path, tmp_path: Path) -> None:
    (tmp_path / "r").mkdir()
    (tmp_path / "r" / "mine.txt").write_text("mine")
    code, output = simulate(store, "x_bo_hop_2", "-o", tmp_path / "r", "--seed", 1)
    assert code == 1
    assert "is not empty" in output
    assert content(tmp_path) == {"r/mine.txt": b"mine"}


def test_nothing_is_left_where_a_take_cannot_be_filmed(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("kinedex.pipelines.simulation.simulated_cameras.write_calibration", fail)
    code, output = simulate(store, "x_bo_hop_2", "-o", tmp_path / "r", "--seed", 1)
    assert code == 1
    assert "No space left" in output
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "no take is named"),
        (("nobody",), "nobody"),
        (("--where", "actor = 'zz'"), "selects no take"),
        (("x_bo_hop_2", "--format", "csv"), "parquet or openpose"),
        (("x_bo_hop_2", "--keypoints", "named"), "has no order"),
    ],
)
def test_requests_that_mean_nothing_are_refused(
    store: Path, tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    code, output = simulate(store, *arguments, "-o", tmp_path / "r", "--seed", 1)
    assert code == 1
    assert message in output
    assert not list(tmp_path.iterdir())


def test_names_of_takes_cannot_leave_the_folder() -> None:
    names = recording_names(["../../etc/passwd", "a/b", "a_b", "A_B", "con", "walk (1)", "…", ".hidden"])
    assert len({name.casefold() for name in names}) == len(names)
    for name in names:
        assert Path(name).name == name
        assert name[0] not in ".+-"


def test_a_keypoint_set_without_elbows_is_refused() -> None:
    with pytest.raises(KinedexError, match="no keypoint at"):
        limbs_of(KeypointSet("heads", ("nose",), {"nose": KeypointPlace(node="neck")}, False))
