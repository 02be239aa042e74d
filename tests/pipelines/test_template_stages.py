"""The stages learn_templates, annotate, evaluate and leave_one_out on made-up and on real words."""

from __future__ import annotations

import json
import weakref
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow.parquet as pq
import pytest

from kinedex.ops.errors import ConfigError, KinedexError, SourceError
from kinedex.pipelines.annotation.batches import TakeAnnotation, annotate_stored
from kinedex.pipelines.stages import annotate
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.evaluate import Evaluate
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.storage.store.store import open_store
from tests.pipelines.labelled import TRUTH, Line, labelled_line, long_take, write_store


@pytest.fixture
def line(tmp_path: Path) -> Line:
    return labelled_line(tmp_path)


def test_every_subclass_gets_a_soft_and_a_hard_template_with_its_clips(line: Line):
    summary = line.run(LearnTemplates)
    assert (summary["subclasses"], summary["templates"], summary["clips"]) == (3, 6, 9)
    rows = open_store(line.store).result("templates").to_pylist()
    assert [(row["subclass"], row["kind"]) for row in rows[:2]] == [("kick", "soft"), ("kick", "hard")]
    assert rows[0]["clips"] == ["ann_kick_001", "ann_kick_002", "bob_kick_003"]
    assert len(rows[0]["values"]) == rows[0]["columns"] * 40
    assert len(rows[0]["costs"]) == rows[0]["rounds"] + 1
    assert rows[0]["take_filter"] == "class IS NOT NULL"


def test_templates_do_not_depend_on_the_executor(line: Line, monkeypatch: pytest.MonkeyPatch):
    line.run(LearnTemplates)
    alone = open_store(line.store).result("templates").drop_columns(["run"])
    monkeypatch.setattr("kinedex.pipelines.templates.template_learning._TASK_CELLS", 1)
    spread = Line(line.store, "processes")
    spread.run(LearnTemplates)
    spread.executor.close()
    assert open_store(line.store).result("templates").drop_columns(["run"]).equals(alone)


def test_a_single_clip_is_used_and_said_and_no_clip_at_all_is_explained(line: Line):
    line.run(LearnTemplates, where="name LIKE '%003'", methods=["soft"])
    assert "kick, walk, wave: one clip only, which then is the template" in line.printed.getvalue()
    with pytest.raises(KinedexError, match=r"`actor = 'eve'` selects none of the 11 takes, 9 of which have a class"):
        line.run(LearnTemplates, where="actor = 'eve'")
    with pytest.raises(KinedexError, match=r"2 takes to learn from that have no class, such as bob_take01"):
        line.run(LearnTemplates, where="true")


def test_takes_are_annotated_and_agree_with_the_ground_truth(line: Line):
    line.run(LearnTemplates)
    assert line.run(Annotate)["takes"] == 2
    store = open_store(line.store)
    found = store.result("annotations").to_pylist()
    assert [(row["take"], row["class"]) for row in found if row["cost"] < 0.01] == [
        ("bob_take01", "wave"),
        ("bob_take01", "kick"),
        ("cat_take01", "walk"),
        ("cat_take01", "kick"),
    ]
    assert all(row["start_seconds"] == row["start"] / 30 and row["method"] == "templates" for row in found)
    curves = store.result("distance_curves").to_pylist()
    assert len(curves) == 2 * 3
    assert [len(row["costs"]) for row in curves if row["take"] == "cat_take01"] == [60] * 3
    summary = line.run(Evaluate)
    assert summary["f2"] == 1
    written = json.loads((line.store / "results/reports/test/metrics.json").read_text())
    assert written["pooled"]["f1"] == pytest.approx(summary["f1"])
    metrics = open_store(line.store).result("metrics")
    assert metrics.column("scope").to_pylist() == ["pooled"] + ["class"] * 3 + ["take"] * 2
    assert open_store(line.store).result("ground_truth").num_rows == 4
    assert "2 takes against ground truth" in line.printed.getvalue()


