"""This module computes precision, recall and F-measure of annotations (thesis, Section 5.4), and of rankings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass

import numpy as np

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.errors import ParameterError

Bounds = Sequence[tuple[int, int]] | I64


@dataclass(frozen=True)
class Counts:
    """The counts that all measures derive from; counts of several takes, classes or folds add up.

    Parameters
    ----------
    frames_both, frames_automatic, frames_manual : int
        |M ∩ A|, |A| and |M|, in pairs of frame and class (thesis, Eq. 5.8 and 5.9).
    segments_automatic_hit : int
        The number of automatic segments that overlap a manual segment of their class.
    segments_automatic : int
        The number of all automatic segments.
    segments_manual_hit : int
        The number of manual segments that overlap an automatic segment of their class.
    segments_manual : int
        The number of all manual segments.
    """

    frames_both: int = 0
    frames_automatic: int = 0
    frames_manual: int = 0
    segments_automatic_hit: int = 0
    segments_automatic: int = 0
    segments_manual_hit: int = 0
    segments_manual: int = 0

    def __add__(self, other: Counts) -> Counts:
        return Counts(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    @property
    def p1(self) -> float:
        """Return the precision by frames (thesis, Eq. 5.10); NaN where nothing was annotated."""
        return _ratio(self.frames_both, self.frames_automatic)

    @property
    def r1(self) -> float:
        """Return the recall by frames (thesis, Eq. 5.11); NaN without manual frames."""
        return _ratio(self.frames_both, self.frames_manual)

    @property
    def f1(self) -> float:
        """Return the F-measure by frames (thesis, Eq. 5.12), from `p1` and `r1`."""
        return f_measure(self.p1, self.r1)

    @property
    def p2(self) -> float:
        """Return the precision by segments; NaN where nothing was annotated."""
        return _ratio(self.segments_automatic_hit, self.segments_automatic)

    @property
    def r2(self) -> float:
        """Return the recall by segments; NaN without manual segments."""
        return _ratio(self.segments_manual_hit, self.segments_manual)

    @property
    def f2(self) -> float:
        """Return the F-measure by segments, from `p2` and `r2`; precision and recall have equal weights."""
        return f_measure(self.p2, self.r2)


def f_measure(precision: float, recall: float) -> float:
    """Return the harmonic mean of precision and recall (thesis, Eq. 5.12).

    The result is 0 if one of them is 0, or if only one is undefined (there are errors and no true positive). It is NaN
    if both are undefined.
    """
    if math.isnan(precision) and math.isnan(recall):
        return math.nan
    if math.isnan(precision) or math.isnan(recall) or precision + recall == 0:
        return 0.0
    return 2 * precision * recall / (precision + recall)


def pooled(counts: Iterable[Counts]) -> Counts:
    """Return the sum of counts, as of a single concatenated take."""
    return sum(counts, Counts())


def compare(automatic: Bounds, manual: Bounds) -> Counts:
    """Count agreements between the automatic and the manual segments of one class in one take.

    Parameters
    ----------
    automatic, manual : int64 array (S, 2) or sequence of (int, int)
        Half-open ranges of frames, in any order. Frames of overlapping ranges are counted once, but each range counts
        as a segment.

    Returns
    -------
    Counts

    Raises
    ------
    ParameterError
        If a segment is empty or begins before frame 0.
    """
    mine, theirs = _segments("automatic", automatic), _segments("manual", manual)
    stop = int(max(mine[:, 1].max(initial=0), theirs[:, 1].max(initial=0)))
    in_mine, in_theirs = _covered(mine, stop), _covered(theirs, stop)
    return Counts(
        frames_both=int(np.count_nonzero(in_mine & in_theirs)),
        frames_automatic=int(np.count_nonzero(in_mine)),
        frames_manual=int(np.count_nonzero(in_theirs)),
        segments_automatic_hit=_hit(mine, in_theirs),
        segments_automatic=len(mine),
        segments_manual_hit=_hit(theirs, in_mine),
        segments_manual=len(theirs),
    )


def _segments(name: str, bounds: Bounds) -> I64:
    segments = np.asarray(bounds, np.int64).reshape(-1, 2)
    if np.any(segments[:, 0] < 0) or np.any(segments[:, 0] >= segments[:, 1]):
        raise ParameterError(name, "segments with 0 ≤ start < stop", segments.tolist()[:4])
    return segments


def _covered(segments: I64, stop: int) -> Bool:
    covered = np.zeros(stop, np.bool_)
    for start, end in segments:
        covered[start:end] = True
    return covered


def _hit(segments: I64, covered: Bool) -> int:
    """Return the number of segments that contain at least one covered frame."""
    return sum(bool(covered[start:end].any()) for start, end in segments)


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else math.nan


def precision_recall(relevant: Sequence[bool], total: int) -> tuple[F64, F64]:
    """Return precision and recall after each rank (thesis, Figure 3.13).

    Parameters
    ----------
    relevant : sequence of bool
        For each rank, the best first, True if the entry at this rank should be found; each entry occurs once.
    total : int
        The number of all entries that should be found, including those that the ranking misses.

    Returns
    -------
    precision, recall : float64 array (R,)
        The values after each of the R ranks.

    Raises
    ------
    ParameterError
        If there are more relevant ranks than entries that should be found.
    """
    hits = np.cumsum(np.asarray(relevant, np.int64))
    if len(hits) and hits[-1] > total:
        raise ParameterError("total", f"at least {int(hits[-1])}, the relevant ranks", total)
    return hits / np.arange(1, len(hits) + 1), hits / total if total else np.full(len(hits), math.nan)


def average_precision(relevant: Sequence[bool], total: int) -> float:
    """Return the mean of the precision at every relevant rank, counting 0 for each entry that is not found.

    The result is NaN if no entry should be found. Parameters and errors are those of `precision_recall`.
    """
    precision, _ = precision_recall(relevant, total)
    return float(precision[np.asarray(relevant, np.bool_)].sum() / total) if total else math.nan
