"""Recordings with silhouettes go through the stages: simulated, tracked, stabilised."""

from __future__ import annotations

import shutil
from pathlib import Path

import polars as pl
import pytest
import yaml
from typer.testing import CliRunner

from kinedex.commands.cli import app
from kinedex.console.terminal import Terminal
from kinedex.ops.simulation.recording import CameraRing, FailureRate, Setup
from kinedex.pipelines.simulation.simulated_cameras import CameraRequest, simulate_cameras
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.store.store import open_store
from tests.pipelines.archives import context, write_archive
from tests.pipelines.tracking.tracks import FILMED, PATTERNS

RING = CameraRing(2, size=(320, 240), focal_px=250.0)


def kinedex(*arguments: object) -> tuple[int, str]:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    return done.exit_code, " ".join(done.output.split())


def track(folder: Path, recordings: Path, *more: str) -> tuple[int, str]:
    return kinedex("track", folder / "store", recordings, "--executor", "serial", *more)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of two takes, and a recording of one with masks."""
    folder = tmp_path_factory.mktemp("silhouettes")
    write_archive(folder / "source", {f"{FILMED}.amc": 48, "x_bo_hop_1.amc": 48})
    Ingest().run(context(folder / "store"), Ingest.parameters(source=str(folder / "source"), patterns=PATTERNS))
    setup = Setup(RING, failures=FailureRate(per_second=0.0))
    with open_store(folder / "store", at="newest") as store:
        simulate_cameras(
            store, CameraRequest((FILMED,), None, 3, setup, silhouettes=True), folder / "sim", Terminal().progress
        )
    return folder


def changed(folder: Path, name: str, **keys: object) -> Path:
    """Copy the recording under another name, with keys changed; None removes one."""
    shutil.copytree(folder / "sim", folder / name)
    path = folder / name / "recordings.yaml"
    entry = yaml.safe_load(path.read_text())["recordings"][FILMED] | {"body": FILMED} | keys
    entry = {key: value for key, value in entry.items() if value is not None}
    path.write_text(yaml.safe_dump({"recordings": {name: entry}}))
    return path


def test_masks_beside_keypoints_are_tracked_and_stabilised(folder: Path) -> None:
    code, output = track(folder, folder / "sim" / "recordings.yaml")
    assert code == 0, output
    code, output = kinedex("stabilise", folder / "store", f"{FILMED}_tracked", "--rounds", 1)
    assert code == 0, output
    store = open_store(folder / "store")
    assert f"{FILMED}_stabilised" in store.take_ids
    assert store.result("recordings").column("silhouettes").to_pylist() == [True]


def test_masks_without_a_first_pose_are_refused_with_a_way_out_that_works(folder: Path) -> None:
    alone = changed(folder, "alone", keypoints=None, keypoint_set=None)
    code, output = track(folder, alone)
    assert code == 1
    assert (
        "alone: silhouettes alone give no first pose; add `keypoints:` of the first frames to the recording" in output
    )
    begun = changed(folder, "begun")
    table = begun.parent / FILMED / "keypoints.parquet"
    pl.read_parquet(table).filter(pl.col("frame") < 2).write_parquet(table)
    code, output = track(folder, begun, "--tracker", "frames")
    assert code == 0, "the recording that failed stops this one"
    assert "begun_tracked" in open_store(folder / "store").take_ids
