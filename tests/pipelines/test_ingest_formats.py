"""Ingest of mixed archives: formats side by side, skeletons found by names, and reports of faults."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_skeleton
from kinedex.console.terminal import Terminal
from kinedex.ops.errors import KinedexError
from kinedex.ops.words import ALL_KNOWN
from kinedex.pipelines.export.data_set import export_take
from kinedex.pipelines.export.request import ClipOptions
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.formats.motion.body_models import BODY
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import verify
from tests.bodies import STANDING, standing
from tests.bvh_files import bvh_text, dance, mixamo, small, still
from tests.pipelines.archives import context, write_archive

JOINTS = load_feature_set().joints
AMASS = load_skeleton("smpl-amass", JOINTS)


def bring_in(store: Path, source: Path, executor: str = "serial", **params: object) -> tuple[dict[str, object], str]:
    """The stage's summary, and its output on the terminal."""
    output = io.StringIO()
    stage = replace(context(store, executor=executor), terminal=Terminal(Console(file=output, width=400)))
    return Ingest().run(stage, Ingest.parameters(source=str(source), **params)), output.getvalue()  # type: ignore[arg-type]


def write_bvh(path: Path, frames: int, *, seed: int = 0, frame_time: str = "0.0333333") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(bvh_text(mixamo(), dance(mixamo(), frames, seed), frame_time=frame_time))


@pytest.fixture
def source(tmp_path: Path) -> Path:
    root = write_archive(tmp_path / "source", {"a/x_1.amc": 50})
    write_bvh(root / "b" / "wave.bvh", 31)
    write_bvh(root / "b" / "fast.BVH", 41, seed=1, frame_time=".0083333")
    return root


def rows(store: Store) -> list[dict[str, object]]:
    return store.takes().to_dicts()


@pytest.mark.parametrize("executor", ["serial", "processes"])
def test_acclaim_and_bvh_files_come_in_side_by_side(tmp_path: Path, source: Path, executor: str) -> None:
    summary, _ = bring_in(tmp_path / "store", source, executor)
    assert (summary["takes"], summary["left_out"]) == (3, 0)
    fast, wave, x = rows(open_store(tmp_path / "store"))
    assert [(row["name"], row["format"], row["skeleton"]) for row in (fast, wave, x)] == [
        ("fast", "bvh", "mixamo"),
        ("wave", "bvh", "mixamo"),
        ("x_1", "amc", "acclaim"),
    ]
    assert [row["source_rate_hz"] for row in (fast, wave, x)] == [120.0, 30.0, 120.0]
    assert [row["frames"] for row in (fast, wave, x)] == [11, 31, 13]
    assert [row["skeleton_source"] for row in (fast, wave, x)] == [None, None, "x.asf"]
    assert wave["unit"] == "0.01 m (guessed)"
    assert verify(open_store(tmp_path / "store", at="newest")) == []


def test_a_second_run_reads_nothing_and_the_rate_of_acclaim_files_does_not_touch_bvh(
    tmp_path: Path, source: Path
) -> None:
    bring_in(tmp_path / "store", source)
    assert bring_in(tmp_path / "store", source)[0]["read"] == 0
    assert bring_in(tmp_path / "store", source, rate_hz=60.0)[0]["read"] == 1
    rates = {row["name"]: row["source_rate_hz"] for row in rows(open_store(tmp_path / "store"))}
    assert rates == {"fast": 120.0, "wave": 30.0, "x_1": 60.0}
    assert bring_in(tmp_path / "store", source, rate_hz=60.0, override_rate_hz=120.0)[0]["read"] == 3
    assert set(open_store(tmp_path / "store").takes()["source_rate_hz"]) == {120.0}


def test_broken_bvh_files_are_logged_with_file_and_line_and_the_rest_comes_in(tmp_path: Path, source: Path) -> None:
    text = (source / "b" / "wave.bvh").read_text()
    (source / "cut.bvh").write_text(text[:-9])
    (source / "names.bvh").write_text(bvh_text(small(), still(small(), 9)))
    (source / "other_names.bvh").write_text(text.replace("mixamorig:LeftUpLeg", "Thigh.L"))
    (source / "roots.bvh").write_text(text.replace("MOTION", "ROOT other\n{\n  OFFSET 0 0 0\n}\nMOTION"))
    summary, output = bring_in(tmp_path / "store", source)
    assert (summary["takes"], summary["left_out"]) == (5, 2)
    log = {row["source"]: row for row in open_store(tmp_path / "store").result("ingest_log").to_pylist()}
    assert "cut off in the middle of a frame" in log["cut.bvh"]["message"]
    assert log["cut.bvh"]["line"] == text.count("\n")
    assert "no skeleton mapping fits its names, and no body is recognised" in log["names.bvh"]["message"]
    assert output.count("excluded:") == 2


