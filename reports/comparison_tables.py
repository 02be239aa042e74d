"""Format a comparison of methods as tables and as Markdown."""

from __future__ import annotations

import math

from kinedex.ops.evaluation.confusion import EXTRA, LACKING, confusions
from kinedex.ops.evaluation.metrics import Counts
from kinedex.ops.intervals import shown_seconds
from kinedex.ops.wording import counted, two_digits
from kinedex.pipelines.engine.display import Line, ResultTable
from kinedex.pipelines.evaluation.annotation_scores import F_FRAMES, F_SEGMENTS, MEASURES, THESIS_NAMES
from kinedex.pipelines.evaluation.comparison_results import SplitResult, Study, boundary_summary
from kinedex.pipelines.evaluation.folds import TestTake
from kinedex.pipelines.evaluation.method_scores import MethodScores, SegmentOutcome
from kinedex.reports.markdown import grid, plain

MEASURE_NAMES = ("P (frames)", "R (frames)", F_FRAMES, "P (segments)", "R (segments)", F_SEGMENTS)
MAX_CONFUSIONS = 8
REPETITIONS = (
    "the ground truth may have repetitions in a row as one segment and a method as several, or the reverse: mAP, AP "
    "and boundaries then say little of either, though F (frames) and F (segments) agree"
)
"""The remark about measures of overlap and boundaries."""

JOINED = "joined: the same where touching segments of one class are one, on both sides"
MAX_LISTED = 60
"""The largest number of manual segments that the Markdown lists; the JSON has all."""


def headings(study: Study) -> list[str]:
    """Return the headings of the table of methods, without that of the method's name."""
    columns = []
    if "frames" in study.metrics:
        columns += [F_FRAMES, "95\N{NO-BREAK SPACE}%", "P", "R"]
    if "segments" in study.metrics:
        columns += [F_SEGMENTS, "95\N{NO-BREAK SPACE}%", "P", "R"]
    if "overlap" in study.metrics:
        columns += ["mAP .1", "mAP .5", "mAP .7"]
    if "boundaries" in study.metrics:
        columns += ["start ±s", "stop ±s"]
    if "joined" in study.metrics:
        columns += ["mAP .5 joined"]
    return columns


def method_cells(judgement: MethodScores, study: Study) -> list[str]:
    """Return the cells of a method in the table of methods."""
    counts = judgement.pooled
    values = []
    for metric, number in (("frames", 1), ("segments", 2)):
        if metric in study.metrics:
            f, p, r = (getattr(counts, f"{letter}{number}") for letter in "fpr")
            values += [two_digits(f), interval_text(judgement.intervals[f"f{number}"]), two_digits(p), two_digits(r)]
    if "overlap" in study.metrics:
        values += [two_digits(judgement.precision[threshold]) for threshold in (0.1, 0.5, 0.7)]
    if "boundaries" in study.metrics:
        ends = boundary_summary(judgement, study.rate_hz)
        values += [two_digits(ends[end]["median_size"]) for end in ("start", "stop")]
    if "joined" in study.metrics:
        values += [two_digits(judgement.joined_precision[0.5])]
    return values


def interval_text(interval: tuple[float, float]) -> str:
    """Format an interval as low–high."""
    return "–" if math.isnan(interval[0]) else f"{interval[0]:.2f}–{interval[1]:.2f}"


def six_measures(counts: Counts) -> list[str]:
    """Return the six measures in the order of Table 5.2 of the thesis."""
    return [two_digits(float(getattr(counts, name))) for name in MEASURES]


def split_description(result: SplitResult) -> str:
    """Return a sentence that describes a split."""
    takes = len(result.test_takes)
    parts = "clips laid end to end as " if result.split.clips_as_takes else ""
    folds = (
        f", {len(result.folds)} folds: {', '.join(one.name for one in result.folds)}" if len(result.folds) > 1 else ""
    )
    segments = sum(len(test_take.truth) for test_take in result.test_takes)
    kind = "" if result.split.kind == result.split.name else f"{result.split.kind}; "
    return f"{kind}{parts}{counted(takes, 'take')} with {counted(segments, 'manual segment')}{folds}"


def take_title(study: Study, result: SplitResult, test_take: TestTake) -> str:
    """Return the name of a take, after that of its split if another split has a different take of the same name."""
    same = [other for split in study.splits for other in split.test_takes if other.name == test_take.name]
    alike = all(other.take_ids == test_take.take_ids for other in same)
    return test_take.name if alike else f"{result.split.name}: {test_take.name}"


def overlap_notes(study: Study) -> list[str]:
    """Return remarks on measures of overlap, if the study has such measures."""
    notes = [REPETITIONS] if {"overlap", "boundaries"} & {*study.metrics} else []
    return notes + ([JOINED] if "joined" in study.metrics else [])


def capitalised(text: str) -> str:
    """Return a text with its first letter in upper case."""
    return text[:1].upper() + text[1:]


