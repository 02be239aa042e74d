"""Labels of limbs in a store: files in, files out, and in again, with limbs, annotators and what was looked at."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from kinedex.commands.cli import app
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.inertial.limb_labels import stored_limb_labels
from kinedex.pipelines.labels.decisions import import_labels
from kinedex.pipelines.labels.label_files import label_differences, label_files
from kinedex.pipelines.templates.examples import ExampleParameters, examples_of
from kinedex.storage.store.store import Store, open_store
from tests.pipelines.labelled import long_take, write_store

FILE = """take,class,start,stop,limb,annotator
a_take01,error,0,40,lshank,A1
a_take01,error,0,40,lshank,A2
a_take01,error,20,60,rhand,A1
a_take01,,,,torso,A1
a_take01,walk,0,40,,ann
a_take01,walk,0,40,,bob
b_take01,,,,,
c_take01,error,8,16,lshank,A2
"""
"""Two annotators of limbs and two of motions; in b_take01 nobody found an error, in c_take01 A1 did not."""

COLUMNS = ("take", "class", "start", "stop", "limb", "annotator", "verdict")


@pytest.fixture
def store(tmp_path: Path) -> Path:
    takes = [long_take(f"{name}_take01", name, "walk", "kick") for name in "abc"]
    return write_store(tmp_path / "store", takes)


def run(*words: object) -> str:
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    return result.stdout


def imported(store: Path, *files: Path) -> set[tuple[object, ...]]:
    """Import label files, and return all labels of the store."""
    run("labels", "import", store, *files)
    return set(rows(open_store(store, at="newest")))


def rows(store: Store) -> list[tuple[object, ...]]:
    return [tuple(row[name] for name in COLUMNS) for row in store.labels().to_pylist()]


def test_nothing_of_a_file_is_lost_on_the_way_in_and_out(store: Path, tmp_path: Path) -> None:
    file = tmp_path / "labels.csv"
    file.write_text(FILE)
    assert "10 labels recorded (6 imported, 4 without errors)" in run("labels", "import", store, file)
    found = set(rows(open_store(store)))
    frames = open_store(store, at="newest").take_frames[1]
    assert found == {
        ("a_take01", "error", 0, 10, "lshank", "A1", "positive"),
        ("a_take01", "error", 0, 10, "lshank", "A2", "positive"),
        ("a_take01", "error", 5, 15, "rhand", "A1", "positive"),
        ("a_take01", "error", 0, frames, "torso", "A1", "negative"),
        ("a_take01", "walk", 0, 10, None, "ann", "positive"),
        ("a_take01", "walk", 0, 10, None, "bob", "positive"),
        ("b_take01", "error", 0, frames, None, "A1", "negative"),
        ("b_take01", "error", 0, frames, None, "A2", "negative"),
        ("c_take01", "error", 2, 4, "lshank", "A2", "positive"),
        ("c_take01", "error", 0, frames, None, "A1", "negative"),
    }
    assert imported(store, file) == found, "what the store has is not recorded again"
    for name in ("again.csv", "again.json"):
        run("labels", "export", store, "--labels", "-o", tmp_path / name)
        fresh = write_store(tmp_path / f"of-{name}", [long_take(f"{one}_take01", one, "walk", "kick") for one in "abc"])
        assert imported(fresh, tmp_path / name) == found, name
        assert "lshank" in run("labels", "list", fresh)
    run("labels", "remove", store, "--class", "walk")
    run("labels", "export", store, "--labels", "--format", "eaf", "--take", "a_take01", "-o", tmp_path / "elan")
    (elan,) = label_files([tmp_path / "elan"])
    assert elan.covered == (("a_take01", "torso", "A1"),)
    assert {(one.limb, one.annotator) for one in elan.segments} == {("lshank", "A1"), ("lshank", "A2"), ("rhand", "A1")}
    assert 'TIER_ID="A1:torso"' in (tmp_path / "elan" / "a_take01.eaf").read_text()
    run("labels", "export", store, "--labels", "--format", "eaf", "--take", "c_take01", "-o", tmp_path / "other")
    assert 'TIER_ID="A1:lshank"' in (tmp_path / "other" / "c_take01.eaf").read_text(), "A1 found no error in any limb"
    refused = CliRunner().invoke(app, ["labels", "export", str(store), "--labels", "--take", "b_take01", "-o", "b.vtt"])
    assert "WebVTT has no place for limbs that were looked at" in refused.output
    assert imported(store, tmp_path / "elan") == {one for one in found if one[1] != "walk"}


def test_labels_of_limbs_are_ground_truth_and_no_examples_of_a_motion(store: Path, tmp_path: Path) -> None:
    file = tmp_path / "labels.csv"
    file.write_text(FILE)
    opened = open_store(store)
    import_labels(opened, label_files([file]))
    found = stored_limb_labels(opened)
    assert found.looked_at == {"A1": {"a_take01", "b_take01", "c_take01"}, "A2": {"a_take01", "b_take01", "c_take01"}}
    spans = {key: [(one.start, one.stop) for one in own] for key, own in found.segments.items()}
    assert spans["A1", "a_take01", "rhand"] == [(20, 60)]
    examples = examples_of(opened, ExampleParameters(examples=["labels", str(file)])).examples
    assert {one.label for one in examples} == {"walk"}
    run("labels", "add", store, "a_take01", "error", 0, 5, "--limb", "left arm")
    with pytest.raises(KinedexError, match=r"no limb is named 'left arm'.*`kinedex labels remove"):
        stored_limb_labels(open_store(store, at="newest"))


def test_corrections_of_a_limb_are_those_of_its_annotator(store: Path, tmp_path: Path) -> None:
    file, after = tmp_path / "labels.csv", tmp_path / "after.csv"
    file.write_text(FILE)
    opened = open_store(store)
    import_labels(opened, label_files([file]))
    after.write_text(FILE.replace("0,40,lshank,A2", "4,40,lshank,A2"))
    made = import_labels(opened, label_files([after]), "labels", annotator="carl").rows.to_pylist()
    assert [tuple(row[name] for name in COLUMNS) for row in made] == [
        ("a_take01", "error", 1, 10, "lshank", "A2", "positive")
    ]
    (row,) = label_differences(file, after).rows.to_pylist()
    assert (row["change"], row["limb"], row["annotator"], row["new_start"]) == ("moved", "lshank", "A2", 4.0)
