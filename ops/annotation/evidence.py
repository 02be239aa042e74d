"""This module computes evidence: numbers of an annotated segment that help to distinguish right from wrong labels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numba as nb
import numpy as np

from kinedex.ops.annotation.decoding import STANDING_OUT
from kinedex.ops.annotation.segments import Segment
from kinedex.ops.arrays import F64, I64

_NO_COST = 0.3  # stands for the cost of a segment in which no path ends
# segments with a distance of 1 / 5 or more have no support, whatever share of entries their template fixes
_DISTANT = 5.0


def evidence_of(
    names: Sequence[str],
    found: Sequence[Sequence[Segment]],
    offsets: I64,
    columns: Sequence[int],
    fixed: Sequence[float],
) -> F64:
    """Return the evidence of segments, from which the confidence of their labels is computed.

    Parameters
    ----------
    names : sequence of str, length E
        The names of the numbers to compute: "lead" is the square root of the value per frame that only the segment's
        class can attain; "margin" is the segment's margin; "cost" is the square root of its cost; "pace" is the
        logarithm of the ratio of the segment's length to the template's, and "haste" its absolute value; "fixed" is the
        fraction of entries that the template fixes; "support" is the advantage of this label over the best other label
        that covers most of the segment's frames, in √frames; "others" is log(1 + n), where n is the mean number of
        other labels per frame; "covered" is the fraction of the take's frames that have a label.
    found : sequence of sequence of Segment, length T
        The segments of each take in the order of their starts, in frames of the take.
    offsets : int64 array (T + 1,)
        The first frame of each take in the concatenation of all takes, and the end.
    columns : sequence of int
        The number of columns of each template.
    fixed : sequence of float
        The fraction of fixed entries of each template.

    Returns
    -------
    float64 array (S, E)
        The numbers of all segments, take by take.
    """
    if not any(found):
        return np.empty((0, len(names)))
    evidence = _Evidence(found, offsets, np.array(columns, np.float64), np.array(fixed, np.float64))
    return np.stack([_NUMBERS[name](evidence) for name in names], axis=1)


@dataclass(frozen=True)
class _Evidence:
    """The S segments of all takes as columns, from which each kind of evidence is computed."""

    found: Sequence[Sequence[Segment]]
    offsets: I64
    columns: F64
    shares: F64

    @cached_property
    def segments(self) -> list[Segment]:
        return [one for own in self.found for one in own]

    @cached_property
    def takes(self) -> I64:
        return np.repeat(np.arange(len(self.found)), [len(own) for own in self.found])

    @cached_property
    def spans(self) -> I64:
        """Return starts and stops, int64 (2, S), in frames of the concatenated takes."""
        spans = np.array([(one.start, one.stop) for one in self.segments], np.int64).T
        return spans + self.offsets[:-1][self.takes]

    @cached_property
    def frames(self) -> F64:
        return (self.spans[1] - self.spans[0]).astype(np.float64)

    @cached_property
    def templates(self) -> I64:
        return np.array([one.subclass for one in self.segments], np.int64)

    @cached_property
    def labels(self) -> I64:
        """Return the number of labels of each frame of all takes, int64 (L,)."""
        changes = np.zeros(int(self.offsets[-1]) + 1, np.int64)
        np.add.at(changes, self.spans[0], 1)
        np.add.at(changes, self.spans[1], -1)
        return np.cumsum(changes)[:-1]

    def margin(self) -> F64:
        return np.array([one.margin for one in self.segments])

    def cost(self) -> F64:
        costs = np.array([one.cost for one in self.segments])
        return np.sqrt(np.where(np.isfinite(costs), costs, _NO_COST**2))

    def pace(self) -> F64:
        return np.log(self.frames / self.columns[self.templates])

    def haste(self) -> F64:
        return np.abs(self.pace())

    def fixed(self) -> F64:
        return self.shares[self.templates]

    def lead(self) -> F64:
        a_frame = np.maximum([one.value for one in self.segments], 0.0) / self.frames
        alone = np.clip(self.margin() / np.maximum(-np.expm1(-a_frame / STANDING_OUT), 1e-9), 0.0, 1.0)
        return np.sqrt(a_frame * alone)

    def support(self) -> F64:
        own = self.fixed() * (1.0 - _DISTANT * self.cost() ** 2) * np.sqrt(self.frames)
        classes = np.array([one.class_index for one in self.segments], np.int64)
        return own - _strongest_rivals(*map(np.ascontiguousarray, self.spans), self.takes, classes, own)

    def others(self) -> F64:
        before = np.concatenate([[0], np.cumsum(self.labels)])
        return np.log((before[self.spans[1]] - before[self.spans[0]]) / self.frames)

    def covered(self) -> F64:
        before = np.concatenate([[0], np.cumsum(self.labels > 0)])[self.offsets]
        shares: F64 = np.diff(before) / np.maximum(np.diff(self.offsets), 1)
        return shares[self.takes]


_NUMBERS: dict[str, Callable[[_Evidence], F64]] = {
    "lead": _Evidence.lead,
    "margin": _Evidence.margin,
    "cost": _Evidence.cost,
    "pace": _Evidence.pace,
    "haste": _Evidence.haste,
    "fixed": _Evidence.fixed,
    "support": _Evidence.support,
    "others": _Evidence.others,
    "covered": _Evidence.covered,
}


@nb.njit(cache=True, nogil=True)
def _strongest_rivals(starts: I64, stops: I64, takes: I64, classes: I64, strengths: F64) -> F64:
    """Return for each segment the greatest strength of other classes' segments that cover most of its frames.

    If there is no such segment, the result is the strength of the segment itself. Segments must be in order of take and
    start, in frames of the concatenated takes.
    """
    longest = np.max(stops - starts)
    result = strengths.copy()
    first = 0
    for i in range(len(starts)):
        while starts[first] + longest <= starts[i]:
            first += 1
        best = -np.inf
        for j in range(first, len(starts)):
            if starts[j] >= stops[i]:
                break
            shared = min(stops[i], stops[j]) - max(starts[i], starts[j])
            if classes[j] != classes[i] and takes[j] == takes[i] and 2 * shared > stops[i] - starts[i]:
                best = max(best, strengths[j])
        if best > -np.inf:
            result[i] = best
    return result
