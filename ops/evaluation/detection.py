"""This module evaluates segments by overlap: average precision at thresholds of intersection over union."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from kinedex.ops.arrays import I64
from kinedex.ops.errors import ParameterError
from kinedex.ops.evaluation.metrics import Counts
from kinedex.ops.intervals import TakeSegment

THRESHOLDS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
"""The usual thresholds of intersection over union."""

LEVEL = 0.95
"""The coverage of bootstrap intervals."""


def overlap(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Return the intersection over union of two half-open ranges."""
    both = min(a[1], b[1]) - max(a[0], b[0])
    return max(both, 0) / (max(a[1], b[1]) - min(a[0], b[0])) if both > 0 else 0.0


def average_precision(found: Sequence[TakeSegment], known: Sequence[TakeSegment], threshold: float) -> float:
    """Return the average precision of the segments of one class.

    Automatic segments are processed in order of decreasing confidence; equal confidences are ordered by take and time.
    Each is compared with the manual segment of its take that it overlaps most, of those not yet matched. It is a true
    positive if their intersection over union is at least the threshold.

    Parameters
    ----------
    found : sequence of TakeSegment
        The automatic segments, with their confidences.
    known : sequence of TakeSegment
        The manual segments.
    threshold : float
        The threshold of intersection over union, in (0, 1].

    Returns
    -------
    float
        The area below the precision-recall curve, with interpolated precision (the maximum over all recalls that are
        not lower); NaN if there is no manual segment.

    Raises
    ------
    ParameterError
        If the threshold is out of its range, or a segment is empty.
    """
    if not 0.0 < threshold <= 1.0:
        raise ParameterError("threshold", "above 0 and at most 1", threshold)
    for name, segments in (("found", found), ("known", known)):
        empty = [one for one in segments if one.start >= one.stop]
        if empty:
            raise ParameterError(name, "segments with start < stop", empty[0])
    if not known:
        return math.nan
    free: dict[str, list[TakeSegment]] = {}
    for one in known:
        free.setdefault(one.take, []).append(one)
    right = np.zeros(len(found))
    ranked = sorted(found, key=lambda one: (-_confidence(one), one.take, one.start, one.stop))
    for place, mine in enumerate(ranked):
        candidates = free.get(mine.take, [])
        shares = [overlap((mine.start, mine.stop), (other.start, other.stop)) for other in candidates]
        if shares and max(shares) >= threshold - 1e-9:
            candidates.pop(shares.index(max(shares)))
            right[place] = 1.0
    hits = np.cumsum(right)
    precision = hits / np.arange(1, len(found) + 1)
    best = np.maximum.accumulate(precision[::-1])[::-1]
    return float((best * right).sum() / len(known))


def _confidence(one: TakeSegment) -> float:
    return 0.0 if one.confidence is None else one.confidence


def boundary_errors(found: Sequence[TakeSegment], known: Sequence[TakeSegment]) -> I64:
    """Return the differences in frames between automatic and manual boundaries.

    Every manual segment is compared with the automatic segment of its take that overlaps it most, if there is any.

    Parameters
    ----------
    found : sequence of TakeSegment
        The automatic segments.
    known : sequence of TakeSegment
        The manual segments.

    Returns
    -------
    int64 array (M, 2)
        The differences at start and stop; positive if the automatic boundary is later.
    """
    errors = []
    for one in known:
        mine = [(overlap((other.start, other.stop), (one.start, one.stop)), other) for other in found]
        share, nearest = max(
            ((share, other) for share, other in mine if other.take == one.take),
            default=(0.0, None),
            key=lambda at: at[0],
        )
        if nearest is not None and share > 0:
            errors.append((nearest.start - one.start, nearest.stop - one.stop))
    return np.array(errors, np.int64).reshape(-1, 2)


def bootstrap(measure: Callable[..., float], *of_takes: Sequence[Counts], draws: int = 1000) -> tuple[float, float]:
    """Return a 95 % bootstrap interval of a measure: takes are drawn with replacement, and their counts pooled.

    Parameters
    ----------
    measure : callable
        A function with one argument for each evaluation, its pooled counts; for instance `lambda counts: counts.f1`, or
        for two evaluations `lambda ours, theirs: theirs.f1 - ours.f1`.
    *of_takes : sequences of Counts
        The counts of the same takes in each evaluation.
    draws : int
        The number of bootstrap samples.

    Returns
    -------
    (float, float)
        The percentile interval; (NaN, NaN) if there is no take, or the measure is never defined.

    Raises
    ------
    ParameterError
        If `draws` is below 1.
    """
    if draws < 1:
        raise ParameterError("draws", "1 or more", draws)
    takes = len(of_takes[0])
    if not takes:
        return math.nan, math.nan
    counts = [np.array([tuple(vars(one).values()) for one in evaluation], np.int64) for evaluation in of_takes]
    drawn = np.random.default_rng(0).integers(takes, size=(draws, takes))
    values = np.array([measure(*(Counts(*map(int, one[some].sum(axis=0))) for one in counts)) for some in drawn])
    values = values[~np.isnan(values)]
    if not len(values):
        return math.nan, math.nan
    low, high = np.quantile(values, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)
