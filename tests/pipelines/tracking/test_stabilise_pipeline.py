"""The pipeline stabilise on a small archive that is filmed by simulated cameras: takes, results, reuse, the page."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.commands.cli import app
from kinedex.ops.body.kinematic_chain import ChainBody
from kinedex.ops.errors import KinedexError
from kinedex.ops.tracking.contours import Observed
from kinedex.ops.tracking.observations import JointPositions
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.tracking import tracking_runs
from kinedex.pipelines.tracking.observed_recordings import stored_recording
from kinedex.pipelines.tracking.tracking_tasks import filled_gaps
from kinedex.storage.store.store import open_store
from kinedex.storage.store.take_removal import planned_removal, remove_takes
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.pipelines.tracking.tracks import FILMED, PATTERNS, filmed_archive, run


def kinedex(*arguments: object, code: int = 0) -> str:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert done.exit_code == code, done.output
    return done.stdout if code == 0 else done.output


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An archive of four clips, one of which is filmed."""
    folder = tmp_path_factory.mktemp("stabilise")
    filmed_archive(folder)
    run(folder)
    return folder


def test_the_takes_are_tracked_stabilised_and_near_the_truth(folder: Path) -> None:
    store = open_store(folder / "store")
    assert {f"{FILMED}_tracked", f"{FILMED}_stabilised"} <= set(store.take_ids)
    metrics = {row["take"]: row for row in store.result("track_metrics").to_pylist() if row["scope"] == "take"}
    assert set(metrics) == {f"{FILMED}_tracked", f"{FILMED}_stabilised"}
    # the body of the archive is a doll with feet of 0.7 m: how accurate tracks are is measured elsewhere
    assert max(row["mean_mm"] for row in metrics.values()) < 150
    assert [one.problem for one in verify(store)] == []
    count = store.sql("SELECT count(*) AS n FROM feature_runs JOIN takes USING (take_id) WHERE format = 'track'")
    assert count.to_pylist()[0]["n"] > 0


def test_results_describe_recordings_cameras_frames_and_priors(folder: Path) -> None:
    store = open_store(folder / "store")
    row = store.sql("SELECT source_frames, len(cameras) AS cameras FROM recordings").to_pylist()[0]
    frames, cameras = row["source_frames"], row["cameras"]
    assert cameras == 4
    for take in (f"{FILMED}_tracked", f"{FILMED}_stabilised"):
        for kind, expected in (("chain_poses", frames), ("track_frames", frames), ("track_cameras", cameras)):
            found = store.sql(f"SELECT count(*) AS n FROM {kind} WHERE take = '{take}'").to_pylist()[0]["n"]
            assert found == expected, (take, kind)
    poses = store.sql("SELECT len(place) AS p, len(turns) AS t FROM chain_poses LIMIT 1").to_pylist()[0]
    assert poses == {"p": 3, "t": 60}
    assert set(store.result("priors").column("class").to_pylist()) <= {"hop", "sway"}
    lent = "SELECT count(DISTINCT hit) FILTER (kept) AS n FROM priors p WHERE p.take = t.take AND round = t.rounds"
    for row in store.sql(f"SELECT hits, ({lent}) AS n FROM tracks t WHERE track_of IS NOT NULL").to_pylist():
        assert row["hits"] == row["n"]
    stored = stored_recording(store, FILMED)
    assert stored.recording is not None
    assert stored.recording.pixels.shape[:2] == (frames, cameras)
    assert np.nanmax(stored.recording.confidence) <= 1


def test_the_command_takes_templates_clips_and_classes_as_the_pipeline_does(folder: Path) -> None:
    shown = kinedex("stabilise", folder / "store", f"{FILMED}_tracked", "--rounds", 1)
    assert f"{FILMED}_tracked: up to date as {FILMED}_stabilised" in shown


def test_what_is_unchanged_is_not_done_again(folder: Path) -> None:
    first, second = run(folder), run(folder)
    assert set(first.ran) <= {"ingest", "index"}
    assert second.ran == ()
    before = open_store(folder / "store").result("chain_poses").drop_columns(["run"])
    run_pipeline(
        "stabilise", folder / "store", executor="serial", force=("track", "stabilise"),
        settings={"source": str(folder / "source"), "recordings": str(folder / "sim" / "recordings.yaml"),
                  "patterns": PATTERNS, "stabilise.rounds": 1},
    )  # fmt: skip
    assert open_store(folder / "store").result("chain_poses").drop_columns(["run"]).equals(before)


def test_a_removed_track_is_made_again(folder: Path) -> None:
    path = folder / "store"
    with StoreWriter.open(path, open_store(path).feature_set) as writer:
        remove_takes(writer, planned_removal(writer.store, [f"{FILMED}_tracked"]))
    assert "track" in run(folder).ran
    assert f"{FILMED}_tracked" in open_store(path, at="newest").take_ids


def test_the_page_shows_takes_before_and_after_with_rays(folder: Path) -> None:
    page = (folder / "store" / "results" / "reports" / "stabilise" / "stabilised.html").read_text()
    data = json.loads(re.search(r'id="motions">(.*?)</script>', page, re.DOTALL)[1])  # type: ignore[index]
    assert {one["take"] for one in data["motions"]} == {f"{FILMED}_tracked", f"{FILMED}_stabilised"}
    assert [one["name"] for one in data["rays"][0]["cameras"]] == ["cam1", "cam2", "cam3", "cam4"]
    assert "Residuals of rays" in page
    assert "Distance from the truth" in page
    assert "1 stabilised take. " in page
    for row in open_store(folder / "store").result("priors").to_pylist():
        assert f"<span>{row['class']}</span>" in page


