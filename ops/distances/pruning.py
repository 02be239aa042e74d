"""Exact pruning: the minima of a distance curve below a threshold, without the curve where it provably has none."""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
import numpy.typing as npt

from ops.bits import count_bits
from ops.distances.annotation import TOLERANCE
from ops.distances.costs import F64, I32, I64, CodedWords, Layout, encode, fill_bounds, lay_out
from ops.distances.dtw import best_paths, check_ranges
from ops.distances.sweep import CAP, U16, pieces_of, sweep_bounds
from ops.errors import ParameterError
from ops.templates.templates import QuantisedTemplate
from ops.words import U64

U32 = npt.NDArray[np.uint32]

_PIECE = 4096  # frames of a stretch that are computed apart from the rest of it
_BLOCK = 8  # frames that are ruled out together
_LANES = 256  # most parts of the words in which blocks are looked at side by side
_FEWEST_LANES = 32
_WORTH_A_LOOK = 0.45  # share of blocks left, above which ruling them out costs more than it saves
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

    units: uint16 (L,), `ops.distances.sweep.CAP` where no path below the threshold ends. unit: what one is worth, as a
    distance. slack: by how many units a minimum may seem to be above its neighbour. frames, computed: as in `Minima`.
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

    The result is that of `ops.distances.annotation.local_minima` on the curve of `ops.distances.dtw.distance_curves`
    in float64, with `start_frames`. Three bounds, each proven below, keep the work small.

    1. *Whole units.* With u = τN / 21845 every local cost c holds ⌊c/u⌋ whole units. A path costs the sum of its local
       costs, each counted once or twice, N counted ones in all; the sum of their whole units is no more than
       cost / u and more than cost / u − N. Sums that reach 21845 are at τN or above: no hit. So the curve of
       least whole units, in 16 bits, is a lower bound within N units of the true one (for paths below τ), and
       a frame can be a minimum only if it is not more than N units above a neighbour. Distances in float64 are
       computed for these frames and their neighbours alone, and decide.
    2. *Blocks.* A bit that all words of a block of 8 frames have on contradicts a column that wants it off in every
       one of them, and likewise the other way round. Let m_n be the whole units of the contradictions of column n
       that the block forces so: no frame of it costs less. Of all paths whose last frame
       lies in block B and whose last column is n, none has fewer units than
       F(B, n) = min(min(F(B, n−1), F(B−1, n−1)) + m_n, min(F(B, n−2), F(B−1, n−2)) + 2 m_n), F(B, 0) = m_0:
       a step goes back two frames at most, so the cell before lies in the same block or the one before it; by
       induction over columns it has F units at least, and the last one costs m_n at least, twice m_n for a
       (2,1) step. Where F(B, N − 1) reaches 21845, no path below τ ends in B. (Takes laid end to end only add paths.)
    3. *Windows.* A path that ends at frame l lies within the 2(N − 1) frames before it. Blocks that remain are
       therefore computed with so many frames before them, and in all else as if they were whole takes.

    Parameters
    ----------
    template, words, ranges: as in `ops.distances.dtw.distance_curves`.
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
        if prune and _worthwhile(layout, worth, coded):
            pieces = surviving(blocks_alive(layout, worth, coded.vocabulary, coded.codes), stretches, reach)
        sweep_bounds(table, coded.codes, pieces, columns - 1, units)
    computed = int((pieces[:, 2] - pieces[:, 0]).sum())
    slack = columns + 1 + int(TOLERANCE * columns / unit)
    return Bounds(units[0], unit / columns, slack, frames, computed)


def _worthwhile(layout: Layout, worth: F64, coded: CodedWords) -> bool:
    """Whether looking at blocks is likely to pay: it does where a sample of the frames can be skipped in good part."""
    few = _FEWEST_LANES * (2 * int(layout.lengths[0]) + 2 * _BLOCK)
    if len(coded) < 8 * few:
        return False
    middle = len(coded) // 2
    return (
        float(blocks_alive(layout, worth, coded.vocabulary, coded.codes[middle : middle + few]).mean()) < _WORTH_A_LOOK
    )


