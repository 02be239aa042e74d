"""Lay out the reliability diagram of a page: the fraction of correct segments over their confidence."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from kinedex.ops.evaluation.reliability import ConfidenceBin, auroc, brier, reliability
from kinedex.ops.intervals import TakeSegment
from kinedex.reports.report_data import ReportData

SIDE = 200.0
"""The width and the height of the diagram, in SVG units."""

_MARGIN = 3.0


@dataclass(frozen=True)
class Bar:
    """One range of confidences in the diagram, in SVG units.

    Attributes
    ----------
    bucket : ConfidenceBin
        The numbers of this range.
    x, y, width, height : float
        The bar, which shows the fraction of correct segments.
    low, high : float
        The y of both ends of the confidence interval of the fraction, measured from the top.
    says : (float, float)
        The point on the diagonal at the mean confidence, which the fraction of correct segments should reach.
    """

    bucket: ConfidenceBin
    x: float
    y: float
    width: float
    height: float
    low: float
    high: float
    says: tuple[float, float]


@dataclass(frozen=True)
class ReliabilityDiagram:
    """The reliability of the confidences of segments in takes with ground truth.

    Attributes
    ----------
    bars : tuple of Bar
        The ranges of confidences that have segments.
    segments, right : int
        The numbers of all segments, and of right ones.
    auroc : float
        The probability that a right segment has a higher confidence than a wrong one; NaN if there are not both kinds.
    brier : float
        The mean squared difference of confidence and truth.
    """

    bars: tuple[Bar, ...]
    segments: int
    right: int
    auroc: float
    brier: float


def reliability_diagram(data: ReportData) -> ReliabilityDiagram | None:
    """Lay out the reliability diagram; None without ground truth, or without confidences.

    A segment is right if manual segments of its class cover most of its frames.
    """
    judged = set(data.take_scores()) | {one.take for one in data.manual}
    manual = defaultdict(list)
    for one in data.manual:
        manual[one.take, one.label].append((one.start, one.stop))
    known = [one for one in data.automatic if one.take in judged and one.confidence is not None]
    if not known or not data.manual:
        return None
    confidences = np.array([one.confidence for one in known], np.float64)
    right = np.array([_is_right(one, manual[one.take, one.label]) for one in known])
    bars = tuple(_bar(one) for one in reliability(confidences, right) if one.count)
    return ReliabilityDiagram(bars, len(known), int(right.sum()), auroc(confidences, right), brier(confidences, right))


def _is_right(one: TakeSegment, manual: Iterable[tuple[int, int]]) -> bool:
    covered = np.zeros(one.stop - one.start, np.bool_)
    for start, stop in manual:
        covered[max(start - one.start, 0) : max(stop - one.start, 0)] = True
    return bool(2 * covered.sum() > len(covered))


def _bar(bucket: ConfidenceBin) -> Bar:
    low, high = bucket.interval
    height = SIDE * bucket.share
    says = SIDE * bucket.confidence
    return Bar(
        bucket,
        SIDE * bucket.low + _MARGIN,
        SIDE - height,
        SIDE * (bucket.high - bucket.low) - 2 * _MARGIN,
        height,
        SIDE * (1 - low),
        SIDE * (1 - high),
        (says, SIDE - says),
    )