def test_a_take_without_cameras_is_stabilised_by_a_command(folder: Path) -> None:
    shown = json.loads(kinedex("stabilise", folder / "store", "x_bo_sway_1", "--rounds", 1, "--json"))
    (one,) = shown["takes"]
    assert (one["take"], one["stabilised"], one["recording"]) == ("x_bo_sway_1", "x_bo_sway_1_stabilised", None)
    assert {"class", "cost", "kept"} <= set(one["priors"][0])
    assert shown["remarks"] == []
    again = kinedex("stabilise", folder / "store", "x_bo_sway_1", "--rounds", 1, "--explain")
    assert "as x_bo_sway_1_stabilised" in again
    assert "no take 'x_bo_swya_1'" in kinedex("stabilise", folder / "store", "x_bo_swya_1", code=1)
    wrong = kinedex("stabilise", folder / "store", "x_bo_sway_1", "--priors", "pse", code=1)
    assert "priors: should be 'archive', 'pose' or 'logical', got 'pse'" in wrong


def test_logical_priors_without_locomotion_are_reported_with_the_way_to_it(folder: Path, tmp_path: Path) -> None:
    command = ("stabilise", folder / "store", "x_bo_sway_1", "--rounds", 1, "--priors", "logical", "--json")
    (remark,) = json.loads(kinedex(*command))["remarks"]
    assert "no class has `locomotion: true`" in remark
    assert "--classes FILE" in remark
    classes = tmp_path / "classes.yaml"
    classes.write_text("hop: {subclasses: [hop], locomotion: true}\n")
    assert json.loads(kinedex(*command, "--classes", classes))["remarks"] == []
    wrong = kinedex("stabilise", folder / "store", "x_bo_sway_1", "--classes", "synthetic", code=1)
    assert "the archive has no subclass 'walk4StepsLstart'" in " ".join(wrong.split())


def test_a_track_with_gaps_is_filled_which_is_reported() -> None:
    places = np.zeros((6, 3, 3))
    places[1:3, 0] = np.nan
    places[:, 2] = np.nan  # a joint that the track never has
    body = ChainBody(load_kinematic_chain(), np.zeros((len(load_kinematic_chain().joints), 3)))
    observed = Observed(body, 30.0, JointPositions(places, np.full((6, 3), 0.02)))
    assert filled_gaps(observed) == "; gaps in 2 frames filled"
    assert filled_gaps(replace(observed, observations=JointPositions(places[3:], np.full((3, 3), 0.02)))) == ""


def test_the_first_track_reports_that_kernels_are_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    band = tracking_runs.solve_band
    fake = SimpleNamespace(stats=SimpleNamespace(cache_path=str(tmp_path)), __name__="solve_band")
    monkeypatch.setattr(tracking_runs, "solve_band", fake)
    assert not tracking_runs.are_kernels_compiled()
    (tmp_path / "band.solve_band-227.py311.nbi").touch()
    assert tracking_runs.are_kernels_compiled()
    monkeypatch.setattr(tracking_runs, "solve_band", band)
    assert tracking_runs.are_kernels_compiled(), "the takes of this module were tracked"


def test_an_archive_without_classes_is_refused_with_ways_out_that_work(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "clips" / "hop").mkdir(parents=True)
    for name in ("x.asf", "x_bo_hop_1.amc"):
        shutil.copy(folder / "source" / name, tmp_path / "clips" / "hop" / name)
    store = tmp_path / "store"
    kinedex("ingest", store, tmp_path / "clips", "--workers", 1)
    refused = " ".join(kinedex("stabilise", store, "x_bo_hop_1", code=1).split())
    assert "neither templates nor takes whose class is known" in refused
    (tmp_path / "recordings.yaml").write_text("recordings: {again: {track: x_bo_hop_1}}\n")
    kinedex("track", store, tmp_path / "recordings.yaml", "--executor", "serial")
    given = re.search(r'--set "(ingest\.patterns=.*?)"', refused)[1]  # type: ignore[index]
    kinedex("ingest", store, tmp_path / "clips", "--workers", 1, "--set", given)
    kinedex("stabilise", store, "x_bo_hop_1", "--rounds", 1)


def test_a_stabilised_take_is_neither_stabilised_again_nor_replaced_by_that_of_another(folder: Path) -> None:
    again = kinedex("stabilise", folder / "store", f"{FILMED}_stabilised", code=1)
    assert f"is stabilised already; stabilise '{FILMED}_tracked' again" in " ".join(again.split())
    other = kinedex("stabilise", folder / "store", FILMED, code=1)
    assert f"would become '{FILMED}_stabilised', and so does '{FILMED}_tracked'" in " ".join(other.split())


def test_a_recordings_file_that_is_wrong_is_refused_with_its_line(folder: Path, tmp_path: Path) -> None:
    file = tmp_path / "wrong.yaml"
    file.write_text("recordings:\n  one: {cameras: calib.toml, rate_hz: 60}\n")
    with pytest.raises(KinedexError, match=r"wrong\.yaml:2"):
        run_pipeline("track", folder / "store", settings={"recordings": str(file)}, executor="serial")
