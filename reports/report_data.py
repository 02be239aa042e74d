"""Define the content of a report as plain data, which is read from a store once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime

from kinedex.ops.arrays import F64
from kinedex.ops.intervals import TakeSegment, in_seconds


@dataclass(frozen=True)
class FeatureNames:
    """The feature set of a store: its identity, and the names of the rows of template images.

    `sets` has a tuple (name, number of the first feature, number of features) for each set, in the order of features.
    """

    name: str
    version: str
    digest: str
    names: tuple[str, ...]
    sets: tuple[tuple[str, int, int], ...] = ()


@dataclass(frozen=True)
class TakeRow:
    """One annotated take; `frames` and `rate_hz` are those of the analysis.

    `group` is the value of the take in the column that `ReportData.grouped_by` names.
    """

    name: str
    frames: int
    rate_hz: float
    actor: str | None = None
    warnings: tuple[str, ...] = ()
    group: str = ""

    @property
    def seconds(self) -> float:
        """Return the duration of the take in seconds."""
        return in_seconds(self.frames, self.rate_hz)


@dataclass(frozen=True)
class Score:
    """One row of an evaluation, with precision, recall and F-measure of frames (1) and of segments (2).

    `scope` is 'pooled', 'class', 'take' or 'fold'; an undefined measure (0/0) is None.
    """

    evaluation: str
    scope: str
    name: str
    p1: float | None = None
    r1: float | None = None
    f1: float | None = None
    p2: float | None = None
    r2: float | None = None
    f2: float | None = None
    frames_both: int = 0
    frames_automatic: int = 0
    frames_manual: int = 0
    segments_automatic_hit: int = 0
    segments_automatic: int = 0
    segments_manual_hit: int = 0
    segments_manual: int = 0


@dataclass(frozen=True)
class Template:
    """The motion template of a subclass: `values` has one row per column of the template, one column per feature."""

    subclass: str
    label: str | None
    kind: str
    values: F64
    clips: tuple[str, ...]
    rounds: int
    costs: tuple[float, ...] = ()
    origin: str = "learned"
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Curve:
    """The distance curve of one subclass over one take, with one cost per frame (inf if no path ends there)."""

    label: str
    subclass: str
    costs: F64
    preselected: float = 1.0


@dataclass(frozen=True)
class Failure:
    """A source file that was excluded, and the reason."""

    source: str
    stage: str
    error: str
    message: str
    line: int | None = None


@dataclass(frozen=True)
class StageRow:
    """The record of one stage in the manifest: its parameters and the summary of its result."""

    stage: str
    run: str
    finished: str
    seconds: float
    fingerprint: str
    params: Mapping[str, object] = field(default_factory=dict)
    summary: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class HitCount:
    """The number of hits of one keyframe query, with their takes and length."""

    query: str
    hits: int
    takes: int
    seconds: float


@dataclass(frozen=True)
class ReportData:
    """The content of a report.

    `takes` are the annotated takes sorted by name; `archive_takes` and `archive_seconds` are totals of the whole store.
    `evaluation` names the main evaluation in `scores`, and `held_out` the evaluation that leaves out one actor (or one
    value of another column of takes) at a time. `held_out_column` is that column, and `learned_from` has its values
    among the example clips. `subclasses` maps a class to the subclasses that were searched for it; it is empty if they
    are not stored. `grouped_by` names the column by which takes are grouped; it is empty if they are not grouped.
    `other_method` is the method that found the classes in `doubted` of segments. `curves` belong to the take
    `curves_take`. `not_applied` has each template and query with the takes to which it was not applied.
    """

    title: str
    pipeline: str
    created: datetime
    store_path: str
    source_roots: tuple[str, ...]
    kinedex_version: str
    feature_set: FeatureNames
    archive_takes: int
    archive_seconds: float
    takes: tuple[TakeRow, ...]
    automatic: tuple[TakeSegment, ...] = ()
    manual: tuple[TakeSegment, ...] = ()
    delta: float | None = None
    tau: float | None = None
    method: str | None = None
    other_method: str | None = None
    grouped_by: str = ""
    searched_share: float | None = None
    scores: tuple[Score, ...] = ()
    evaluation: str | None = None
    held_out: str | None = None
    held_out_column: str = "actor"
    learned_from: tuple[str, ...] = ()
    subclasses: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    templates: tuple[Template, ...] = ()
    other_templates: int = 0
    curves: tuple[Curve, ...] = ()
    curves_take: str | None = None
    curves_choice: str = ""
    hits: tuple[HitCount, ...] = ()
    failures: tuple[Failure, ...] = ()
    warnings: tuple[tuple[str, str], ...] = ()
    not_applied: tuple[tuple[str, tuple[str, ...]], ...] = ()
    stages: tuple[StageRow, ...] = ()
    versions: tuple[tuple[str, str], ...] = ()
    commands: tuple[str, ...] = ()

    def scores_of(self, evaluation: str | None, scope: str) -> tuple[Score, ...]:
        """Return the rows of one evaluation and scope, in stored order."""
        return tuple(s for s in self.scores if s.evaluation == evaluation and s.scope == scope)

    def pooled(self, evaluation: str | None) -> Score | None:
        """Return the pooled row of an evaluation; None if there is none."""
        rows = self.scores_of(evaluation, "pooled")
        return rows[0] if rows else None

    def take_scores(self) -> dict[str, Score]:
        """Return, by take, the row of the take in the main evaluation."""
        return {score.name: score for score in self.scores_of(self.evaluation, "take")}

    def labels(self) -> tuple[str, ...]:
        """Return all classes, sorted; colours and rows of the page have this order."""
        known = {segment.label for segment in (*self.automatic, *self.manual)}
        known.update(score.name for score in self.scores_of(self.evaluation, "class"))
        known.update(curve.label for curve in self.curves)
        known.update(self.subclasses)
        return tuple(sorted(known))
