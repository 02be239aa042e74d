"""A report takes from a store what the stages stored, and recomputes nothing."""

from __future__ import annotations

import re
from pathlib import Path

import pyarrow as pa
import pytest

from kinedex.catalog.features import FeatureSet, load_feature_set
from kinedex.console.terminal import Terminal
from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import TakeSegment
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.executors import make_executor
from kinedex.reports.annotation_data import read_report_data
from kinedex.reports.annotation_page import annotation_page
from kinedex.reports.report_data import Failure
from kinedex.reports.stages.report import Report
from kinedex.storage.snapshot.manifest import StageRecord
from kinedex.storage.snapshot.schemas import frames_schema, result_schema, takes_schema
from kinedex.storage.store.store import open_store
from kinedex.storage.store.writer import StoreWriter
from tests.pipelines.study import FRAMES, MOMENT, Reading


def table(schema: pa.Schema, rows: list[dict[str, object]]) -> pa.Table:
    """Rows of a schema; columns that they lack are null."""
    return pa.Table.from_pylist([{name: row.get(name) for name in schema.names} for row in rows], schema=schema)


def put_takes(writer: StoreWriter, features: FeatureSet, names: dict[str, str | None]) -> dict[str, int]:
    """Add takes of these names and classes, and return their ids."""
    ids = writer.assign_take_ids(names)
    takes = [
        {"take_id": ids[name], "name": name, "source": f"{name}.amc", "source_root": "/archive", "rate_hz": 30.0,
         "frames": FRAMES, "seconds": 3.0, "invalid_frames": 0, "actor": "ann", "class": label, "groups": "{}",
         "warnings": ["odd header"] if name == "long_1" else []}
        for name, label in names.items()
    ]  # fmt: skip
    point, turn = dict.fromkeys("xyz", 0.0), dict(zip("wxyz", (1.0, 0.0, 0.0, 0.0), strict=True))
    joints = dict.fromkeys(features.joints, point)
    frames = [
        {"take_id": i, "frame": f, **joints, "root_orientation": turn, "word": 0}
        for i in sorted(ids.values())
        for f in range(FRAMES)
    ]
    writer.add_takes(table(takes_schema(), takes), table(frames_schema(features, 30.0), frames))
    return ids


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """A store with two annotated takes and one clip, as the pipeline `study` would leave it."""
    features = load_feature_set()
    path = tmp_path / "store"
    names = {"clip_a": "squat1Reps", "long_1": None, "long_2": None}
    with StoreWriter.open(path, features) as writer:
        ids = put_takes(writer, features, names)

        def put(kind: str, stage: str, rows: list[dict[str, object]]) -> None:
            schema = result_schema(kind)
            rows = [{**row, "run": f"run-{stage}"} for row in rows]
            writer.put_results(kind, table(schema, rows), stage=f"study/{stage}", run=f"run-{stage}")

        put("templates", "learn_templates", [
            {"subclass": "squat1Reps", "kind": kind, "features": 40, "columns": 2, "values": [0.0, 1.0] * 40,
             "weights": [1.0, 1.0], "clips": ["clip_a"], "rounds": 1, "costs": [0.0]} for kind in ("soft", "hard")
        ])  # fmt: skip
        put("distance_curves", "annotate", [
            {"take_id": ids[name], "take": name, "class": "squat", "subclass": "squat1Reps",
             "costs": [0.5] * 40 + [low] + [0.5] * 49, "preselected": 0.5}
            for name, low in (("long_1", 0.01), ("long_2", 0.02))
        ])  # fmt: skip
        put("annotated_takes", "annotate", [
            {"take_id": ids[name], "take": name, "frames": FRAMES} for name in ("long_1", "long_2")
        ])  # fmt: skip
        put("annotations", "annotate", [
            {"take_id": ids["long_1"], "take": "long_1", "class": "squat", "subclass": "squat1Reps", "start": 20,
             "stop": 41, "start_seconds": 0.67, "stop_seconds": 1.37, "cost": 0.01, "method": "thesis"}
        ])  # fmt: skip
        put("ground_truth", "evaluate", [
            {"take_id": ids["long_1"], "take": "long_1", "class": "squat", "start": 21, "stop": 44, "origin": "x.csv"}
        ])  # fmt: skip
        for name, measure in (("evaluate", 0.91), ("leave_one_out", 0.61)):
            put("metrics", name, [
                {"evaluation": name, "scope": scope, "name": of, "f1": measure, "f2": measure,
                 **dict.fromkeys(result_schema("metrics").names[10:], 7)}
                for scope, of in (("pooled", "all"), ("take", "long_1"), ("fold", "ann"))
            ])  # fmt: skip
        put("ingest_log", "ingest", [
            {"source": "bad.amc", "stage": "ingest", "error": "SourceError", "message": "frame 9 is cut", "line": 99,
             "logged_at": MOMENT}
        ])  # fmt: skip
        for name in ("ingest", "learn_templates", "annotate", "evaluate", "report"):
            summary = {
                "uses": name,
                "params": {"delta": 0.04, "tau": 0.11, "templates": "soft"},
                "searched": 0.5,
                "inputs": {"takes": "ingest"} if name == "annotate" else {},
            }
            writer.record_stage(StageRecord(f"study/{name}", f"print-{name}", f"run-{name}", "2026", 1.0, summary))
        writer.commit()
    return path


