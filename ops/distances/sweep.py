"""This module has the inner loops of subsequence DTW: frame by frame over adjacent columns, for several pieces."""

from __future__ import annotations

import numba as nb
import numpy as np

from kinedex.ops.arrays import I32, I64, U16
from kinedex.ops.copies import copy_table
from kinedex.ops.distances.costs import Table
from kinedex.ops.distances.recurrence import path_cost

LANES = 4
"""The number of pieces that are computed together. A frame depends on the frame before it, whose stores have not
completed; while one piece waits for them, another one is computed. (The number is a constant, so that the loop over
lanes is unrolled.)
"""

CHUNK = 512
"""The number of frames after which the lanes write their results."""

CAP = 21845
"""The number at which sums of whole units saturate; a (2,1) step of the greatest cost on top still fits 16 bits.
"""


def pieces_of(ranges: I64, longest: int, lead_in: int) -> I64:
    """Divide ranges into pieces that can be computed independently of each other.

    A path of N columns begins 2(N − 1) frames before its end at most. So a piece has the results of the whole range if
    its computation begins that many frames earlier, or at the start of its range.

    Parameters
    ----------
    ranges : int64 array (R, 2)
        Half-open ranges of frames, none of them empty.
    longest : int
        The most frames of a piece, without the lead-in.
    lead_in : int
        2(N − 1) for the longest template.

    Returns
    -------
    int64 array (P, 3)
        The frame where the computation begins, and the half-open range of the frames whose results are wanted.
    """
    counts = -(-(ranges[:, 1] - ranges[:, 0]) // longest)
    source = np.repeat(np.arange(len(ranges)), counts)
    place = np.arange(len(source)) - np.repeat(np.cumsum(counts) - counts, counts)
    starts = ranges[source, 0] + place * longest
    stops = np.minimum(starts + longest, ranges[source, 1])
    return np.stack([np.maximum(starts - lead_in, ranges[source, 0]), starts, stops], axis=1)


@nb.njit(cache=True, nogil=True)
def refill(pieces: I64, following: int, lanes: I64, state: Table, initial: float) -> tuple[int, int]:
    """Assign the next pieces to lanes that have finished theirs (kernel).

    Parameters
    ----------
    pieces : int64 array (P, 3)
        See `pieces_of`.
    following : int
        The next piece.
    lanes : int64 array (LANES, 3)
        For each lane the next frame to compute, the first frame whose result is wanted, and the stop frame, which is -1
        for a lane without a piece; such a lane repeats the work of another.
    state : array (3, LANES, columns + 2)
        The sums of each lane, which become `initial` at the beginning of a piece.
    initial : float
        The value of sums before the first frame of a piece.

    Returns
    -------
    (int, int)
        The next unassigned piece, and the number of frames that all lanes can still compute.
    """
    steps = 0
    for k in range(len(lanes)):
        if lanes[k, 0] == lanes[k, 2] and following < len(pieces):
            for field in range(3):
                lanes[k, field] = pieces[following, field]
            state[:, k, :] = initial
            following += 1
        elif lanes[k, 0] == lanes[k, 2]:
            lanes[k, 2] = -1
        left = lanes[k, 2] - lanes[k, 0]
        if lanes[k, 2] >= 0 and (steps == 0 or left < steps):
            steps = left
    for k in range(len(lanes)):
        if lanes[k, 2] < 0:
            for other in range(len(lanes)):
                if lanes[other, 2] >= 0:
                    lanes[k, 0] = lanes[other, 0]
    return following, min(steps, CHUNK)


@nb.njit(cache=True, nogil=True)
def write_results(lanes: I64, steps: int, found: Table, sums: Table, first: int) -> None:
    """Write the results of the lanes into `sums`, from the frame `first` on, and advance the lanes (kernel)."""
    for k in range(len(lanes)):
        at = lanes[k, 0]
        start = max(at, lanes[k, 1])
        if lanes[k, 2] >= 0 and start < at + steps:
            copy_table(sums[:, first + start : first + at + steps], found[:, k, start - at : steps])
        lanes[k, 0] = at + steps


@nb.njit(cache=True, nogil=True)
def sweep(table: Table, codes: I32, pieces: I64, firsts: I64, lasts: I64, sums: Table, first: int) -> None:
    """Fill in the costs of the best paths of all templates of a layout, in the precision of the table (kernel).

    All three steps advance in the take, so a frame depends on the two frames before it only, and the columns of a frame
    are independent of each other: the loop over columns vectorises. A column of ∞ before a template's first keeps the
    (2,1) step out; the first column is the local cost alone.

    Parameters
    ----------
    table : array (W, S)
        See `ops.distances.costs.cost_table`.
    codes : int32 array (L,)
        The index in the vocabulary of the word of each frame, see `CodedWords`.
    pieces : int64 array (P, 3)
        The pieces of frames to compute, see `pieces_of`.
    firsts, lasts : int64 array (T,)
        The first and the last column of each template.
    sums : array (T, M)
        The results; frames outside the pieces are left as they are.
    first : int
        The index in `sums` of the first code's result.
    """
    columns = table.shape[1]
    state = np.full((3, LANES, columns + 2), np.inf, table.dtype)
    found = np.empty((len(firsts), LANES, CHUNK), table.dtype)
    lanes = np.zeros((LANES, 3), np.int64)
    previous, last, here = 0, 1, 2
    following, steps = refill(pieces, np.int64(0), lanes, state, np.inf)
    while steps > 0:
        before, behind, now = state[previous], state[last], state[here]
        for step in range(steps):
            for k in range(LANES):
                cost = table[codes[lanes[k, 0] + step]]
                a, b, c = before[k], behind[k], now[k]
                for n in range(columns):
                    c[n + 2] = path_cost(b[n + 1], a[n + 1], b[n], cost[n])
                for t in range(len(firsts)):
                    c[firsts[t] + 2] = cost[firsts[t]]
                for t in range(len(firsts)):
                    found[t, k, step] = c[lasts[t] + 2]
            before, behind, now = behind, now, before
        turn = steps % 3
        previous, last, here = (previous + turn) % 3, (last + turn) % 3, (here + turn) % 3
        write_results(lanes, steps, found, sums, first)
        following, steps = refill(pieces, following, lanes, state, np.inf)


@nb.njit(cache=True, nogil=True)
def sweep_bounds(table: U16, codes: I32, pieces: I64, final: int, sums: U16) -> None:
    """Fill in one template's lower bounds in whole units, saturated at `CAP` (kernel).

    It is `sweep` with saturating sums: no path of fewer units than `CAP` reaches a cell with the value `CAP`.

    Parameters
    ----------
    table : uint16 array (W, S)
        See `ops.distances.costs.bound_table`.
    codes : int32 array (L,)
        The index in the vocabulary of the word of each frame, see `CodedWords`.
    pieces : int64 array (P, 3)
        The pieces of frames to compute, see `pieces_of`.
    final : int
        The template's last column.
    sums : uint16 array (1, L)
        The results.
    """
    columns = table.shape[1]
    cap = np.uint16(CAP)
    state = np.full((3, LANES, columns + 2), cap, np.uint16)
    found = np.empty((1, LANES, CHUNK), np.uint16)
    lanes = np.zeros((LANES, 3), np.int64)
    previous, last, here = 0, 1, 2
    following, steps = refill(pieces, np.int64(0), lanes, state, CAP)
    while steps > 0:
        before, behind, now = state[previous], state[last], state[here]
        for step in range(steps):
            for k in range(LANES):
                cost = table[codes[lanes[k, 0] + step]]
                a, b, c = before[k], behind[k], now[k]
                for n in range(columns):
                    least = path_cost(b[n + 1], a[n + 1], b[n], cost[n])
                    c[n + 2] = least if least < cap else cap
                c[2] = cost[0]
                found[0, k, step] = c[final + 2]
            before, behind, now = behind, now, before
        turn = steps % 3
        previous, last, here = (previous + turn) % 3, (last + turn) % 3, (here + turn) % 3
        write_results(lanes, steps, found, sums, np.int64(0))
        following, steps = refill(pieces, following, lanes, state, CAP)
