"""Exact pruning: where a distance curve can have minima below a threshold, without the curve where it has none.

Three bounds, each proven below, keep the work small: whole units and windows (`bounds_below`), and coarse units before
them (`coarse_bounds`). What they leave is computed in float64 by `ops.ranking.ranking`, and over short ranges by
`ops.distances.range_minima`; that decides, so that hits are those of the whole curve of
`ops.distances.dtw.distance_curves`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba as nb
import numpy as np
import numpy.typing as npt

from kinedex.ops.annotation.segments import TOLERANCE
from kinedex.ops.distances.costs import F64, I32, I64, CodedWords, bound_table, lay_out
from kinedex.ops.distances.stripes import BLOCK, COARSE_CAP, SLOTS, U8, least_sums
from kinedex.ops.distances.sweep import CAP, U16, pieces_of, sweep_bounds
from kinedex.ops.errors import ParameterError
from kinedex.ops.templates.templates import QuantisedTemplate

_PIECE = 4096  # frames of a stretch that are computed apart from the rest of it
_TABLE_CELLS = 16_000_000  # most bytes of a table of coarse costs; where words are many, fewer templates share a pass
_WORTHWHILE = 128  # columns from which coarse sums cost less than they save: rows of few are as slow as in 16 bits
_TOGETHER = SLOTS // 2  # most templates in a pass: with more, few rows would have to be filled up a lot


@dataclass(frozen=True)
class Coarse:
    """A distance curve, bounded in coarse units: no path that ends in a block of frames costs less.

    sums: uint8 (B,), of blocks of `ops.distances.stripes.BLOCK` frames, the last one may have fewer; `COARSE_CAP` where
    no path below the threshold ends that it was made for. unit: what one is worth, as a distance.
    """

    sums: U8
    unit: float

    def below(self, threshold: float) -> npt.NDArray[np.bool_]:
        """The blocks in which a path below a threshold may end, bool (B,)."""
        least = min(float(COARSE_CAP), np.ceil(threshold / self.unit * (1 + 1e-9)))
        below: npt.NDArray[np.bool_] = self.sums < np.uint8(least)
        return below


@dataclass(frozen=True)
class Bounds:
    """A distance curve below a threshold, bounded in whole units.

    units: uint16 (L,), `ops.distances.sweep.CAP` where no path below the threshold ends. unit: what one is worth, as a
    distance. slack: by how many units a minimum may seem to be above its neighbour. spans: int64 (S, 2), ascending
    stretches outside of which all is `CAP`. frames: how many the curve has; computed: in how
    many the units were computed column by column, those that lead in to others included; the rest was skipped.
    """

    units: U16
    unit: float
    slack: int
    spans: I64
    frames: int
    computed: int


def coarse_bound(template: QuantisedTemplate, coded: CodedWords, threshold: float, stretches: I64) -> Coarse | None:
    """The coarse bound of one template on its own, where it pays to have one; see `coarse_bounds`."""
    if len(template) < _WORTHWHILE:
        return None
    return coarse_bounds([template], coded, np.array([threshold]), stretches)[0]


def coarse_bounds(
    templates: Sequence[QuantisedTemplate], coded: CodedWords, thresholds: F64, stretches: I64
) -> list[Coarse]:
    """Bound the distance curves of templates from below, all in one pass over the words.

    *Coarse units.* With u = τN / 255 every local cost c holds ⌊c/u⌋ whole units. A path costs the sum of its local
    costs, each counted once or twice, N counted ones in all, and the sum of their whole units is no more than cost / u.
    Sums are kept in 8 bits that stop at 255; one that has stopped stands for one that is no less. So where the least
    sum is q units, no path costs less than q u, and where it is 255, none is below τ: a path below any τ' ≤ τ ends only
    at frames of fewer than τ'N / u units.

    Parameters
    ----------
    templates: T templates. coded: the words. thresholds: float64 (T,), τ > 0 of each.
    stretches: int64 (R, 2), see `ops.ranges.checked_ranges`.

    Raises
    ------
    ParameterError: a threshold that is not above 0.
    """
    thresholds = np.asarray(thresholds, np.float64)
    if len(thresholds) != len(templates) or not np.all(thresholds > 0):
        raise ParameterError("thresholds", f"above 0, one for each of {len(templates)} templates", thresholds.tolist())
    sums = np.full((len(templates), -(-len(coded) // BLOCK)), COARSE_CAP, np.uint8)
    room = _TABLE_CELLS // max(1, len(coded.vocabulary))
    first, columns = 0, 0
    for place in range(len(templates) + 1):
        full = place < len(templates) and (columns + len(templates[place]) >= room or place - first == _TOGETHER)
        if place > first and (place == len(templates) or full):
            if len(stretches):
                layout = lay_out(templates[first:place])
                pieces = pieces_of(stretches, _PIECE, 2 * (int(layout.lengths.max()) - 1))
                units = thresholds[first:place] * layout.lengths / COARSE_CAP
                sums[first:place] = least_sums(layout, coded, units, pieces)
            first, columns = place, 0
        if place < len(templates):
            columns += len(templates[place]) + 1
    return [Coarse(own, float(tau) / COARSE_CAP) for own, tau in zip(sums, thresholds, strict=True)]


def bounds_below(
    template: QuantisedTemplate, coded: CodedWords, threshold: float, stretches: I64, coarse: Coarse | None = None
) -> Bounds:
    """Bound a distance curve from below, as far as it may be below a threshold.

    *Whole units.* With u = τN / 21845 every local cost c holds ⌊c/u⌋ whole units. A path costs the sum of its local
    costs, each counted once or twice, N counted ones in all; the sum of their whole units is no more than cost / u
    and more than cost / u − N. Sums that reach 21845 are at τN or above: no hit. So the curve of least whole units, in
    16 bits, is a lower bound within N units of the true one (for paths below τ), and a frame can be a minimum only
    if it is not more than N units above a neighbour.

    *Windows.* A path that ends at frame l lies within the 2(N − 1) frames before it. What the coarse bound leaves is
    therefore computed with so many frames before it, and in all else as if these were whole takes.

    Parameters
    ----------
    coarse: where to look, made for these words and ranges and for this τ or a greater one; None: everywhere.

    Raises
    ------
    ParameterError: a threshold that is not above 0.
    """
    if not threshold > 0:
        raise ParameterError("threshold", "above 0", threshold)
    layout = lay_out([template])
    columns = len(template)
    cost = threshold * columns / CAP
    units = np.full((1, len(coded)), CAP, np.uint16)
    frames = int((stretches[:, 1] - stretches[:, 0]).sum())
    reach = 2 * (columns - 1)
    spans = stretches
    if coarse is not None:
        pieces = surviving(coarse.below(threshold), stretches, reach)
        spans = pieces[:, 1:]
        # Long ones first: the lanes end together.
        pieces = pieces[np.argsort(pieces[:, 0] - pieces[:, 2], kind="stable")]
    elif frames:
        pieces = pieces_of(stretches, _PIECE, reach)
    else:
        pieces = np.empty((0, 3), np.int64)
    if len(pieces):
        needed = np.zeros(len(coded.vocabulary), np.bool_)
        mark_words(coded.codes, pieces, needed)
        table = bound_table(layout, coded.vocabulary, np.array([cost]), CAP, np.uint16, needed)
        sweep_bounds(table, coded.codes, pieces, columns - 1, units)
    computed = int((pieces[:, 2] - pieces[:, 0]).sum())
    slack = columns + 1 + int(TOLERANCE * columns / cost)
    return Bounds(units[0], cost / columns, slack, spans, frames, computed)


def surviving(below: npt.NDArray[np.bool_], stretches: I64, reach: int) -> I64:
    """Return the pieces, see `ops.distances.sweep.pieces_of`, that cover the blocks that may be below a threshold.

    Blocks between which fewer frames lie than a piece has to reach back are in one piece. Pieces are in ascending
    order.
    """
    places = np.flatnonzero(below)
    if not len(places):
        return np.empty((0, 3), np.int64)
    apart = np.flatnonzero((np.diff(places) - 1) * BLOCK > reach)
    begins = places[np.concatenate(([0], apart + 1))] * BLOCK
    ends = (places[np.concatenate((apart, [len(places) - 1]))] + 1) * BLOCK
    # A piece meets the stretches from the first that ends behind its beginning to the last that begins before its end.
    first = np.searchsorted(stretches[:, 1], begins, side="right")
    counts = np.maximum(np.searchsorted(stretches[:, 0], ends, side="left") - first, 0)
    piece = np.repeat(np.arange(len(begins)), counts)
    home = np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts) + first[piece]
    starts = np.maximum(begins[piece], stretches[home, 0])
    stops = np.minimum(ends[piece], stretches[home, 1])
    return np.stack([np.maximum(starts - reach, stretches[home, 0]), starts, stops], axis=1)


@nb.njit(cache=True, nogil=True)
def mark_words(codes: I32, pieces: I64, needed: npt.NDArray[np.bool_]) -> None:
    """Mark the words that occur in pieces (kernel)."""
    for p in range(len(pieces)):
        for frame in range(pieces[p, 0], pieces[p, 2]):
            needed[codes[frame]] = True


@nb.njit(cache=True, nogil=True)
def possible_minima(bounds: U16, stretches: I64, slack: int) -> tuple[I64, npt.NDArray[np.bool_]]:
    """Return the frames below the threshold that can be minima or stand beside such, and which of them can (kernel)."""
    found = np.empty(len(bounds), np.int64)
    possible = np.empty(len(bounds), np.bool_)
    count = 0
    for s in range(len(stretches)):
        start, stop = stretches[s]
        taken = start  # frames before this one have been kept or passed over for good
        for frame in range(start, stop):
            if bounds[frame] == CAP:
                continue
            units = np.int64(bounds[frame])
            left = frame > start and bounds[frame - 1] != CAP
            right = frame + 1 < stop and bounds[frame + 1] != CAP
            if left and units > np.int64(bounds[frame - 1]) + slack:
                continue
            if right and units > np.int64(bounds[frame + 1]) + slack:
                continue
            for beside in range(max(frame - 1, start), frame + 2):
                if beside < taken:
                    possible[count - 1 - (taken - 1 - beside)] |= beside == frame
                elif (beside < frame and left) or beside == frame or (beside > frame and right):
                    found[count] = beside
                    possible[count] = beside == frame
                    count += 1
                    taken = beside + 1
    return found[:count].copy(), possible[:count].copy()
