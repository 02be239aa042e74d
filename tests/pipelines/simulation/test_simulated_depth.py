"""Recordings by a simulated depth camera: their files, the truth apart, and requests that mean nothing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

import kinedex
from kinedex.catalog.depth_recordings import load_depth_recordings
from kinedex.commands.cli import app
from kinedex.pipelines.stages.index import Index
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.formats.depth.camera_file import read_camera
from kinedex.storage.formats.depth.png import read_depth_png
from kinedex.storage.formats.depth.recording import read_recording
from tests.pipelines.archives import context, write_archive


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of two takes."""
    folder = tmp_path_factory.mktemp("filmed")
    source = write_archive(folder / "source", {"x_al_hop_1.amc": 90, "x_bo_hop_2.amc": 60})
    Ingest().run(context(folder / "store"), Ingest.parameters(source=str(source), patterns=[r"x_(?P<actor>[a-z]+)_.*"]))
    Index().run(context(folder / "store", "index"), Index.parameters())
    return folder / "store"


def simulate(store: Path, *arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["simulate", "depth", str(store), *map(str, arguments)])
    return result.exit_code, result.output


def content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_recordings_name_their_files_and_the_truth_lies_in_the_images(store: Path, tmp_path: Path) -> None:
    code, output = simulate(
        store, "x_al_hop_1", "-o", tmp_path / "r", "--seed", 5, "--camera", "tof_small", "--frames", "3:9", "--json"
    )
    assert code == 0, output
    document = json.loads(output[output.index("{") :])
    assert (document["recordings"], document["frames"], document["outside"]) == ({"x_al_hop_1": "x_al_hop_1"}, 6, {})
    entry = yaml.safe_load((tmp_path / "r" / "recordings.yaml").read_text())["recordings"]["x_al_hop_1"]
    assert entry["rate_hz"] == 30
    camera = read_camera(tmp_path / "r" / entry["camera"])
    true = kinedex.read(tmp_path / "r" / entry["truth"])
    stored = kinedex.open_store(store).positions("x_al_hop_1")[3:9]
    moved = true.positions - stored
    assert np.ptp(moved, axis=(0, 1)) == pytest.approx(np.zeros(3), abs=1e-5)  # the take was only lowered
    files = sorted((tmp_path / "r" / "x_al_hop_1" / "depth").iterdir())
    assert [path.name for path in files] == [f"{frame:06d}.png" for frame in range(6)]
    recording = read_recording(load_depth_recordings(tmp_path / "r" / "recordings.yaml"), "x_al_hop_1")
    assert (recording.name, recording.rate_hz, recording.notes) == ("x_al_hop_1", 30, ())
    background = recording.background
    assert background is not None
    for path, joints in zip(files, true.positions, strict=True):
        depths = read_depth_png(path, camera)
        pixels, z = camera.camera.project(joints[[true.joints.index(name) for name in ("neck", "head", "lknee")]])
        u, v = np.round(pixels).astype(int).T
        assert (np.abs(depths[v, u] - z) < 0.25).all()
        assert (background[v, u] - depths[v, u] > 0.5).all()


def test_the_same_command_makes_the_same_bytes_and_another_seed_others(store: Path, tmp_path: Path) -> None:
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        arguments = ("--where", "actor = 'bo'", "-o", tmp_path / name, "--seed", seed, "--frames", "0:2")
        assert simulate(store, *arguments, "--camera", "structured", "--body", "second")[0] == 0
    assert content(tmp_path / "a") == content(tmp_path / "b") != content(tmp_path / "c")
    assert b"camera structured, body 'second', seed 1" in content(tmp_path / "a")["recordings.yaml"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "no take is named"),
        (("nobody",), "nobody"),
        (("x_bo_hop_2", "--camera", "tof_smal"), "did you mean 'tof_small'"),
        (("x_bo_hop_2", "--body", "secnd"), "did you mean 'second'"),
        (("x_bo_hop_2", "--frames", "10-20"), "as 0:60"),
        (("x_bo_hop_2", "--frames", "0:5000"), "film an interval of 0:"),
    ],
)
def test_requests_that_mean_nothing_are_refused(
    store: Path, tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    code, output = simulate(store, *arguments, "-o", tmp_path / "r", "--seed", 1)
    assert code in (1, 2)
    assert message in " ".join(output.split())
    assert not list(tmp_path.iterdir())
