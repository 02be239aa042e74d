"""The inner loops of subsequence DTW: frame by frame over columns side by side, several stretches at a time."""

from __future__ import annotations

import numba as nb
import numpy as np
import numpy.typing as npt

from ops.distances.costs import F64, I32, I64, Table, column_costs
from ops.words import NO_WORD, U64

U16 = npt.NDArray[np.uint16]

_NO_WORD = np.uint64(NO_WORD)

LANES = 4
"""Stretches computed at a time. A frame waits for the one before it, which has just been written; while one stretch
waits, another one computes. (Always so many, so that the loop over them is unrolled.)"""

CHUNK = 512
"""Frames after which the lanes lay down what they have found."""

CAP = 21845
"""Sums of whole units stop here: with a (2,1) step of the dearest cost on top, a third of 65,535 still fits 16 bits."""

ROW_CELLS = 4_000_000
"""Costs of words against columns that are kept while paths are traced: 32 MB."""


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


@nb.njit(cache=True, nogil=True)
def workspace(frames: int, columns: int, words: int) -> tuple[F64, F64, I32, I64]:
    """Room for the sums of a window and for the costs of words: each word that occurs is one row (kernel).

    Returns the sums, the costs, the row of each word (−1: none), and how many rows are used.
    """
    grid = np.empty((frames + 2, columns + 2))
    grid[:2, :] = np.inf
    costs = np.empty((max(frames, min(words, ROW_CELLS // columns)), columns))
    return grid, costs, np.full(words, -1, np.int32), np.zeros(1, np.int64)


@nb.njit(cache=True, nogil=True)
def sum_group(
    vocabulary: U64, codes: I32, values: U64, parts: U64, worths: F64, counted: F64, ends: I64, begin: int,
    limit: float, grid: F64, costs: F64, row_of: I32, used: I64, sums: F64,
) -> None:  # fmt: skip
    """Add up the costs of the paths to ends that share the window that opens at frame `begin` (kernel).

    Cells from which no end of the group can be reached are left out: from frame f the columns N − 1 − 2(e − f)
    to N − 1 − (e − f)/2 lead to the end e, so that over a group those from the last end's least to the first end's
    most count. Every step back from a cell of these leads to another one, or out of the window. So are cells that are
    reached only by paths that cost more than the limit: costs only grow along a path, so that one within the limit
    has no such cell. What is left out is ∞; sums above the limit may be too high, or ∞.
    """
    columns = len(values)
    lowest, highest = ends[0] - begin, ends[len(ends) - 1] - begin
    if used[0] + highest + 1 > len(costs):
        row_of[:] = -1
        used[0] = 0
    low, high, lower, higher = (
        columns,
        -1,
        columns,
        -1,
    )  # cells within the limit of the frame before, and of that before
    for frame in range(highest + 1):
        whole = grid[frame + 2]
        whole[:] = np.inf
        least = max(0, columns - 1 - 2 * (highest - frame))
        most = columns - 1 - max(0, (lowest - frame + 1) // 2)
        first = 0 if least == 0 else max(least, min(low, lower) + 1)
        last = min(most, max(high + 2, higher + 1, 0))
        lower, higher = low, high
        code = codes[begin + frame]
        if last < first or vocabulary[code] == _NO_WORD:
            low, high = columns, -1
            continue
        if row_of[code] < 0:
            column_costs(vocabulary[code], values, parts, worths, counted, costs[used[0]])
            row_of[code] = used[0]
            used[0] += 1
        # All of these begin at the first column, so that the loop over columns need not ask where they are.
        behind, here = grid[frame + 1, first:], whole[first + 2 : last + 3]
        near, far = behind[1:], grid[frame, first + 1 :]
        own = costs[row_of[code], first:]
        for n in range(len(here)):
            one, two = near[n], far[n]
            single = (one if one < two else two) + own[n]
            double = behind[n] + (own[n] + own[n])
            here[n] = double if double < single else single
        if first == 0:
            here[0] = own[0]
        while first <= last and not whole[first + 2] <= limit:
            first += 1
        while last >= first and not whole[last + 2] <= limit:
            last -= 1
        low, high = (first, last) if first <= last else (columns, -1)
    for place in range(len(ends)):
        sums[place] = grid[ends[place] - begin + 2, columns + 1]


@nb.njit(cache=True, nogil=True)
def walk_back(grid: F64, costs: F64, row_of: I32, codes: I32, frame: int) -> int:
    """Return the frame where the best path begins that ends in the last column at a frame of the window (kernel).

    Among equally cheap paths the one is taken that, read from its end, prefers (1,1), then (1,2), then (2,1).

    codes: int32, the words from the window's first frame on.
    """
    n = costs.shape[1] - 1
    while n > 0:
        dear = costs[row_of[codes[frame]], n]
        best = grid[frame + 1, n + 1] + dear
        skipped = grid[frame, n + 1] + dear
        doubled = grid[frame + 1, n] + (dear + dear)
        if doubled < best and doubled < skipped:
            frame, n = frame - 1, n - 2
        elif skipped < best:
            frame, n = frame - 2, n - 1
        else:
            frame, n = frame - 1, n - 1
    return frame