def test_exactly_the_takes_that_were_annotated_are_evaluated(line: Line):
    line.run(LearnTemplates, methods=["soft"])
    line.run(Annotate, where="name = 'cat_take01'", tau=0.0001)
    assert open_store(line.store).result("annotated_takes").to_pylist() == [
        {
            "run": "run-annotate",
            "take_id": open_store(line.store).take_id("cat_take01"),
            "take": "cat_take01",
            "frames": 60,
            "searched": 1.0,
            "fingerprint": None,
        }
    ]
    line.params["annotate"] = Annotate.parameters(where="class IS NULL")  # as a filter whose answer has changed since
    assert line.run(Evaluate)["evaluated_takes"] == 1
    assert line.leave_out()["folds"] == 1
    written = json.loads((line.store / "results/reports/test/methods.json").read_text())
    assert list(written["splits"][0]["methods"]["annotate"]["takes"]) == ["cat_take01"]


def test_takes_that_changed_since_they_were_annotated_are_not_evaluated(line: Line, tmp_path: Path):
    line.run(LearnTemplates, methods=["soft"])
    line.run(Annotate)
    write_store(line.store, [long_take("cat_take01", "cat", "walk")], tmp_path / "archive")
    line.params["evaluate"] = Evaluate.parameters()
    for run in (lambda: line.run(Evaluate), line.leave_out):
        with pytest.raises(
            KinedexError, match=r"replaced or dropped since: cat_take01; run it again: `--force annotate`"
        ):
            run()
    line.run(Annotate, where="name = 'bob_take01'")
    assert line.run(Evaluate)["evaluated_takes"] == 1


def test_curves_are_written_batch_by_batch_and_not_kept(line: Line, monkeypatch: pytest.MonkeyPatch):
    line.run(LearnTemplates, methods=["soft"])
    line.run(Annotate, where="true")
    whole = open_store(line.store).result("distance_curves").sort_by([("take", "ascending"), ("subclass", "ascending")])
    monkeypatch.setattr("kinedex.pipelines.annotation.batches.BATCH_FRAMES", 1)
    alive: list[weakref.ref[np.ndarray]] = []
    most = []

    def watched(*given: object) -> Iterator[list[TakeAnnotation]]:
        for batch in annotate_stored(*given):  # type: ignore[arg-type]
            alive.extend(weakref.ref(one.curves) for one in batch if one.curves is not None)
            most.append(sum(one() is not None for one in alive))
            yield batch

    monkeypatch.setattr(annotate, "annotate_stored", watched)
    line.run(Annotate, where="true")
    assert len(most) == 11
    assert max(most) <= 3
    store = open_store(line.store)
    (part,) = store.manifest.results["distance_curves"]
    assert pq.ParquetFile(line.store / part.path).num_row_groups == 11
    split = store.result("distance_curves").sort_by([("take", "ascending"), ("subclass", "ascending")])
    assert split.equals(whole)
    line.run(Annotate, where="true", store_curves=False)
    assert open_store(line.store).result("distance_curves").num_rows == 0
    assert open_store(line.store).result("annotations").equals(store.result("annotations"))


def test_hard_templates_and_classes_of_a_file_are_a_matter_of_parameters(line: Line, tmp_path: Path):
    (tmp_path / "mine.yaml").write_text("legs: [walk, kick]\n")
    line.run(LearnTemplates, methods=["hard"])
    line.run(Annotate, templates="hard", classes=str(tmp_path / "mine.yaml"), store_curves=False)
    store = open_store(line.store)
    assert set(store.result("annotations").column("class").to_pylist()) == {"legs"}
    assert set(store.result("annotations").column("subclass").to_pylist()) == {"walk", "kick"}
    assert store.result("distance_curves").num_rows == 0
    assert "in no class and not annotated: wave" in line.printed.getvalue()
    with pytest.raises(SourceError, match=r"ground_truth.csv:4: 'wave' is neither a class nor a subclass"):
        line.run(Evaluate)
    line.run(Evaluate, unknown_labels="ignore")
    assert "labels of no class, excluded: wave" in line.printed.getvalue()


def test_templates_that_say_nothing_are_told_on_the_terminal_and_with_the_metrics(line: Line):
    opposites = [np.full(20, word, np.uint64) for word in (0x5A5A5A5A5A, 0xA5A5A5A5A5)]
    blur = [
        {"name": f"ann_blur_{number}", "actor": "ann", "class": "blur", "words": words}
        for number, words in enumerate(opposites)
    ]
    write_store(line.store, blur)
    line.run(LearnTemplates, methods=["soft"])
    summary = line.run(Annotate)
    line.run(Evaluate)
    line.leave_out()
    remark = "templates of wildcards alone, which would fit anything, excluded: blur"
    assert summary["remarks"] == [remark]
    assert line.printed.getvalue().count(remark) == 3  # once for all, once for each of two actors
    assert json.loads((line.store / "results/reports/test/metrics.json").read_text())["remarks"] == [remark]
    assert "blur" not in open_store(line.store).result("distance_curves").column("class").to_pylist()


