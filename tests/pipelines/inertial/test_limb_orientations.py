"""The stage limb_orientations: limbs of takes from their sources, as the store keeps them."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.limbs import LIMB_NAMES
from kinedex.ops.errors import KinedexError
from kinedex.ops.inertial.limb_motion import common_markers
from kinedex.ops.inertial.rotations import distance_deg
from kinedex.pipelines.inertial.limb_motion import TakeLimbs, stored_limbs, take_limbs
from kinedex.pipelines.inertial.source_limbs import LimbTask, limb_tasks, read_limbs
from kinedex.pipelines.stages import limb_orientations as stage_module
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.pipelines.stages.limb_orientations import LimbOrientations
from kinedex.storage.formats.motion.body_limbs import BodyLimbs
from kinedex.storage.formats.motion.reader import Body
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import verify
from tests.bodies import standing
from tests.bvh_files import write_duet
from tests.pipelines.archives import context, write_archive

JOINTS = load_feature_set().joints
TAKES = {"x_al_hop_1.amc": 240, "x_bo_sway_1.amc": 120}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("limbs")
    write_archive(made / "source", TAKES)
    write_duet(made / "source" / "duet.bvh", 40)
    Ingest().run(context(made / "store"), Ingest.parameters(source=str(made / "source")))
    run(made)
    return made


def run(folder: Path, **params: object) -> dict[str, object]:
    given = LimbOrientations.parameters(**params)
    return LimbOrientations().run(context(folder / "store", "limb_orientations"), given)


def store_in(folder: Path) -> Store:
    return open_store(folder / "store", at="newest")


def test_every_limb_of_every_take_is_stored_at_the_source_rate(folder: Path) -> None:
    store = store_in(folder)
    rows = store.sql(
        "SELECT take, limb, count(*) AS n, max(basis) AS basis, max(t) AS t, bool_and(valid) AS valid "
        "FROM limb_orientations GROUP BY take, limb"
    ).to_pylist()
    assert {row["limb"] for row in rows} == set(LIMB_NAMES)
    assert {(row["take"], row["n"], round(row["t"], 6)) for row in rows if row["take"][0] == "x"} == {
        ("x_al_hop_1", 240, round(239 / 120, 6)),
        ("x_bo_sway_1", 120, round(119 / 120, 6)),
    }
    assert all(row["basis"] == "full" and row["valid"] for row in rows)
    assert len({row["take"] for row in rows}) == 4, "each person of a file of two"
    assert verify(store) == []


def test_stored_limbs_are_those_that_were_read(folder: Path) -> None:
    store = store_in(folder)
    (task,) = limb_tasks(store, ["x_al_hop_1"], LIMB_NAMES)
    read = read_limbs(task)
    (found,) = stored_limbs(store, "test/limb_orientations", ["x_al_hop_1"])
    assert (found.take, list(found.limbs)) == ("x_al_hop_1", list(read.limbs))
    assert found.rate_hz == pytest.approx(120.0)
    for limb, one in read.limbs.items():
        other = found.limbs[limb]
        np.testing.assert_array_equal(other.orientation, one.orientation)
        np.testing.assert_array_equal(other.position, one.position)
        np.testing.assert_array_equal(other.direction, one.direction)
        assert (other.valid == one.valid).all()
        assert (other.jump == one.jump).all()
    assert len(list(stored_limbs(store, "test/limb_orientations"))) == 4


def test_a_filter_and_a_list_choose_takes_and_limbs(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "store", tmp_path / "store")
    made = run(tmp_path, where="name LIKE 'x_al%'", limbs=["hands", "torso"])
    assert made["takes"] == 1
    limbs = store_in(tmp_path).sql("SELECT DISTINCT limb FROM limb_orientations ORDER BY limb").to_pylist()
    assert [row["limb"] for row in limbs] == ["lhand", "rhand", "torso"]
    with pytest.raises(KinedexError, match="no take fits"):
        run(tmp_path, where="name = 'nobody'")
    with pytest.raises(ValueError, match="no limb is named 'lshanc'; did you mean 'lshank'"):
        LimbOrientations.parameters(limbs=["lshanc"])


def test_a_source_that_is_gone_or_changed_is_named(tmp_path: Path) -> None:
    write_archive(tmp_path / "source", TAKES)
    Ingest().run(context(tmp_path / "store"), Ingest.parameters(source=str(tmp_path / "source")))
    path = tmp_path / "source" / "x_al_hop_1.amc"
    text = path.read_text()
    path.write_text(text + "\n")
    with pytest.raises(KinedexError, match=r"take 'x_al_hop_1': its source .*x_al_hop_1.amc has changed since"):
        run(tmp_path)
    path.unlink()
    with pytest.raises(KinedexError, match=r"x_al_hop_1.amc is not there.*kinedex ingest.*`where`"):
        run(tmp_path)
    assert run(tmp_path, where="name <> 'x_al_hop_1'")["takes"] == 1


def _segments(frames: int = 60, **more: object) -> BodyLimbs:
    positions = standing(frames).astype(np.float64)
    bend = np.radians(40 + 20 * np.sin(np.linspace(0, 6, frames)))
    knee, ankle = JOINTS.index("lknee"), JOINTS.index("lankle")
    length = np.linalg.norm(positions[ankle, :, 0] - positions[knee, :, 0])
    positions[ankle] = positions[knee] + length * np.stack([0 * bend, -np.cos(bend), -np.sin(bend)])
    body = Body(positions, np.full((4, frames), np.nan), 60.0, "1 m", "", **{"unknown": (), "warnings": (), **more})
    return BodyLimbs(body)


def test_joints_alone_give_hinges_the_trunk_and_directions() -> None:
    found = take_limbs(_segments(), JOINTS, LIMB_NAMES)
    basis = {name: one.basis for name, one in found.limbs.items()}
    assert {basis["pelvis"], basis["torso"]} == {"full"}
    assert {basis["lthigh"], basis["lshank"]} == {"hinge"}
    assert {basis["rthigh"], basis["rshank"]} == {"none"}, "that knee never bends"
    assert any(remark.startswith("rthigh: the hinge never bends") for remark in found.remarks)
    assert {basis["lhand"], basis["head"], basis["lfoot"]} == {"none"}
    hand = found.limbs["lhand"]
    assert hand.valid.all()
    assert np.isnan(hand.orientation).all()
    shank = found.limbs["lshank"]
    turn = distance_deg(shank.orientation[:1], shank.orientation)
    assert turn.max() == pytest.approx(40.0, abs=25.0)
    lacking = take_limbs(_segments(unknown=("lfingers",), estimated=("ltoes",)), JOINTS, ["lhand", "lfoot"]).lacking
    assert lacking == {
        "lhand": "the skeleton has no lfingers",
        "lfoot": "ltoes is estimated, and no node turns with the limb",
    }


def test_the_shoulders_show_how_the_torso_twists() -> None:
    segments = _segments()
    trunk = [JOINTS.index(joint) for joint in ("chest", "neck", "lshoulder", "rshoulder")]
    twist = np.radians(30 * np.sin(np.linspace(0, 6, 60)))
    for place in trunk:
        x, _, z = segments.body.positions[place].copy()
        segments.body.positions[place, 0] = np.cos(twist) * x + np.sin(twist) * z
        segments.body.positions[place, 2] = np.cos(twist) * z - np.sin(twist) * x
    torso = take_limbs(segments, JOINTS, ["torso"]).limbs["torso"]
    assert (torso.basis, torso.fit_m) == ("full", None)
    turned = distance_deg(torso.orientation[:1], torso.orientation)
    np.testing.assert_allclose(turned, np.degrees(np.abs(twist - twist[0])), atol=1e-6)


def test_a_marker_that_is_seldom_seen_is_left_out() -> None:
    markers = np.zeros((10, 4, 3))
    markers[:5, 0] = np.nan
    markers[3:, 1] = np.nan
    assert common_markers(markers).shape == (10, 3, 3)
    markers[:] = 0.0
    markers[:5, 0] = np.nan
    assert common_markers(markers).shape == (10, 4, 3)


def test_unchanged_takes_are_not_read_again_and_the_rows_are_those_of_a_run_at_once(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[str] = []

    def reading(task: LimbTask) -> TakeLimbs:
        read.append(task.take)
        return read_limbs(task)

    monkeypatch.setattr(stage_module, "read_limbs", reading)
    given = LimbOrientations.parameters()

    def again(code: str, where: str = "true", anew: bool = False) -> dict[str, object]:
        place = replace(context(tmp_path / "store", "limb_orientations"), code=code, anew=anew)
        read.clear()
        return LimbOrientations().run(place, given.model_copy(update={"where": where}))

    shutil.copytree(folder / "store", tmp_path / "store")
    assert again("a")["unchanged"] == 0, "another code"
    (whole,) = (store_in(tmp_path).result("limb_orientations"),)
    again("a", "name <> 'x_al_hop_1'")
    made = again("a")
    assert read == ["x_al_hop_1"]
    assert (made["takes"], made["unchanged"], made["frames"]) == (4, 3, 240 + 120 + 2 * 40)
    assert store_in(tmp_path).result("limb_orientations").equals(whole)
    assert again("a", anew=True)["unchanged"] == 0
    again("b")
    assert len(read) == 4