def overview(study: Study) -> list[ResultTable | Line]:
    """Return tables of methods for each split, first by frames and segments, then by overlap, and lines of remarks."""
    thesis = 4 * len({"frames", "segments"} & {*study.metrics})
    tables = []
    for result in study.splits:
        title = f"{result.split.name} ({split_description(result)})"
        parts = [part for part in (slice(thesis), slice(thesis, None)) if headings(study)[part]] or [slice(None)]
        tables += [_overview(result, study, part) for part in parts]
        tables[-len(parts)].title = title
        tables[-1].caption = f"{counted(len(result.missed), 'manual segment')} found by no method"
    return [*tables, *(Line(f"{capitalised(text)}.") for text in (THESIS_NAMES, *overlap_notes(study)))]


def _overview(result: SplitResult, study: Study, part: slice) -> ResultTable:
    """Return the table of methods with some of its columns."""
    table = ResultTable(("", *(name.replace(" ", "\n") for name in headings(study)[part])), layout="tall")
    for name, judgement in result.judgements.items():
        leads = name == result.leading and len(result.judgements) > 1
        table.add(name, *method_cells(judgement, study)[part], tone="main" if leads else "plain")
    return table


def markdown(study: Study) -> str:
    """Return a study as a Markdown summary."""
    lines = [f"# {plain(study.title)}", ""]
    lines += [f"{THESIS_NAMES}; {study.rate_hz:g} frames a second; intervals: 95 % "
              "over takes, by bootstrap; mAP at thresholds of intersection over union; start and stop: how far off "
              "boundaries are in the middle.", ""]  # fmt: skip
    lines += [*(f"{capitalised(text)}." for text in overlap_notes(study)), ""] if overlap_notes(study) else []
    lines += [f"- {plain(remark)}" for remark in study.remarks] + ([""] if study.remarks else [])
    for result in study.splits:
        lines += [f"## {plain(result.split.name)}", "", plain(capitalised(split_description(result))) + ".", ""]
        lines += [f"- {plain(remark)}" for remark in result.remarks] + ([""] if result.remarks else [])
        lines += grid(
            ["method", *headings(study)], [[name, *method_cells(j, study)] for name, j in result.judgements.items()]
        )
        lines += ["### By " + plain(study.group), ""]
        lines += grid(
            ["", "method", *MEASURE_NAMES],
            [
                [group, name, *six_measures(counts)]
                for name, judgement in result.judgements.items()
                for group, counts in judgement.by_group.items()
            ],
        )
        lines += _by_class(result) + _missed(result, study.rate_hz)
    return "\n".join(lines).rstrip("\n") + "\n"


def _by_class(result: SplitResult) -> list[str]:
    names = list(result.judgements)
    labels = result.judgements[names[0]].by_class
    rows = []
    for label in labels:
        counts = [result.judgements[name].by_class[label] for name in names]
        if any(one.frames_automatic + one.frames_manual for one in counts):
            rows.append([label, *(f"{two_digits(one.f1)} / {two_digits(one.f2)}" for one in counts)])
    lines = [f"### By class, {F_FRAMES} / {F_SEGMENTS}", "", *grid(["class", *names], rows)]
    worst = confusions(result.judgements[result.leading].confusion, MAX_CONFUSIONS)
    if worst:
        shown = [
            f"{one.label} → {one.taken_for} ({one.frames:.0f} frames, {one.share:.0%})"
            for one in worst
        ]  # fmt: skip
        lines += [plain(f"Confused most by {result.leading}: {'; '.join(shown)}."), ""]
        if any(one.label == EXTRA or one.taken_for == LACKING for one in worst):
            lines += [f"{capitalised(EXTRA)}, {LACKING}: beyond as many as the other side gave the frame.", ""]
    return lines


def _missed(result: SplitResult, rate_hz: float) -> list[str]:
    lines = [f"### Found by no method: {len(result.missed)}", ""]
    for one in result.missed[:MAX_LISTED]:
        labels = "; ".join(f"{method}: {', '.join(names) or 'nothing'}" for method, names in one.labels.items())
        seconds = f"{shown_seconds(one.start, rate_hz)}–{shown_seconds(one.stop, rate_hz)} s"
        lines.append(f"- {plain(f'{one.take}, {seconds}, {one.label} ({labels})')}")
    if len(result.missed) > MAX_LISTED:
        lines.append(f"- and {len(result.missed) - MAX_LISTED} more, in the JSON")
    lines += [""] if result.missed else []
    if len(result.segment_outcomes) > MAX_LISTED:
        return lines
    names = list(result.judgements)
    rows = [
        [
            one.take,
            f"{shown_seconds(one.start, rate_hz)}–{shown_seconds(one.stop, rate_hz)}",
            one.label,
            *(outcome_text(one, n) for n in names),
        ]
        for one in result.segment_outcomes
    ]
    return [*lines, "### Segment by segment", "", *grid(["take", "seconds", "class", *names], rows)]


def outcome_text(one: SegmentOutcome, method: str) -> str:
    """Return the overlap of a method's segment with a manual segment, or the labels that it has there instead."""
    share = one.overlaps[method]
    return f"{share:.0%}" if share else f"missed ({', '.join(one.labels[method]) or 'nothing'})"
