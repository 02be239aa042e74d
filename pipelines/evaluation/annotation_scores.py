"""Evaluate annotations: count frames and segments per class and take, and make tables of the counts."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import pyarrow as pa

from kinedex.ops.evaluation.metrics import Counts, compare, pooled
from kinedex.ops.wording import two_digits
from kinedex.pipelines.engine.display import ResultTable
from kinedex.pipelines.evaluation.ground_truth import GroundTruth
from kinedex.storage.durable_files import replace_file, write_errors
from kinedex.storage.formats.json_text import json_text
from kinedex.storage.snapshot.schemas import result_schema

F_FRAMES, F_SEGMENTS = "F (frames)", "F (segments)"
"""Headings of the F-measures; the thesis and the keys in files call them F1 and F2."""

THESIS_NAMES = "F (frames) and F (segments) are F1 and F2 of the thesis (Section 5.4); P is precision, R recall"
"""The remark that explains these names, shown once per page or table."""


MEASURES = ("p1", "r1", "f1", "p2", "r2", "f2")
SCOPES = ("pooled", "fold", "class", "take")


@dataclass(frozen=True)
class Row:
    """A row of an evaluation, with the scope 'pooled', 'class', 'take', 'fold' or 'group' (takes with equal values)."""

    scope: str
    name: str
    counts: Counts


@dataclass(frozen=True)
class Evaluation:
    """An evaluation: its name and its rows."""

    name: str
    rows: tuple[Row, ...] = field(default_factory=tuple)

    @property
    def pooled(self) -> Counts:
        """The counts over all takes and classes."""
        return next(row.counts for row in self.rows if row.scope == "pooled")


def evaluate(name: str, annotations: pa.Table, truth: GroundTruth, classes: Sequence[str]) -> Evaluation:
    """Compare annotations with ground truth on the takes that have ground truth (thesis, Section 5.4).

    Parameters
    ----------
    name : str
        The name of the evaluation.
    annotations : pyarrow.Table
        Columns take, class, start and stop, such as results of the kind `annotations`.
    truth : GroundTruth
        The ground truth, with the takes to evaluate.
    classes : sequence of str
        The classes in the order of their rows; labels that only the ground truth has follow.

    Returns
    -------
    Evaluation
        Counts pooled over all takes and classes, and counts of each class and each take.
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


def measures(counts: Counts) -> dict[str, float | None]:
    """Return the six measures by name; a measure that is undefined is None."""
    return {name: defined(float(getattr(counts, name))) for name in MEASURES}


def defined(value: float) -> float | None:
    """Return a measure for JSON and tables; None for NaN, where it is undefined."""
    return None if math.isnan(value) else value


def scores(counts: Counts) -> dict[str, float | int | None]:
    """Return measures and counts by name; a measure that is undefined is None."""
    return {**measures(counts), **asdict(counts)}


def metrics_rows(evaluation: Evaluation, run: str) -> pa.Table:
    """Return an evaluation as results of the kind `metrics`."""
    rows = [
        {"run": run, "evaluation": evaluation.name, "scope": row.scope, "name": row.name, **scores(row.counts)}
        for row in evaluation.rows
    ]
    return pa.Table.from_pylist(rows, schema=result_schema("metrics"))


def write_metrics(path: Path, evaluation: Evaluation, run: str, **about: object) -> None:
    """Write an evaluation as JSON: the fields `about`, then measures and counts of every row by scope and name."""
    content: dict[str, object] = {"evaluation": evaluation.name, "run": run, **about}
    content["pooled"] = scores(evaluation.pooled)
    for scope, key in zip(SCOPES[1:], ("folds", "classes", "takes"), strict=True):
        rows = {row.name: scores(row.counts) for row in evaluation.rows if row.scope == scope}
        if rows:
            content[key] = rows
    text = json_text(content)
    with write_errors(path):
        replace_file(path, lambda unfinished: unfinished.write_text(text, encoding="utf-8"))


def metrics_table(evaluation: Evaluation, title: str, scopes: Sequence[str] = SCOPES) -> ResultTable:
    """Return an evaluation as a table for people, without classes that neither annotations nor ground truth contain.

    Parameters
    ----------
    evaluation : Evaluation
        The evaluation.
    title : str
        The title of the table.
    scopes : sequence of str
        The scopes of the rows that are shown.
    """
    columns = ("", F_FRAMES, "P", "R", F_SEGMENTS, "P", "R", "auto", "manual")
    table = ResultTable(columns, title=title, layout="close")
    for scope in scopes:
        section = bool(table.rows)
        for row in evaluation.rows:
            counts = row.counts
            if row.scope != scope or (scope == "class" and not counts.frames_automatic + counts.frames_manual):
                continue
            values = [counts.f1, counts.p1, counts.r1, counts.f2, counts.p2, counts.r2]
            table.add(
                row.name,
                *(two_digits(value) for value in values),
                f"{counts.segments_automatic_hit}/{counts.segments_automatic}",
                f"{counts.segments_manual_hit}/{counts.segments_manual}",
                tone="main" if scope == "pooled" else "plain",
                section=section,
            )
            section = False
    table.caption = f"{THESIS_NAMES}; auto, manual: number of segments that overlap one of the other side"
    return table
