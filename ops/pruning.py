"""Exact pruning: the minima of a distance curve below a threshold, without the curve where it provably has none."""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
import numpy.typing as npt

from ops.annotation import TOLERANCE
from ops.costs import F64, I32, I64, CodedWords, encode, fill_bounds, lay_out
from ops.dtw import best_paths, check_ranges
from ops.errors import ParameterError
from ops.sweep import CAP, U16, pieces_of, sweep_bounds
from ops.templates import QuantisedTemplate
from ops.words import U64

_PIECE = 4096  # frames of a stretch that are computed apart from the rest of it
_BLOCK = 16  # frames that are ruled out together
_LANES = 32  # parts of the words in which blocks are looked at side by side
_WORTH_A_LOOK = 0.6  # share of blocks left, above which ruling them out costs more than it saves
_SHAVE = 1 - 1e-9  # units are counted a little low, so that rounding never makes a bound too high


@dataclass(frozen=True)
class Minima:
    """Local minima of one template's distance curve below a threshold, by frame.

    ends: int64 (M,), their frames. starts: int64 (M,), the first frame of the best path that ends there. costs: float64
    (M,), the distances. frames: how many frames the curve has. computed: in how many a bound of it was computed column
    by column, those that lead in to others included; the rest was skipped.
    """

    ends: I64
    starts: I64
    costs: F64
    frames: int
    computed: int

    @property
    def skipped(self) -> float:
        """The share of the frames that was skipped."""
        return max(0.0, 1 - self.computed / self.frames) if self.frames else 0.0


@dataclass(frozen=True)
class Bounds:
    """A distance curve below a threshold, bounded in whole units.

    units: uint16 (L,), `ops.sweep.CAP` where no path below the threshold ends. unit: what one is worth, as a distance.
    slack: by how many units a minimum may seem to be above its neighbour. frames, computed: as in `Minima`.
    """

    units: U16
    unit: float
    slack: int
    frames: int
    computed: int


def minima_below(
    template: QuantisedTemplate,
    words: U64,
    threshold: float,
    ranges: I64 | None = None,
    coded: CodedWords | None = None,
    prune: bool = True,
) -> Minima:
    """Find the local minima of a distance curve below a threshold, with the paths that lead to them.

    The result is that of `ops.annotation.local_minima` on the curve of `ops.dtw.distance_curves` in float64, with
    `start_frames`. Three bounds, each proven below, keep the work small.

    1. *Whole units.* With u = τN / 21845 every local cost c holds ⌊c/u⌋ whole units. A path costs the sum of its local
       costs, each counted once or twice, N counted ones in all; the sum of their whole units is no more than
       cost / u and more than cost / u − N. Sums that reach 21845 are at τN or above: no hit. So the curve of
       least whole units, in 16 bits, is a lower bound within N units of the true one (for paths below τ), and
       a frame can be a minimum only if it is not more than N units above a neighbour. Distances in float64 are
       computed for these frames and their neighbours alone, and decide.
    2. *Blocks.* Let m_n be the least units of column n over a block of 16 frames. Of all paths whose last frame
       lies in block B and whose last column is n, none has fewer units than
       F(B, n) = min(min(F(B, n−1), F(B−1, n−1)) + m_n, min(F(B, n−2), F(B−1, n−2)) + 2 m_n), F(B, 0) = m_0:
       a step goes back two frames at most, so the cell before lies in the same block or the one before it; by
       induction over columns it has F units at least, and the last one costs m_n at least, twice m_n for a
       (2,1) step. Where F(B, N − 1) reaches 21845, no path below τ ends in B. (Takes laid end to end only add paths.)
    3. *Windows.* A path that ends at frame l lies within the 2(N − 1) frames before it. Blocks that remain are
       therefore computed with so many frames before them, and in all else as if they were whole takes.

    Parameters
    ----------
    template, words, ranges: as in `ops.dtw.distance_curves`.
    threshold: τ > 0.
    coded: `encode(words)`, where several templates share it.
    prune: False leaves out the blocks, to compare.

    Raises
    ------
    ParameterError: a threshold that is not above 0, or wrong ranges.
    """
    stretches = check_ranges(ranges, len(words))
    bounds = bounds_below(template, encode(words) if coded is None else coded, threshold, stretches, prune)
    candidates, possible = possible_minima(bounds.units, stretches, bounds.slack)
    starts, costs = best_paths(template, words, candidates, stretches)
    kept = possible & _true_minima(candidates, costs, stretches, threshold)
    return Minima(candidates[kept], starts[kept], costs[kept], bounds.frames, bounds.computed)


