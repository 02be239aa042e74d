"""The files of a folder decide the axis, rate or unit that one of them leaves open, and its warnings say so."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from kinedex.catalog.capture_sessions import decided_recipes, decisions_in, same_decisions
from kinedex.commands.cli import app
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.remedies import repair
from kinedex.storage.store.store import open_store
from tests.bodies import standing
from tests.bvh_files import bvh_text, dance, mixamo
from tests.oracles.features import JOINTS
from tests.pipelines.archives import context
from tests.storage.formats.motion.test_positions import trc

KEYPOINTS = {
    "lhip": "LHip", "rhip": "RHip", "lknee": "LKnee", "rknee": "RKnee", "lankle": "LAnkle", "rankle": "RAnkle",
    "ltoes": "LBigToe", "rtoes": "RBigToe", "neck": "Neck", "head": "Nose", "lshoulder": "LShoulder",
    "rshoulder": "RShoulder", "lelbow": "LElbow", "relbow": "RElbow", "lwrist": "LWrist", "rwrist": "RWrist",
}  # fmt: skip
"""Joint → keypoint of files that state no axes."""

LYING = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])

Rows = dict[str, dict[str, Any]]


def write(path: Path, body: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    chosen = np.einsum("ab,jbt->taj", Z_UP, body[[JOINTS.index(joint) for joint in KEYPOINTS]]).transpose(0, 2, 1)
    np.savez(path, positions=chosen, names=np.array(list(KEYPOINTS.values())), fps=30.0)


def half_lying() -> np.ndarray:
    """A body that stands in half of its frames and lies in the others: either may be the upright one."""
    return np.concatenate([standing(45), np.einsum("ab,jbt->jat", LYING, standing(45))], axis=2)


def take_in(store: Path, source: Path, executor: str = "serial") -> Rows:
    Ingest().run(context(store, executor=executor), Ingest.parameters(source=str(source)))
    return {row["name"]: row for row in open_store(store).takes().to_dicts()}


@pytest.mark.parametrize("executor", ["serial", "processes"])
def test_a_static_trial_decides_which_axis_is_up_in_the_motion_beside_it(tmp_path: Path, executor: str) -> None:
    write(tmp_path / "alone" / "get_up.npz", half_lying())
    write(tmp_path / "day" / "get_up.npz", half_lying())
    write(tmp_path / "day" / "static.npz", standing(60))
    alone = take_in(tmp_path / "first", tmp_path / "alone")["get_up"]
    assert alone["file_up"] == "y"
    assert any(one.startswith("no axis is clearly up") for one in alone["warnings"])
    assert any(one.endswith("y is taken") for one in alone["warnings"])
    beside = take_in(tmp_path / "second", tmp_path / "day", executor)["get_up"]
    assert beside["file_up"] == "z"
    assert any(one.endswith("z is taken, as in the other files of its folder") for one in beside["warnings"])
    heights = open_store(tmp_path / "second").sql(f"SELECT root.y FROM frames WHERE take_id = {beside['take_id']}")
    found = np.array(heights.column(0).to_pylist())
    assert (found[:40].min(), found[-40:].max()) == (pytest.approx(1.0, abs=0.1), pytest.approx(0.0, abs=0.1))


def test_a_file_that_comes_later_decides_the_same_as_if_it_had_been_there(tmp_path: Path) -> None:
    source = tmp_path / "day"
    write(source / "get_up.npz", half_lying())
    first = take_in(tmp_path / "grown", source)
    assert first["get_up"]["file_up"] == "y"
    write(source / "static.npz", standing(60))
    grown, fresh = take_in(tmp_path / "grown", source), take_in(tmp_path / "fresh", source)
    for name in grown:
        for column in ("file_up", "recipe", "warnings", "height_m", "floor_m"):
            assert grown[name][column] == fresh[name][column]
    again = Ingest().run(context(tmp_path / "grown"), Ingest.parameters(source=str(source)))
    assert (again["read"], again["unchanged"]) == (0, 2)


def test_an_impossible_rate_gives_way_to_that_of_the_other_files(tmp_path: Path) -> None:
    text = bvh_text(mixamo(), dance(mixamo(), 120), frame_time="0.0166667")
    for name in ("a", "b"):
        (tmp_path / "day").mkdir(exist_ok=True)
        (tmp_path / "day" / f"{name}.bvh").write_text(text)
    wrong = "\n".join("Frame Time: 1.0" if line.startswith("Frame Time") else line for line in text.split("\n"))
    (tmp_path / "day" / "c.bvh").write_text(wrong)
    rows = take_in(tmp_path / "store", tmp_path / "day")
    assert rows["a"]["source_rate_hz"] == rows["c"]["source_rate_hz"] == pytest.approx(60)
    assert "it is read at 60 Hz, as in the other files of its folder" in rows["c"]["warnings"][0]
    shutil.copytree(tmp_path / "store", tmp_path / "copy")
    assert take_in(tmp_path / "copy", tmp_path / "day") == rows


def test_a_file_without_a_rate_is_read_with_that_of_the_other_files(tmp_path: Path) -> None:
    source = tmp_path / "day"
    write(source / "a.npz", standing(60))
    with np.load(source / "a.npz") as arrays:
        np.savez(source / "b.npz", positions=arrays["positions"], names=arrays["names"])
    rows = take_in(tmp_path / "store", source)
    assert rows["b"]["source_rate_hz"] == 30
    taken = "it does not state its frames per second: 30 Hz is taken, as in the other"
    assert any(one.startswith(taken) for one in rows["b"]["warnings"])
    assert open_store(tmp_path / "store").result("ingest_log").num_rows == 0
    assert take_in(tmp_path / "store", source) == rows
    write(source / "a.npz", standing(61))  # read again, which decides as before
    assert take_in(tmp_path / "store", source)["b"] == rows["b"]
    (source / "alone").mkdir()
    shutil.copy(source / "b.npz", source / "alone" / "c.npz")
    assert set(take_in(tmp_path / "store", source)) == {"a", "b"}
    (row,) = open_store(tmp_path / "store").result("ingest_log").to_pylist()
    assert "does not state its frames per second: give `rate_hz`" in row["message"]


ACCLAIM_M = 0.0254 / 0.45


def test_the_unit_of_the_other_files_decides_between_a_child_and_a_tall_person(tmp_path: Path) -> None:
    child = 0.6 * standing(60) / ACCLAIM_M
    write(tmp_path / "alone" / "child.npz", child)
    alone = take_in(tmp_path / "first", tmp_path / "alone")["child"]
    assert alone["unit"] == "0.1 m (guessed)"
    write(tmp_path / "day" / "child.npz", child)
    write(tmp_path / "day" / "mother.npz", standing(60) / ACCLAIM_M)
    rows = take_in(tmp_path / "second", tmp_path / "day")
    assert rows["child"]["unit"] == rows["mother"]["unit"] == "0.0564444 m (guessed)"
    assert rows["child"]["height_m"] == pytest.approx(0.6 * rows["mother"]["height_m"], rel=0.01)
    (doubt,) = (one for one in rows["child"]["warnings"] if one.startswith("its unit of length is doubtful"))
    assert "read so, as in the other files of its folder; in dm" in doubt
    assert take_in(tmp_path / "second", tmp_path / "day") == rows


def test_a_wrong_unit_gives_way_to_that_of_the_other_files_if_it_makes_a_human(tmp_path: Path) -> None:
    points = standing(30)[[JOINTS.index(joint) for joint in KEYPOINTS]].transpose(2, 0, 1) / 0.3048
    (tmp_path / "day").mkdir()
    for name, size, unit in (("a", 1.0, "ft"), ("child", 0.6, "mm"), ("giant", 3.0, "mm")):
        (tmp_path / "day" / f"{name}.trc").write_text(trc(size * points, tuple(KEYPOINTS.values()), units=unit))
    rows = take_in(tmp_path / "store", tmp_path / "day")
    assert rows["a"]["unit"] == "0.3048 m"
    assert rows["child"]["unit"] == "0.3048 m (guessed)"
    assert any("it is read in feet, as in the other files of its folder" in one for one in rows["child"]["warnings"])
    assert rows["giant"]["unit"] != "0.3048 m (guessed)"


def test_files_that_disagree_decide_nothing() -> None:
    def row(number: int, **figures: object) -> dict[str, Any]:
        place = {"take_id": number, "source": f"day/{number}.trc", "source_root": "/", "format": "trc"}
        return place | {"recipe": "abc", "warnings": [], "source_rate_hz": 30.0} | figures

    unsure = row(0, file_up="y", warnings=["no axis is clearly up (nothing stands): y is taken"])
    assert decided_recipes([unsure]) == {}
    assert decided_recipes([unsure, row(1, file_up="z"), row(2, file_up="y")]) == {}
    (recipe,) = decided_recipes([unsure, row(1, file_up="z")]).values()
    assert decisions_in(recipe) == {"session_up": "z"}
    decided = unsure | {"recipe": recipe, "file_up": "z"}
    assert decided_recipes([decided, row(1, file_up="z")]) == {}
    assert decided_recipes([decided, row(1, file_up="x")]) != {}
    assert decided_recipes([decided]) == {0: "abc"}  # nothing decides any longer
    assert decided_recipes([decided, row(1, file_up="z", source="night/1.trc")]) == {0: "abc"}
    assert decisions_in(same_decisions("def", decided)) == {"session_up": "z"}


def test_a_damaged_take_comes_back_as_its_session_decided(tmp_path: Path) -> None:
    write(tmp_path / "day" / "get_up.npz", half_lying())
    write(tmp_path / "day" / "static.npz", standing(60))
    before = take_in(tmp_path / "store", tmp_path / "day")
    with open_store(tmp_path / "store") as store:
        ids = {name: row["take_id"] for name, row in before.items()}
        query = "SELECT take_id, root, word FROM frames ORDER BY take_id, frame"
        frames = store.sql(query).to_pylist()
    for part in store.manifest.frames:
        path = tmp_path / "store" / part.path
        path.write_bytes(b"\0" * path.stat().st_size)
    program, *words = repair(tmp_path / "store").command
    done = CliRunner().invoke(app, [*map(str, words), "--executor", "serial"], catch_exceptions=False)
    assert (program, done.exit_code) == ("kinedex", 0), done.output
    with open_store(tmp_path / "store") as store:
        assert store.sql(query).to_pylist() == frames
        after = {row["name"]: row for row in store.takes().to_dicts()}
    assert {name: row["take_id"] for name, row in after.items()} == ids
    assert {name: row["file_up"] for name, row in after.items()} == {"get_up": "z", "static": "z"}
    assert take_in(tmp_path / "store", tmp_path / "day") == before
