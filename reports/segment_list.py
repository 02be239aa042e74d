"""List all segments, as rows on the page and as a CSV file beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import polars as pl
from markupsafe import Markup

from kinedex.ops.intervals import TakeSegment
from kinedex.pipelines.labels.selection import least_confident_first
from kinedex.reports.data import ReportData
from kinedex.reports.motions import Motions, script_json
from kinedex.storage.formats.csv_tables import csv_line

MOST_ROWS = 5000
"""Maximum number of segments on the page, the least confident ones; the CSV file beside it has all."""

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
        Those on the page, the least confident first.
    looks : tuple of TakeSegment
        The first of them, which the page proposes to review first.
    rows_json : Markup
        The rows for the page's script.
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
    motions: Motions | None,
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
    motions : Motions or None
        The motions that can be played.
    near : mapping of (take, class, start, stop) to int
        Nearest examples.
    confirmed : mapping of (take, class, start, stop) to bool, or None
        Whether the ground truth has the class there; None without ground truth.
    """
    ordered = in_order(data.automatic)
    shown = ordered[:MOST_ROWS]
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
