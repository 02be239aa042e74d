"""Depth recordings become takes: frames, votes, errors, what stays unchanged, and what is odd about a frame."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

import kinedex
from kinedex.commands.cli import app
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.wording import listed_frames
from kinedex.ops.words import NO_WORD
from kinedex.pipelines.engine.runner import Outcome, run_pipeline
from kinedex.reports.reconstruction_page import POINTS, packed_points, reconstruction_page
from kinedex.storage.formats.depth.camera_file import read_camera
from kinedex.storage.formats.depth.png import read_depth_png, write_depth_png
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import verify
from tests.pipelines.reconstruction.recordings import FILMED, FRAMES, edit_recordings, filmed_by_depth


def command(*arguments: object, code: int = 0) -> str:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert done.exit_code == code, done.output
    return done.stdout if code == 0 else " ".join(done.output.split())


def run(folder: Path, **settings: object) -> Outcome:
    given = {"recordings": str(folder / "rec" / "recordings.yaml"), "reconstruct.direction": "forward", **settings}
    return run_pipeline("depth", folder / "store", settings=given, executor="serial")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an archive of four clips, recordings of two of them, and their takes."""
    folder = tmp_path_factory.mktemp("reconstruction")
    filmed_by_depth(folder)
    run(folder)
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    return tmp_path


def frames_of(store: Store, name: str) -> list[dict[str, object]]:
    return store.sql(
        f"SELECT * FROM reconstruction_frames WHERE take = '{name}_reconstructed' ORDER BY source_frame"
    ).to_pylist()


def test_a_recording_becomes_a_take_with_words_frames_and_votes(made: Path) -> None:
    store = open_store(made / "store")
    for name in FILMED:
        row = next(row for row in store.take_rows.to_pylist() if row["name"] == f"{name}_reconstructed")
        assert (row["format"], row["recording"], row["frames"], row["class"]) == ("depth", name, FRAMES, None)
        frames = frames_of(store, name)
        assert [one["source_frame"] for one in frames] == list(range(FRAMES))
        places = np.array([one["joints"] for one in frames]).reshape(FRAMES, len(JOINTS), 3)
        stored = kinedex.open_store(made / "store")[f"{name}_reconstructed"]
        order = [stored.joints.index(joint) for joint in JOINTS]
        assert np.allclose(stored.positions[:, order], places, atol=1e-5)
        true = kinedex.open_store(made / "store").positions(name)[:FRAMES]
        assert abs(places[..., 0].mean() - true[..., 0].mean()) < 0.3  # it stands where the take does
    winners = store.sql(
        "SELECT take, source_frame, count(*) AS n, sum(surface + extrema + points - cost) AS rest FROM depth_votes "
        "WHERE winner GROUP BY ALL"
    ).to_pylist()
    assert len(winners) == len(FILMED) * FRAMES
    assert all(one["n"] == 1 and abs(one["rest"]) < 1e-9 for one in winners)
    assert store.sql("SELECT count(*) AS n FROM depth_votes WHERE candidate > 0 AND archive_take IS NULL").to_pylist()[
        0
    ] == {"n": 0}
    assert [one.problem for one in verify(store)] == []


def test_the_winner_is_the_cheaper_hypothesis_and_the_frame_names_it(made: Path) -> None:
    store = open_store(made / "store")
    for row in store.sql("FROM reconstruction_frames").to_pylist():
        costs = {"local": row["cost_local"], "database": row["cost_database"]}
        known = {name: cost for name, cost in costs.items() if cost is not None}
        assert row["hypothesis"] == min(known, key=lambda name: (known[name], name != "local"))
        assert (row["hypothesis"] == "database") <= (row["archive_take"] in store.take_ids)
    first = store.sql("SELECT hypothesis FROM reconstruction_frames WHERE source_frame = 0").to_pylist()
    assert {row["hypothesis"] for row in first} == {"database"}


def test_what_is_unchanged_stays_and_what_has_changed_is_done_again(folder: Path) -> None:
    run(folder)  # a copy has other paths
    assert run(folder).ran == ()
    camera = folder / "rec" / FILMED[1] / "camera.yaml"
    camera.write_text(camera.read_text() + "\n# looked at\n")
    done = run(folder).summaries["reconstruct"]
    assert done == {**done, "unchanged": 1, "takes": [f"{name}_reconstructed" for name in FILMED]}
    before = open_store(folder / "store", at="newest").result("reconstructions").to_pylist()
    edit_recordings(folder, lambda entries: entries[FILMED[0]].pop("truth"))
    done = run(folder)
    assert "reconstruct" in done.skipped
    assert len(done.summaries["evaluate_reconstruction"]["without_truth"]) == 1
    assert open_store(folder / "store", at="newest").result("reconstructions").to_pylist() == before


