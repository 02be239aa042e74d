"""The stage break_track: broken limbs beside the true ones, and the files of labels."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinedex.ops.inertial.rotations import distance_deg
from kinedex.pipelines.inertial.limb_motion import StoredLimbs, stored_limbs
from kinedex.pipelines.inertial.simulated_errors import LimbLabel, label_text
from kinedex.pipelines.stages.break_track import BreakTrack
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.pipelines.stages.limb_orientations import LimbOrientations
from kinedex.storage.formats.labels.label_tables import read_csv
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from tests.pipelines.archives import context, write_archive

pytest.importorskip("scipy")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("broken")
    write_archive(folder / "source", {"x_al_hop_1.amc": 1200, "x_bo_sway_1.amc": 30})
    Ingest().run(context(folder / "store"), Ingest.parameters(source=str(folder / "source")))
    LimbOrientations().run(context(folder / "store", "limb_orientations"), LimbOrientations.parameters())
    run(folder / "store", seed=3)
    return folder / "store"


def run(store: Path, **params: object) -> dict[str, object]:
    given = BreakTrack.parameters(**params)
    place = replace(context(store, "break_track"), uses="break_track", inputs={"limbs": "limb_orientations"})
    return BreakTrack().run(place, given)


def limbs(store: Path, stage: str) -> StoredLimbs:
    return next(stored_limbs(open_store(store), f"test/{stage}", ["x_al_hop_1"]))


def rows(store: Path, name: str) -> list[dict[str, str]]:
    with (store / "results" / "reports" / "test" / name).open() as file:
        return list(csv.DictReader(file))


def test_labels_say_where_limbs_are_wrong(store: Path) -> None:
    before, after = limbs(store, "limb_orientations"), limbs(store, "break_track")
    truth = rows(store, "limb_truth.csv")
    assert {row["take"] for row in truth} == {"x_al_hop_1", "x_bo_sway_1"}, "also a take without errors"
    for name, one in before.limbs.items():
        off = distance_deg(one.orientation, after.limbs[name].orientation)
        marked = np.zeros(len(off), bool)
        for row in truth:
            if (row["take"], row["limb"]) == ("x_al_hop_1", name):
                marked[int(row["start"]) : int(row["stop"])] = True
        assert (marked == (off >= 20.0)).all()
        if name in ("torso", "pelvis", "head"):
            assert off.max() < 1e-9
    assert sum(row["class"] == "error" for row in truth) > 10


def test_two_annotators_mark_them_each_in_an_own_way(store: Path) -> None:
    labels = rows(store, "limb_labels.csv")
    names = {row["annotator"] for row in labels if row["annotator"]}
    assert names == {"simulated A1", "simulated A2"}
    first, second = ([row for row in labels if row["annotator"] == name] for name in sorted(names))
    assert [row["start"] for row in first] != [row["start"] for row in second]
    read = read_csv(store / "results" / "reports" / "test" / "limb_labels.csv")
    assert set(read.takes) == {"x_al_hop_1", "x_bo_sway_1"}
    assert {segment.label for segment in read.segments} == {"error"}
    assert verify(open_store(store)) == []


def test_a_seed_repeats_errors_and_labels(store: Path) -> None:
    before = (store / "results" / "reports" / "test" / "limb_labels.csv").read_bytes()
    broken = limbs(store, "break_track").limbs["lhand"].orientation
    run(store, seed=4)
    assert (store / "results" / "reports" / "test" / "limb_labels.csv").read_bytes() != before
    run(store, seed=3)
    assert (store / "results" / "reports" / "test" / "limb_labels.csv").read_bytes() == before
    np.testing.assert_array_equal(limbs(store, "break_track").limbs["lhand"].orientation, broken)


def test_noise_moves_every_limb_a_little(store: Path, tmp_path: Path) -> None:
    import shutil

    shutil.copytree(store, tmp_path / "store")
    run(tmp_path / "store", limbs=["lhand"], noise_deg=1.5, annotators=0)
    before, after = limbs(tmp_path / "store", "limb_orientations"), limbs(tmp_path / "store", "break_track")
    off = distance_deg(before.limbs["torso"].orientation, after.limbs["torso"].orientation)
    assert np.sqrt(np.mean(off**2)) == pytest.approx(1.5, abs=0.4)
    assert rows(tmp_path / "store", "limb_labels.csv")[0]["annotator"] == ""


def test_names_that_a_spreadsheet_would_compute_are_guarded() -> None:
    text = label_text(["=1+1", "b"], [LimbLabel("b", "lhand", 3, 9, "A1")])
    assert text.splitlines() == ["take,class,start,stop,limb,annotator", "'=1+1,,,,,", "b,error,3,9,lhand,A1"]