def bounds_below(
    template: QuantisedTemplate, coded: CodedWords, threshold: float, stretches: I64, prune: bool = True
) -> Bounds:
    """Bound a distance curve from below, as far as it may be below a threshold (bounds 1 to 3 of `minima_below`).

    Raises
    ------
    ParameterError: a threshold that is not above 0.
    """
    if not threshold > 0:
        raise ParameterError("threshold", "above 0", threshold)
    layout = lay_out([template])
    columns = len(template)
    unit = threshold * columns / CAP
    units = np.full((1, len(coded)), CAP, np.uint16)
    frames = int((stretches[:, 1] - stretches[:, 0]).sum())
    pieces = np.empty((0, 3), np.int64)
    if frames:
        worth = _SHAVE / unit / np.maximum(np.bitwise_count(layout.masks), 1)
        table = np.empty((len(coded.vocabulary), len(layout.masks)), np.uint16)
        fill_bounds(coded.vocabulary, layout.masks, layout.values, worth, CAP, table)
        table[:, columns:] = CAP
        reach = 2 * (columns - 1)
        pieces = pieces_of(stretches, _PIECE, reach)
        if prune and _worthwhile(table, coded.codes, columns):
            pieces = surviving(blocks_alive(table, coded.codes, columns), stretches, reach)
        sweep_bounds(table, coded.codes, pieces, columns - 1, units)
    computed = int((pieces[:, 2] - pieces[:, 0]).sum())
    slack = columns + 1 + int(TOLERANCE * columns / unit)
    return Bounds(units[0], unit / columns, slack, frames, computed)


def _worthwhile(table: U16, codes: I32, columns: int) -> bool:
    """Whether looking at blocks is likely to pay: it does where a sample of the frames can be skipped in good part."""
    few = _LANES * (2 * columns + _BLOCK)
    if len(codes) < 8 * few:
        return False
    middle = len(codes) // 2
    return float(blocks_alive(table, codes[middle : middle + few], columns).mean()) < _WORTH_A_LOOK