def blocks_alive(layout: Layout, worth: F64, vocabulary: U64, codes: I32) -> npt.NDArray[np.bool_]:
    """Tell of every block of frames whether a path below the threshold may end in it (bound 2 of `minima_below`).

    Parameters
    ----------
    layout: of one template. worth: float64 (S,), the units of one contradiction of a column. vocabulary, codes: words.
    """
    columns = int(layout.lengths[0])
    count = -(-len(codes) // _BLOCK)
    before = -(-2 * (columns - 1) // _BLOCK)  # a path reaches back over so many blocks besides its own
    lanes = _FEWEST_LANES
    while lanes < _LANES and count > 16 * lanes * before:
        lanes *= 2
    rows = -(-count // lanes)
    always, never = np.empty((before + rows, lanes), np.uint64), np.empty((before + rows, lanes), np.uint64)
    block_words(vocabulary, codes, before, always, never)
    masks, values = layout.masks[:columns], layout.values[:columns]
    whole = np.minimum(worth[:columns], CAP).astype(np.uint32)
    alive = np.empty((lanes, rows), np.bool_)
    block_bounds(masks & ~values, masks & values, whole, always, never, alive)
    return alive.ravel()[:count]


def surviving(alive: npt.NDArray[np.bool_], stretches: I64, reach: int) -> I64:
    """Return the pieces, see `ops.distances.sweep.pieces_of`, that cover the blocks that are alive.

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
def block_words(vocabulary: U64, codes: I32, before: int, always: U64, never: U64) -> None:
    """Fill the bits that all words of a block have on, and those that all have off; frames without a word have both.

    always, never: uint64 (before + R, lanes); lane l has the blocks from l·R, and so many blocks before them first.
    Beyond the words all bits are on and off at once, as dear as can be: paths from there are no better than others.
    (kernel)
    """
    rows = len(always) - before
    every = ~np.uint64(0)
    for lane in range(always.shape[1]):
        for row in range(len(always)):
            begin = (lane * rows + row - before) * _BLOCK
            on, off = every, every
            if begin >= 0 and begin + _BLOCK <= len(codes):
                for frame in range(_BLOCK):  # of known length, so that it is unrolled
                    word = vocabulary[codes[begin + frame]]
                    on &= word
                    off &= ~word if word != every else every
            elif begin >= 0:
                for frame in range(begin, len(codes)):
                    word = vocabulary[codes[frame]]
                    on &= word
                    off &= ~word if word != every else every
            always[row, lane], never[row, lane] = on, off


@nb.njit(cache=True, nogil=True)
def block_bounds(
    wants_off: U64, wants_on: U64, worth: U32, always: U64, never: U64, alive: npt.NDArray[np.bool_]
) -> None:
    """Carry the bound F over the blocks, all lanes side by side (kernel).

    wants_off, wants_on: uint64 (N,), bits of the columns. worth: uint32 (N,), units of a contradiction.
    """
    columns, (lanes, rows) = len(worth), alive.shape
    before = len(always) - rows
    cap = np.uint16(CAP)
    bits, units = np.empty(lanes, np.uint32), np.empty(lanes, np.uint16)
    last = np.full((columns, lanes), cap, np.uint16)  # F of the block before
    either = np.full((columns, lanes), cap, np.uint16)  # the lower F of this block and of the one before
    for row in range(before + rows):
        forced(wants_off[0], wants_on[0], worth[0], always[row], never[row], bits, units)
        lower(last[0], units, either[0])
        for n in range(1, columns):
            forced(wants_off[n], wants_on[n], worth[n], always[row], never[row], bits, units)
            step(either[max(n - 2, 0)], either[n - 1], units, last[n], either[n], n > 1)
        if row >= before:
            for lane in range(lanes):
                alive[lane, row - before] = last[columns - 1, lane] < cap


@nb.njit(cache=True, nogil=True)
def forced(
    wants_off: np.uint64, wants_on: np.uint64, worth: np.uint32, always: U64, never: U64, bits: U32, units: U16
) -> None:
    """Fill the units that a column costs at least in each lane's block (kernel)."""
    cap = np.uint32(CAP)
    for lane in range(len(bits)):
        bits[lane] = np.uint32(count_bits((always[lane] & wants_off) | (never[lane] & wants_on)))
    for lane in range(len(bits)):
        least = np.uint32(bits[lane] * worth)
        units[lane] = np.uint16(least if least < cap else cap)


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
