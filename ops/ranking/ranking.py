"""Ranking: where in an archive a template fits best, each place once (thesis, Chapter 3.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from kinedex.ops.annotation.segments import TOLERANCE
from kinedex.ops.distances.costs import F64, I64, CodedWords, Layout, encode, lay_out
from kinedex.ops.distances.pruning import Coarse, bounds_below, coarse_bound, coarse_bounds, possible_minima
from kinedex.ops.distances.stripes import BLOCK
from kinedex.ops.errors import ParameterError
from kinedex.ops.ranges import checked_ranges
from kinedex.ops.ranking.block_search import gather_blocks, take_from_blocks
from kinedex.ops.ranking.hit_selection import take_best
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import TakeWords

_MARGIN = 0.12
"""By what share of τ the best hits are looked for beyond their coarse bounds, which are that much too low at times."""

_BLOCK = 1024
"""Frames of a still stretch, where neighbour stands beside neighbour, whose costs are computed together at most."""


@dataclass(frozen=True)
class Hits:
    """The best places for a template, the best first.

    takes: int64 (H,), which of the takes. starts, stops: int64 (H,), frames of the take, half-open. costs: float64
    (H,), the distance at the last frame. frames: how many frames the takes (or ranges) have; computed: in how many of
    them more than the coarse bound was computed column by column, a bound in 16 bits (see
    `ops.distances.pruning.Bounds`) or sums for the best hits, those that lead in to others included; twice if twice.
    bounded: whether the coarse bound was tried, without which nothing is skipped.
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


@dataclass(frozen=True)
class _Archive:
    """Words to rank, checked. stretches: int64 (R, 2), that paths must not leave; homes: int64 (R,), the take of each.

    order: int64 (T,), the places of takes among equal hits.
    """

    words: TakeWords
    coded: CodedWords
    stretches: I64
    homes: I64
    order: I64

    @property
    def frames(self) -> int:
        return int((self.stretches[:, 1] - self.stretches[:, 0]).sum())


