"""The inner loops of subsequence DTW: frame by frame over columns side by side, several stretches at a time."""

from __future__ import annotations

import numba as nb
import numpy as np
import numpy.typing as npt

from kinedex.ops.distances.costs import I32, I64, Table

U16 = npt.NDArray[np.uint16]

LANES = 4
"""Stretches computed at a time. A frame waits for the one before it, which has just been written; while one stretch
waits, another one computes. (Always so many, so that the loop over them is unrolled.)"""

CHUNK = 512
"""Frames after which the lanes lay down what they have found."""

CAP = 21845
"""Sums of whole units stop here: with a (2,1) step of the dearest cost on top, a third of 65,535 still fits 16 bits."""


def pieces_of(stretches: I64, longest: int, reach: int) -> I64:
    """Cut stretches into pieces that can be computed one without the other.

    A path of N columns begins 2(N − 1) frames before its end at most. A piece therefore computes so many frames
    before those that it is there for, or from where the stretch begins, and the rest of it is as if it were whole.

    Parameters
    ----------
    stretches: int64 (R, 2), half-open, none empty.
    longest: most frames that a piece is there for. reach: 2(N − 1) of the longest template.

    Returns
    -------
    int64 (P, 3): the frame where computing begins, and the frames [start, stop) that the piece is there for.
    """
    counts = -(-(stretches[:, 1] - stretches[:, 0]) // longest)
    home = np.repeat(np.arange(len(stretches)), counts)
    place = np.arange(len(home)) - np.repeat(np.cumsum(counts) - counts, counts)
    begins = stretches[home, 0] + place * longest
    stops = np.minimum(begins + longest, stretches[home, 1])
    return np.stack([np.maximum(begins - reach, stretches[home, 0]), begins, stops], axis=1)


@nb.njit(cache=True, nogil=True)
def refill(pieces: I64, following: int, lanes: I64, state: Table, nothing: float) -> tuple[int, int]:
    """Give lanes that are done the next piece; return which one comes then, and how far all can go on (kernel).

    lanes: int64 (LANES, 3): the frame to compute next, the frame to keep results from, and where to stop; −1 there for
    a lane without a piece, which computes what another one does, for nobody. state: (3, LANES, columns).
    """
    steps = 0
    for k in range(len(lanes)):
        if lanes[k, 0] == lanes[k, 2] and following < len(pieces):
            lanes[k] = pieces[following]
            state[:, k, :] = nothing
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
def keep(lanes: I64, steps: int, found: Table, sums: Table) -> None:
    """Put what the lanes have found where it belongs, and move them on (kernel)."""
    for k in range(len(lanes)):
        at = lanes[k, 0]
        begin = max(at, lanes[k, 1])
        if lanes[k, 2] >= 0 and begin < at + steps:
            sums[:, begin : at + steps] = found[:, k, begin - at : steps]
        lanes[k, 0] = at + steps


@nb.njit(cache=True, nogil=True)
def sweep(table: Table, codes: I32, pieces: I64, firsts: I64, lasts: I64, sums: Table) -> None:
    """Fill the costs of the best paths of all templates of a layout, in the table's own precision (kernel).

    All three steps advance the take and none stays in its row, so a frame depends on the two frames before it only, and
    nothing within a frame depends on anything: the loop over columns vectorises. A column of ∞ before a template's
    first keeps the (2,1) step out; the first column is the local cost alone.
    """
    columns = table.shape[1]
    state = np.full((3, LANES, columns + 2), np.inf, table.dtype)
    found = np.empty((len(firsts), LANES, CHUNK), table.dtype)
    lanes = np.zeros((LANES, 3), np.int64)
    previous, last, here = 0, 1, 2
    following, steps = refill(pieces, 0, lanes, state, np.inf)
    while steps > 0:
        before, behind, now = state[previous], state[last], state[here]
        for step in range(steps):
            for k in range(LANES):
                cost = table[codes[lanes[k, 0] + step]]
                a, b, c = before[k], behind[k], now[k]
                for n in range(columns):
                    one, two = b[n + 1], a[n + 1]
                    single = (one if one < two else two) + cost[n]
                    double = b[n] + (cost[n] + cost[n])
                    c[n + 2] = double if double < single else single
                for t in range(len(firsts)):
                    c[firsts[t] + 2] = cost[firsts[t]]
                for t in range(len(firsts)):
                    found[t, k, step] = c[lasts[t] + 2]
            before, behind, now = behind, now, before
        turn = steps % 3
        previous, last, here = (previous + turn) % 3, (last + turn) % 3, (here + turn) % 3
        keep(lanes, steps, found, sums)
        following, steps = refill(pieces, following, lanes, state, np.inf)


@nb.njit(cache=True, nogil=True)
def sweep_bounds(table: U16, codes: I32, pieces: I64, final: int, sums: U16) -> None:
    """Fill one template's lower bounds in whole units, `CAP` for all that is no less: uint16 (1, L) (kernel).

    The same as `sweep` with sums that stop at `CAP`: a cell at `CAP` is reached by no path of fewer units.
    """
    columns = table.shape[1]
    cap = np.uint16(CAP)
    state = np.full((3, LANES, columns + 2), cap, np.uint16)
    found = np.empty((1, LANES, CHUNK), np.uint16)
    lanes = np.zeros((LANES, 3), np.int64)
    previous, last, here = 0, 1, 2
    following, steps = refill(pieces, 0, lanes, state, CAP)
    while steps > 0:
        before, behind, now = state[previous], state[last], state[here]
        for step in range(steps):
            for k in range(LANES):
                cost = table[codes[lanes[k, 0] + step]]
                a, b, c = before[k], behind[k], now[k]
                for n in range(columns):
                    one, two = b[n + 1], a[n + 1]
                    single = np.uint16((one if one < two else two) + cost[n])
                    double = np.uint16(b[n] + np.uint16(cost[n] + cost[n]))
                    least = double if double < single else single
                    c[n + 2] = least if least < cap else cap
                c[2] = cost[0]
                found[0, k, step] = c[final + 2]
            before, behind, now = behind, now, before
        turn = steps % 3
        previous, last, here = (previous + turn) % 3, (last + turn) % 3, (here + turn) % 3
        keep(lanes, steps, found, sums)
        following, steps = refill(pieces, following, lanes, state, CAP)
