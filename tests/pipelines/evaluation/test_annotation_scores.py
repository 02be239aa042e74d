"""Evaluating: ground truth is placed on takes, faults are named, counts are pooled."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import polars as pl
import pyarrow as pa
import pytest
from rich.console import Console

from kinedex.catalog.classes import Classes, MotionClass
from kinedex.console.terminal import Terminal
from kinedex.ops.errors import KinedexError, SourceError
from kinedex.ops.evaluation.metrics import Counts
from kinedex.ops.intervals import analysis_frame
from kinedex.pipelines.evaluation.annotation_scores import (
    Evaluation,
    evaluate,
    metrics_rows,
    metrics_table,
    write_metrics,
)
from kinedex.pipelines.evaluation.ground_truth import (
    GroundTruth,
    UnknownLabels,
    ground_truth_of_classes,
    ground_truth_rows,
    place_ground_truth,
)
from kinedex.storage.formats.labels.file_labels import LabelFile, ManualSegment
from kinedex.storage.snapshot.schemas import result_schema
from tests.storage.made_up import take_row, takes_table

CLASSES = Classes((MotionClass("legs", "", ("kick", "walk")), MotionClass("arms", "", ("wave",))))


def takes(*names: str, **columns: object) -> pl.DataFrame:
    rows = [take_row(number, name, 100, **columns) for number, name in enumerate(names, 1)]
    frame = pl.from_arrow(takes_table(rows))
    assert isinstance(frame, pl.DataFrame)
    return frame


def manual(take: str, label: str, start: int, stop: int, line: int = 2) -> ManualSegment:
    return ManualSegment(take, label, start, stop, "truth.csv", line)


def file(*segments: ManualSegment, takes: tuple[str, ...] = (), path: str = "truth.csv") -> LabelFile:
    """A label file of segments, and of takes besides in which there is nothing."""
    placed = tuple(replace(segment, path=path) for segment in segments)
    return LabelFile(path, tuple(dict.fromkeys([*(one.take for one in segments), *takes])), placed)


def place(
    segments: Sequence[ManualSegment],
    annotated: pl.DataFrame,
    archive: Sequence[str],
    classes: Classes,
    unknown: UnknownLabels = "error",
) -> GroundTruth:
    return place_ground_truth([file(*segments)], annotated, archive, classes, unknown)


def annotations(*rows: tuple[str, str, int, int]) -> pa.Table:
    filled = [
        dict.fromkeys(result_schema("annotations").names)
        | dict(zip(("take", "class", "start", "stop"), row, strict=True))
        for row in rows
    ]
    return pa.Table.from_pylist(filled, schema=result_schema("annotations"))


def test_source_frames_become_the_first_analysis_frame_at_or_after_them():
    assert [analysis_frame(n, 120.0, 30.0) for n in (0, 1, 4, 5, 337)] == [0, 1, 1, 2, 85]
    assert analysis_frame(3, 100.0, 30.0) == 1
    assert analysis_frame(10, 100.0, 30.0) == 3
    assert analysis_frame(7, 30.0, 30.0) == 7


def test_labels_are_classes_or_subclasses_and_touching_segments_stay_apart():
    truth = place(
        [manual("a", "legs", 0, 40), manual("a", "kick", 40, 80), manual("b", "wave", 4, 400)],
        takes("a", "b", "c"),
        ["a", "b", "c", "z"],
        CLASSES,
    )
    assert [(s.take, s.label, s.start, s.stop) for s in truth.segments] == [
        ("a", "legs", 0, 10),
        ("a", "legs", 10, 20),
        ("b", "arms", 1, 100),
    ]
    assert truth.takes == ("a", "b")
    assert truth.remarks == ("annotated takes without ground truth, not evaluated: c",)
    assert ground_truth_rows(truth, "r").column("origin").to_pylist() == ["truth.csv"] * 3


def test_an_unknown_label_is_an_error_a_miss_or_left_out():
    segments = [manual("a", "kick", 0, 40), manual("a", "wavee", 40, 80, line=7)]
    with pytest.raises(SourceError, match=r"csv:7: 'wavee' is neither.*did you mean 'wave'.*unknown_labels") as caught:
        place(segments, takes("a"), ["a"], CLASSES)
    assert caught.value.way_out == ("unknown_labels", "miss")
    assert "`--set classes=FILE`" in str(caught.value)
    left_out = place(segments, takes("a"), ["a"], CLASSES, "ignore")
    assert [s.label for s in left_out.segments] == ["legs"]
    assert left_out.remarks == ("labels of no class, excluded: wavee",)
    missed = place(segments, takes("a"), ["a"], CLASSES, "miss")
    counts = evaluate("x", annotations(("a", "legs", 0, 10)), missed, CLASSES.names).pooled
    assert (counts.r1, counts.r2, counts.p1) == (0.5, 0.5, 1)


def test_a_take_whose_labels_are_all_left_out_is_evaluated_and_what_is_found_in_it_is_wrong():
    segments = [manual("a", "kick", 0, 40), manual("b", "swim", 0, 40), manual("c", "kick", 1, 3, line=9)]
    truth = place(segments, takes("a", "b", "c", "d"), ["a", "b", "c", "d"], CLASSES, "ignore")
    assert truth.takes == ("a", "b", "c")
    assert truth.remarks == (
        "annotated takes without ground truth, not evaluated: d",
        "labels of no class, excluded: swim",
        "truth.csv:9: no analysis frame lies in this segment, excluded",
        "takes in which nothing is left to be found, evaluated as such: b, c",
    )
    found = annotations(("a", "legs", 0, 10), ("b", "legs", 0, 10), ("c", "arms", 0, 20), ("d", "legs", 0, 10))
    rows = {(row.scope, row.name): row.counts for row in evaluate("x", found, truth, CLASSES.names).rows}
    assert rows["pooled", "all"] == Counts(10, 40, 10, 1, 3, 1, 1)
    assert rows["take", "b"] == Counts(0, 10, 0, 0, 1, 0, 0)
    assert ("take", "d") not in rows


def test_a_take_that_somebody_found_empty_is_evaluated_and_what_is_found_in_it_is_wrong():
    labelled, empty = file(manual("a", "kick", 0, 40)), file(takes=("b",), path="b.txt")
    truth = place_ground_truth([labelled, empty], takes("a", "b", "c"), ["a", "b", "c"], CLASSES)
    assert truth.takes == ("a", "b")
    assert truth.remarks == (
        "annotated takes without ground truth, not evaluated: c",
        "takes of label files that have no segment of them, in which nothing is to be found: b",
    )
    found = annotations(("a", "legs", 0, 10), ("b", "legs", 0, 10), ("c", "legs", 0, 10))
    counts = evaluate("x", found, truth, CLASSES.names).pooled
    assert (counts.p1, counts.r1, counts.p2) == (0.5, 1, 0.5)
    alone = place_ground_truth([empty], takes("b"), ["b"], CLASSES)
    assert (alone.takes, alone.segments) == (("b",), ())
    with pytest.raises(KinedexError, match="none of its takes was annotated"):
        place_ground_truth([empty], takes("a"), ["a", "b"], CLASSES)


def test_what_two_files_say_counts_once_and_both_are_named():
    kick, wave = manual("a", "kick", 0, 40), manual("b", "wave", 40, 80)
    again = ManualSegment("a", "legs", 0, 1 / 3, "", None, in_seconds=True)  # 40 frames of 120 Hz, and its class
    truth = place_ground_truth(
        [file(kick, wave), file(again, wave, path="b.json")], takes("a", "b"), ["a", "b"], CLASSES
    )
    assert [(one.take, one.start, one.stop, one.origin) for one in truth.segments] == [
        ("a", 0, 10, "truth.csv"),
        ("b", 10, 20, "truth.csv"),
    ]
    assert truth.remarks == ("the same segments again, counted once: 2 in b.json that truth.csv has as well",)
    truth = place_ground_truth([file(kick, wave, kick)], takes("a", "b"), ["a", "b"], CLASSES)
    assert len(truth.segments) == 2
    assert truth.remarks == ("the same segments again, counted once: 1 in truth.csv itself",)


def test_a_take_that_two_files_label_differently_is_named():
    kick, wave = manual("a", "kick", 0, 40), manual("b", "wave", 40, 80)
    others = [file(wave, takes=("a",), path="b.json"), file(manual("b", "wave", 44, 80), path="c.vtt")]
    truth = place_ground_truth([file(kick), *others], takes("a", "b"), ["a", "b"], CLASSES)
    assert [(one.take, one.start) for one in truth.segments] == [("a", 0), ("b", 10), ("b", 11)]
    assert truth.remarks == (
        "takes that files label differently, all of it counted: a (truth.csv, b.json), b (b.json, c.vtt)",
    )


def test_a_segment_beyond_its_take_is_named_with_both_lengths():
    with pytest.raises(SourceError, match=r"truth.csv:2: stop 401 is beyond the end of a, which has 400 source frames"):
        place([manual("a", "kick", 0, 401)], takes("a"), ["a"], CLASSES)


def test_unknown_takes_are_listed_and_an_error_only_where_no_take_is_known():
    segments = [manual("a", "kick", 0, 40), manual("q", "kick", 0, 40)]
    assert place(segments, takes("a"), ["a"], CLASSES).remarks == ("truth.csv: 1 of 2 labels matches no take: q",)
    with pytest.raises(KinedexError, match=r"no take is named 'take_11'; did you mean 'take_1'"):
        place([manual("take_11", "kick", 0, 40)], takes("take_1"), ["take_1"], CLASSES)
    with pytest.raises(KinedexError, match="none of its takes was annotated"):
        place([manual("clip", "kick", 0, 40)], takes("take_1"), ["take_1", "clip"], CLASSES)


def test_a_segment_between_two_analysis_frames_is_said_to_be_left_out():
    truth = place([manual("a", "kick", 1, 3, line=5), manual("a", "kick", 4, 9)], takes("a"), ["a"], CLASSES)
    assert len(truth.segments) == 1
    assert truth.remarks == ("truth.csv:5: no analysis frame lies in this segment, excluded",)


def test_a_takes_own_class_spans_it():
    labelled = takes("a", "b", **{"class": "kick"})
    truth = ground_truth_of_classes(pl.concat([labelled, takes("c")]), CLASSES)
    assert [(s.take, s.label, s.start, s.stop, s.origin) for s in truth.segments] == [
        ("a", "legs", 0, 100, "take class"),
        ("b", "legs", 0, 100, "take class"),
    ]
    assert "1 annotated takes have no class" in truth.remarks[0]
    with pytest.raises(KinedexError, match="none of the annotated takes has a class"):
        ground_truth_of_classes(takes("c"), CLASSES)


def evaluation() -> Evaluation:
    truth = place(
        [manual("a", "kick", 0, 40), manual("b", "wave", 0, 40)], takes("a", "b", "c"), ["a", "b", "c"], CLASSES
    )
    found = annotations(("a", "legs", 5, 15), ("b", "legs", 0, 10), ("c", "legs", 0, 10))
    return evaluate("annotate", found, truth, CLASSES.names)


def test_counts_are_pooled_over_takes_with_ground_truth_by_class_and_by_take():
    rows = {(row.scope, row.name): row.counts for row in evaluation().rows}
    assert rows["pooled", "all"] == Counts(5, 20, 20, 1, 2, 1, 2)
    assert rows["class", "legs"] == Counts(5, 20, 10, 1, 2, 1, 1)
    assert rows["class", "arms"] == Counts(0, 0, 10, 0, 0, 0, 1)
    assert rows["take", "b"] == Counts(0, 10, 10, 0, 1, 0, 1)
    assert ("take", "c") not in rows


def test_metrics_are_stored_printed_and_written_with_what_is_undefined_left_empty(tmp_path: Path):
    table = metrics_rows(evaluation(), "r").to_pylist()
    arms = next(row for row in table if row["name"] == "arms")
    assert (arms["p1"], arms["r1"], arms["f1"]) == (None, 0, 0)
    out = io.StringIO()
    Terminal(Console(file=out, width=80)).show(metrics_table(evaluation(), "the title"))
    assert "the title" in out.getvalue()
    assert "legs" in out.getvalue()
    write_metrics(tmp_path / "metrics.json", evaluation(), "r", pipeline="p")
    written = json.loads((tmp_path / "metrics.json").read_text())
    assert written["pooled"]["f1"] == 0.25
    assert written["classes"]["arms"]["p1"] is None
    assert list(written["takes"]) == ["a", "b"]


def test_names_in_brackets_are_shown_and_a_report_that_cannot_be_written_is_an_error(tmp_path: Path):
    truth = place([manual("[/a]\\", "kick", 0, 40)], takes("[/a]\\"), ["[/a]\\"], CLASSES)
    out = io.StringIO()
    Terminal(Console(file=out, width=80)).show(metrics_table(evaluate("x", annotations(), truth, CLASSES.names), "t"))
    assert "[/a]\\ " in out.getvalue()
    (tmp_path / "metrics.json").mkdir()
    with pytest.raises(KinedexError, match=r"metrics\.json: cannot be written: Is a directory"):
        write_metrics(tmp_path / "metrics.json", evaluation(), "r")
