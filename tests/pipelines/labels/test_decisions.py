"""Decisions about labels: what is compared, what is chosen, and what is recorded by commands and in Python."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

import kinedex
from docs.generators.json_documents import DOCUMENTS
from kinedex.commands.cli import app
from kinedex.pipelines.labels.file_segments import SegmentDifference, segment_differences
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.storage.formats.labels.file_labels import ManualSegment
from tests.pipelines.labelled import Line, clip, labelled_line, long_take, write_store


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Line:
    line = labelled_line(tmp_path_factory.mktemp("decisions"))
    line.run(LearnTemplates, methods=["soft"])
    line.run(Annotate)
    return line


def run(*words: object, fails: bool = False) -> str:
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert (result.exit_code != 0) == fails, result.output
    return result.output


def labels(line: Line, *options: object) -> list[dict[str, object]]:
    found: list[dict[str, object]] = json.loads(run("labels", "list", line.store, "--json", *options))["labels"]
    return found


def segment(label: str, start: float, stop: float, take: str = "a") -> ManualSegment:
    return ManualSegment(take, label, start, stop)


segments = st.builds(segment, st.sampled_from("xy"), st.integers(0, 4), st.integers(5, 9), st.sampled_from("ab"))


@given(st.lists(segments, unique=True, max_size=6), st.lists(segments, unique=True, max_size=6))
def test_every_segment_is_in_one_difference(before: list[ManualSegment], after: list[ManualSegment]) -> None:
    found = segment_differences(before, after)
    assert sorted(map(str, before)) == sorted(str(one.before) for one in found if one.before)
    assert sorted(map(str, after)) == sorted(str(one.after) for one in found if one.after)
    for one in found:
        if one.before is not None and one.after is not None:
            same_edges = (one.before.start, one.before.stop) == (one.after.start, one.after.stop)
            assert (one.before.label == one.after.label, same_edges) == {
                "same": (True, True), "renamed": (False, True), "moved": (True, False)
            }[one.change]  # fmt: skip
    assert {one.change for one in segment_differences(before, before)} <= {"same"}


def test_a_moved_segment_is_paired_with_what_it_overlaps_most() -> None:
    before = [segment("walk", 0, 10), segment("walk", 12, 30)]
    after = [segment("walk", 8, 29), segment("kick", 40, 50)]
    assert segment_differences(before, after) == [
        SegmentDifference("removed", before[0], None),
        SegmentDifference("moved", before[1], after[0]),
        SegmentDifference("added", None, after[1]),
    ]
    assert segment_differences([segment("walk", 0.1, 1)], [segment("walk", 0.1004, 1)], 0.001)[0].change == "same"


def test_annotations_are_accepted_and_rejected_by_what_the_options_choose(line: Line) -> None:
    (first, *_) = annotations = kinedex.open_store(line.store).results("annotations").to_dicts()
    assert "choose annotations by options" in run("labels", "accept", line.store, fails=True)
    run("labels", "accept", line.store, "--all", "--annotator", "ann")
    assert len(labels(line)) == len(annotations)
    again = json.loads(run("labels", "accept", line.store, "--class", first["class"], "--json"))
    assert (again["counts"], again["known"]) == ({}, sum(one["class"] == first["class"] for one in annotations))
    chosen = ("--take", first["take"], "--start", first["start"], "--stop", first["start"] + 1)
    rejected = json.loads(run("labels", "reject", line.store, *chosen, "--note", "not that", "--json"))
    assert rejected["counts"] == {"rejected": 1}
    (row,) = labels(line, *chosen)
    assert (row["verdict"], row["note"], row["class"]) == ("negative", "not that", first["class"])
    assert len(labels(line)) == len(annotations)
    assert len(labels(line, "--history")) == len(annotations) + 1
    assert "frames or times of one take" in run("labels", "reject", line.store, "--start", "3", fails=True)
    wrong = run("labels", "reject", line.store, "--class", first["class"], "--class", "swim", fails=True)
    assert "no annotation of test/annotate has the class 'swim'; known: " in wrong
    wrong = run("labels", "accept", line.store, "--take", first["take"] + "x", fails=True)
    assert f"did you mean '{first['take']}'?" in wrong
    assert "is chosen by these options" in run("labels", "reject", line.store, "--where", "start < 0", fails=True)
    assert "columns of annotations" in run("labels", "reject", line.store, "--where", "colour = 1", fails=True)


def test_an_unchanged_export_takes_no_decision_back(line: Line, tmp_path: Path) -> None:
    first, second, *_ = kinedex.open_store(line.store).results("annotations").to_dicts()
    chosen = [("--take", one["take"], "--start", one["start"], "--stop", one["stop"]) for one in (first, second)]
    run("labels", "accept", line.store, *chosen[0])
    run("labels", "export", line.store, "-o", tmp_path / "all.csv")
    run("labels", "reject", line.store, *chosen[0])
    importing = ("labels", "import", line.store, "--corrects", "annotations")
    assert "stays" in run(*importing, tmp_path / "all.csv")
    assert {row["verdict"] for row in labels(line, *chosen[0])} == {"negative"}
    rows = pl.read_csv(tmp_path / "all.csv")
    place = (pl.col("take") == second["take"]) & (pl.col("class") == second["class"])
    moved = pl.when(place).then(pl.col("stop") - 20).otherwise(pl.col("stop"))
    rows.with_columns(stop=moved).drop("start_seconds", "stop_seconds").write_csv(tmp_path / "moved.csv")
    assert json.loads(run(*importing, tmp_path / "moved.csv", "--json"))["counts"] == {"corrected": 1}
    decided = labels(line)
    assert json.loads(run(*importing, tmp_path / "all.csv", "--json"))["counts"] == {}
    assert labels(line) == decided
    run("labels", "accept", line.store, *chosen[0])
    assert {row["verdict"] for row in labels(line, *chosen[0])} == {"positive"}


def test_rejected_annotations_leave_the_store_neither_as_labels_nor_as_clips(line: Line, tmp_path: Path) -> None:
    first, *others = kinedex.open_store(line.store).results("annotations").to_dicts()
    run("labels", "reject", line.store, "--take", first["take"], "--start", first["start"], "--stop", first["stop"])
    standing = {(row["take"], row["start"]) for row in labels(line) if row["verdict"] == "negative"}
    rejected = sum((one["take"], one["start"]) in standing for one in (first, *others))
    exported = run("labels", "export", line.store, "-o", tmp_path / "all.csv")
    assert f"since a person has rejected them: {rejected} annotation" in exported
    assert pl.read_csv(tmp_path / "all.csv").height == len(others) + 1 - rejected
    again = json.loads(
        run("labels", "import", line.store, tmp_path / "all.csv", "--corrects", "annotations", "--json")
    )  # fmt: skip
    assert "rejected" not in again["counts"]
    run("labels", "accept", line.store, "--take", first["take"], "--start", first["start"], "--stop", first["stop"])
    made = kinedex.open_store(line.store).export(tmp_path / "clips", annotations=True)
    still = rejected - 1
    assert made["take"].len() == len(others) + 1 - still
    assert any("which a person has rejected" in one for one in _remarks(tmp_path / "clips")) == bool(still)


def _remarks(folder: Path) -> list[str]:
    remarks: list[str] = json.loads((folder / "dataset.json").read_text())["remarks"]
    return remarks


def test_differences_are_in_frames_of_the_store_where_it_is_given(line: Line, tmp_path: Path) -> None:
    head = "take,class,start,stop\n"
    (tmp_path / "old.csv").write_text(head + "bob_take01,skip,0,40\n")
    (tmp_path / "new.csv").write_text(head + "bob_take01,skip,20,40\n")
    (tmp_path / "new.txt").write_text("0.166667\t0.333333\tskip\n")
    (tmp_path / "new.txt").rename(tmp_path / "bob_take01.txt")
    of_files, of_store = (
        run("labels", "diff", tmp_path / "old.csv", tmp_path / "new.csv", "--format", "csv", *more).splitlines()[-1]
        for more in ((), ("--store", line.store))
    )
    assert of_files == "bob_take01,moved,skip,,0.0,40.0,20.0,40.0,source frames".replace(",,", ",skip,")
    assert of_store == "bob_take01,moved,skip,skip,0.0,10.0,5.0,10.0,frames"
    words = ("labels", "diff", tmp_path / "old.csv", tmp_path / "bob_take01.txt")
    assert "give it with --store STORE" in run(*words, fails=True)
    assert run(*words, "--store", line.store, "--format", "csv").splitlines()[-1] == of_store


def test_json_documents_have_the_keys_of_the_reference(line: Line, tmp_path: Path) -> None:
    file = tmp_path / "mine.csv"
    file.write_text("take,class,start,stop\nbob_take01,skip,0,50\n")
    words: dict[str, tuple[object, ...]] = {
        "import": (file,),
        "add": ("bob_take01", "skip", 3, 9),
        "accept": ("--all",),
        "reject": ("--all",),
        "list": (),
        "suspects": (),
    }
    found = {
        f"labels {name}": json.loads(run("labels", name, line.store, *own, "--json")) for name, own in words.items()
    }
    (label, *_) = found["labels add"]["labels"]
    found["labels change"] = json.loads(run("labels", "change", line.store, label["id"], "--stop", 8, "--json"))
    found["labels remove"] = json.loads(run("labels", "remove", line.store, "--class", "skip", "--json"))
    of_files = ("labels export", "labels read", "labels diff")  # tests/commands/test_json_everywhere.py
    expected = {
        command: list(keys)
        for command, keys in DOCUMENTS.items()
        if command.startswith("labels ") and command not in of_files
    }
    assert {command: list(keys) for command, keys in found.items()} == expected


def test_rows_of_a_file_choose_annotations(line: Line, tmp_path: Path) -> None:
    rows, wrong = tmp_path / "rows.csv", tmp_path / "wrong.csv"
    run("sql", line.store, "SELECT take, class, start, stop FROM annotations ORDER BY ALL LIMIT 1", "-o", rows)
    assert json.loads(run("labels", "reject", line.store, "--rows", rows, "--json"))["known"] <= 1
    wrong.write_text(rows.read_text().rsplit(",", 1)[0] + ",9999\n")
    assert "rows are no annotation, such as" in run("labels", "reject", line.store, "--rows", wrong, fails=True)
    wrong.write_text("take,class\na,b\n")
    assert "has no column 'start'" in run("labels", "reject", line.store, "--rows", wrong, fails=True)


def test_labels_are_drawn_listed_exported_corrected_and_removed(line: Line, tmp_path: Path) -> None:
    run("labels", "add", line.store, "bob_take01", "jump", "1s", "2s", "--limb", "left arm", "--confidence", "0.5")
    run("labels", "add", line.store, "bob_take01", "jump", 0, 9, "--not")
    assert "expected 0 <= START < STOP <= 60" in run(
        "labels", "add", line.store, "bob_take01", "jump", 0, 9999, fails=True
    )
    drawn, negative = sorted(labels(line, "--class", "jump"), key=lambda one: one["verdict"] == "negative")
    assert (drawn["start"], drawn["stop"], drawn["limb"], drawn["confidence"]) == (30, 60, "left arm", 0.5)
    file = tmp_path / "mine.csv"
    run("labels", "export", line.store, "--labels", "--take", "bob_take01", "-o", file)
    kept = [one for one in file.read_text().splitlines() if ",jump," in one]
    assert len(kept) == 1
    file.write_text(file.read_text().replace(",120,240,", ",124,240,"))
    done = json.loads(run("labels", "import", line.store, file, "--corrects", "labels", "--json"))
    assert set(done["counts"]) == {"corrected"}
    (moved,) = (one for one in labels(line, "--class", "jump") if one["verdict"] == "positive")
    assert (moved["start"], moved["replaces"], moved["limb"]) == (31, drawn["id"], "left arm")
    assert "no label has an id" in run("labels", "remove", line.store, "nothing", fails=True)
    assert "either by ids or by options" in run("labels", "remove", line.store, fails=True)
    run("labels", "remove", line.store, str(negative["id"])[:12])
    run("labels", "remove", line.store, "--class", "jump")
    assert labels(line, "--class", "jump") == []


def test_files_without_a_take_of_the_store_are_refused(line: Line, tmp_path: Path) -> None:
    file = tmp_path / "mine.csv"
    file.write_text("take,class,start,stop\nbob_take02,walk,0,50\n")
    assert "no take is named 'bob_take02'; did you mean 'bob_take01'" in run(
        "labels", "import", line.store, file, fails=True
    )
    file.write_text("take,class,start,stop\nbob_take02,walk,0,50\nbob_take01,hop,0,50\nbob_take01,hop,1,2\n")
    text = run("labels", "import", line.store, file, fails=True)
    assert f"{file}: 1 of 3 labels matches no take: bob_take02" in text
    assert "no analysis frame lies in this segment" in text
    assert len(labels(line, "--class", "hop")) == 1
    file.write_text("take,class,start,stop\nbob_take01,hop,0,5000\n")
    assert "mine.csv:2: stop 5000 is beyond the end of bob_take01" in run(
        "labels", "import", line.store, file, fails=True
    )


def test_python_records_what_commands_do(tmp_path: Path) -> None:
    takes = [clip("walk", "ann", 1), long_take("cat_1", "cat", "walk", "kick")]
    store = kinedex.open_store(write_store(tmp_path / "store", takes), at="newest")
    made = store.labels.add([{"take": "cat_1", "class": "walk", "start": 0, "stop": 20}], annotator="ann")
    assert made.height == len(store.labels) == 1
    assert store.labels.add(made.select("take", "class", "start", "stop")).height == 0
    moved = {**made.row(0, named=True), "id": None, "stop": 19, "replaces": made["id"][0], "origin": "corrected"}
    store.labels.add([moved])
    assert store.labels.table("stop = 19")["annotator"].to_list() == ["ann"]
    assert store.labels.table(history=True)["current"].to_list() == [False, True]
    assert store.sql("SELECT count(*) AS n FROM labels", polars=True)["n"][0] == 1
    with pytest.raises(kinedex.KinedexError, match="beyond the end of cat_1, at 45"):
        store.labels.add([{"take": "cat_1", "class": "walk", "start": 0, "stop": 99}])
    with pytest.raises(kinedex.ParameterError, match="without stop"):
        store.labels.add([{"take": "cat_1", "class": "walk", "start": 0}])
    file = tmp_path / "mine.csv"
    file.write_text("take,class,start_seconds,stop_seconds\ncat_1,kick,0.7,1.5\nnobody,kick,0,1\n")
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        assert store.labels.read(file)["origin"].to_list() == ["imported"]
    assert "1 of 2 labels matches no take: nobody" in str(seen[0].message)
    assert store.labels.remove(store.labels.table()["id"]).height == 2
    assert len(store.labels) == 0
