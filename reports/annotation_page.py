"""Render the page about the annotation of an archive as one self-contained HTML file."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from jinja2 import Environment
from markupsafe import Markup

from kinedex.ops.evaluation.confusion import confusion
from kinedex.ops.intervals import TakeSegment
from kinedex.ops.numeric.explanation import Explanation
from kinedex.ops.wording import counted, two_digits
from kinedex.reports.archive_strip import archive_strip
from kinedex.reports.cards import Card, card, readable, rules
from kinedex.reports.embedded_motions import EmbeddedMotions, motions_json, script_json
from kinedex.reports.method_diagrams import ConfusionTable, confusion_table
from kinedex.reports.page_environment import page_environment
from kinedex.reports.palette import colour_rules, colour_slot
from kinedex.reports.reliability import reliability_diagram
from kinedex.reports.report_data import ReportData, Score
from kinedex.reports.report_overview import (
    BARS,
    LOOKS,
    SEGMENTS,
    Key,
    class_findings,
    group_findings,
    in_order,
    most_doubtful,
    segment_list,
    surest,
    totals,
)
from kinedex.reports.take_selection import Choice, choose_takes, findings_of
from kinedex.reports.timelines import HEIGHT, CurveDiagram, Timeline, curve_diagram, overlap, timeline, y_ticks

DELTA_SHOWN = 0.05
"""The δ with which templates are quantised on the page if the δ of the annotation is not stored."""

ROWS = 500
"""Largest number of rows of a table or list; the page states how many more there are."""

CARDS = 16
"""Number of templates that are shown unfolded."""


@dataclass(frozen=True)
class Gaps:
    """Classes that occur only in the ground truth, or only among the templates."""

    without_template: tuple[str, ...]
    without_manual: tuple[str, ...]


def shown_takes(data: ReportData, takes: Sequence[str] | None = None, max_takes: int = 40) -> Choice:
    """Choose the takes whose timelines a report shows; the parameters are those of `annotation_page`."""
    f1 = {name: score.f1 for name, score in data.take_scores().items() if score.f1 is not None}
    names = [take.name for take in data.takes]
    return choose_takes(names, f1, findings=findings_of(data.automatic), wanted=takes, max_takes=max_takes)


def hits_to_play(data: ReportData) -> list[TakeSegment]:
    """Return the segments that a page must play: those on its first screen, and the first ones to be reviewed."""
    return [*surest(data.automatic), *most_doubtful(data.automatic), *in_order(data.automatic)[:LOOKS]]


def annotation_page(
    data: ReportData,
    *,
    takes: Sequence[str] | None = None,
    max_takes: int = 40,
    motions: EmbeddedMotions | None = None,
    near: Mapping[Key, int] | None = None,
    why: Mapping[Key, Explanation] | None = None,
) -> str:
    """Render the page about an annotation.

    Parameters
    ----------
    data : ReportData
        The content.
    takes : sequence of str or None
        Takes whose timelines are shown; if None, `choose_takes` chooses them.
    max_takes : int
        Largest number of timelines if takes are chosen.
    motions : EmbeddedMotions or None
        Motions of the player; None for a page without player.
    near : mapping of (take, class, start, stop) to int, or None
        Place of the nearest example of a segment in `motions.near`.
    why : mapping of (take, class, start, stop) to Explanation, or None
        What speaks for the class of a segment, and against it.

    Returns
    -------
    str
        A complete HTML page; equal data give equal text.

    Raises
    ------
    KinedexError
        If a take was not annotated.
    ParameterError
        If `max_takes` is not positive.
    """
    labels = data.labels()
    slots = class_slots(data)
    choice = shown_takes(data, takes, max_takes)
    light, dark = colour_rules(len(labels))
    return (
        _environment()
        .get_template("report.html.j2")
        .render(
            data=data,
            main=data.pooled(data.evaluation),
            labels=labels,
            slots=slots,
            rows_shown=ROWS,
            choice=choice,
            motions=motions,
            motions_json=motions_json(motions),
            near=near or {},
            why=why or {},
            gaps=class_gaps(data),
            light=light,
            dark=dark,
            **_findings(data, slots, motions, near or {}),
            **_measures(data, labels),
            **_diagrams(data, slots, choice, near or {}),
        )
    )


def class_slots(data: ReportData) -> dict[str, int]:
    """Return the number of the colour of each class, in the order of `data.labels()`; classes that occur come first."""
    labels = data.labels()
    occurring = {segment.label for segment in (*data.automatic, *data.manual)}
    ordered = sorted(labels, key=lambda label: label not in occurring)
    positions = {label: place for place, label in enumerate(ordered)}
    return {label: colour_slot(positions[label]) for label in labels}


def _findings(
    data: ReportData, slots: Mapping[str, int], motions: EmbeddedMotions | None, near: Mapping[Key, int]
) -> dict[str, object]:
    """Return the variables of the page about annotations: its first screen, the tables and the list of segments."""
    confirmed = confirmations(data)
    rates = {take.name: take.rate_hz for take in data.takes}
    by_class = class_findings(data)
    archive = archive_strip(data.takes, data.automatic, slots)
    found = findings_of(data.automatic)
    return {
        "totals": totals(data),
        "archive": archive,
        "archive_json": script_json(archive.takes),
        "take_rows": sorted(
            data.takes, key=lambda take: (-found[take.name].segments if take.name in found else 0, take.name)
        )[:ROWS],
        "segments_file": SEGMENTS,
        "class_rows": by_class,
        "bars": BARS,
        "longest": max((row.seconds for row in by_class), default=0.0),
        "groups": group_findings(data),
        "findings": found,
        "surest": surest(data.automatic),
        "doubtful": most_doubtful(data.automatic),
        "segments": segment_list(data, slots, motions, near, confirmed),
        "confirmed": confirmed,
        "rates": rates,
    }


def _measures(data: ReportData, labels: Sequence[str]) -> dict[str, object]:
    """Return the variables of the page about agreement with the ground truth."""
    return {
        "held": data.pooled(data.held_out),
        "by_class": data.scores_of(data.evaluation, "class"),
        "by_take": lowest_scores(data.scores_of(data.evaluation, "take"), ROWS),
        "takes_scored": len(data.scores_of(data.evaluation, "take")),
        "by_fold": data.scores_of(data.held_out, "fold"),
        "unseen": folds_without_training(data),
        "weakest": weakest_classes(data),
        "confusion": confusion_of(data, labels),
        "reliability": reliability_diagram(data),
        "take_seconds": {take.name: take.seconds for take in data.takes},
    }


def _diagrams(data: ReportData, slots: Mapping[str, int], choice: Choice, near: Mapping[Key, int]) -> dict[str, object]:
    """Return the variables of the page for timelines, templates and distance curves."""
    delta = DELTA_SHOWN if data.delta is None else data.delta
    diagram = curves_of(data, slots)
    return {
        "timelines": timelines_of(data, choice.shown, slots, near),
        "delta": delta,
        "cards": cards_of(data, delta),
        "cards_open": CARDS,
        "rules": rules(data.feature_set),
        "diagram": diagram,
        "y_ticks": y_ticks(diagram) if diagram else (),
        "height": HEIGHT,
    }


def confirmations(data: ReportData) -> dict[Key, bool] | None:
    """Return, for each automatic segment, whether ground truth of its class overlaps it; None without ground truth."""
    judged = set(data.take_scores()) | {one.take for one in data.manual}
    if not judged:
        return None
    manual = by_take(data.manual)
    return {
        one.key: any(one.label == other.label and overlap(one, other) for other in manual.get(one.take, ()))
        for one in data.automatic
    }


def confusion_of(data: ReportData, labels: Sequence[str]) -> ConfusionTable | None:
    """Lay out the confusion matrix of the takes with ground truth; None if there are no such takes."""
    judged = set(data.take_scores()) | {one.take for one in data.manual}
    automatic, manual = by_take(data.automatic), by_take(data.manual)
    takes = [
        (take.frames, manual.get(take.name, []), automatic.get(take.name, []))
        for take in data.takes
        if take.name in judged
    ]
    if not takes or not data.manual:
        return None
    numbers = {label: place + 1 for place, label in enumerate(labels)}
    return confusion_table(confusion(takes, labels), numbers)


def timelines_of(
    data: ReportData, names: Sequence[str], slots: Mapping[str, int], near: Mapping[Key, int]
) -> list[Timeline]:
    """Lay out the timelines of some takes."""
    rows = {take.name: take for take in data.takes}
    scores = data.take_scores()
    automatic, manual = by_take(data.automatic), by_take(data.manual)
    return [
        timeline(rows[name], automatic.get(name, []), manual.get(name, []), slots, scores.get(name), near)
        for name in names
    ]


def curves_of(data: ReportData, slots: Mapping[str, int]) -> CurveDiagram | None:
    """Lay out the distance curves; None if the data has none."""
    rows = {take.name: take for take in data.takes}
    if data.curves_take is None or not data.curves or data.curves_take not in rows:
        return None
    name = data.curves_take
    automatic, manual = by_take(data.automatic).get(name, []), by_take(data.manual).get(name, [])
    return curve_diagram(rows[name], data.curves, automatic, manual, slots, data.tau)


def cards_of(data: ReportData, delta: float) -> list[Card]:
    """Draw the templates, ordered by class and subclass."""
    rate_hz = data.takes[0].rate_hz if data.takes else 30.0
    ordered = sorted(data.templates, key=lambda t: (t.label or t.subclass, t.subclass))
    return [card(template, delta, rate_hz) for template in ordered]


def by_take(segments: Sequence[TakeSegment]) -> dict[str, list[TakeSegment]]:
    """Group segments by take, in the order of their starts."""
    grouped: dict[str, list[TakeSegment]] = {}
    for segment in sorted(segments, key=lambda s: (s.take, s.start, s.stop, s.label)):
        grouped.setdefault(segment.take, []).append(segment)
    return grouped


def weakest_classes(data: ReportData) -> list[Score]:
    """Return the classes with the lowest F (frames), lowest first; empty if there are few or all are perfect."""
    scored = [score for score in data.scores_of(data.evaluation, "class") if score.f1 is not None]
    ranked = sorted(scored, key=lambda score: (score.f1, score.name))
    return [score for score in ranked[:3] if score.f1 != 1] if len(ranked) > 3 else []


def lowest_scores(scores: Sequence[Score], count: int) -> list[Score]:
    """Return all scores if there are few, otherwise those with the lowest F (frames); their order is kept."""
    if len(scores) <= count:
        return list(scores)
    ranked = sorted(scores, key=lambda score: (score.f1 is None, score.f1, score.name))[:count]
    kept = set(ranked)
    return [score for score in scores if score in kept]


def folds_without_training(data: ReportData) -> list[str]:
    """Return the folds without training clips, whose templates are learned from all clips."""
    if not data.learned_from:
        return []
    return [score.name for score in data.scores_of(data.held_out, "fold") if score.name not in data.learned_from]


def class_gaps(data: ReportData) -> Gaps:
    """Find classes that occur in the ground truth without a template, and templates without ground truth."""
    searched = {template.label or template.subclass for template in data.templates} | set(data.subclasses)
    manual = {segment.label for segment in data.manual}
    if not searched or not manual:
        return Gaps((), ())
    return Gaps(tuple(sorted(manual - searched)), tuple(sorted(searched - manual)))


def _environment() -> Environment:
    filters: dict[str, Callable[..., str]] = {
        "measure": two_digits,
        "share": share,
        "span": span,
        "thousands": thousands,
        "compact_json": compact_json,
        "minutes": minutes,
        "readable": readable,
        "counted": counted,
        "breakable": breakable,
    }
    return page_environment(filters)


def breakable(name: str) -> Markup:
    """Mark the places between the words of a long name where a line may break."""
    return Markup("<wbr>").join(re.split(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[_./-])", name))


def share(value: float | None) -> str:
    """Format a fraction as a percentage; "–" for None."""
    return "–" if value is None else f"{value:.0%}" if value >= 0.1 or value == 0 else f"{value:.1%}"


def span(seconds: float) -> str:
    """Format a length of time in seconds, minutes or hours."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    if seconds < 3600:
        return f"{seconds / 60:.1f} min"
    return f"{seconds / 3600:.1f} h"


def minutes(seconds: float) -> str:
    """Format a length of time in minutes, or in seconds below one."""
    return f"{seconds:.0f} s" if seconds < 60 else f"{seconds / 60:,.1f} min"


def thousands(value: float) -> str:
    """Format a count with separators."""
    return f"{value:,.0f}"


def compact_json(value: object) -> str:
    """Format a value as one line of JSON with sorted keys."""
    return json.dumps(value, ensure_ascii=False, sort_keys=True, default=str)
