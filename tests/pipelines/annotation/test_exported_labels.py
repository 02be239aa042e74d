"""Annotations leave a store as label files, and come back as ground truth that they equal to the frame."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from kinedex.commands.cli import app
from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import analysis_frame, source_frame
from kinedex.pipelines.annotation.annotation_tables import annotation_stage
from kinedex.pipelines.labels.label_files import annotation_labels
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.evaluate import Evaluate
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.storage.store.store import open_store
from tests.pipelines.labelled import Line, clip, long_take, write_store


@pytest.fixture
def line(tmp_path: Path) -> Line:
    clips = [clip(name, actor, number) for name in ("walk", "kick") for actor in ("ann", "bob") for number in (1, 2)]
    takes = [long_take("cat_1", "cat", "walk", "kick", "walk"), long_take("cat_2", "cat", "rest", "kick", "rest")]
    (tmp_path / "archive").mkdir()
    line = Line(write_store(tmp_path / "store", [*clips, *takes], tmp_path / "archive"))
    line.run(LearnTemplates, methods=["soft"])
    line.run(Annotate)
    return line


@given(st.integers(0, 10**7), st.sampled_from([30.0, 50.0, 59.94, 60.0, 100.0, 120.0, 240.0, 1000.0]))
def test_source_frames_give_back_the_analysis_frame(frame: int, source_rate_hz: float):
    assert analysis_frame(source_frame(frame, source_rate_hz, 30.0, 10**9), source_rate_hz, 30.0) == frame


@pytest.mark.parametrize("form", ["csv", "json", "eaf", "vtt", "txt"])
def test_exported_annotations_are_ground_truth_that_they_equal(line: Line, tmp_path: Path, form: str):
    given = ["labels", "export", str(line.store), "--format", form, "-o", str(tmp_path / "archive" / "sub")]
    result = CliRunner().invoke(app, given)
    assert result.exit_code == 0, result.stderr
    segments = open_store(line.store).result("annotations")
    assert f"{segments.num_rows} segments of 2 takes, annotated by test/annotate: 2 files in" in result.stdout
    assert sorted(path.name for path in (tmp_path / "archive" / "sub").iterdir()) == [f"cat_1.{form}", f"cat_2.{form}"]
    summary = line.run(Evaluate, ground_truth=f"**/*.{form}")
    assert summary["f1"] == summary["f2"] == 1
    truth = open_store(line.store).result("ground_truth")
    columns = ["take", "class", "start", "stop"]
    order = [(name, "ascending") for name in columns]
    assert truth.select(columns).sort_by(order).equals(segments.select(columns).sort_by(order))
    again = CliRunner().invoke(app, given)
    assert again.exit_code == 1
    assert "nothing is overwritten without --force" in again.stderr
    assert CliRunner().invoke(app, [*given, "--force"]).exit_code == 0
    shown = CliRunner().invoke(
        app, ["labels", "read", str(tmp_path / "archive" / "sub" / f"cat_1.{form}"), "--format", "csv"]
    )
    assert shown.stdout.splitlines()[0] == "take,class,start,stop,unit,where"


def test_a_store_without_annotations_says_the_whole_command_that_makes_some(tmp_path: Path):
    takes = [long_take("cat_1", "cat", "walk")]
    store = open_store(write_store(tmp_path / "my store", takes, tmp_path / "my archive"))
    command = f"kinedex run annotate --store '{tmp_path}/my store' --set 'source={tmp_path}/my archive'"
    with pytest.raises(KinedexError, match=f"nothing was annotated; `{command}` annotates it"):
        annotation_stage(store)


@pytest.mark.parametrize("form", ["csv", "json", "eaf", "vtt", "txt"])
def test_a_take_that_was_exported_without_a_segment_is_evaluated(line: Line, tmp_path: Path, form: str):
    line.run(Annotate, min_seconds=99)
    target = tmp_path / "archive" / (f"both.{form}" if form in ("csv", "json") else "each")
    exported = CliRunner().invoke(app, ["labels", "export", str(line.store), "--format", form, "-o", str(target)])
    assert exported.exit_code == 0, exported.stderr
    shown = CliRunner().invoke(app, ["labels", "read", str(min((tmp_path / "archive").rglob(f"*.{form}")))])
    assert "cat_1" in shown.stdout
    line.run(Annotate)
    summary = line.run(Evaluate, ground_truth=f"**/*.{form}")
    assert (summary["evaluated_takes"], summary["p1"], summary["r1"]) == (2, 0, None)
    assert "in which nothing is to be found: cat_1, cat_2" in line.printed.getvalue()


def test_takes_with_a_class_are_ground_truth_for_themselves_where_there_is_no_label_file(line: Line):
    line.run(Annotate, where="name LIKE 'ann_%_001'")
    assert line.run(Evaluate)["evaluated_takes"] == 2
    assert "no label file '**/ground_truth.csv': each take's own class is its ground truth" in line.printed.getvalue()
    truth = open_store(line.store).result("ground_truth").to_pylist()
    assert [(one["take"], one["class"]) for one in truth] == [("ann_kick_001", "kick"), ("ann_walk_001", "walk")]
    assert line.run(Evaluate, ground_truth="none")["evaluated_takes"] == 0
    line.run(Annotate)
    assert line.run(Evaluate)["evaluated_takes"] == 0


def test_the_same_labels_in_two_files_count_once(line: Line, tmp_path: Path):
    for form in ("csv", "json"):
        given = ["labels", "export", str(line.store), "-o", str(tmp_path / "archive" / f"gt.{form}")]
        assert CliRunner().invoke(app, given).exit_code == 0
    segments = open_store(line.store).result("annotations").num_rows
    summary = line.run(Evaluate, ground_truth="gt.[cj]*")
    assert (summary["segments"], summary["f1"]) == (segments, 1)
    archive = tmp_path / "archive"
    message = line.printed.getvalue()
    assert f"counted once: {segments} in {archive / 'gt.json'} that {archive / 'gt.csv'} has as well" in message
    assert "differently" not in message


def test_a_folder_with_a_dot_in_its_name_needs_a_format_or_a_slash(line: Line, tmp_path: Path):
    given = ["labels", "export", str(line.store), "-o", str(tmp_path / "lab.2024")]
    refused = CliRunner().invoke(app, given)
    assert refused.exit_code == 1
    assert "its ending, '.2024', is no format of labels" in refused.stderr
    for right in ([*given, "--format", "VTT"], [*given[:-1], f"{given[-1]}/"]):
        assert CliRunner().invoke(app, right).exit_code == 0
    assert len(list((tmp_path / "lab.2024").iterdir())) == 4


def test_stages_and_takes_are_chosen_by_name(line: Line):
    store = open_store(line.store)
    for wanted in (None, "test", "test/annotate", "run-annotate"):
        assert annotation_stage(store, wanted) == "test/annotate"
    with pytest.raises(
        KinedexError, match="no stage 'tests/annotate' has annotated anything; did you mean 'test/annotate'"
    ):
        annotation_stage(store, "tests/annotate")
    assert [one.take for one in annotation_labels(store, "test/annotate", ["cat_2"]).takes] == ["cat_2"]
    assert [one.take for one in annotation_labels(store, "test/annotate", where="name = 'cat_1'").takes] == ["cat_1"]
    with pytest.raises(KinedexError, match="did not annotate 'cat_3'; did you mean"):
        annotation_labels(store, "test/annotate", ["cat_3"])
    with pytest.raises(KinedexError, match="selects no take that stage test/annotate annotated"):
        annotation_labels(store, "test/annotate", where="class = 'walk'")
