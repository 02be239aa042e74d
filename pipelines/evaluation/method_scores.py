"""Score a method in a split: counts, average precision, boundary errors, and confidence intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from kinedex.ops.arrays import I64
from kinedex.ops.evaluation.confusion import Confusion, confusion
from kinedex.ops.evaluation.detection import (
    THRESHOLDS,
    average_precision,
    bootstrap,
    boundary_errors,
    overlap,
)
from kinedex.ops.evaluation.metrics import Counts, compare, pooled
from kinedex.ops.intervals import TakeSegment
from kinedex.pipelines.evaluation.annotation_scores import MEASURES
from kinedex.pipelines.evaluation.folds import TestTake

Outcome = Mapping[str, Sequence[TakeSegment]]
"""The segments that a method has found in all folds of a split, by take name."""


@dataclass(frozen=True)
class SegmentOutcome:
    """The result of each method for one manual segment.

    Attributes
    ----------
    take, label : str
        The take and the class.
    start, stop : int
        The analysis frames [start, stop) of the manual segment.
    overlaps : dict of str to float
        For each method, the intersection over union of the manual segment with that automatic segment of the same
        class that overlaps it most; 0 if none overlaps it.
    labels : dict of str to tuple of str
        For each method, the labels of the automatic segments that overlap it, the largest overlap first.
    """

    take: str
    label: str
    start: int
    stop: int
    overlaps: dict[str, float]
    labels: dict[str, tuple[str, ...]]

    @property
    def missed(self) -> bool:
        """True if no method has an automatic segment of its class that overlaps it."""
        return not any(self.overlaps.values())


@dataclass(frozen=True)
class MethodScores:
    """The scores of a method in a split.

    Attributes
    ----------
    pooled : Counts
        The counts over all takes and classes.
    by_class, by_group, by_take : dict of str to Counts
        The counts of each class, group and take.
    intervals : dict of str to (float, float)
        The 95 % interval over takes of each measure.
    precision : dict of float to float
        The mean average precision at each threshold of intersection over union.
    class_precision : dict of str to dict of float to float
        The average precision of each class, at each threshold.
    confusion : Confusion
        Frames by manual and automatic labels.
    boundaries : int64 array (M, 2)
        Boundary errors, see `boundary_errors`.
    joined_precision, joined_boundaries
        Mean average precision and boundary errors after touching segments of a class are joined (`joined_segments`).
    """

    pooled: Counts
    by_class: dict[str, Counts]
    by_group: dict[str, Counts]
    by_take: dict[str, Counts]
    intervals: dict[str, tuple[float, float]]
    precision: dict[float, float]
    class_precision: dict[str, dict[float, float]]
    confusion: Confusion
    boundaries: I64
    joined_precision: dict[float, float]
    joined_boundaries: I64


def counts_of(
    outcome: Outcome, test_takes: Sequence[TestTake], classes: Sequence[str]
) -> dict[tuple[str, str], Counts]:
    """Return the counts of every take and class (thesis, Section 5.4)."""

    def bounds(segments: Sequence[TakeSegment], label: str) -> list[tuple[int, int]]:
        return [(one.start, one.stop) for one in segments if one.label == label]

    return {
        (one.name, label): compare(bounds(outcome[one.name], label), bounds(one.truth, label))
        for one in test_takes
        for label in labels_of(test_takes, classes)
    }


def labels_of(test_takes: Sequence[TestTake], classes: Sequence[str]) -> list[str]:
    """Return the classes in their order, followed by labels that only the ground truth has."""
    return list(dict.fromkeys([*classes, *sorted({one.label for take in test_takes for one in take.truth})]))


def score_method(
    outcome: Outcome, test_takes: Sequence[TestTake], classes: Sequence[str], draws: int = 1000
) -> MethodScores:
    """Return the scores of the segments that a method has found in all takes of a split.

    Parameters
    ----------
    outcome : mapping of str to sequence of TakeSegment
        The segments of each take, by its name.
    test_takes : sequence of TestTake
        The takes of all folds.
    classes : sequence of str
        The classes in the order of the tables.
    draws : int
        The number of draws of the bootstrap over takes.
    """
    labels = labels_of(test_takes, classes)
    counts = counts_of(outcome, test_takes, classes)
    by_take = {test_take.name: pooled(counts[test_take.name, label] for label in labels) for test_take in test_takes}
    groups = sorted({test_take.group for test_take in test_takes})
    every = list(by_take.values())
    class_precision = {label: _precision(outcome, test_takes, label) for label in labels}
    one_piece = joined_segments(outcome, test_takes)
    joined_class_precision = [_precision(*one_piece, label) for label in labels]
    return MethodScores(
        pooled(every),
        {label: pooled(counts[test_take.name, label] for test_take in test_takes) for label in labels},
        {
            group: pooled(by_take[test_take.name] for test_take in test_takes if test_take.group == group)
            for group in groups
        },
        by_take,
        {name: bootstrap(attrgetter(name), every, draws=draws) for name in MEASURES},
        {threshold: _mean([class_precision[label][threshold] for label in labels]) for threshold in THRESHOLDS},
        class_precision,
        confusion([(one.frames, one.truth, outcome[one.name]) for one in test_takes], labels),
        _boundaries(outcome, test_takes, labels),
        {threshold: _mean([one[threshold] for one in joined_class_precision]) for threshold in THRESHOLDS},
        _boundaries(*one_piece, labels),
    )


def joined_segments(outcome: Outcome, test_takes: Sequence[TestTake]) -> tuple[Outcome, list[TestTake]]:
    """Join segments of a class that touch or overlap, both automatic and manual ones.

    People label repetitions in a row as one segment or as several; after joining, both ways of labelling are equal. The
    confidence of a joined segment is the average over its parts, weighted by frames.
    """
    return {one.name: _joined(outcome[one.name]) for one in test_takes}, [
        replace(one, truth=tuple(_joined(one.truth))) for one in test_takes
    ]


def _joined(segments: Sequence[TakeSegment]) -> list[TakeSegment]:
    runs: list[list[TakeSegment]] = []
    for one in sorted(segments, key=lambda one: (one.label, one.start, one.stop)):
        if runs and runs[-1][0].label == one.label and one.start <= max(part.stop for part in runs[-1]):
            runs[-1].append(one)
        else:
            runs.append([one])
    found = [
        replace(
            run[0],
            stop=max(one.stop for one in run),
            confidence=None
            if run[0].confidence is None
            else float(np.average([one.confidence for one in run], weights=[one.stop - one.start for one in run])),
        )
        for run in runs
    ]
    return sorted(found, key=lambda one: (one.start, one.stop))


def _mean(values: Sequence[float]) -> float:
    known = [value for value in values if not math.isnan(value)]
    return sum(known) / len(known) if known else math.nan


def _precision(outcome: Outcome, test_takes: Sequence[TestTake], label: str) -> dict[float, float]:
    """Return the average precision of a class at each threshold; NaN if the class does not occur."""
    found, known = _of_class(outcome, test_takes, label)
    return {threshold: average_precision(found, known, threshold) for threshold in THRESHOLDS}


def _of_class(
    outcome: Outcome, test_takes: Sequence[TestTake], label: str
) -> tuple[list[TakeSegment], list[TakeSegment]]:
    found = [one for test_take in test_takes for one in outcome[test_take.name] if one.label == label]
    return found, [one for test_take in test_takes for one in test_take.truth if one.label == label]


def _boundaries(outcome: Outcome, test_takes: Sequence[TestTake], labels: Sequence[str]) -> I64:
    errors = [
        boundary_errors(*_of_class(outcome, [test_take], label))
        for test_take in test_takes
        for label in labels
        if any(one.label == label for one in test_take.truth)
    ]
    return np.concatenate([np.empty((0, 2), np.int64), *errors])


def segment_outcomes(outcomes: Mapping[str, Outcome], test_takes: Sequence[TestTake]) -> list[SegmentOutcome]:
    """Return the outcome of every manual segment with each method, in the order of takes and time."""
    found = []
    for test_take in test_takes:
        for true in sorted(test_take.truth, key=lambda one: (one.start, one.stop, one.label)):
            label, start, stop = true.label, true.start, true.stop
            there = {
                method: [one for one in outcome[test_take.name] if one.interval.overlaps(true.interval)]
                for method, outcome in outcomes.items()
            }
            overlaps = {
                method: max(
                    (overlap((one.start, one.stop), (start, stop)) for one in own if one.label == label), default=0.0
                )
                for method, own in there.items()
            }
            labels = {method: _names(own, start, stop) for method, own in there.items()}
            found.append(SegmentOutcome(test_take.name, label, start, stop, overlaps, labels))
    return found


def _names(found: Sequence[TakeSegment], start: int, stop: int) -> tuple[str, ...]:
    """Return the distinct labels of segments, the one with the largest overlap first."""
    ranked = sorted(found, key=lambda one: -overlap((one.start, one.stop), (start, stop)))
    return tuple(dict.fromkeys(one.label for one in ranked))


def chosen_takes(by_take: Mapping[str, Counts]) -> dict[str, str]:
    """Return the names of the best, the median and the worst take by F (frames), among those where it is defined.

    With two takes there is no median, and with one take only the best.
    """
    ranked = sorted((counts.f1, name) for name, counts in by_take.items() if not math.isnan(counts.f1))
    if not ranked:
        return {}
    chosen = {"best": ranked[-1][1]}
    if len(ranked) > 2:
        chosen["median"] = ranked[(len(ranked) - 1) // 2][1]
    if len(ranked) > 1:
        chosen["worst"] = ranked[0][1]
    return chosen
