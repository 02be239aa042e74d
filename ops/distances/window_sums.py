"""Sums of a window of frames that some ends share, in float64, and the paths that lead to these ends."""

from __future__ import annotations

import numba as nb
import numpy as np

from kinedex.ops.distances.costs import F64, I32, I64, column_costs
from kinedex.ops.words import NO_WORD, U64

_NO_WORD = np.uint64(NO_WORD)

ROW_CELLS = 4_000_000
"""Costs of words against columns that are kept while paths are traced: 32 MB."""


@nb.njit(cache=True, nogil=True)
def workspace(frames: int, columns: int, words: int) -> tuple[F64, F64, I32, I64, I64]:
    """Room for the sums of a window and for the costs of words: each word that occurs is one row (kernel).

    Returns the sums, the costs, the row of each word (−1: none), how many rows are used, and the trail of `walk_back`.
    """
    grid = np.empty((frames + 2, columns + 2))
    grid[:2, :] = np.inf
    costs = np.empty((max(frames, min(words, ROW_CELLS // columns)), columns))
    return grid, costs, np.full(words, -1, np.int32), np.zeros(1, np.int64), np.full((frames, 2), -1, np.int64)


@nb.njit(cache=True, nogil=True)
def sum_window(
    vocabulary: U64, codes: I32, values: U64, parts: U64, worths: F64, counted: F64, begin: int, end: int, sums: F64,
    limit: float, grid: F64, costs: F64, row_of: I32, used: I64,
) -> None:  # fmt: skip
    """Add up the costs of the paths that end in the frames from `end` on, as many as there are sums (kernel).

    They share the window that opens at frame `begin`, where a stretch does or 2(N − 1) frames before the first end.

    Cells from which no end of the group can be reached are left out: from frame f the columns N − 1 − 2(e − f)
    to N − 1 − (e − f)/2 lead to the end e, so that over a group those from the last end's least to the first end's
    most count. Every step back from a cell of these leads to another one, or out of the window. So are cells that are
    reached only by paths that cost more than the limit: costs only grow along a path, so that one within the limit
    has no such cell. Sums above the limit may be too high, or ∞.
    """
    columns = len(values)
    lowest, highest = end - begin, end - begin + len(sums) - 1
    if used[0] + highest + 1 > len(costs):
        row_of[:] = -1
        used[0] = 0
    # Cells within the limit of the frame before, and of that before.
    low, high, lower, higher = columns, -1, columns, -1
    for frame in range(highest + 1):
        whole = grid[frame + 2]
        least = max(0, columns - 1 - 2 * (highest - frame))
        most = columns - 1 - max(0, (lowest - frame + 1) // 2)
        first = 0 if least == 0 else max(least, min(low, lower) + 1)
        last = min(most, max(high + 2, higher + 1, 0))
        lower, higher = low, high
        code = codes[begin + frame]
        if last < first or vocabulary[code] == _NO_WORD:
            whole[:] = np.inf
            low, high = columns, -1
            continue
        if row_of[code] < 0:
            column_costs(vocabulary[code], values, parts, worths, counted, costs[used[0]])
            row_of[code] = used[0]
            used[0] += 1
        add_row(grid, frame, first, last, costs[row_of[code]])
        low, high = within_limit(whole, first, last, limit)
    for place in range(len(sums)):
        sums[place] = grid[lowest + place + 2, columns + 1]


@nb.njit(cache=True, nogil=True)
def add_row(grid: F64, frame: int, first: int, last: int, own: F64) -> None:
    """Add up the costs of the paths to the columns from first to last in a frame of a window (kernel).

    What is left out is ∞ as far as the two rows after this one ask for it. These begin a column behind the first cell
    within the limit of the two rows before, or with the first one that leads to an end, which is two columns further in
    each row; they end two columns behind the last cell within the limit of the row before, or one behind that of the
    row before it. So they ask for three columns before the first cell of this row at most, and three behind its
    last one. The last column is asked for at ends.

    own: float64 (N,), the costs of the frame's word.
    """
    whole = grid[frame + 2]
    whole[max(0, first - 1) : first + 2] = np.inf
    whole[last + 3 : last + 6] = np.inf
    whole[len(whole) - 1] = np.inf
    # All of these begin at the first column, so that the loop over columns need not ask where they are.
    behind, here = grid[frame + 1, first:], whole[first + 2 : last + 3]
    near, far, cost = behind[1:], grid[frame, first + 1 :], own[first:]
    for n in range(len(here)):
        one, two = near[n], far[n]
        single = (one if one < two else two) + cost[n]
        double = behind[n] + (cost[n] + cost[n])
        here[n] = double if double < single else single
    if first == 0:
        here[0] = own[0]


@nb.njit(cache=True, nogil=True)
def within_limit(row: F64, first: int, last: int, limit: float) -> tuple[int, int]:
    """The first and the last column of those from first to last within the limit, (N, −1) where none is (kernel)."""
    while first <= last and not row[first + 2] <= limit:
        first += 1
    while last >= first and not row[last + 2] <= limit:
        last -= 1
    return (first, last) if first <= last else (len(row) - 2, -1)


@nb.njit(cache=True, nogil=True)
def walk_back(
    grid: F64, costs: F64, row_of: I32, codes: I32, begin: int, end: int, i: int, trail: I64, paths: I64
) -> int:
    """Return the frame where the best path begins that ends in the last column at a frame of a window (kernel).

    Among equally cheap paths the one is taken that, read from its end, prefers (1,1), then (1,2), then (2,1). It
    depends on nothing but the cell that it has come to: where another path has come by, it goes on as that did.

    Parameters
    ----------
    begin: the window's first frame. i: the number of the path. trail: int64 (F, 2), the last path that came by each
        frame of the window, by its number, and the column there; −1 at first. paths: int64 (C,), what this returned
        for each number.
    """
    frame, n = end - begin, costs.shape[1] - 1
    while n > 0:
        if trail[frame, 1] == n:
            return paths[trail[frame, 0]]
        trail[frame, 0], trail[frame, 1] = i, n
        dear = costs[row_of[codes[begin + frame]], n]
        straight = grid[frame + 1, n + 1] + dear
        skipped = grid[frame, n + 1] + dear
        doubled = grid[frame + 1, n] + (dear + dear)
        frames, columns = step_back(straight, skipped, doubled)
        frame, n = frame - frames, n - columns
    return begin + frame


@nb.njit(cache=True, nogil=True)
def step_back(straight: float, skipped: float, doubled: float) -> tuple[int, int]:
    """By how many frames and columns the best path comes to a cell, given its cost by each step (kernel).

    Steps are (columns, frames): of equal costs (1,1) is taken, before (1,2), before (2,1).
    """
    if doubled < straight and doubled < skipped:
        return 1, 2
    return (2, 1) if skipped < straight else (1, 1)