def test_errors_are_of_takes_joints_and_all(made: Path) -> None:
    store = open_store(made / "store")
    rows = store.result("reconstruction_errors").to_pylist()
    takes = [row for row in rows if row["scope"] == "take"]
    assert {row["take"] for row in takes} == {f"{name}_reconstructed" for name in FILMED}
    assert all(
        row["frames"] == FRAMES and row["unseen_frames"] == 0 and 0 <= row["rate_five_ends"] <= 1 for row in takes
    )
    (whole,) = [row for row in rows if row["scope"] == "all"]
    assert whole["mean_m"] == pytest.approx(np.mean([row["mean_m"] for row in takes]))
    joints = [row["mean_m"] for row in rows if row["scope"] == "joint" and row["take"] == takes[0]["take"]]
    assert len(joints) == 20
    assert np.mean(joints) == pytest.approx(takes[0]["mean_m"])


def test_markers_are_judged_where_they_sit_on_their_body_part(folder: Path) -> None:
    name = FILMED[0]
    joints = [one["joints"] for one in frames_of(open_store(folder / "store"), name)]
    places = np.array(joints).reshape(FRAMES, len(JOINTS), 3)[:, JOINTS.index("lknee")] + (0.0, 0.0, 5.0)
    lines = ["time,KNEE_x,KNEE_y,KNEE_z"] + [f"{t / 30:.6f},{x},{y},{z}" for t, (x, y, z) in enumerate(places)]
    (folder / "rec" / "markers.csv").write_text("\n".join(lines) + "\n")
    pose = {"rotation": np.eye(3).tolist(), "place": [0.0, 0.0, -5.0]}

    def change(entries: dict[str, dict[str, object]]) -> None:
        entries[name].update(truth="markers.csv", markers={"KNEE": "lknee"}, truth_pose=pose)
        del entries[FILMED[1]]

    edit_recordings(folder, change)
    run(folder)
    rows = open_store(folder / "store", at="newest").result("reconstruction_errors").to_pylist()
    (marker,) = [row for row in rows if row["name"] == "KNEE"]
    assert marker["mean_m"] < 1e-6
    assert np.linalg.norm(marker["offset_m"]) < 1e-6
    edit_recordings(folder, lambda entries: entries[name].update(markers={"KNE": "lknee"}))
    with pytest.raises(kinedex.KinedexError, match=r"recordings.yaml:\d+: .*no marker 'KNE'; did you mean 'KNEE'"):
        run(folder)


def test_odd_frames_are_reported_and_the_others_go_on(folder: Path) -> None:
    name = FILMED[0]
    home = folder / "rec" / name
    camera = read_camera(home / "camera.yaml")
    room = read_depth_png(home / "background.png", camera)
    (home / "depth" / "000002.png").unlink()
    (home / "depth" / "000003.png").write_bytes(b"no image")
    write_depth_png(home / "depth" / "000004.png", room, 0.001)
    write_depth_png(home / "depth" / "000005.png", np.where(room > 0, room + 1.0, 0), 0.001)
    edit_recordings(folder, lambda entries: entries[name].update(rate_hz=15))
    run(folder, **{"reconstruct.only": [name]})
    store = open_store(folder / "store", at="newest")
    remarks = [one["remarks"] for one in frames_of(store, name)]
    assert [next(iter(one), "") for one in remarks[2:6]] == ["no image", "no image", "nobody", "camera moved"]
    row = next(row for row in store.take_rows.to_pylist() if row["name"] == f"{name}_reconstructed")
    text = " ".join(row["warnings"])
    for phrase in ("2 frames without an image, missing or damaged: 2–3", "1 frame damaged", "nobody is seen in 1 frame",
                   "behind the background; 1 frame not used: 5"):  # fmt: skip
        assert phrase in text, (phrase, text)
    words = store.words([store.take_ids[f"{name}_reconstructed"]]).take(0)
    assert (words == NO_WORD).any()
    assert not (words == NO_WORD).all()
    unseen = {row["recording"]: row["unseen_frames"] for row in store.result("reconstructions").to_pylist()}
    assert unseen == {name: 4, FILMED[1]: 0}