def rank(
    template: QuantisedTemplate,
    words: TakeWords,
    threshold: float,
    most: int | None = None,
    ranges: I64 | None = None,
    coded: CodedWords | None = None,
    coarse: Coarse | None = None,
    order: I64 | None = None,
) -> Hits:
    """Rank the hits of a template: local minima of its distance curve below a threshold, the best first.

    A hit that is taken, of m frames, rules out those in its take that end within 0.5 m before to 0.1 m after its end or
    start within 0.1 m before to 0.5 m after its start. Costs closer than 1e-9 are equal; of equal hits that of
    the first take comes first (in `order`), and within it the one that ends first.

    The hits are those of the whole curve in float64 (`tests/oracles/ranking.py` does it that way). Here minima come
    with a lower bound (`ops.distances.pruning`); the most promising is taken up, computed, and put back with its
    true cost; when it comes up again, nothing better is left. Those that a taken hit rules out are never computed.

    Where only the best hits are asked for, they are looked for below a lower threshold first, which the coarse bound
    suggests, and in the order of that bound alone (`ops.ranking.block_search`). Hits below the lower threshold are the
    first ones below τ: they come in the order of their costs, and only a better one rules one out. If they are enough,
    they are the answer; if not, the threshold rises.

    Parameters
    ----------
    template: N columns. words: the takes.
    threshold: τ > 0. most: how many hits at most; None for all.
    ranges: int64 (R, 2), half-open stretches of the words laid end to end, ascending, apart, and each within a take,
        that paths must not leave; None: the takes.
    coded: `encode(words.words)`, where several templates share it. coarse: this template's coarse bound for τ or
        more on these words and ranges, where it is known.
    order: int64 (T,), the place of each take among equal hits; as they are laid out for None.

    Raises
    ------
    ParameterError: a threshold or a number of hits that is not above 0, or wrong ranges.
    """
    if most is not None and most < 1:
        raise ParameterError("most", "at least 1, or None", most)
    if not threshold > 0:
        raise ParameterError("threshold", "above 0", threshold)
    archive = _archive(words, ranges, coded, order)
    if coarse is None:
        coarse = coarse_bound(template, archive.coded, threshold, archive.stretches)
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

    The hits are those of `rank` of each. thresholds: float64 (T,), the other parameters as there.
    """
    if len(templates) < 2:
        return [
            rank(one, words, float(tau), most, None, coded, order=order)
            for one, tau in zip(templates, thresholds, strict=True)
        ]
    if most is not None and most < 1:
        raise ParameterError("most", "at least 1, or None", most)
    archive = _archive(words, None, coded, order)
    bounds = coarse_bounds(templates, archive.coded, thresholds, archive.stretches)
    return [
        _rank(template, archive, float(tau), most, coarse)
        for template, tau, coarse in zip(templates, thresholds, bounds, strict=True)
    ]


def _rank(
    template: QuantisedTemplate, archive: _Archive, threshold: float, most: int | None, coarse: Coarse | None
) -> Hits:
    """The hits below a threshold, or the best of them; below lower thresholds first."""
    layout, computed = lay_out([template]), 0
    if coarse is not None and most is not None:
        for tau in _rising(coarse, threshold, most, len(template)):
            hits = _first_below(layout, archive, tau, most, coarse)
            computed += hits.computed
            # What is at the threshold, but for the tolerance, may be as good as the last: then this is not the end yet.
            if len(hits) == most and hits.costs[-1] < tau - 4 * TOLERANCE:
                return replace(hits, computed=computed)
    hits = _all_below(template, layout, archive, threshold, most, coarse)
    return replace(hits, computed=computed + hits.computed)


def _archive(words: TakeWords, ranges: I64 | None, coded: CodedWords | None, order: I64 | None) -> _Archive:
    """Check the stretches that paths must not leave, the takes or ranges, and the places of takes among equal hits."""
    whole = np.stack([words.offsets[:-1], words.offsets[1:]], axis=1)
    stretches = checked_ranges(whole if ranges is None else ranges, len(words.words))
    homes = np.searchsorted(words.offsets, stretches[:, 0], side="right") - 1
    if len(stretches) and np.any(stretches[:, 1] > words.offsets[homes + 1]):
        raise ParameterError("ranges", "each within a take", stretches[stretches[:, 1] > words.offsets[homes + 1]][:4])
    if order is not None and len(order) != len(words):
        raise ParameterError("order", f"one place for each of {len(words)} takes", len(order))
    places = np.arange(len(words), dtype=np.int64) if order is None else np.ascontiguousarray(order, np.int64)
    return _Archive(words, encode(words.words) if coded is None else coded, stretches, homes, places)


def _rising(coarse: Coarse, threshold: float, most: int, columns: int) -> list[float]:
    """Thresholds below τ to look below before, one after the other: the first is likely to be enough.

    A stretch of as many frames as the template has columns holds a hit or two, the best of which its least bound tells.
    """
    width = max(columns // BLOCK, 1)
    blocks = coarse.sums[: len(coarse.sums) // width * width].reshape(-1, width)
    if most >= len(blocks) // 4:
        return []
    least = reduce(np.minimum, blocks.T)  # block by block of all stretches, which is faster than stretch by stretch
    first = (int(np.partition(least, most)[most]) + 1) * coarse.unit + _MARGIN * threshold
    return [tau for tau in (first, first + 2 * _MARGIN * threshold) if tau < 0.9 * threshold]


def _first_below(layout: Layout, archive: _Archive, threshold: float, most: int, coarse: Coarse) -> Hits:
    """The best hits below a threshold, looked for in the order of the coarse bounds."""
    columns = int(layout.lengths[0])
    blocks = np.flatnonzero(coarse.below(threshold))
    groups = gather_blocks(blocks, coarse.sums, archive.stretches, archive.homes, columns)
    starts, ends, costs = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most)
    found, computed = take_from_blocks(
        archive.coded.vocabulary, archive.coded.codes, layout.values[:columns], layout.parts[:, :columns],
        layout.worths[:, :columns], layout.counted[:columns], threshold, groups, coarse.unit, archive.order,
        starts, ends, costs,
    )  # fmt: skip
    return _hits(archive, starts[:found], ends[:found], costs[:found], computed, bounded=True)


def _all_below(
    template: QuantisedTemplate,
    layout: Layout,
    archive: _Archive,
    threshold: float,
    most: int | None,
    coarse: Coarse | None,
) -> Hits:
    """The hits below a threshold, all of them or the best, looked for where finer bounds leave any."""
    coded, stretches, columns = archive.coded, archive.stretches, len(template)
    bounds = bounds_below(template, coded, threshold, stretches, coarse)
    candidates, possible = possible_minima(bounds.units, bounds.spans, bounds.slack)
    place = np.searchsorted(stretches[:, 0], candidates, side="right") - 1
    groups = grouped(candidates, place, columns)
    limit = len(candidates) if most is None else min(most, len(candidates))
    starts, ends, costs = np.empty(limit, np.int64), np.empty(limit, np.int64), np.empty(limit)
    found = take_best(
        coded.vocabulary, coded.codes, layout.values[:columns], layout.parts[:, :columns], layout.worths[:, :columns],
        layout.counted[:columns], threshold, bounds.units, bounds.unit, candidates, possible,
        groups, stretches[place, 0], archive.homes[place], archive.order, starts, ends, costs,
    )  # fmt: skip
    return _hits(archive, starts[:found], ends[:found], costs[:found], bounds.computed, bounded=coarse is not None)


def _hits(archive: _Archive, starts: I64, ends: I64, costs: F64, computed: int, *, bounded: bool) -> Hits:
    """Hits by the frames of their takes."""
    takes = (np.searchsorted(archive.words.offsets, ends, side="right") - 1).astype(np.int64)
    shift = archive.words.offsets[takes]
    return Hits(takes, starts - shift, ends + 1 - shift, costs, archive.frames, computed, bounded)


def grouped(candidates: I64, place: I64, columns: int) -> I64:
    """Which candidates are computed together, in one window: int64 (G + 1,), group g begins with groups[g].

    What costs one of them lies in the 2(N − 1) frames before it, so that candidates close to each other share most of
    the work. Where candidates are neighbours, as in a still stretch, they stay together in blocks of `_BLOCK`
    frames; a window therefore spans so many frames and those before, however long a still stretch is.

    Parameters
    ----------
    candidates: int64 (C,), frames, ascending. place: int64 (C,), the stretch of each. columns: N.
    """
    if not len(candidates):
        return np.zeros(1, np.int64)
    far, other = np.diff(candidates) > columns // 8 + 1, np.diff(place) > 0
    far |= np.diff(candidates // (columns + 8)) > 0
    # Neighbours decide about each other: it is cheaper to have them in one window.
    apart = (far & (np.diff(candidates) > 1)) | other | (np.diff(candidates // _BLOCK) > 0)
    return np.concatenate(([0], np.flatnonzero(apart) + 1, [len(candidates)])).astype(np.int64)
