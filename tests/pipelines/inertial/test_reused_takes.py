"""Stages of sensors run again: unchanged takes are reused, and the results are those of a run over all takes."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import pyarrow as pa
import pytest

from kinedex.pipelines.stages.break_track import BreakTrack
from kinedex.pipelines.stages.calibrate_sensors import CalibrateSensors
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.pipelines.stages.limb_errors import LimbErrors
from kinedex.pipelines.stages.limb_orientations import LimbOrientations
from kinedex.pipelines.stages.synchronise import Synchronise
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from tests.pipelines.archives import context, write_archive
from tests.pipelines.inertial.test_synchronise_calibrate import put_sensors

pytest.importorskip("scipy")

INPUTS = {
    "sensors": "read_imu",
    "limbs": "limb_orientations",
    "broken": "break_track",
    "clocks": "synchronise",
    "mounts": "calibrate_sensors",
}
KINDS = ("limb_orientations", "sensor_sync", "sensor_calibration", "limb_errors", "limb_error_runs")
FILES = ("limb_labels.csv", "limb_truth.csv")


def run(folder: Path, store: str, *sources: Path, anew: bool = False) -> dict[str, object]:
    """Run all stages, after takes were ingested from folders, and return how many takes each has reused."""

    def step(stage: object, name: str, **params: object) -> object:
        place = dataclasses.replace(
            context(folder / store, name), inputs=INPUTS, uses=name, code="" if name == "ingest" else "c", anew=anew
        )
        return stage.run(place, stage.parameters(**params)).get("unchanged")

    for source in sources:
        step(Ingest(), "ingest", source=str(source), patterns=[r"x_(?P<actor>[a-z]+)_[a-z]+_\d"])
    reused = {"limbs": step(LimbOrientations(), "limb_orientations", where="true", limbs=["lshank", "rhand", "torso"])}
    put_sensors(folder, store=store)
    reused["broken"] = step(BreakTrack(), "break_track", limbs=["lshank"])
    reused["clocks"] = step(Synchronise(), "synchronise")
    reused["mounts"] = step(CalibrateSensors(), "calibrate_sensors", **{"from": "actor"})
    reused["errors"] = step(LimbErrors(), "limb_errors")
    return reused


def results(folder: Path, store: str, *without: str) -> list[pa.Table | bytes]:
    """Return all rows of the stages, and their label files."""
    found = open_store(folder / store, at="newest")
    tables = []
    for kind in KINDS:
        for stage in sorted({part.stage for part in found.manifest.results[kind]}):
            rows = found.result(kind, stage=stage)
            tables.append(rows.drop_columns([name for name in without if name in rows.column_names]))
    return [*tables, *((folder / store / "results/reports/test" / name).read_bytes() for name in FILES)]


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of two takes through all stages."""
    made = tmp_path_factory.mktemp("reused")
    write_archive(made / "source", {"x_al_hop_1.amc": 600, "x_bo_sway_1.amc": 600})
    assert set(run(made, "store", made / "source").values()) == {0}
    return made


def test_a_new_take_costs_no_other_take_and_the_results_are_those_of_a_fresh_store(two: Path, tmp_path: Path) -> None:
    shutil.copytree(two / "store", tmp_path / "store")
    more = write_archive(tmp_path / "more", {"x_al_hop_2.amc": 600}, 2)
    assert run(tmp_path, "store", more) == {"limbs": 2, "broken": 2, "clocks": 2, "mounts": 1, "errors": 1}
    once = results(tmp_path, "store")
    assert verify(open_store(tmp_path / "store", at="newest")) == []
    run(tmp_path, "fresh", more, two / "source")
    names = ("take_id", "fingerprint")
    for one, other in zip(results(tmp_path, "store", *names), results(tmp_path, "fresh", *names), strict=True):
        assert one == other
    assert set(run(tmp_path, "store", anew=True).values()) == {0}
    assert results(tmp_path, "store") == once


def test_changed_labels_and_damaged_parts_are_made_again(two: Path, tmp_path: Path) -> None:
    shutil.copytree(two / "store", tmp_path / "store")
    once = results(tmp_path, "store")
    labels = tmp_path / "store/results/reports/test/limb_labels.csv"
    labels.write_text(labels.read_text().replace("x_al_hop_1,error,", "x_al_hop_1,error,1"))
    (part,) = open_store(tmp_path / "store", at="newest").manifest.results["limb_error_runs"]
    path = tmp_path / "store" / part.path
    path.write_bytes(path.read_bytes()[:-1] + b"!")
    assert run(tmp_path, "store") == {"limbs": 2, "broken": 1, "clocks": 2, "mounts": 2, "errors": 0}
    assert results(tmp_path, "store") == once
