"""The inner loops of subsequence DTW: frame by frame over columns side by side, several pieces at a time."""

from __future__ import annotations

import numba as nb
import numpy as np
import numpy.typing as npt

from kinedex.ops.copies import copy_table
from kinedex.ops.distances.costs import I32, I64, Table
from kinedex.ops.distances.recurrence import path_cost

U16 = npt.NDArray[np.uint16]

LANES = 4
"""The number of pieces that are computed at a time. A frame waits for the one before it, which has just been written;
while one piece waits, another one computes. (The number is constant, so that the loop over lanes is unrolled.)"""

CHUNK = 512
"""The number of frames after which the lanes write their results."""

CAP = 21845
"""Sums of whole units stop here; with a (2,1) step of the greatest cost on top, the sum still fits 16 bits."""


def pieces_of(ranges: I64, longest: int, lead_in: int) -> I64:
    """Cut ranges into pieces that can be computed independently of each other.

    A path of N columns begins 2(N − 1) frames before its end at most. A piece whose computation begins so many frames
    earlier, or where its range begins, therefore has the results of the whole range.

    Parameters
    ----------
    ranges : int64 array (R, 2)
        Half-open ranges of frames, none of them empty.
    longest : int
        The most frames of a piece, without those that lead in to it.
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
    """Give the next piece to lanes that have finished theirs (kernel).

    Parameters
    ----------
    pieces : int64 array (P, 3)
        See `pieces_of`.
    following : int
        The next piece.
    lanes : int64 array (LANES, 3)
        Of each lane the frame to compute next, the first frame whose result is wanted, and the frame where it stops; -1
        there for a lane without a piece, which repeats the work of another one.
    state : array (3, LANES, columns + 2)
        The sums of each lane, which become `initial` at the beginning of a piece.
    initial : float

    Returns
    -------
    (int, int)
        The piece that is next then, and the number of frames that all lanes can go on.
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
    """Write the results of the lanes into the sums, from a first frame on, and move the lanes on (kernel)."""
    for k in range(len(lanes)):
        at = lanes[k, 0]
        start = max(at, lanes[k, 1])
        if lanes[k, 2] >= 0 and start < at + steps:
            copy_table(sums[:, first + start : first + at + steps], found[:, k, start - at : steps])
        lanes[k, 0] = at + steps


@nb.njit(cache=True, nogil=True)
def sweep(table: Table, codes: I32, pieces: I64, firsts: I64, lasts: I64, sums: Table, first: int) -> None:
    """Fill the costs of the best paths of all templates of a layout, in the precision of the table (kernel).

    All three steps advance the take and none stays in its row, so a frame depends on the two frames before it only, and
    nothing within a frame depends on anything: the loop over columns vectorises. A column of ∞ before a template's
    first keeps the (2,1) step out; the first column is the local cost alone.

    Parameters
    ----------
    table : array (W, S)
        See `ops.distances.costs.cost_table`.
    codes : int32 array (L,)
    pieces : int64 array (P, 3)
    firsts, lasts : int64 array (T,)
        The first and the last column of each template.
    sums : array (T, M)
        The results; frames outside the pieces are left as they are.
    first : int
        The place of the first code's result among them.
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
    """Fill one template's lower bounds in whole units, `CAP` for all that is no less (kernel).

    It is `sweep` with sums that stop at `CAP`: a cell at `CAP` is reached by no path of fewer units.

    Parameters
    ----------
    table : uint16 array (W, S)
        See `ops.distances.costs.bound_table`.
    codes : int32 array (L,)
    pieces : int64 array (P, 3)
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