def blocks_alive(table: U16, codes: I32, columns: int) -> npt.NDArray[np.bool_]:
    """Tell of every block of frames whether a path below the threshold may end in it (bound 2 of `minima_below`)."""
    count = -(-len(codes) // _BLOCK)
    rows = -(-count // _LANES)
    alive = np.empty((_LANES, rows), np.bool_)
    # A path reaches back over so many blocks besides its own.
    block_bounds(table, codes, columns, -(-2 * (columns - 1) // _BLOCK), alive)
    return alive.ravel()[:count]


def surviving(alive: npt.NDArray[np.bool_], stretches: I64, reach: int) -> I64:
    """Return the pieces, see `ops.sweep.pieces_of`, that cover the blocks that are alive.

    Blocks between which fewer frames lie than a piece has to reach back are in one piece.
    """
    edges = np.diff(np.concatenate(([0], alive.astype(np.int8), [0])))
    begins, ends = np.flatnonzero(edges == 1) * _BLOCK, np.flatnonzero(edges == -1) * _BLOCK
    if not len(begins):
        return np.empty((0, 3), np.int64)
    apart = np.flatnonzero(begins[1:] - ends[:-1] > reach)
    begins, ends = begins[np.concatenate(([0], apart + 1))], ends[np.concatenate((apart, [len(ends) - 1]))]
    # A stretch meets the pieces from the first that ends behind its beginning to the last that begins before its end.
    first = np.searchsorted(ends, stretches[:, 0], side="right")
    counts = np.maximum(np.searchsorted(begins, stretches[:, 1], side="left") - first, 0)
    home = np.repeat(np.arange(len(stretches)), counts)
    piece = np.arange(len(home)) - np.repeat(np.cumsum(counts) - counts, counts) + first[home]
    starts = np.maximum(begins[piece], stretches[home, 0])
    stops = np.minimum(ends[piece], stretches[home, 1])
    pieces = np.stack([np.maximum(starts - reach, stretches[home, 0]), starts, stops], axis=1)
    return pieces[np.argsort(pieces[:, 0] - pieces[:, 2], kind="stable")]  # long ones first: the lanes end together


def _true_minima(candidates: I64, costs: F64, stretches: I64, threshold: float) -> npt.NDArray[np.bool_]:
    """Which candidates are minima, with the distances of all frames that could deny it (float64)."""
    home = np.searchsorted(stretches[:, 0], candidates, side="right")
    low = costs < threshold - TOLERANCE
    joined = (np.diff(candidates) == 1) & (np.diff(home) == 0)
    low[1:] &= ~joined | (costs[1:] <= costs[:-1] + TOLERANCE)
    low[:-1] &= ~joined | (costs[:-1] <= costs[1:] + TOLERANCE)
    return low


@nb.njit(cache=True, nogil=True)
def block_least(table: U16, codes: I32, begin: int, least: U16) -> None:
    """Fill the least units of every column over the block that begins at this frame (kernel)."""
    least[:] = CAP
    final = len(codes) - 1
    for frame in range(begin, begin + _BLOCK, 4):
        a, b = table[codes[min(frame, final)]], table[codes[min(frame + 1, final)]]
        c, d = table[codes[min(frame + 2, final)]], table[codes[min(frame + 3, final)]]
        for n in range(len(least)):
            one = a[n] if a[n] < b[n] else b[n]
            two = c[n] if c[n] < d[n] else d[n]
            both = one if one < two else two
            least[n] = both if both < least[n] else least[n]


@nb.njit(cache=True, nogil=True)
def block_bounds(table: U16, codes: I32, columns: int, before: int, alive: npt.NDArray[np.bool_]) -> None:
    """Carry the bound F over the blocks, all lanes side by side (kernel).

    alive: bool (lanes, R); lane l has the blocks from l·R, and looks at so many blocks before them first.
    """
    lanes, rows = alive.shape
    cap = np.uint16(CAP)
    least = np.full((lanes, table.shape[1]), cap, np.uint16)
    units = np.full((columns, lanes), cap, np.uint16)
    last = np.full((columns, lanes), cap, np.uint16)  # F of the block before
    either = np.full((columns, lanes), cap, np.uint16)  # the lower F of this block and of the one before
    for row in range(-before, rows):
        for lane in range(lanes):
            begin = (lane * rows + row) * _BLOCK
            if 0 <= begin < len(codes):
                block_least(table, codes, begin, least[lane])
            else:
                least[lane, :] = cap
        for n in range(columns):
            for lane in range(lanes):
                units[n, lane] = least[lane, n]
        lower(last[0], units[0], either[0])
        for n in range(1, columns):
            step(either[max(n - 2, 0)], either[n - 1], units[n], last[n], either[n], n > 1)
        if row >= 0:
            for lane in range(lanes):
                alive[lane, row] = last[columns - 1, lane] < cap


@nb.njit(cache=True, nogil=True)
def lower(last: U16, units: U16, either: U16) -> None:
    """Begin a path in the first column (kernel)."""
    for lane in range(len(last)):
        either[lane] = last[lane] if last[lane] < units[lane] else units[lane]
        last[lane] = units[lane]


@nb.njit(cache=True, nogil=True)
def step(two: U16, one: U16, units: U16, last: U16, either: U16, doubled: bool) -> None:
    """Carry F on to the next column; from two columns before it, `doubled` says whether there are two (kernel)."""
    cap = np.uint16(CAP)
    extra = np.uint16(0) if doubled else cap
    for lane in range(len(last)):
        single = np.uint16(one[lane] + units[lane])
        far = two[lane] if two[lane] > extra else extra
        double = np.uint16(far + np.uint16(units[lane] + units[lane]))
        best = double if double < single else single
        best = best if best < cap else cap
        either[lane] = last[lane] if last[lane] < best else best
        last[lane] = best


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
