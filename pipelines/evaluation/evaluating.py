"""Evaluating annotations: ground truth placed on takes, counts per class and take, and how they are shown."""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

import polars as pl
import pyarrow as pa
from rich import box
from rich.table import Table
from rich.text import Text

from catalog.classes import Classes
from ops.errors import KinedexError, did_you_mean
from ops.measures.metrics import Counts, compare, pooled
from pipelines.wording import few
from storage.disk import writing
from storage.ground_truth import ManualSegment
from storage.schemas import result_schema

UnknownLabels = Literal["error", "miss", "ignore"]
MEASURES = ("p1", "r1", "f1", "p2", "r2", "f2")
SCOPES = ("pooled", "fold", "class", "take")


@dataclass(frozen=True)
class Manual:
    """A manual segment on a take of the store, in analysis frames [start, stop), with its class."""

    take_id: int
    take: str
    label: str
    start: int
    stop: int
    source_start: int
    source_stop: int
    origin: str


@dataclass(frozen=True)
class GroundTruth:
    """What is known of the takes that are evaluated.

    takes: their names, sorted; in a take without any segment (all of its labels are left out) nothing is to be found.
    remarks: what had to be left out, in words.
    """

    segments: tuple[Manual, ...]
    takes: tuple[str, ...]
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Row:
    """One line of an evaluation: scope 'pooled', 'class', 'take', 'fold' or 'group' (takes with one value)."""

    scope: str
    name: str
    counts: Counts


@dataclass(frozen=True)
class Evaluation:
    """An evaluation by its name, and its lines."""

    name: str
    rows: tuple[Row, ...] = field(default_factory=tuple)

    @property
    def pooled(self) -> Counts:
        """The counts over everything."""
        return next(row.counts for row in self.rows if row.scope == "pooled")


def place_ground_truth(
    segments: Sequence[ManualSegment],
    takes: pl.DataFrame,
    archive: Iterable[str],
    classes: Classes,
    unknown_labels: UnknownLabels = "error",
) -> GroundTruth:
    """Put manual segments of label files on the takes that were annotated, in analysis frames.

    Parameters
    ----------
    segments: source frames, or seconds, which become the nearest source frames; touching ones stay separate.
    takes: the annotated takes. archive: the names of all takes of the store.
    unknown_labels: what a label does that is neither a class nor a subclass in one: "error"; "miss": it counts as a
        class that was not found; "ignore": it is left out, and so said, but its take is evaluated all the same.

    Raises
    ------
    SourceError: a segment ends beyond its take. KinedexError: an unknown label, or no segment is on an annotated take.
    """
    by_name = {row["name"]: row for row in takes.iter_rows(named=True)}
    known_takes = set(archive)
    here = [segment for segment in segments if segment.take in by_name]
    absent = sorted({segment.take for segment in segments} - known_takes)
    remarks = [f"ground truth of takes that the archive does not have: {few(absent)}"] if absent else []
    if not here:
        hint = did_you_mean(absent[0], known_takes) if absent else "; none of its takes was annotated"
        raise KinedexError(
            f"none of the {len(segments)} manual segments is on a take that was annotated"
            + (f": no take is named '{absent[0]}'{hint}" if absent else hint)
        )
    evaluated = {segment.take for segment in here}
    silent = sorted(set(by_name) - evaluated)
    if silent:
        remarks.append(f"annotated takes without ground truth, not evaluated: {few(silent)}")
    labels = _labels(here, classes, unknown_labels)
    ignored = sorted(label for label, name in labels.items() if name is None)
    if ignored:
        remarks.append(f"labels of no class, left out: {few(ignored)}")
    missed = sorted(label for label, name in labels.items() if name == label and classes.class_of(label) is None)
    if missed:
        remarks.append(f"labels of no class, counted as missed: {few(missed)}")
    placed = []
    for segment in here:
        manual = _placed(segment, by_name[segment.take], labels[segment.label])
        if manual is not None and manual.start < manual.stop:
            placed.append(manual)
        elif manual is not None:
            remarks.append(f"{segment.where}: no analysis frame lies in this segment, left out")
    bare = sorted(evaluated - {segment.take for segment in placed})
    if bare:
        remarks.append(f"takes in which nothing is left to be found, evaluated as such: {few(bare)}")
    return GroundTruth(tuple(placed), tuple(sorted(evaluated)), tuple(remarks))


