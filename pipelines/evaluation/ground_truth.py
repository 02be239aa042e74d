"""Assign ground truth to takes: the evaluated takes, their manual segments, and remarks on both."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import polars as pl
import pyarrow as pa

from kinedex.catalog.classes import Classes
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.wording import few
from kinedex.pipelines.labels.unmatched_labels import UnmatchedLabels, unmatched_labels
from kinedex.storage.formats.labels.segments import LabelFile, ManualSegment
from kinedex.storage.snapshot.schemas import result_schema

Statement = tuple[str, str, int, int]
"""A take, a class, and the source frames [start, stop) of a segment."""

UnknownLabels = Literal["error", "miss", "ignore"]


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
    """The manual segments of the evaluated takes.

    Attributes
    ----------
    segments : tuple of Manual
        The segments.
    takes : tuple of str
        The names of the takes, sorted; a take without a segment (it was labelled as empty, or all of its labels are
        excluded) has nothing to find.
    remarks : tuple of str
        Labels and takes that were excluded.
    unmatched : tuple of UnmatchedLabels
        The labels that match no take, file by file.
    """

    segments: tuple[Manual, ...]
    takes: tuple[str, ...]
    remarks: tuple[str, ...] = ()
    unmatched: tuple[UnmatchedLabels, ...] = ()


def place_ground_truth(
    files: Sequence[LabelFile],
    takes: pl.DataFrame,
    archive: Iterable[str],
    classes: Classes,
    unknown_labels: UnknownLabels = "error",
) -> GroundTruth:
    """Assign manual segments of label files to the annotated takes, in analysis frames.

    A take that a file names without any segment is evaluated as one with nothing to find. Segments with the same class,
    start and stop (in source frames) count once, even if they are in several files.

    Parameters
    ----------
    files : sequence of LabelFile
        Segments in source frames, or in seconds, which are rounded to source frames; touching ones stay separate.
    takes : polars.DataFrame
        Rows of the annotated takes.
    archive : iterable of str
        The names of all takes of the store.
    classes : Classes
        The classes of the evaluation.
    unknown_labels : {"error", "miss", "ignore"}
        The treatment of a label that is neither a class nor a subclass: raise an error; count it as missed; or
        exclude it with a remark, and evaluate its take nevertheless.

    Raises
    ------
    SourceError
        A segment ends beyond its take.
    KinedexError
        A label is unknown, or no take of the files was annotated.
    """
    by_name = {row["name"]: row for row in takes.iter_rows(named=True)}
    known_takes = set(archive)
    here = [segment for file in files for segment in file.segments if segment.take in by_name]
    looked_at = {take for file in files for take in file.takes}
    absent = sorted(looked_at - known_takes)
    unmatched = unmatched_labels(files, known_takes)
    remarks = list(map(str, unmatched))
    evaluated = looked_at & set(by_name)
    if not evaluated:
        count = sum(len(file.segments) for file in files)
        hint = did_you_mean(absent[0], known_takes) if absent else "; none of its takes was annotated"
        raise KinedexError(
            f"none of the {count} manual segments is on a take that was annotated"
            + (f": no take is named '{absent[0]}'{hint}" if absent else hint)
        )
    silent = sorted(set(by_name) - evaluated)
    if silent:
        remarks.append(f"annotated takes without ground truth, not evaluated: {few(silent)}")
    labels = _labels(here, classes, unknown_labels)
    remarks += _of_no_class(labels, classes)
    empty = sorted(evaluated - {segment.take for segment in here})
    if empty:
        text = "takes of label files that have no segment of them, in which nothing is to be found"
        remarks.append(f"{text}: {few(empty)}")
    known = [
        (manual, segment.where)
        for segment in here
        if (manual := _placed(segment, by_name[segment.take], labels[segment.label])) is not None
    ]
    every = [manual for manual, _ in known]
    once = [pair for pair, first in zip(known, _firsts(every), strict=True) if pair[0] is first]
    placed = [manual for manual, _ in once if manual.start < manual.stop]
    between = [where for manual, where in once if manual.start >= manual.stop]
    remarks += [f"{where}: no analysis frame lies in this segment, excluded" for where in between]
    remarks += _of_several_files(files, every, evaluated)
    bare = sorted(evaluated - {segment.take for segment in placed} - set(empty))
    if bare:
        remarks.append(f"takes in which nothing is left to be found, evaluated as such: {few(bare)}")
    return GroundTruth(tuple(placed), tuple(sorted(evaluated)), tuple(remarks), unmatched)


def _of_no_class(labels: Mapping[str, str | None], classes: Classes) -> list[str]:
    """Return remarks on labels that belong to no class."""
    ignored = sorted(label for label, name in labels.items() if name is None)
    missed = sorted(label for label, name in labels.items() if name == label and classes.class_of(label) is None)
    treated = [("excluded", ignored), ("counted as missed", missed)]
    return [f"labels of no class, {how}: {few(names)}" for how, names in treated if names]


def _firsts(segments: Sequence[Manual]) -> list[Manual]:
    """Return for each segment the first one that equals it."""
    known: dict[Statement, Manual] = {}
    return [known.setdefault(_statement(one), one) for one in segments]


def _statement(one: Manual) -> Statement:
    return one.take, one.label, one.source_start, one.source_stop


def _of_several_files(files: Sequence[LabelFile], segments: Sequence[Manual], evaluated: Container[str]) -> list[str]:
    """Return remarks on repeated segments, and on takes that several files label differently."""
    pairs = zip(_firsts(segments), segments, strict=True)
    again = Counter((first.origin, one.origin) for first, one in pairs if first is not one)
    remarks = []
    if again:
        doubles = [f"{n} in {b} " + ("itself" if a == b else f"that {a} has as well") for (a, b), n in again.items()]
        remarks.append(f"the same segments again, counted once: {few(doubles)}")
    by_take: dict[str, dict[str, set[Statement]]] = defaultdict(dict)
    for file in files:
        for take in file.takes:
            by_take[take][file.path] = set()
    for one in segments:
        by_take[one.take][one.origin].add(_statement(one))
    unlike = [
        f"{take} ({', '.join(of_file)})"
        for take, of_file in sorted(by_take.items())
        if take in evaluated and len({frozenset(own) for own in of_file.values()}) > 1
    ]
    if unlike:
        remarks.append(f"takes that files label differently, all of it counted: {few(unlike)}")
    return remarks


def ground_truth_of_classes(takes: pl.DataFrame, classes: Classes) -> GroundTruth:
    """Return the class of each take as the ground truth of all of its frames.

    Raises
    ------
    KinedexError
        No take has a class.
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
    """Return the first analysis frame at or after a source frame: ceil(source_frame · rate / source_rate)."""
    return math.ceil(round(source_frame * rate_hz / source_rate_hz, 9))


def _labels(segments: Sequence[ManualSegment], classes: Classes, unknown: UnknownLabels) -> dict[str, str | None]:
    """Return the class of each label, or None if it is excluded."""
    result: dict[str, str | None] = {}
    for segment in segments:
        name = classes.class_of(segment.label)
        if name is None and unknown == "error":
            labels = {*classes.names, *classes.of_subclass()}
            fault = segment.error(
                f"'{segment.label}' is neither a class nor a subclass of this evaluation"
                f"{did_you_mean(segment.label, labels)} (`unknown_labels: miss` counts it as missed, `ignore` leaves "
                "it out; where labels name classes of several subclasses, `--set classes=FILE` names them)"
            )
            fault.way_out = ("unknown_labels", "miss")
            raise fault
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


def ground_truth_rows(truth: GroundTruth, run: str) -> pa.Table:
    """Return ground truth as results of the kind `ground_truth`, sorted by take and start."""
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
