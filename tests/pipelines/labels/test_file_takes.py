"""Labels find their takes by name, also where copies of a file have names of paths; the others are counted."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner, Result

from kinedex.catalog.classes import load_classes
from kinedex.commands.cli import app
from kinedex.commands.output import show_outcome
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.engine.runner import Outcome
from kinedex.pipelines.evaluation.ground_truth import GroundTruthParameters, ground_truth
from kinedex.pipelines.labels.file_segments import with_take_names
from kinedex.pipelines.labels.unmatched_labels import (
    UNMATCHED,
    UnmatchedLabels,
    recorded_unmatched,
    unmatched_labels,
    unmatched_summary,
)
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.evaluate import Evaluate
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.storage.formats.labels.file_labels import LabelFile
from kinedex.storage.formats.labels.formats import read_labels
from kinedex.storage.store.store import open_store
from tests.pipelines.archives import write_archive
from tests.pipelines.labelled import labelled_line

TRUTH = """take,class,start,stop
01_01,jump,0,40
01_01,turn,40,80
02_02,jump,8,48
03_03,,,
"""


def kinedex(*words: str | Path) -> Result:
    return CliRunner().invoke(app, [*map(str, words)], prog_name="kinedex", catch_exceptions=False)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """An archive with a take 01_01, and 02_02 in a folder of its own."""
    write_archive(tmp_path / "source", {"a/01_01.amc": 160, "a/02_02.amc": 120})
    for name in ("01.asf", "02.asf"):
        shutil.copy(tmp_path / "source" / "x.asf", tmp_path / "source" / "a" / name)
    (tmp_path / "source" / "labels.csv").write_text(TRUTH)
    return tmp_path / "source"


def copied(source: Path, *, decimals: int | None = None, cut: int = 0) -> None:
    """Copy 01_01 into another folder, as it is, with fewer digits, or without its first frames."""
    (source / "b").mkdir()
    shutil.copy(source / "x.asf", source / "b" / "01.asf")
    text = (source / "a" / "01_01.amc").read_text()
    if decimals is not None:
        text = re.sub(r"-?\d+\.\d+", lambda found: f"{float(found[0]):.{decimals}f}", text)
    head, *frames = re.split(r"(?m)^(?=\d+$)", text)
    (source / "b" / "01_01.amc").write_text("".join([head, *frames[cut:]]))


def ingested(source: Path) -> Path:
    store = source.parent / "store"
    assert kinedex("ingest", store, source, "--executor", "serial").exit_code == 0
    return store


@pytest.mark.parametrize("decimals", [None, 2])
def test_labels_of_a_stem_belong_to_every_copy_of_the_motion(source: Path, decimals: int | None) -> None:
    copied(source, decimals=decimals)
    store = open_store(ingested(source))
    assert sorted(store.take_ids) == ["02_02", "a/01_01", "b/01_01"]
    (file,), remarks = with_take_names(store, [read_labels(source / "labels.csv")])
    assert file.takes == ("a/01_01", "b/01_01", "02_02", "03_03")
    assert [(one.take, one.label) for one in file.segments] == [
        ("a/01_01", "jump"), ("b/01_01", "jump"), ("a/01_01", "turn"), ("b/01_01", "turn"), ("02_02", "jump"),
    ]  # fmt: skip
    assert remarks == ["labels of '01_01' belong to a/01_01, b/01_01, which hold the same motion"]
    classes = load_classes("own", {"jump", "turn"})
    truth = ground_truth(store, GroundTruthParameters(ground_truth="labels.csv"), store.takes(), classes)
    assert len(truth.segments) == 5
    assert truth.unmatched == (UnmatchedLabels(str(source / "labels.csv"), 1, 6, ("03_03",)),)


def test_a_label_of_takes_of_different_motion_belongs_to_none(source: Path) -> None:
    copied(source, cut=80)
    store = open_store(ingested(source))
    files, remarks = with_take_names(store, [read_labels(source / "labels.csv")])
    assert files[0].takes == ("01_01", "02_02", "03_03")
    assert remarks == [
        "'01_01' fits takes of different motion, a/01_01, b/01_01: labels of it belong to none of them until the file "
        "names one of these"
    ]
    (found,) = unmatched_labels(files, store.take_ids)
    assert str(found) == f"{source / 'labels.csv'}: 3 of 4 labels match no take: 01_01, 03_03"
    assert UnmatchedLabels.of_json(json.loads(json.dumps(found.as_json()))) == found


def test_a_label_of_a_take_that_has_the_name_itself_is_not_given_to_later_copies(source: Path) -> None:
    ingested(source)
    copied(source)
    store = open_store(ingested(source), at="newest")
    assert sorted(store.take_ids) == ["01_01", "02_02", "b/01_01"]
    (file,), remarks = with_take_names(store, [read_labels(source / "labels.csv")])
    assert file.takes == ("01_01", "02_02", "03_03")
    assert remarks == [
        "labels of '01_01' belong to the take of this name alone, not to b/01_01, whose files are named so"
    ]


def test_takes_named_by_paths_are_found_by_the_names_of_their_files(source: Path) -> None:
    store = source.parent / "store"
    done = kinedex("ingest", store, source, "--executor", "serial", "--set", "ingest.name=path")
    assert done.exit_code == 0
    (file,), _ = with_take_names(open_store(store), [read_labels(source / "labels.csv")])
    assert file.takes == ("a/01_01", "a/02_02", "03_03")


def test_an_import_names_the_file_and_the_number_of_labels_and_exits_with_3(source: Path) -> None:
    copied(source)
    store = ingested(source)
    done = kinedex("labels", "import", store, source / "labels.csv", "--json")
    found = json.loads(done.stdout)
    assert done.exit_code == 3
    assert found["unmatched_labels"] == [{"file": str(source / "labels.csv"), "labels": 1, "of": 6, "takes": ["03_03"]}]
    assert len(found["labels"]) == 5
    done = kinedex("labels", "import", store, source / "labels.csv")
    assert done.exit_code == 3
    assert f"{source / 'labels.csv'}: 1 of 6 labels matches no take: 03_03" in done.stdout


def test_a_run_ends_with_the_labels_that_match_no_take(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pipeline = load_pipeline("ingest", None, {"source": str(tmp_path)})
    lost = UnmatchedLabels("/data/ground_truth.csv", 12, 15, ("01_01",))
    outcome = Outcome(pipeline, tmp_path, ("ingest",), (), {}, 0, (lost,), None)
    with pytest.raises(Exception) as ended:
        show_outcome(outcome, tmp_path)
    assert getattr(ended.value, "exit_code", None) == 3
    assert "/data/ground_truth.csv: 12 of 15 labels match no take: 01_01" in capsys.readouterr().out


def test_every_stage_that_reads_label_files_reports_labels_that_match_no_take(tmp_path: Path) -> None:
    line = labelled_line(tmp_path)
    file = tmp_path / "archive" / "ground_truth.csv"
    file.write_text(f"{file.read_text()}elsewhere,walk,0,40\n")
    lost = [{"file": str(file), "labels": 1, "of": 5, "takes": ["elsewhere"]}]
    done = [
        line.run(LearnTemplates, examples=["clips", "**/ground_truth.csv"]),
        line.run(Annotate, where="class IS NULL"),
        line.run(Evaluate),
        line.leave_out(),
    ]
    assert [one.get(UNMATCHED) for one in done] == [lost, None, lost, lost]
    (recorded,) = recorded_unmatched(done)
    assert unmatched_summary([recorded, recorded]) == {UNMATCHED: lost}


def test_a_run_that_learns_from_a_label_file_ends_with_3_where_labels_match_no_take(source: Path) -> None:
    (source / "labels.csv").write_text(TRUTH.replace("02_02,jump,8,48", "02_02,turn,8,88\n02_02,jump,88,120"))
    stages = {"ingest": {"source": str(source)}, "index": {}, "learn_templates": {"examples": ["labels.csv"]}}
    content = {"name": "learn", "stages": {name: {"params": params} for name, params in stages.items()}}
    pipeline, store = source.parent / "learn.yaml", source.parent / "store"
    pipeline.write_text(yaml.safe_dump(content, sort_keys=False))
    for stages_run in (3, 0):  # the second run does nothing, and ends in the same way
        done = kinedex("run", pipeline, "--store", store, "--executor", "serial", "--json")
        found = json.loads(done.stdout)
        assert (done.exit_code, len(found["ran"])) == (3, stages_run), done.stderr
        assert [one["takes"] for one in found["unmatched_labels"]] == [["03_03"]]


def test_a_list_without_labels_says_so(source: Path) -> None:
    store = ingested(source)
    assert kinedex("labels", "list", store).stdout.splitlines()[-1] == "the store has no labels"
    assert kinedex("labels", "import", store, source / "labels.csv").exit_code == 3
    done = kinedex("labels", "list", store, "--class", "hop")
    assert done.stdout.splitlines()[-1] == "no label of 3 fits"


def test_differences_in_a_store_count_labels_that_match_no_take(source: Path) -> None:
    store, file = ingested(source), source / "labels.csv"
    done = kinedex("labels", "diff", file, file, "--store", store, "--json")
    assert (done.exit_code, len(json.loads(done.stdout)["unmatched_labels"])) == (3, 2)
    done = kinedex("labels", "diff", file, file, "--store", store)
    assert (done.exit_code, "1 of 4 labels matches no take: 03_03" in done.stderr) == (3, True)
    assert kinedex("labels", "diff", file, file).exit_code == 0


def test_a_file_whose_takes_are_all_there_has_no_such_labels() -> None:
    assert unmatched_labels([LabelFile("a.csv", ("x",), ())], ["x", "y"]) == ()


def test_classes_of_file_names_are_exported_as_labels_without_sql(source: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    pattern = "ingest.patterns=['a/(?P<class>01)_']"
    assert kinedex("ingest", store, source, "--executor", "serial", "--set", pattern).exit_code == 0
    for form in ("csv", "eaf"):
        done = kinedex("labels", "export", store, "--classes", "--format", form, "-o", tmp_path / form)
        assert done.exit_code == 0
        assert "1 segment of 1 take, by the classes of takes" in done.stdout
        (segment,) = read_labels(tmp_path / form / f"01_01.{form}").segments
        assert (segment.take, segment.label) == ("01_01", "01")
        assert segment.source_frames(120) == (0, 160)
    done = kinedex("labels", "export", store, "--classes", "--take", "02_02", "-o", tmp_path / "none")
    assert (done.exit_code, "'02_02' is no take with a class" in done.stderr) == (1, True)
    done = kinedex("labels", "export", store, "--classes", "--stage", "annotate", "-o", tmp_path / "none")
    assert (done.exit_code, "give --stage or --classes" in done.stderr) == (2, True)