def ground_truth_of_classes(takes: pl.DataFrame, classes: Classes) -> GroundTruth:
    """Take each take's own class as ground truth for all of it.

    Raises
    ------
    KinedexError: no take has a class.
    """
    labelled = takes.filter(pl.col("class").is_not_null())
    known = [(row, classes.class_of(row["class"])) for row in labelled.iter_rows(named=True)]
    if not known:
        raise KinedexError("none of the annotated takes has a class; ground_truth must be a CSV file instead")
    segments = [
        Manual(row["take_id"], row["name"], name, 0, row["frames"], 0, row["source_frames"], "take class")
        for row, name in known
        if name is not None
    ]
    remarks = []
    if labelled.height < takes.height:
        remarks.append(f"{takes.height - labelled.height} annotated takes have no class and are not evaluated")
    outside = sorted({row["class"] for row, name in known if name is None})
    if outside:
        remarks.append(f"takes of subclasses in no class, not evaluated: {few(outside)}")
    return GroundTruth(tuple(segments), tuple(sorted(segment.take for segment in segments)), tuple(remarks))


def analysis_frame(source_frame: int, source_rate_hz: float, rate_hz: float) -> int:
    """The first analysis frame at or after a source frame: ceil(source_frame · rate / source_rate)."""
    return math.ceil(round(source_frame * rate_hz / source_rate_hz, 9))


def _labels(segments: Sequence[ManualSegment], classes: Classes, unknown: UnknownLabels) -> dict[str, str | None]:
    """Label → the class that it counts for, None for none."""
    result: dict[str, str | None] = {}
    for segment in segments:
        name = classes.class_of(segment.label)
        if name is None and unknown == "error":
            labels = {*classes.names, *classes.of_subclass()}
            raise segment.error(
                f"'{segment.label}' is neither a class nor a subclass of this evaluation"
                f"{did_you_mean(segment.label, labels)} (`unknown_labels: miss` counts it as missed, `ignore` leaves "
                "it out)"
            )
        result[segment.label] = segment.label if name is None and unknown == "miss" else name
    return result


def _placed(segment: ManualSegment, take: dict[str, object], label: str | None) -> Manual | None:
    frames, rate_hz = int(str(take["source_frames"])), float(str(take["rate_hz"]))
    source_rate_hz = float(str(take["source_rate_hz"]))
    start, stop = segment.source_frames(source_rate_hz)
    if stop > frames:
        raise segment.error(f"stop {stop} is beyond the end of {segment.take}, which has {frames} source frames")
    if label is None:
        return None
    return Manual(
        int(str(take["take_id"])),
        segment.take,
        label,
        analysis_frame(start, source_rate_hz, rate_hz),
        analysis_frame(stop, source_rate_hz, rate_hz),
        start,
        stop,
        segment.path,
    )


def evaluate(name: str, annotations: pa.Table, truth: GroundTruth, classes: Sequence[str]) -> Evaluation:
    """Compare annotations with ground truth on the takes that have it; counts are pooled (thesis, 5.4).

    Parameters
    ----------
    name: the evaluation's name. annotations: results of the kind `annotations`.
    classes: names in the order of their lines; labels that only the ground truth has follow.
    """
    automatic: dict[tuple[str, str], list[tuple[int, int]]] = defaultdict(list)
    manual: dict[tuple[str, str], list[tuple[int, int]]] = defaultdict(list)
    for row in annotations.select(["take", "class", "start", "stop"]).to_pylist():
        automatic[row["take"], row["class"]].append((row["start"], row["stop"]))
    for segment in truth.segments:
        manual[segment.take, segment.label].append((segment.start, segment.stop))
    labels = list(dict.fromkeys([*classes, *sorted({segment.label for segment in truth.segments})]))
    counts = {
        (take, label): compare(automatic[take, label], manual[take, label]) for take in truth.takes for label in labels
    }
    rows = [Row("pooled", "all", pooled(counts.values()))]
    rows += [Row("class", label, pooled(counts[take, label] for take in truth.takes)) for label in labels]
    rows += [Row("take", take, pooled(counts[take, label] for label in labels)) for take in truth.takes]
    return Evaluation(name, tuple(rows))