def test_formats_that_are_not_read_are_said_with_the_way_out(tmp_path: Path, source: Path) -> None:
    (source / "b" / "dance.bip").write_bytes(b"Biped")
    (source / "b" / "dance.HTR").write_bytes(b"[Header]")
    summary, output = bring_in(tmp_path / "store", source)
    assert summary["not_read"] == 2
    assert "1 file of a format not read (.bip): export it as BVH" in output
    assert "1 file of a format not read (.htr)" in output
    (tmp_path / "only").mkdir()
    (tmp_path / "only" / "dance.bip").write_bytes(b"Biped")
    with pytest.raises(KinedexError, match=r"no motion files \(.amc, .bvh, .* below .* \(.bip\): export it as BVH"):
        bring_in(tmp_path / "other", tmp_path / "only")


def test_one_take_in_two_formats_is_two_takes_named_with_their_endings(tmp_path: Path, source: Path) -> None:
    write_bvh(source / "a" / "x_1.bvh", 9)
    for rule in ("stem", "path", "file"):
        summary, _ = bring_in(tmp_path / rule, source, name=rule)
        assert summary["left_out"] == 0
        names = [row["name"] for row in rows(open_store(tmp_path / rule))]
        others = {"stem": ["fast", "wave"], "path": ["b/fast", "b/wave"], "file": ["b/fast.BVH", "b/wave.bvh"]}
        assert names == ["a/x_1.amc", "a/x_1.bvh", *others[rule]]


def test_a_joint_that_the_skeleton_lacks_switches_its_features_off_and_the_take_says_which(
    tmp_path: Path, source: Path
) -> None:
    shipped = load_skeleton("mixamo", JOINTS).path.read_text()
    own = tmp_path / "own.yaml"
    own.write_text(shipped.replace("lfingers: [LeftHandMiddle1, LeftHandIndex1", "lfingers: [LeftPaw").replace(
        "{virtual: {lelbow: -0.25, lwrist: 1.25}}", "null"
    ))  # fmt: skip
    bring_in(tmp_path / "store", source, skeleton=str(own))
    store = open_store(tmp_path / "store")
    (wave,) = (row for row in rows(store) if row["name"] == "wave")
    assert wave["warnings"][:2] == [  # type: ignore[index]
        "skeleton mapping 'mixamo' has no lfingers; these features are unknown: F14 lhand_fast, F34 lhand_lowered",
        "without lfingers these features use the other joints only: F17 rfoot_raised, F18 lfoot_raised, "
        "F33 rhand_lowered, F37 body_low",
    ]
    every = store.words()
    assert every.known is not None
    assert wave["known"] == (1 << 40) - 1 - (1 << 13) - (1 << 33)
    assert set(every.known.tolist()) == {wave["known"], int(ALL_KNOWN)}  # those of other formats know all
    words = store.words([wave["take_id"]]).words  # type: ignore[list-item]
    assert not ((words >> np.uint64(13)) & np.uint64(1)).any()
    fingers = store.frames("wave").column("lfingers").combine_chunks()
    assert np.isnan(fingers.field("x").to_numpy()).all()
    assert verify(store) == []


@pytest.mark.parametrize(
    ("form", "skeleton", "apart_m"),
    [("bvh", "named", 0.03), ("csv", "named-positions", 1e-5)],  # a BVH holds the joints as near as its bones reach
)
def test_a_take_that_was_exported_comes_back(
    tmp_path: Path, source: Path, form: str, skeleton: str, apart_m: float
) -> None:
    bring_in(tmp_path / "store", source)
    store = open_store(tmp_path / "store")
    (tmp_path / "out").mkdir()
    for take in ("wave", "x_1"):
        export_take(store, take, ClipOptions(form, joints=True), tmp_path / "out" / f"{take}.{form}")
    (tmp_path / "out" / "ground_truth.csv").write_text("take,class,start,stop\n")
    assert bring_in(tmp_path / "again", tmp_path / "out", rate_hz=30.0)[0]["left_out"] == 0
    again = open_store(tmp_path / "again")
    assert set(again.takes()["skeleton"]) == {skeleton}
    assert verify(again) == []
    for take in ("wave", "x_1"):
        before, after = (joint_positions(opened.frames(take), JOINTS) for opened in (store, again))
        np.testing.assert_allclose(after, before, atol=apart_m)