def context(path: Path, inputs: dict[str, str]) -> StageContext:
    return StageContext(
        store_path=path,
        feature_set=load_feature_set(),
        pipeline="study",
        stage="report",
        run="run-report",
        executor=make_executor("serial", None),
        terminal=Terminal(),
        inputs=inputs,
    )


INPUTS = {
    "templates": "learn_templates",
    "annotations": "annotate",
    "evaluation": "evaluate",
    "leave_one_out": "leave_one_out",
}


def test_a_store_gives_everything_that_a_report_shows(store: Path) -> None:
    data = read_report_data(open_store(store), "study", created=MOMENT, inputs=INPUTS, own_stage="report")
    assert [take.name for take in data.takes] == ["long_1", "long_2"]
    assert data.archive_takes == 3
    assert data.title == "Annotation of archive"
    assert (data.delta, data.tau, data.searched_share) == (0.04, 0.11, 0.5)
    assert data.automatic == (TakeSegment("long_1", "squat", 20, 41, 0.01, "squat1Reps"),)
    assert data.manual == (TakeSegment("long_1", "squat", 21, 44),)
    main, held = data.pooled(data.evaluation), data.pooled(data.held_out)
    assert main is not None
    assert held is not None
    assert (main.f1, held.f1) == (0.91, 0.61)
    assert [(t.subclass, t.label, t.values.shape) for t in data.templates] == [("squat1Reps", "squat", (2, 40))]
    assert data.other_templates == 1
    assert data.learned_from == ("ann",)
    assert data.curves_take == "long_1"
    assert data.curves[0].costs[40] == pytest.approx(0.01)
    assert data.warnings == (("long_1", "odd header"),)
    assert data.failures == (Failure("bad.amc", "ingest", "SourceError", "frame 9 is cut", 99),)
    assert [row.stage for row in data.stages] == ["evaluate", "ingest", "annotate", "learn_templates"]
    assert data.stages[2].summary == {"searched": 0.5}


def test_only_stages_that_play_a_role_are_reported(store: Path) -> None:
    inputs = {"templates": "learn_templates", "annotations": "annotate"}
    data = read_report_data(open_store(store), "study", created=MOMENT, inputs=inputs)
    assert data.scores == ()
    assert data.manual == ()
    assert data.curves_take == "long_1"


def test_another_takes_curves_can_be_asked_for(store: Path) -> None:
    data = read_report_data(open_store(store), "study", created=MOMENT, inputs=INPUTS, curves_take="long_2")
    assert data.curves[0].costs[40] == pytest.approx(0.02)
    with pytest.raises(KinedexError, match="no annotated take is named 'long_3'; did you mean"):
        read_report_data(open_store(store), "study", created=MOMENT, inputs=INPUTS, curves_take="long_3")


def test_segments_that_another_method_of_the_store_does_not_find_are_doubted(store: Path) -> None:
    with StoreWriter.open(store, load_feature_set()) as writer:
        schema = result_schema("annotations")
        kick = {"run": "run-o", "take_id": 1, "take": "long_1", "class": "kick", "subclass": "kick", "start": 30,
                "stop": 50, "cost": 0.1, "confidence": 0.3, "method": "all frames in a row"}  # fmt: skip
        writer.put_results("annotations", table(schema, [kick]), stage="other/annotate", run="run-o")
        seen = [{"run": "run-o", "take_id": i, "take": f"long_{i}", "frames": FRAMES} for i in (1, 2)]
        schema = result_schema("annotated_takes")
        writer.put_results("annotated_takes", table(schema, seen), stage="other/annotate", run="run-o")
        writer.record_stage(StageRecord("other/annotate", "print", "run-o", "2026", 1.0, {"uses": "annotate"}))
        writer.commit()
    data = read_report_data(open_store(store), "study", created=MOMENT, inputs=INPUTS)
    assert data.other_method == "all frames in a row"
    assert [one.doubted for one in data.automatic] == ["kick"]


def test_an_empty_store_has_a_report_too(tmp_path: Path) -> None:
    with StoreWriter.open(tmp_path / "store", load_feature_set()) as writer:
        writer.commit()
    page = annotation_page(read_report_data(open_store(tmp_path / "store"), "study", created=MOMENT, inputs=INPUTS))
    assert "No take was annotated" in page


def test_the_stage_writes_the_page_beside_the_results(store: Path) -> None:
    summary = Report().run(context(store, INPUTS), Report.parameters(title="A study"))
    path = store / "results" / "reports" / "study" / "report.html"
    assert summary["files"] == [f"results/reports/study/report.{ending}" for ending in ("html", "segments.csv")]
    assert summary["bytes"] == path.stat().st_size
    text = Reading(path.read_text(encoding="utf-8")).text
    assert "A study" in text
    assert "0.91 F (frames)" in text
    assert "0.61 F (frames)" in text


def test_a_changed_page_template_changes_what_the_stage_depends_on() -> None:
    digest = Report().external_digest(Report.parameters(), None)
    assert digest == Report().external_digest(Report.parameters(title="other"), None)
    assert re.fullmatch(r"[0-9a-f]{16}", digest)
