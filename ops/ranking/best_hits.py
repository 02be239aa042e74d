"""This module ranks the intervals of an archive by how well a template fits them (thesis, Section 3.6.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from kinedex.ops.annotation.segments import TOLERANCE
from kinedex.ops.arrays import F64, I64
from kinedex.ops.distances.costs import CodedWords, encode, template_columns
from kinedex.ops.distances.pruning import CoarseBound, coarse_bound, coarse_bounds, fine_bound, possible_minima
from kinedex.ops.distances.sweep import BLOCK
from kinedex.ops.errors import ParameterError
from kinedex.ops.ranges import checked_ranges
from kinedex.ops.ranking.block_search import gather_blocks, select_from_blocks
from kinedex.ops.ranking.hit_selection import KEYS, Candidates, Selection, select_best
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import TakeWords

_MARGIN = 0.12
"""Fraction of τ by which the threshold for the best hits exceeds their coarse bounds, which may be too low by so much.
"""

_BLOCK = 1024
"""Maximum number of neighbouring frames, as in a motionless interval, that are computed together."""


@dataclass(frozen=True)
class Hits:
    """The intervals that match a template best, the best first.

    Parameters
    ----------
    takes : int64 array (H,)
        The position of the take of each hit.
    starts, stops : int64 array (H,)
        Half-open ranges of frames of the take.
    costs : float64 array (H,)
        The distance at the last frame.
    frames : int
        The number of frames of the takes or ranges.
    computed : int
        The number of frames for which more than the coarse bound was computed: a bound in 16 bits
        (`ops.distances.pruning.FineBound`), or the sums for the best hits, both including lead-in frames. Frames that
        were computed twice are counted twice.
    bounded : bool
        True if the coarse bound was computed; without it, no frames are skipped.
    """

    takes: I64
    starts: I64
    stops: I64
    costs: F64
    frames: int
    computed: int
    bounded: bool

    def __len__(self) -> int:
        return len(self.costs)

    @classmethod
    def none(cls, frames: int = 0, *, bounded: bool = False) -> Hits:
        """Return an empty result for a number of frames of which none was computed."""
        empty = np.empty(0, np.int64)
        return cls(empty, empty, empty, np.empty(0), frames, 0, bounded)

    def merged(self, other: Hits, order: I64, most: int | None) -> Hits:
        """Merge these hits with those of the same template in other takes.

        Parameters
        ----------
        other : Hits
            Hits of other takes. Both objects must refer to the same numbering of takes.
        order : int64 array (T,)
            The rank of each take among hits of equal cost.
        most : int, optional
            The number of best hits to keep; None to keep all.
        """
        columns = zip(self._columns(), other._columns(), strict=True)
        takes, starts, stops, costs = (np.concatenate(pair) for pair in columns)
        best = np.lexsort((stops, order[takes], np.rint(costs * KEYS)))[:most]
        frames, computed = self.frames + other.frames, self.computed + other.computed
        return Hits(
            takes[best], starts[best], stops[best], costs[best], frames, computed, self.bounded or other.bounded
        )

    def _columns(self) -> tuple[I64, I64, I64, F64]:
        return self.takes, self.starts, self.stops, self.costs


@dataclass(frozen=True)
class _Archive:
    """The words in which hits are ranked, after the arguments have been checked.

    Parameters
    ----------
    words : TakeWords
        The words of the takes.
    coded : CodedWords
        The words of the frames.
    ranges : int64 array (R, 2)
        The ranges that paths must not leave.
    takes : int64 array (R,)
        The take of each range.
    order : int64 array (T,)
        The rank of each take among hits of equal cost.
    """

    words: TakeWords
    coded: CodedWords
    ranges: I64
    takes: I64
    order: I64

    @property
    def frames(self) -> int:
        return int((self.ranges[:, 1] - self.ranges[:, 0]).sum())


def rank(
    template: QuantisedTemplate,
    words: TakeWords,
    threshold: float,
    most: int | None = None,
    ranges: I64 | None = None,
    coded: CodedWords | None = None,
    coarse: CoarseBound | None = None,
    order: I64 | None = None,
) -> Hits:
    """Rank the hits of a template, the local minima of its distance curve below a threshold, the best first.

    A selected hit of m frames excludes worse hits of its take that end between 0.5 m before and 0.1 m after its end, or
    start between 0.1 m before and 0.5 m after its start. Costs that differ by less than 1e-9 are treated as equal. Of
    equal hits, that of the first take (in `order`) comes first, and within a take the hit that ends first.

    The hits equal those of the whole curve in float64, which `tests/oracles/ranking.py` computes. Candidates are kept
    in a heap ordered by their lower bounds (`ops.distances.pruning`). The first candidate is computed and put back with
    its true cost; when it is first again, no better candidate is left, and it is selected. Candidates that a selected
    hit excludes are never computed.

    If only the best hits are requested, they are first searched below a lower threshold, which is estimated from the
    coarse bound, and in the order of that bound (`ops.ranking.block_search`). Since hits are selected in order of cost
    and excluded only by better hits, the hits below the lower threshold are also the first hits below τ. If there are
    not enough of them, the threshold is raised.

    Parameters
    ----------
    template : QuantisedTemplate
        A template of N columns.
    words : TakeWords
        The words of the takes.
    threshold : float
        The threshold τ > 0.
    most : int, optional
        The maximum number of hits to return; None for all.
    ranges : int64 array (R, 2), optional
        Half-open ranges of frames of the concatenated takes, which paths must not leave. They must be ascending and
        disjoint, and each must lie within a take. None for all frames of each take.
    coded : CodedWords, optional
        The result of `encode(words.words)`, which several templates may share; computed if it is not given.
    coarse : CoarseBound, optional
        The template's coarse bound on these words and ranges, for τ or a greater threshold; computed if not given.
    order : int64 array (T,), optional
        The rank of each take among hits of equal cost; by default the order of the takes.

    Raises
    ------
    ParameterError
        If the threshold or the number of hits is not above 0, or the ranges are invalid.
    """
    if most is not None and most < 1:
        raise ParameterError("most", "at least 1, or None", most)
    if not threshold > 0:
        raise ParameterError("threshold", "above 0", threshold)
    archive = _archive(words, ranges, coded, order)
    if coarse is None:
        coarse = coarse_bound(template, archive.coded, threshold, archive.ranges)
    return _rank(template, archive, threshold, most, coarse)


def rank_together(
    templates: Sequence[QuantisedTemplate],
    words: TakeWords,
    thresholds: F64,
    most: int | None = None,
    coded: CodedWords | None = None,
    order: I64 | None = None,
) -> list[Hits]:
    """Rank the hits of several templates, with one pass over the words for the coarse bounds of all of them.

    The hits equal those of `rank` for each template.

    Parameters
    ----------
    templates : sequence of QuantisedTemplate
        T templates.
    words : TakeWords
        The words of the takes.
    thresholds : float64 array (T,)
        The threshold τ > 0 of each template.
    most : int, optional
        The maximum number of hits of each template; None for all.
    coded : CodedWords, optional
        The result of `encode(words.words)`; computed if it is not given.
    order : int64 array, optional
        The rank of each take among hits of equal cost; by default the order of the takes.

    Raises
    ------
    ParameterError
        If a threshold or the number of hits is not above 0.
    """
    if len(templates) < 2:
        return [
            rank(one, words, float(tau), most, None, coded, order=order)
            for one, tau in zip(templates, thresholds, strict=True)
        ]
    if most is not None and most < 1:
        raise ParameterError("most", "at least 1, or None", most)
    archive = _archive(words, None, coded, order)
    bounds = coarse_bounds(templates, archive.coded, thresholds, archive.ranges)
    return [
        _rank(template, archive, float(tau), most, coarse)
        for template, tau, coarse in zip(templates, thresholds, bounds, strict=True)
    ]


def _rank(
    template: QuantisedTemplate, archive: _Archive, threshold: float, most: int | None, coarse: CoarseBound | None
) -> Hits:
    """Return the hits below a threshold, or the best of them, trying lower thresholds first."""
    computed = 0
    if coarse is not None and most is not None:
        for tau in _rising(coarse, threshold, most, len(template)):
            hits = _best_below(template, archive, tau, most, coarse)
            computed += hits.computed
            # Costs within the tolerance of the threshold may tie with the last hit, so they do not count as found yet.
            if len(hits) == most and hits.costs[-1] < tau - 4 * TOLERANCE:
                return replace(hits, computed=computed)
    hits = _all_below(template, archive, threshold, most, coarse)
    return replace(hits, computed=computed + hits.computed)


def _archive(words: TakeWords, ranges: I64 | None, coded: CodedWords | None, order: I64 | None) -> _Archive:
    """Check the ranges that paths must not leave and the ranks of takes, and return the words to rank."""
    whole = np.stack([words.offsets[:-1], words.offsets[1:]], axis=1)
    checked = checked_ranges(whole if ranges is None else ranges, len(words.words))
    takes = np.searchsorted(words.offsets, checked[:, 0], side="right") - 1
    outside = checked[:, 1] > words.offsets[takes + 1]
    if outside.any():
        raise ParameterError("ranges", "each within a take", checked[outside][:4].tolist())
    if order is not None and len(order) != len(words):
        raise ParameterError("order", f"one place for each of {len(words)} takes", len(order))
    positions = np.arange(len(words), dtype=np.int64) if order is None else np.ascontiguousarray(order, np.int64)
    return _Archive(words, encode(words.words) if coded is None else coded, checked, takes, positions)


def _rising(coarse: CoarseBound, threshold: float, most: int, columns: int) -> list[float]:
    """Return thresholds below τ to try, in ascending order; the first one is likely to give enough hits.

    An interval of as many frames as the template has columns contains one or two hits, and its smallest bound is an
    estimate of the best of them.
    """
    width = max(columns // BLOCK, 1)
    blocks = coarse.sums[: len(coarse.sums) // width * width].reshape(-1, width)
    if most >= len(blocks) // 4:
        return []
    least = reduce(np.minimum, blocks.T)  # faster than a minimum along the short axis
    first = (int(np.partition(least, most)[most]) + 1) * coarse.unit + _MARGIN * threshold
    return [tau for tau in (first, first + 2 * _MARGIN * threshold) if tau < 0.9 * threshold]


def _best_below(
    template: QuantisedTemplate, archive: _Archive, threshold: float, most: int, coarse: CoarseBound
) -> Hits:
    """Return the best hits below a threshold, found in the order of the coarse bounds."""
    blocks = np.flatnonzero(coarse.blocks_below(threshold))
    groups = gather_blocks(blocks, coarse.sums, archive.ranges, archive.takes, len(template))
    selection, computed = select_from_blocks(
        archive.coded.vocabulary, archive.coded.codes, template_columns(template), threshold, groups, coarse.unit,
        archive.order, most,
    )  # fmt: skip
    return _hits(archive, selection, computed, bounded=True)


def _all_below(
    template: QuantisedTemplate, archive: _Archive, threshold: float, most: int | None, coarse: CoarseBound | None
) -> Hits:
    """Return all or the best hits below a threshold, computed in the frames that finer bounds do not exclude."""
    coded, ranges, columns = archive.coded, archive.ranges, len(template)
    bound = fine_bound(template, coded, threshold, ranges, coarse)
    frames, possible = possible_minima(bound.units, bound.ranges, bound.slack)
    place = np.searchsorted(ranges[:, 0], frames, side="right") - 1
    candidates = Candidates(frames, possible, grouped(frames, place, columns), ranges[place, 0], archive.takes[place])
    selection = select_best(
        coded.vocabulary, coded.codes, template_columns(template), threshold, bound.units, bound.unit, candidates,
        archive.order, len(frames) if most is None else min(most, len(frames)),
    )  # fmt: skip
    return _hits(archive, selection, bound.computed, bounded=coarse is not None)


def _hits(archive: _Archive, selection: Selection, computed: int, *, bounded: bool) -> Hits:
    """Convert selected hits to frames of their takes."""
    found = int(selection.found[0])
    ends = selection.ends[:found]
    takes = (np.searchsorted(archive.words.offsets, ends, side="right") - 1).astype(np.int64)
    shift = archive.words.offsets[takes]
    starts, stops = selection.starts[:found] - shift, ends + 1 - shift
    return Hits(takes, starts, stops, selection.costs[:found], archive.frames, computed, bounded)


def grouped(candidates: I64, ranges: I64, columns: int) -> I64:
    """Return the groups of candidates that are computed together in one window.

    The cost of a candidate depends on the 2(N − 1) frames before it, so that candidates close to each other share most
    of the work. Many successive candidates, as in a motionless interval, are divided into blocks of at most `_BLOCK`
    frames, so that a window never has more frames than this plus the lead-in.

    Parameters
    ----------
    candidates : int64 array (C,)
        The frames of the candidates, ascending.
    ranges : int64 array (C,)
        The number of the range of each candidate.
    columns : int
        The number of columns N of the template.

    Returns
    -------
    int64 array (G + 1,)
        Group g begins with the candidate groups[g].
    """
    if not len(candidates):
        return np.zeros(1, np.int64)
    far, other = np.diff(candidates) > columns // 8 + 1, np.diff(ranges) > 0
    far |= np.diff(candidates // (columns + 8)) > 0
    # Neighbours are compared with each other, so it is cheaper to have them in one window.
    apart = (far & (np.diff(candidates) > 1)) | other | (np.diff(candidates // _BLOCK) > 0)
    return np.concatenate(([0], np.flatnonzero(apart) + 1, [len(candidates)])).astype(np.int64)
