"""Summarise an annotation for its report: totals, tables by class and by group, and the list of all segments."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
import polars as pl
from markupsafe import Markup

from kinedex.ops.evaluation.metrics import Counts, pooled
from kinedex.ops.intervals import TakeSegment
from kinedex.pipelines.labels.row_selection import least_confident_first
from kinedex.reports.embedded_motions import EmbeddedMotions, script_json
from kinedex.reports.report_data import ReportData, Score
from kinedex.reports.take_selection import by_group
from kinedex.storage.formats.csv_tables import csv_line

MOVING = 4
"""Number of the most and of the least confident segments that the first screen shows as moving figures."""

BARS = 20
"""Maximum number of classes on the first screen; the table has all of them."""


@dataclass(frozen=True)
class Totals:
    """The totals of all takes: segments, classes, takes with a segment, seconds of takes, and seconds with a label."""

    segments: int
    classes: int
    takes: int
    seconds: float
    labelled: float

    @property
    def share(self) -> float:
        """Return the fraction of the time that has a label."""
        return self.labelled / self.seconds if self.seconds else 0.0


@dataclass(frozen=True)
class ClassFindings:
    """The segments of a class: their number, takes and seconds, median and minimum of the confidences."""

    label: str
    segments: int
    takes: int
    seconds: float
    confidence: float | None
    least: float | None


@dataclass(frozen=True)
class GroupFindings:
    """A group of takes: its takes and seconds, its segments, most frequent classes, and agreement with ground truth."""

    name: str
    takes: tuple[str, ...]
    seconds: float
    segments: int
    labelled: float
    common: tuple[str, ...]
    f1: float | None
    f2: float | None


def totals(data: ReportData) -> Totals:
    """Return totals of the automatic segments; a frame with several labels counts once."""
    rates = {take.name: take.rate_hz for take in data.takes}
    return Totals(
        segments=len(data.automatic),
        classes=len({one.label for one in data.automatic}),
        takes=len({one.take for one in data.automatic}),
        seconds=sum(take.seconds for take in data.takes),
        labelled=sum(frames / rates[take] for take, frames in _labelled(data.automatic).items()),
    )


def class_findings(data: ReportData) -> list[ClassFindings]:
    """Return the totals of each class, sorted by duration, the longest first; classes without segments come last."""
    rates = {take.name: take.rate_hz for take in data.takes}
    grouped: dict[str, list[TakeSegment]] = defaultdict(list)
    for one in data.automatic:
        grouped[one.label].append(one)
    rows = []
    for label in data.labels():
        own = grouped[label]
        sure = [one.confidence for one in own if one.confidence is not None]
        rows.append(
            ClassFindings(
                label=label,
                segments=len(own),
                takes=len({one.take for one in own}),
                seconds=sum((one.stop - one.start) / rates[one.take] for one in own),
                confidence=float(np.median(sure)) if sure else None,
                least=min(sure, default=None),
            )
        )
    return sorted(rows, key=lambda row: (-row.seconds, row.label))


def group_findings(data: ReportData) -> list[GroupFindings]:
    """Return the totals of each group of takes; empty if takes are not grouped."""
    if not data.grouped_by:
        return []
    rows = {take.name: take for take in data.takes}
    scores = data.take_scores()
    labelled = _labelled(data.automatic)
    segments: dict[str, list[str]] = defaultdict(list)
    for one in data.automatic:
        segments[one.take].append(one.label)
    found = []
    for group, names in by_group({take.name: take.group for take in data.takes}, list(rows)).items():
        labels = Counter(label for name in names for label in segments[name])
        f1, f2 = _agreement([scores[name] for name in names if name in scores])
        found.append(
            GroupFindings(
                name=group,
                takes=tuple(names),
                seconds=sum(rows[name].seconds for name in names),
                segments=sum(labels.values()),
                labelled=sum(labelled.get(name, 0) / rows[name].rate_hz for name in names),
                common=tuple(label for label, _ in sorted(labels.items(), key=lambda pair: (-pair[1], pair[0]))[:3]),
                f1=f1,
                f2=f2,
            )
        )
    return found


def surest(segments: Sequence[TakeSegment], count: int = MOVING) -> list[TakeSegment]:
    """Return the most confident segments, of as many different classes as possible."""
    return _of_classes(sorted(segments, key=lambda one: (-(one.confidence or 0.0), _cost(one), one.key)), count)


def most_doubtful(segments: Sequence[TakeSegment], count: int = MOVING) -> list[TakeSegment]:
    """Return the least confident segments, of as many different classes as possible."""
    known = [one for one in segments if one.confidence is not None]
    return _of_classes(sorted(known, key=lambda one: (one.confidence, -_cost(one), one.key)), count)


def _cost(segment: TakeSegment) -> float:
    return segment.cost if segment.cost is not None else 0.0


def _of_classes(ranked: Sequence[TakeSegment], count: int) -> list[TakeSegment]:
    """Return up to `count` segments in the given order: the first of each class, then the second of each, and so on."""
    seen: Counter[str] = Counter()
    rounds = []
    for place, one in enumerate(ranked):
        rounds.append((seen[one.label], place))
        seen[one.label] += 1
    chosen = sorted(rounds)[:count]
    return [ranked[place] for _, place in sorted(chosen, key=lambda pair: pair[1])]


def _labelled(segments: Sequence[TakeSegment]) -> dict[str, int]:
    """Return, by take, the number of frames with a label; frames with several labels count once."""
    grouped: dict[str, list[tuple[int, int]]] = defaultdict(list)
    for one in segments:
        grouped[one.take].append((one.start, one.stop))
    found = {}
    for take, ranges in grouped.items():
        last, count = 0, 0
        for start, stop in sorted(ranges):
            count += max(0, stop - max(start, last))
            last = max(last, stop)
        found[take] = count
    return found


def _agreement(scores: Sequence[Score]) -> tuple[float | None, float | None]:
    """Return F (frames) and F (segments) over the pooled counts of takes; None without scores."""
    counts = pooled(Counts(*(getattr(score, field.name) for field in fields(Counts))) for score in scores)
    return (counts.f1, counts.f2) if scores else (None, None)


MAX_ROWS = 5000
"""Maximum number of segments on the page, which shows the least confident ones; the CSV file has all segments."""

LOOKS = 25
"""Number of segments that the page proposes to review first."""

SEGMENTS = "report.segments.csv"
"""The file of all segments, beside the page."""

COLUMNS = (
    "take", "class", "subclass", "start", "stop", "start_seconds", "stop_seconds", "cost", "confidence", "other_method",
)  # fmt: skip
"""The columns of the CSV file; `kinedex labels accept --rows` reads it."""

Key = tuple[str, str, int, int]


@dataclass(frozen=True)
class SegmentList:
    """The segments that the page lists.

    Attributes
    ----------
    total : int
        Number of all segments.
    shown : tuple of TakeSegment
        The segments on the page, the least confident first.
    looks : tuple of TakeSegment
        The segments that the page proposes to review first.
    rows_json : Markup
        The rows for the script of the page.
    """

    total: int
    shown: tuple[TakeSegment, ...]
    looks: tuple[TakeSegment, ...]
    rows_json: Markup


def in_order(segments: Sequence[TakeSegment]) -> list[TakeSegment]:
    """Return segments in the order of review, the least confident first."""
    rows = [(*one.key, one.confidence, place) for place, one in enumerate(segments)]
    schema = {"take": pl.String, "class": pl.String, "start": pl.Int64, "stop": pl.Int64,
              "confidence": pl.Float64, "place": pl.Int64}  # fmt: skip
    return [segments[place] for place in least_confident_first(pl.DataFrame(rows, schema, orient="row"))["place"]]


def segment_list(
    data: ReportData,
    slots: Mapping[str, int],
    motions: EmbeddedMotions | None,
    near: Mapping[Key, int],
    confirmed: Mapping[Key, bool] | None,
) -> SegmentList:
    """Lay out the list of segments.

    Parameters
    ----------
    data : ReportData
        The content of the page.
    slots : mapping of str to int
        Colour of each class.
    motions : EmbeddedMotions or None
        The motions that can be played.
    near : mapping of (take, class, start, stop) to int
        Nearest examples.
    confirmed : mapping of (take, class, start, stop) to bool, or None
        Segment → True if ground truth of its class overlaps it; None without ground truth.
    """
    ordered = in_order(data.automatic)
    shown = ordered[:MAX_ROWS]
    takes = {name: place for place, name in enumerate(dict.fromkeys(one.take for one in shown))}
    classes = {name: place for place, name in enumerate(dict.fromkeys(one.label for one in shown))}
    names = {name: place for place, name in enumerate(dict.fromkeys(one.subclass or one.label for one in shown))}
    rates = {take.name: take.rate_hz for take in data.takes}
    rows = [
        [
            takes[one.take], classes[one.label], names[one.subclass or one.label], one.start, one.stop,
            None if one.confidence is None else round(one.confidence, 3),
            None if one.cost is None else round(one.cost, 3),
            int(motions is not None and motions.has(one.take, one.start, one.stop)), near.get(one.key),
            one.doubted, None if confirmed is None else int(confirmed[one.key]),
        ]
        for one in shown
    ]  # fmt: skip
    content = {
        "takes": list(takes),
        "rates": [rates[name] for name in takes],
        "classes": list(classes),
        "slots": [slots[name] for name in classes],
        "subclasses": list(names),
        "rows": rows,
    }
    return SegmentList(len(ordered), tuple(shown), tuple(ordered[:LOOKS]), script_json(content))


def csv_lines(data: ReportData) -> Iterator[str]:
    """Yield the lines of a CSV file of all segments, by take and start."""
    rates = {take.name: take.rate_hz for take in data.takes}
    yield csv_line(COLUMNS)
    for one in data.automatic:
        seconds = (round(frame / rates[one.take], 4) for frame in (one.start, one.stop))
        measures = (None if value is None else round(value, 6) for value in (one.cost, one.confidence))
        yield csv_line((one.take, one.label, one.subclass, one.start, one.stop, *seconds, *measures, one.doubted))