def test_the_command_explains_frames(folder: Path) -> None:
    store, file = folder / "store", folder / "rec" / "recordings.yaml"
    given = (store, file, "--only", FILMED[0], "--body", FILMED[0], "--set", "reconstruct.direction=both")
    assert "archive_frame" in command("reconstruct", *given, "--explain", "--frames", "2:3")
    output = command("reconstruct", *given, "--explain", "--frames", "2:4", "--json")
    document = json.loads(output[output.index("{") :])
    assert document["takes"] == [f"{FILMED[0]}_reconstructed"]
    votes = document["votes"]
    assert {one["source_frame"] for one in votes} == {2, 3}
    assert {one["direction"] for one in votes} == {"forward", "backward"}
    assert all(sum(one["winner"] for one in votes if one["source_frame"] == t) == 1 for t in (2, 3))
    assert "--explain" in command("reconstruct", *given, "--frames", "2:3", code=2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"body": "x_al_hop"}, "no take 'x_al_hop'; did you mean 'x_al_hop_1'"),
        ({"truth": "nothing"}, "truth 'nothing' is neither a take of the store nor a motion file"),
        ({"depth": "none/*.png"}, "none/*.png"),
    ],
)
def test_wrong_recordings_are_refused_with_the_key(folder: Path, change: dict[str, str], message: str) -> None:
    edit_recordings(folder, lambda entries: entries[FILMED[0]].update(change))
    with pytest.raises(kinedex.KinedexError) as fault:
        run(folder, **{"reconstruct.only": FILMED[0:1]})
    assert message in str(fault.value)


def test_intrinsics_that_do_not_fit_are_noted_and_a_recording_without_a_person_is_refused(folder: Path) -> None:
    name, home = FILMED[0], folder / "rec" / FILMED[0]
    camera = home / "camera.yaml"
    text = camera.read_text()
    camera.write_text(text.replace("206.0", "103.0"))
    run(folder, **{"reconstruct.only": [name]})
    rows = open_store(folder / "store", at="newest").result("reconstructions").to_pylist()
    remarks = " ".join(next(row for row in rows if row["recording"] == name)["remarks"])
    assert "in the background the floor lies 2.20 m below the camera, and by its `pose` 1.10 m: are fx, fy" in remarks
    assert "the body fits the points badly" in remarks
    camera.write_text(text)
    for path in (home / "depth").iterdir():
        shutil.copy(home / "background.png", path)
    with pytest.raises(kinedex.KinedexError, match=r"recordings.yaml:\d+: .*background: no frame shows a person"):
        run(folder, **{"reconstruct.only": [name]})


def test_a_camera_of_ones_own_gives_the_poses_of_the_stage(made: Path) -> None:
    name = FILMED[0]
    home = made / "rec" / name
    live = kinedex.Reconstructor(
        made / "store", home / "camera.yaml", body=name, background=home / "background.png", rate_hz=30
    )
    assert np.isnan(live.step(np.zeros((144, 176), np.uint16))).all()
    assert live.last is None
    camera = read_camera(home / "camera.yaml")
    for path, row in zip(sorted((home / "depth").iterdir()), frames_of(open_store(made / "store"), name), strict=True):
        pose = live.step(read_depth_png(path, camera))
        assert np.allclose(pose.ravel(), row["joints"], atol=1e-9)
    assert live.last is not None
    with pytest.raises(kinedex.KinedexError, match="shape"):
        live.step(np.zeros((4, 4)))


def test_frames_are_listed_as_ranges() -> None:
    assert listed_frames([3, 7, 8, 9, 12]) == "3, 7–9, 12"
    assert listed_frames(list(range(0, 40, 2))).endswith("14 and 12 more ranges")


def test_a_recording_that_cannot_be_read_leaves_the_others_their_takes(folder: Path) -> None:
    (folder / "rec" / FILMED[0] / "camera.yaml").write_text("width: 3\n")
    camera = folder / "rec" / FILMED[1] / "camera.yaml"
    camera.write_text(camera.read_text() + "\n# looked at\n")
    with pytest.raises(kinedex.KinedexError, match=r"camera.yaml(?s:.*)the other 1 take of this run is in the store"):
        run(folder)
    rows = open_store(folder / "store", at="newest").result("reconstructions").to_pylist()
    assert {row["recording"]: row["file"].startswith(str(folder)) for row in rows} == {
        FILMED[0]: False,
        FILMED[1]: True,
    }