def test_what_cannot_be_annotated_is_explained(line: Line, tmp_path: Path):
    line.run(LearnTemplates, methods=["hard"])
    with pytest.raises(KinedexError, match=r"learned no soft templates \(it has: hard\)"):
        line.run(Annotate)
    with pytest.raises(KinedexError, match=r"`actor = 'eve'` selects none of 11 takes, 2 of which have no class"):
        line.run(Annotate, where="actor = 'eve'", templates="hard")
    (tmp_path / "mine.yaml").write_text("legs: [wolk]\n")
    with pytest.raises(ConfigError, match=r"mine.yaml:1: .*'wolk'; did you mean 'walk'"):
        line.run(Annotate, templates="hard", classes=str(tmp_path / "mine.yaml"))


def test_keyframe_queries_preselect_and_their_file_belongs_to_the_fingerprint(line: Line, tmp_path: Path):
    queries = tmp_path / "mine.json"
    queries.write_text("queries:\n  my kick:\n    class: kick\n    keyframes:\n      - {upper: '****111*******'}\n")
    params = Annotate.parameters(queries=[str(queries)])
    before = Annotate().external_digest(params, None)
    queries.write_text(queries.read_text() + "\n# other words\n")
    assert Annotate().external_digest(params, None) != before
    assert Annotate().external_digest(Annotate.parameters(), None) == Annotate().external_digest(
        Annotate.parameters(tau=0.2), None
    )


def test_a_takes_own_class_can_be_the_ground_truth_and_there_can_be_none(line: Line):
    line.run(LearnTemplates)
    line.run(Annotate, where="class IS NOT NULL")
    assert line.run(Evaluate, ground_truth="class")["f2"] == 1
    assert line.run(Evaluate, ground_truth="none") == {"evaluated_takes": 0}
    assert open_store(line.store).result("metrics").num_rows == 0
    assert not (line.store / "results/reports/test/metrics.json").exists()
    assert line.leave_out() == {"splits": 0, "methods": 1}


def test_nothing_is_evaluated_where_nobody_has_labels_but_a_pattern_that_was_given_must_find_some(
    line: Line, tmp_path: Path
):
    (tmp_path / "archive" / "ground_truth.csv").unlink()
    line.run(LearnTemplates)
    line.run(Annotate)
    assert line.run(Evaluate) == {"evaluated_takes": 0}
    message = line.printed.getvalue()
    assert "no ground truth, nothing to evaluate: the source has no file '**/ground_truth.csv'" in message
    assert line.leave_out() == {"splits": 0, "methods": 1}
    assert line.run(Evaluate, source=str(tmp_path / "archive")) == {"evaluated_takes": 0}
    with pytest.raises(KinedexError, match=r"no file '\*\*/ground_truth.csv' below .*archive"):
        line.run(Evaluate, ground_truth="**/ground_truth.csv")
    with pytest.raises(KinedexError, match=r"the source folder .*gone is no longer there"):
        line.run(Evaluate, source=str(tmp_path / "gone"))


def test_ground_truth_that_changes_makes_the_evaluation_run_again(line: Line, tmp_path: Path):
    truth = tmp_path / "archive" / "ground_truth.csv"
    ways = [
        Evaluate.parameters(),  # below the source folders of the store's takes
        Evaluate.parameters(source=str(tmp_path / "archive")),
        Evaluate.parameters(ground_truth=str(truth)),
    ]
    store = open_store(line.store)
    before = [Evaluate().external_digest(params, store) for params in ways]
    assert before == [Evaluate().external_digest(params, store) for params in ways]
    truth.write_text(TRUTH + "bob_take01,walk,96,120\n")
    assert all(Evaluate().external_digest(params, store) != old for params, old in zip(ways, before, strict=True))
    truth.unlink()
    nobodys, read = "nobody's labels", "none to be read"
    assert [Evaluate().external_digest(params, store) for params in ways] == [nobodys, nobodys, read]
    assert Evaluate().external_digest(ways[0], None) == nobodys
    assert Evaluate().external_digest(Evaluate.parameters(ground_truth="class"), store) == ""


