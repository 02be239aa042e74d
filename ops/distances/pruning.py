"""This module excludes frames in which a distance curve cannot have a minimum below a threshold, by lower bounds.

The bounds are proven below: coarse units (`coarse_bounds`), and whole units and windows (`fine_bound`). The remaining
frames are computed in float64 by `ops.ranking.best_hits`, or over short ranges by `ops.distances.range_minima`, so that
hits equal those of the full curve of `ops.distances.dtw.distance_curves`.

A third bound, `granule_bounds`, is applied before these. It needs only the coarse copy of bit slices
(`ops.search.bit_slices`), which has for every granule of 8 frames the features that are on in some frame, and the
features that are off in some frame. If a template requires a feature to be on and the feature is on in no frame of a
granule, every frame of the granule contradicts it. This bounds the cost of a path through the granule from below,
whichever frames the path visits.

*Blocks of columns.* The columns of a template are divided into blocks of B columns from the end; the first columns that
fill no block are ignored. The steps of a path in a block have a total weight of at least B − 1: B for the columns, less
one if a (2,1) step skips the last column, which then counts in the next block. Each unit of weight costs at least as
much as the block in the cheapest granule that the path visits there. This is at least the fraction of the entries fixed
alike in all columns of the block that the granule contradicts.

*Steps.* From a cell of a block to a cell of the next block there are at most 2B − 1 columns, and at most twice as many
frames. The granules of two consecutive blocks are therefore between 0 and (7 + 4B − 2) / 8 apart. Dynamic programming
finds the cheapest choice of granules within these steps, whose cost is at most that of the path divided by B − 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numba as nb
import numpy as np

from kinedex.ops.annotation.segments import TOLERANCE
from kinedex.ops.arrays import F32, F64, I32, I64, U8, U16, U64, Bool
from kinedex.ops.bits import count_bits
from kinedex.ops.distances.costs import CodedWords, bound_table, column_layout, template_columns
from kinedex.ops.distances.recurrence import COARSE_CAP
from kinedex.ops.distances.sweep import BLOCK, CAP, SLOTS, least_sums, pieces_of, sweep_bounds
from kinedex.ops.errors import ParameterError
from kinedex.ops.search.bit_slices import GRANULE, GRANULES, BitSlices, transpose
from kinedex.ops.templates.templates import QuantisedTemplate

_PIECE = 4096  # frames of a range that are computed independently of its other frames
# most bytes of a table of coarse costs; with many different words, fewer templates share a pass
_TABLE_CELLS = 16_000_000
_MIN_COLUMNS = 128  # least number of columns in a pass for which coarse sums save more time than they cost
_MAX_TEMPLATES = SLOTS // 2  # most templates in one pass: with more, a large part of the rows would be padding

LONG = 40
"""Number of columns from which a template is divided into blocks of 8 columns; shorter templates have blocks of 4."""

_ROUNDING = 1 + 1e-4
"""Factor by which sums in float32 may be too high."""


@dataclass(frozen=True)
class CoarseBound:
    """A lower bound of a distance curve in coarse units, one for each block of frames.

    Parameters
    ----------
    sums : uint8 array (B,)
        The bound in units, for all paths that end in a block of `ops.distances.sweep.BLOCK` frames; the last block may
        be shorter. It is `COARSE_CAP` if no path below the threshold of the bound ends in the block.
    unit : float
        The distance that corresponds to one unit.
    """

    sums: U8
    unit: float

    def blocks_below(self, threshold: float) -> Bool:
        """Return the blocks in which a path below a threshold may end, bool (B,)."""
        least = min(float(COARSE_CAP), np.ceil(threshold / self.unit * (1 + 1e-9)))
        below: Bool = self.sums < np.uint8(least)
        return below


@dataclass(frozen=True)
class FineBound:
    """A lower bound of a distance curve in whole units of 16 bits, computed where the curve may be below a threshold.

    Parameters
    ----------
    units : uint16 array (L,)
        The bound in each frame; `ops.distances.sweep.CAP` if no path below the threshold ends there.
    unit : float
        The distance that corresponds to one unit.
    slack : int
        The number of units by which the bound at a minimum of the curve may exceed the bound at a neighbouring frame.
    ranges : int64 array (R, 2)
        Ascending ranges outside of which all units are `CAP`.
    frames : int
        The number of frames of the curve.
    computed : int
        The number of frames that were computed, including those before each window from which paths lead into it.
    """

    units: U16
    unit: float
    slack: int
    ranges: I64
    frames: int
    computed: int


def coarse_bound(template: QuantisedTemplate, coded: CodedWords, threshold: float, ranges: I64) -> CoarseBound | None:
    """Return the coarse bound of a single template (`coarse_bounds`), or None if it would not save time."""
    if len(template) < _MIN_COLUMNS:
        return None
    return coarse_bounds([template], coded, np.array([threshold]), ranges)[0]


def coarse_bounds(
    templates: Sequence[QuantisedTemplate], coded: CodedWords, thresholds: F64, ranges: I64
) -> list[CoarseBound]:
    """Bound the distance curves of templates from below in coarse units, all in one pass over the words.

    *Coarse units.* With the unit u = τN / 255, a local cost c has ⌊c/u⌋ whole units. The cost of a path is the sum of
    its local costs, each counted once or twice, and the sum of their whole units is at most cost / u. Sums saturate at
    255 in 8 bits, and a saturated sum is still a lower bound. Hence, if the smallest sum in a frame is q units, no path
    that ends there costs less than q u, and if it is 255, no path there is below τ. A path below some τ' ≤ τ ends only
    in frames with fewer than τ'N / u units.

    Parameters
    ----------
    templates : sequence of QuantisedTemplate
        T templates.
    coded : CodedWords
        The words.
    thresholds : float64 array (T,)
        The threshold τ > 0 of each template.
    ranges : int64 array (R, 2)
        The ranges that paths must not leave, see `ops.ranges.checked_ranges`.

    Raises
    ------
    ParameterError
        If a threshold is not above 0.
    """
    thresholds = np.asarray(thresholds, np.float64)
    if len(thresholds) != len(templates) or not np.all(thresholds > 0):
        raise ParameterError("thresholds", f"above 0, one for each of {len(templates)} templates", thresholds.tolist())
    sums = np.full((len(templates), -(-len(coded) // BLOCK)), COARSE_CAP, np.uint8)
    most_columns = _TABLE_CELLS // max(1, len(coded.vocabulary))
    first, columns = 0, 0
    for place in range(len(templates) + 1):
        full = place < len(templates) and (
            columns + len(templates[place]) >= most_columns or place - first == _MAX_TEMPLATES
        )
        if place > first and (place == len(templates) or full):
            if len(ranges):
                layout = column_layout(templates[first:place])
                pieces = pieces_of(ranges, _PIECE, 2 * (int(layout.lengths.max()) - 1))
                units = thresholds[first:place] * layout.lengths / COARSE_CAP
                sums[first:place] = least_sums(layout, coded, units, pieces)
            first, columns = place, 0
        if place < len(templates):
            columns += len(templates[place]) + 1
    return [CoarseBound(own, float(tau) / COARSE_CAP) for own, tau in zip(sums, thresholds, strict=True)]


def fine_bound(
    template: QuantisedTemplate, coded: CodedWords, threshold: float, ranges: I64, coarse: CoarseBound | None = None
) -> FineBound:
    """Bound a distance curve from below in whole units, where it may be below a threshold.

    *Whole units.* With the unit u = τN / 21845, a local cost c has ⌊c/u⌋ whole units. The cost of a path is the sum of
    its local costs, N of them if those that count twice are counted twice. The sum of their whole units is at most
    cost / u and more than cost / u − N. Paths whose sums reach 21845 cost τN or more and are no hits. For paths below
    τ, the smallest sums are therefore a lower bound that differs from the curve by less than N units. A frame can be a
    minimum only if its bound is at most N units above that of a neighbour.

    *Windows.* A path that ends at frame l lies within the 2(N − 1) frames before l. Each part of the frames that the
    coarse bound does not exclude is therefore computed like a separate take that starts this many frames earlier.

    Parameters
    ----------
    template : QuantisedTemplate
        The template.
    coded : CodedWords
        The words of the frames.
    threshold : float
        τ > 0.
    ranges : int64 array (R, 2)
        The ranges that paths must not leave.
    coarse : CoarseBound, optional
        The bound that selects the frames to compute, made for these words and ranges and for this τ or a greater one;
        None to compute all frames.

    Raises
    ------
    ParameterError
        If the threshold is not above 0.
    """
    if not threshold > 0:
        raise ParameterError("threshold", "above 0", threshold)
    layout = column_layout([template])
    columns = len(template)
    cost = threshold * columns / CAP
    units = np.full((1, len(coded)), CAP, np.uint16)
    frames = int((ranges[:, 1] - ranges[:, 0]).sum())
    lead_in = 2 * (columns - 1)
    kept = ranges
    if coarse is not None:
        pieces = pieces_below(coarse, threshold, ranges, lead_in)
        kept = np.ascontiguousarray(pieces[:, 1:])
        # Long pieces first, so that the lanes end at about the same time.
        pieces = pieces[np.argsort(pieces[:, 0] - pieces[:, 2], kind="stable")]
    elif frames:
        pieces = pieces_of(ranges, _PIECE, lead_in)
    else:
        pieces = np.empty((0, 3), np.int64)
    if len(pieces):
        needed = np.zeros(len(coded.vocabulary), np.bool_)
        mark_words(coded.codes, pieces, needed)
        table = bound_table(layout, coded.vocabulary, np.array([cost]), CAP, np.uint16, needed)
        sweep_bounds(table, coded.codes, pieces, columns - 1, units)
    computed = int((pieces[:, 2] - pieces[:, 0]).sum())
    slack = columns + 1 + int(TOLERANCE * columns / cost)
    return FineBound(units[0], cost / columns, slack, kept, frames, computed)


def pieces_below(bound: CoarseBound, threshold: float, ranges: I64, lead_in: int) -> I64:
    """Return the pieces, see `ops.distances.sweep.pieces_of`, that cover all blocks that may be below a threshold.

    Blocks with fewer than `lead_in` frames between them are merged into one piece. Pieces are ascending.
    """
    positions = np.flatnonzero(bound.blocks_below(threshold))
    if not len(positions):
        return np.empty((0, 3), np.int64)
    apart = np.flatnonzero((np.diff(positions) - 1) * BLOCK > lead_in)
    begins = positions[np.concatenate(([0], apart + 1))] * BLOCK
    ends = (positions[np.concatenate((apart, [len(positions) - 1]))] + 1) * BLOCK
    # A piece overlaps the ranges from the first that ends after its start to the last that starts before its end.
    first = np.searchsorted(ranges[:, 1], begins, side="right")
    counts = np.maximum(np.searchsorted(ranges[:, 0], ends, side="left") - first, 0)
    piece = np.repeat(np.arange(len(begins)), counts)
    source = np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts) + first[piece]
    starts = np.maximum(begins[piece], ranges[source, 0])
    stops = np.minimum(ends[piece], ranges[source, 1])
    return np.stack([np.maximum(starts - lead_in, ranges[source, 0]), starts, stops], axis=1)


@nb.njit(cache=True, nogil=True)
def mark_words(codes: I32, pieces: I64, needed: Bool) -> None:
    """Mark the words that occur in pieces (kernel)."""
    for p in range(len(pieces)):
        for frame in range(pieces[p, 0], pieces[p, 2]):
            needed[codes[frame]] = True


@nb.njit(cache=True, nogil=True)
def possible_minima(units: U16, ranges: I64, slack: int) -> tuple[I64, Bool]:
    """Return the frames that can be minima with their neighbours, and a mask of the possible minima (kernel).

    Parameters
    ----------
    units : uint16 array (L,)
        The bound of each frame in whole units.
    ranges : int64 array (R, 2)
        The ranges that paths must not leave.
    slack : int
        See `FineBound`.

    Returns
    -------
    candidates : int64 array (C,)
        Ascending frames.
    possible : bool array (C,)
        True for frames that can be minima, False for their neighbours.
    """
    found = np.empty(len(units), np.int64)
    possible = np.empty(len(units), np.bool_)
    count = 0
    for r in range(len(ranges)):
        start, stop = ranges[r]
        done = start  # all candidates before this frame have been found
        for frame in range(start, stop):
            if units[frame] == CAP:
                continue
            own = np.int64(units[frame])
            left = frame > start and units[frame - 1] != CAP
            right = frame + 1 < stop and units[frame + 1] != CAP
            if left and own > np.int64(units[frame - 1]) + slack:
                continue
            if right and own > np.int64(units[frame + 1]) + slack:
                continue
            for beside in range(max(frame - 1, start), frame + 2):
                if beside < done:
                    possible[count - 1 - (done - 1 - beside)] |= beside == frame
                elif (beside < frame and left) or beside == frame or (beside > frame and right):
                    found[count] = beside
                    possible[count] = beside == frame
                    count += 1
                    done = beside + 1
    return found[:count].copy(), possible[:count].copy()


class GranuleBlocks(NamedTuple):
    """The blocks of columns of a template.

    Parameters
    ----------
    must_on, must_off : uint64 array (G, K)
        For each group of features of equal weight, the features that all columns of a block require to be on, or off.
    weights : float32 array (G, K)
        The weight of a feature of each group as a fraction of all weights of a column.
    """

    must_on: U64
    must_off: U64
    weights: F32


@dataclass(frozen=True)
class GranuleWords:
    """The features that are on in at least one frame of each granule, and those that are off in at least one frame.

    Parameters
    ----------
    on, off : uint64 array
        One word per granule, with the bits of the features.
    """

    on: U64
    off: U64


def granule_words(slices: BitSlices, first: int, stop: int) -> GranuleWords:
    """Return the features that are on and off in the granules of takes `first` to `stop` − 1.

    Parameters
    ----------
    slices : BitSlices
        The slices.
    first, stop : int
        A range of takes; the result begins with the first granule of the first take.
    """
    begin, end = int(slices.first[first]) * GRANULES, int(slices.first[stop]) * GRANULES
    on, off = np.empty(end - begin, np.uint64), np.empty(end - begin, np.uint64)
    _gather(slices.coarse, slices.features, len(slices.coarse) // (2 * slices.features + 1), begin, on, off)
    return GranuleWords(on, off)


@nb.njit(cache=True, nogil=True)
def _gather(coarse, features, width, begin, on, off):  # type: ignore[no-untyped-def]
    """Write the on and off words of the granules from `begin`, by transposing the coarse slices (kernel)."""
    square = np.empty(64, np.uint64)
    end = begin + len(on)
    for word in range(begin // 64, -(-end // 64)):
        low, high = max(begin, 64 * word), min(end, 64 * word + 64)
        for side in range(2):
            square[features:] = 0
            for row in range(features):
                square[row] = coarse[(side * features + row) * width + word]
            transpose(square)
            into = on if side == 0 else off
            for granule in range(low, high):
                into[granule - begin] = square[granule - 64 * word]


def granule_blocks(template: QuantisedTemplate) -> tuple[GranuleBlocks, int]:
    """Return the blocks of a template, and the number of columns B of each."""
    size = 8 if len(template) >= LONG else 4
    count = len(template) // size
    columns = template_columns(template)
    own = slice(len(template) - count * size, None)

    def common(masks: U64) -> U64:
        found: U64 = np.bitwise_and.reduce(masks[:, own].reshape(len(masks), count, size), axis=2)
        return np.ascontiguousarray(found)

    on, off = common(columns.group_masks & columns.values), common(columns.group_masks & ~columns.values)
    totals = columns.total_weights[own].reshape(count, size).max(axis=1) if count else np.ones(0)
    weights = columns.group_weights[:, :1] / totals[None, :]
    return GranuleBlocks(on, off, np.ascontiguousarray(weights, np.float32)), size


def granule_bounds(template: QuantisedTemplate, words: GranuleWords, edges: I64) -> F32:
    """Return a lower bound of the distance of all paths that end in each granule.

    Parameters
    ----------
    template : QuantisedTemplate
        A template of N columns.
    words : GranuleWords
        The granules of T takes.
    edges : int64 array (T + 1,)
        Take t has the granules edges[t] to edges[t + 1] − 1.

    Returns
    -------
    float32 array
        The bounds, one for each granule.
    """
    blocks, size = granule_blocks(template)
    bounds = np.zeros(len(words.on), np.float32)
    if blocks.weights.shape[1]:
        steps, ends = (7 + 4 * size - 2) // GRANULE, (7 + 2 * (size - 1)) // GRANULE
        longest = int(np.diff(edges).max(initial=0))
        _bound(blocks, words.on, words.off, edges, steps, ends, np.empty((2, longest + max(steps, ends)), np.float32),
               bounds)  # fmt: skip
        bounds *= np.float32((size - 1) / (len(template) * _ROUNDING))
    return bounds


@nb.njit(cache=True, nogil=True)
def _bound(blocks, on, off, edges, steps, ends, memory, bounds):  # type: ignore[no-untyped-def]
    """Fill in the smallest sums over blocks of the paths that end in each granule (kernel)."""
    must_on, must_off, weights = blocks
    pad = max(steps, ends)
    for take in range(len(edges) - 1):
        start, stop = edges[take], edges[take + 1]
        count = stop - start
        before, here = memory[0, : count + pad], memory[1, : count + pad]
        before[:] = np.float32(0)
        before[:pad] = np.float32(np.inf)
        own_on, own_off = on[start:stop], off[start:stop]
        for block in range(weights.shape[1]):
            here[:pad] = np.float32(np.inf)
            target = here[pad:]
            _least(before, pad, steps, target)
            for group in range(len(weights)):
                wanted, unwanted, weight = must_on[group, block], must_off[group, block], weights[group, block]
                for g in range(count):
                    wrong = count_bits(wanted & ~own_on[g]) + count_bits(unwanted & ~own_off[g])
                    target[g] += np.float32(wrong) * weight
            before, here = here, before
        _least(before, pad, ends, bounds[start:stop])


@nb.njit(cache=True, nogil=True)
def _least(values, pad, back, found):  # type: ignore[no-untyped-def]
    """Fill in the minima of each value and the `back` values before it (kernel)."""
    for g in range(len(found)):
        found[g] = values[g + pad]
    for step in range(1, back + 1):
        earlier = values[pad - step :]
        for g in range(len(found)):
            one, other = found[g], earlier[g]
            found[g] = one if one < other else other