def pool_folds(name: str, folds: Sequence[tuple[str, Evaluation]]) -> Evaluation:
    """Pool evaluations of disjoint takes: a line per fold, and all lines of the folds added up."""
    rows = [Row("pooled", "all", pooled(one.pooled for _, one in folds))]
    rows += [Row("fold", fold, one.pooled) for fold, one in folds]
    for scope in ("class", "take"):
        sums: dict[str, Counts] = {}
        for _, one in folds:
            for row in one.rows:
                if row.scope == scope:
                    sums[row.name] = sums.get(row.name, Counts()) + row.counts
        rows += [Row(scope, label, counts) for label, counts in sums.items()]
    return Evaluation(name, tuple(rows))


def measures(counts: Counts) -> dict[str, float | None]:
    """The six measures by name, None where one is undefined."""
    values = {name: float(getattr(counts, name)) for name in MEASURES}
    return {name: None if math.isnan(value) else value for name, value in values.items()}


def metrics_rows(evaluation: Evaluation, run: str) -> pa.Table:
    """Lay an evaluation out as results of the kind `metrics`."""
    rows = [
        {"run": run, "evaluation": evaluation.name, "scope": row.scope, "name": row.name}
        | measures(row.counts)
        | asdict(row.counts)
        for row in evaluation.rows
    ]
    return pa.Table.from_pylist(rows, schema=result_schema("metrics"))


def ground_truth_rows(truth: GroundTruth, run: str) -> pa.Table:
    """Lay ground truth out as results of the kind `ground_truth`, by take and start."""
    rows = [
        {
            "run": run,
            "take_id": one.take_id,
            "take": one.take,
            "class": one.label,
            "start": one.start,
            "stop": one.stop,
            "source_start": one.source_start,
            "source_stop": one.source_stop,
            "origin": one.origin,
        }
        for one in sorted(truth.segments, key=lambda one: (one.take, one.start, one.stop, one.label))
    ]
    return pa.Table.from_pylist(rows, schema=result_schema("ground_truth"))


def write_metrics(path: Path, evaluation: Evaluation, run: str, **about: object) -> None:
    """Write an evaluation as JSON: about it, then per scope name → measures and counts."""
    content: dict[str, object] = {"evaluation": evaluation.name, "run": run, **about}
    content["pooled"] = measures(evaluation.pooled) | asdict(evaluation.pooled)
    for scope, key in zip(SCOPES[1:], ("folds", "classes", "takes"), strict=True):
        rows = {row.name: measures(row.counts) | asdict(row.counts) for row in evaluation.rows if row.scope == scope}
        if rows:
            content[key] = rows
    temporary = path.with_name(f".tmp-{path.name}")
    with writing(path):
        temporary.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        temporary.replace(path)


def metrics_table(evaluation: Evaluation, title: str, scopes: Sequence[str] = SCOPES) -> Table:
    """An evaluation as a table for the terminal.

    Classes that are neither annotated nor there are left out, and so are lines of other scopes than these.
    """
    table = Table(
        title=title,
        title_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
        header_style="bold",
    )
    table.add_column("", overflow="fold")
    for name in ("F1", "P1", "R1", "F2", "P2", "R2", "auto", "manual"):
        table.add_column(name, justify="right", no_wrap=True)
    for scope in scopes:
        table.add_section()
        for row in evaluation.rows:
            counts = row.counts
            if row.scope != scope or (scope == "class" and not counts.frames_automatic + counts.frames_manual):
                continue
            values = [counts.f1, counts.p1, counts.r1, counts.f2, counts.p2, counts.r2]
            table.add_row(
                Text(row.name),
                *("–" if math.isnan(value) else f"{value:.2f}" for value in values),
                f"{counts.segments_automatic_hit}/{counts.segments_automatic}",
                f"{counts.segments_manual_hit}/{counts.segments_manual}",
                style="bold" if scope == "pooled" else None,
            )
    table.caption = "1: frames, 2: segments; auto, manual: how many segments overlap one of the other side"
    return table