def test_a_second_evaluation_of_one_pipeline_has_a_file_of_its_own(line: Line):
    line.run(LearnTemplates, methods=["soft"])
    line.run(Annotate)
    line.run(Evaluate)
    context = replace(line.context("evaluate"), stage="by_class", run="run-2")
    summary = Evaluate().run(context, Evaluate.parameters(unknown_labels="miss"))
    assert summary["files"] == ["results/reports/test/by_class.metrics.json"]
    assert (line.store / "results/reports/test/metrics.json").exists()


def test_each_actor_is_left_out_once_and_their_clips_are_not_learned_from(line: Line):
    line.run(LearnTemplates, methods=["soft"])
    line.run(Annotate)
    plain = line.run(Evaluate)
    summary = line.leave_out()
    assert summary["folds"] == 2
    message = line.printed.getvalue()
    assert "cat: no training clip is of actor cat, so all are learned from" in message
    rows = {(row["scope"], row["name"]): row for row in open_store(line.store).result("metrics").to_pylist()[6:]}
    assert rows["pooled", "all"]["evaluation"] == "leave one actor out"
    assert rows["fold", "bob"]["frames_manual"] + rows["fold", "cat"]["frames_manual"] == 24 + 30 + 20 + 25
    (split,) = json.loads((line.store / "results/reports/test/methods.json").read_text())["splits"]
    assert [fold["name"] for fold in split["folds"]] == ["bob", "cat"]
    assert split["methods"]["annotate"]["pooled"]["f2"] == summary["f2"]
    assert plain["f2"] == 1


def test_left_out_values_that_leave_nothing_to_learn_from_are_said(line: Line):
    line.run(LearnTemplates, where="class IS NOT NULL AND actor = 'bob'", methods=["soft"])
    line.run(Annotate)
    line.run(Evaluate)
    assert line.leave_out()["folds"] == 1
    assert (
        "bob: all training clips are of actor bob, so there is no such fold; not annotated: 1 take"
        in line.printed.getvalue()
    )
    with pytest.raises(KinedexError, match="takes have no column 'actr'; did you mean 'actor'"):
        line.leave_out("actr")


@pytest.fixture(scope="module")
def hdm05(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Line:
    """The HDM05 clips and takes as a store of reference words."""
    words = pl.read_parquet(shared / "reference" / "feature_words.parquet").with_columns(pl.col("take").cast(pl.String))
    words = words.filter(pl.col("take").str.starts_with("HDM_")).sort("take", "source_frame")
    takes = []
    for (name,), frames in words.group_by("take", maintain_order=True):
        parts = str(name).split("_")
        subclass = parts[2] if len(parts) == 5 else None
        sampled = frames.filter(pl.col("source_frame") % 4 == 0)["word"].to_numpy()
        takes.append(
            {"name": name, "actor": parts[1], "class": subclass, "words": sampled, "source_frames": frames.height}
        )
    store = write_store(tmp_path_factory.mktemp("hdm05") / "store", takes, shared / "data" / "hdm05")
    line = Line(store)
    line.run(LearnTemplates, methods=["soft"])
    return line


@pytest.mark.shared
@pytest.mark.parametrize(("tau", "f1", "f2"), [(0.13, 0.82, 0.87), (0.06, 0.83, 0.90)])
def test_an_actor_whom_no_template_has_seen_is_annotated_as_well_as_by_the_reference(
    hdm05: Line, tau: float, f1: float, f2: float
):
    hdm05.run(Annotate, tau=tau)
    summary = hdm05.run(Evaluate)
    assert float(str(summary["f1"])) >= f1
    assert float(str(summary["f2"])) >= f2


@pytest.mark.shared
def test_the_authors_queries_leave_a_seventh_of_the_frames_and_better_annotations(hdm05: Line, shared: Path):
    queries = str(shared / "reference" / "keyframe_queries.json")
    summary = hdm05.run(Annotate, queries=queries, classes="hdm05-11")
    assert 0.12 <= float(str(summary["searched"])) <= 0.16
    scores = hdm05.run(Evaluate)
    assert float(str(scores["f1"])) >= 0.84
    assert float(str(scores["f2"])) >= 0.91
    assert np.isfinite(float(str(scores["f1"])))