def test_positions_come_in_beside_other_formats_and_frames_in_long_gaps_have_no_word(
    tmp_path: Path, source: Path
) -> None:
    track = np.moveaxis(standing(40), 2, 0).copy()
    track[10:20, JOINTS.index("rwrist")] = np.nan
    np.savez(source / "b" / "seen.npz", positions=track, names=np.array(JOINTS), rate_hz=60)
    summary, _ = bring_in(tmp_path / "store", source)
    assert (summary["takes"], summary["left_out"]) == (4, 0)
    (seen,) = (row for row in rows(open_store(tmp_path / "store")) if row["name"] == "seen")
    assert (seen["format"], seen["skeleton"], seen["source_rate_hz"]) == ("npz", "named-positions", 60.0)
    assert (seen["frames"], seen["invalid_frames"]) == (20, 5)
    assert "`fill_gap_frames: 10` closes all gaps" in str(seen["warnings"])
    words = open_store(tmp_path / "store").frames("seen").column("word")
    assert [word is None for word in words.to_pylist()] == [5 <= t < 10 for t in range(20)]
    assert verify(open_store(tmp_path / "store", at="newest")) == []
    summary, _ = bring_in(tmp_path / "store", source, fill_gap_frames=10)
    assert (summary["takes"], summary["read"]) == (4, 1)
    (seen,) = (row for row in rows(open_store(tmp_path / "store")) if row["name"] == "seen")
    assert seen["invalid_frames"] == 0
    assert bring_in(tmp_path / "store", source, fill_gap_frames=10)[0]["read"] == 0


def test_joint_angles_come_in_with_a_body_model_and_are_read_again_with_another(tmp_path: Path) -> None:
    (tmp_path / "source").mkdir()
    model = tmp_path / "model.csv"
    placed = {mix.node: STANDING[joint] for joint, mixes in AMASS.joints.items() if (mix := mixes[0]) and mix.node}
    rest = [(name, *placed.get(name, STANDING["chest"])) for name in BODY]
    model.write_text("joint,x,y,z\n" + "\n".join(f"{name},{x},{y},{z}" for name, x, y, z in rest))
    poses = np.zeros((60, 156))
    poses[:, 0] = np.pi / 2
    np.savez(tmp_path / "source" / "walk_poses.npz", poses=poses, trans=np.zeros((60, 3)), mocap_framerate=60)
    with pytest.raises(KinedexError, match="the only file could not be read; the reasons are above"):
        bring_in(tmp_path / "store", tmp_path / "source")
    (message,) = open_store(tmp_path / "store").result("ingest_log").column("message").to_pylist()
    assert "give `body_model`" in message
    summary, _ = bring_in(tmp_path / "store", tmp_path / "source", body_model=str(model))
    assert (summary["takes"], summary["left_out"]) == (1, 0)
    (row,) = rows(open_store(tmp_path / "store"))
    assert (row["format"], row["skeleton"], row["frames"], row["invalid_frames"]) == ("npz", "smpl-amass", 30, 0)
    assert bring_in(tmp_path / "store", tmp_path / "source", body_model=str(model))[0]["read"] == 0
    model.write_text(model.read_text() + "\nleft_hand,0.3,0.7,0")
    assert bring_in(tmp_path / "store", tmp_path / "source", body_model=str(model))[0]["read"] == 1


@pytest.mark.shared
def test_marker_files_of_several_vendors_come_in_and_the_others_say_what_they_lack(
    shared: Path, tmp_path: Path
) -> None:
    bring_in(tmp_path / "store", shared / "data" / "c3d")
    store = open_store(tmp_path / "store")
    takes = {row["name"]: row for row in rows(store)}
    assert {name: takes[name]["skeleton"] for name in ("HDM_bd_05-01_01_120", "Qualisys", "BTS", "Vicon")} == {
        "HDM_bd_05-01_01_120": "hdm05-c3d",
        "Qualisys": "recognised markers",
        "BTS": "recognised markers",
        "Vicon": "recognised markers",
    }
    assert takes["HDM_bd_05-01_01_120"]["invalid_frames"] == 0
    assert takes["BTS"]["invalid_frames"] > 0  # type: ignore[operator]
    assert takes["03_rolling"]["frames"] > takes["03_rolling"]["invalid_frames"] > 0  # type: ignore[operator]
    log = {row["source"]: row["message"] for row in store.result("ingest_log").to_pylist()}
    assert set(log) == {"Optotrak.c3d"}
    assert all("no human body is recognised" in message for message in log.values())
    assert verify(store) == []