def test_a_depth_frame_is_inspected_and_drawn(made: Path, tmp_path: Path) -> None:
    home = made / "rec" / FILMED[0]
    given = ("--camera", home / "camera.yaml", "--background", home / "background.png")
    output = command("inspect", home / "depth" / "000003.png", *given, "--picture", tmp_path / "frame.png", "--json")
    facts = {one["name"]: one["value"] for one in json.loads(output[output.index("{") :])["facts"]}
    assert facts["image"].startswith("176 × 144 pixels")
    assert facts["extrema"].startswith("1: pixel (")
    assert "--camera FILE" in command("inspect", home / "depth" / "000003.png", code=1)
    with Image.open(tmp_path / "frame.png") as picture:
        assert picture.size == (4 * 176, 4 * 144)
        assert len(picture.getcolors(1 << 20) or ()) > 20


def test_the_printed_form_goes_forward_with_one_candidate(folder: Path) -> None:
    run(folder, **{"reconstruct.only": [FILMED[0]], "reconstruct.form": "printed", "reconstruct.direction": "both"})
    store = open_store(folder / "store", at="newest")
    row = next(row for row in store.result("reconstructions").to_pylist() if row["recording"] == FILMED[0])
    assert (row["form"], row["direction"], row["candidates"]) == ("printed", "forward", 1)
    assert row["smooth_hz"] is None
    votes = store.sql(f"FROM depth_votes WHERE take = '{row['take']}'").to_pylist()
    assert {one["candidate"] for one in votes} == {None, 1}
    assert all(one["points"] in (None, 0.0) for one in votes)


@pytest.mark.slow
def test_workers_change_no_row(folder: Path) -> None:
    tables = []
    for executor in ("serial", "processes"):
        given = {"recordings": str(folder / "rec" / "recordings.yaml")}
        run_pipeline("depth", folder / "store", settings=given, executor=executor, workers=2, force=["reconstruct"])
        store = open_store(folder / "store", at="newest")
        found = [store.result(kind).drop_columns(["run"]) for kind in ("reconstruction_frames", "depth_votes")]
        tables.append([table.sort_by([("take", "ascending"), ("source_frame", "ascending")]) for table in found])
    assert [one.to_pylist() for one in tables[0]] == [one.to_pylist() for one in tables[1]]


def test_smoothed_takes_move_less_between_frames(folder: Path) -> None:
    def steps() -> float:
        frames = frames_of(open_store(folder / "store", at="newest"), FILMED[0])
        places = np.array([one["joints"] for one in frames]).reshape(FRAMES, len(JOINTS), 3)
        return float(np.linalg.norm(np.diff(places, 2, axis=0), axis=2).mean())

    rough = steps()
    run(folder, **{"reconstruct.only": [FILMED[0]], "reconstruct.smooth_hz": 3})
    assert steps() < 0.5 * rough


def test_a_second_person_is_reported_and_the_first_one_stays(folder: Path) -> None:
    home = folder / "rec" / FILMED[0]
    camera = read_camera(home / "camera.yaml")
    path = home / "depth" / "000006.png"
    image = read_depth_png(path, camera).copy()
    image[40:110, 146:172] = 2.3  # somebody stands beside
    write_depth_png(path, image, 0.001)
    before = frames_of(open_store(folder / "store"), FILMED[0])[6]
    run(folder, **{"reconstruct.only": [FILMED[0]]})
    after = frames_of(open_store(folder / "store", at="newest"), FILMED[0])[6]
    assert after["remarks"] == ["several people"]
    assert np.allclose(after["joints"][:3], before["joints"][:3], atol=0.1)  # not beside, 1 m away


def test_the_page_has_the_points_of_recordings_that_are_there(made: Path) -> None:
    with open_store(made / "store") as store:
        row = next(row for row in store.result("reconstructions").to_pylist() if row["recording"] == FILMED[0])
        found = packed_points(row, FRAMES, store.rate_hz)
        assert found is not None
        assert (found["take"], found["frames"], found["count"]) == (row["take"], FRAMES, POINTS)
        assert packed_points({**row, "file": str(made / "gone.yaml")}, FRAMES, store.rate_hz) is None
        page = reconstruction_page(store, "depth/reconstruct", "depth/evaluate_reconstruction", "Title <b>", 5)
    assert '"clouds":[{' in page
    assert "Title &lt;b&gt;" in page
    assert page.count('class="lent"') >= 1
    assert page.count('data-what="jump to ') >= len(FILMED)  # each begins with a pose of the archive
    assert 'data-near="1" data-near-start="0"' in page


def test_the_demo_films_the_synthetic_archive_alone(tmp_path: Path) -> None:
    assert "choose one" in command("demo", tmp_path / "store", "--depth", "--tracking", code=2)
    assert "leave out --data" in command("demo", tmp_path / "store", "--depth", "--data", tmp_path, code=2)
