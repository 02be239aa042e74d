"""This module computes the costs of the paths that end in a few frames, in float64, and traces the paths.

Paths that end in neighbouring frames share the frames before these. A *window* is such an interval of frames: the costs
of the paths to all its cells are kept until the paths of interest have been traced back.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np

from kinedex.ops.annotation.segments import TOLERANCE
from kinedex.ops.arrays import F64, I32, I64, U64
from kinedex.ops.distances.costs import TemplateColumns, column_costs
from kinedex.ops.distances.recurrence import path_cost, step_back
from kinedex.ops.words import NO_WORD

_NO_WORD = np.uint64(NO_WORD)

MAX_COSTS = 4_000_000
"""Maximum number of costs of words against columns that are kept for tracing paths: 32 MB."""


class Window(NamedTuple):
    """Memory for the path costs of a window and for the local costs of the words that occur.

    Parameters
    ----------
    sums : float64 array (F + 2, N + 2)
        The costs of paths, see `ops.distances.recurrence`; those of frame f of the window are in row f + 2.
    costs : float64 array (R, N)
        The local costs of the words that have occurred so far.
    row_of : int32 array (W,)
        The row of each word in `costs`, -1 for none.
    used : int64 array (1,)
        The number of rows of `costs` that are filled.
    trail : int64 array (F, 2)
        For each frame the number of the last path through it, and the column there; -1 for none.
    """

    sums: F64
    costs: F64
    row_of: I32
    used: I64
    trail: I64


@nb.njit(cache=True, nogil=True)
def make_window(frames: int, columns: int, words: int) -> Window:
    """Allocate a window for at most the given numbers of frames and columns, and a vocabulary size (kernel)."""
    sums = np.empty((frames + 2, columns + 2))
    sums[:2, :] = np.inf
    costs = np.empty((max(frames, min(words, MAX_COSTS // columns)), columns))
    return Window(sums, costs, np.full(words, -1, np.int32), np.zeros(1, np.int64), np.full((frames, 2), -1, np.int64))


@nb.njit(cache=True, nogil=True)
def sum_window(
    vocabulary: U64, codes: I32, template: TemplateColumns, begin: int, end: int, sums: F64, limit: float,
    window: Window,
) -> None:  # fmt: skip
    """Fill in the costs of the cheapest paths that end in the frames from `end` on, one for each of `sums` (kernel).

    Cells from which no end can be reached are skipped: from frame f the columns N − 1 − 2(e − f) to N − 1 − (e − f)/2
    lead to the end e; over all ends, the columns from the last end's least to the first end's greatest are needed.
    Every step back from such a cell leads to another one, or out of the window. Cells that are only reached by paths
    above the limit are skipped as well: costs only grow along a path, so a path within the limit has no such cell.

    Parameters
    ----------
    vocabulary : uint64 array (W,)
        The different words, see `CodedWords`.
    codes : int32 array (L,)
        The words, see `CodedWords`.
    template : TemplateColumns
        The columns of the template.
    begin : int
        The first frame of the window: where the range of the paths begins, or 2(N − 1) frames before the first end.
    end : int
        The first frame whose cost is wanted.
    sums : float64 array (E,)
        The results: N times the distances. Those above the limit may be too high, or ∞.
    limit : float
        The greatest cost of a path that is of interest.
    window : Window
        Memory for at least as many frames as lie from `begin` to the last end.
    """
    grid, costs, row_of, used, _ = window
    columns = len(template.values)
    first_end, last_end = end - begin, end - begin + len(sums) - 1
    if used[0] + last_end + 1 > len(costs):
        row_of[:] = -1
        used[0] = 0
    # The cells within the limit of the previous frame, and of the one before it.
    low, high, lower, higher = columns, -1, columns, -1
    for frame in range(last_end + 1):
        row = grid[frame + 2]
        least = max(0, columns - 1 - 2 * (last_end - frame))
        most = columns - 1 - max(0, (first_end - frame + 1) // 2)
        first = 0 if least == 0 else max(least, min(low, lower) + 1)
        last = min(most, max(high + 2, higher + 1, 0))
        lower, higher = low, high
        code = codes[begin + frame]
        if last < first or vocabulary[code] == _NO_WORD:
            row[:] = np.inf
            low, high = columns, -1
            continue
        if row_of[code] < 0:
            column_costs(vocabulary[code], template, costs[used[0]])
            row_of[code] = used[0]
            used[0] += 1
        fill_row(grid, frame, first, last, costs[row_of[code]])
        low, high = within_limit(row, first, last, limit)
    for place in range(len(sums)):
        sums[place] = grid[first_end + place + 2, columns + 1]


@nb.njit(cache=True, nogil=True)
def fill_row(sums: F64, frame: int, first: int, last: int, costs: F64) -> None:
    """Fill in the costs of the paths to the columns from `first` to `last` in a frame of a window (kernel).

    Skipped cells are set to ∞ where the next two rows read them. The cells of a row begin one column after the first
    cell within the limit of the two rows before, or at the first one that leads to an end, which advances by two
    columns a row; they end two columns after the last cell within the limit of the row before, or one after that of the
    row before it. So the next rows read at most three columns before the first cell of this row, and three after its
    last one. The last column is read at ends.

    Parameters
    ----------
    sums : float64 array (F + 2, N + 2)
        The costs of paths, see `Window`; the results are written into them.
    frame, first, last : int
        The frame of the window, and the first and the last column to compute.
    costs : float64 array (N,)
        The local costs of the frame's word.
    """
    row = sums[frame + 2]
    row[max(0, first - 1) : first + 2] = np.inf
    row[last + 3 : last + 6] = np.inf
    row[len(row) - 1] = np.inf
    # All of these begin at the first column, so that the loop over columns needs no bounds checks.
    behind, here = sums[frame + 1, first:], row[first + 2 : last + 3]
    straight, slow, own = behind[1:], sums[frame, first + 1 :], costs[first:]
    for n in range(len(here)):
        here[n] = path_cost(straight[n], slow[n], behind[n], own[n])
    if first == 0:
        here[0] = costs[0]


@nb.njit(cache=True, nogil=True)
def within_limit(row: F64, first: int, last: int, limit: float) -> tuple[int, int]:
    """Return the first and the last of some columns that are within the limit, (N, −1) if none is (kernel)."""
    while first <= last and not row[first + 2] <= limit:
        first += 1
    while last >= first and not row[last + 2] <= limit:
        last -= 1
    return (first, last) if first <= last else (len(row) - 2, -1)


@nb.njit(cache=True, nogil=True)
def is_minimum(distances: F64, place: int, threshold: float) -> bool:
    """Return True if a distance is below the threshold and not above its neighbours (kernel).

    Distances closer than `TOLERANCE` are equal. Beyond the ends there is no path.
    """
    if not distances[place] < threshold - TOLERANCE:
        return False
    if place > 0 and distances[place] > distances[place - 1] + TOLERANCE:
        return False
    return not (place + 1 < len(distances) and distances[place] > distances[place + 1] + TOLERANCE)


@nb.njit(cache=True, nogil=True)
def path_start(window: Window, codes: I32, begin: int, end: int, number: int, starts: I64) -> int:
    """Return the start frame of the cheapest path that ends in the last column at a frame of a window (kernel).

    Among equally cheap paths the one is taken that, read from its end, prefers (1,1), then (1,2), then (2,1). Its
    continuation depends on the current cell only: from a cell of an earlier path, it follows that path.

    Parameters
    ----------
    window : Window
        The window; `trail` must be -1 everywhere before the first path.
    codes : int32 array (L,)
        The index in the vocabulary of the word of each frame, see `CodedWords`.
    begin : int
        The first frame of the window.
    end : int
        The frame where the path ends.
    number : int
        The number of the path.
    starts : int64 array (C,)
        The start frames of the earlier paths, by their numbers.
    """
    sums, costs, row_of, _, trail = window
    frame, n = end - begin, costs.shape[1] - 1
    while n > 0:
        if trail[frame, 1] == n:
            return starts[trail[frame, 0]]
        trail[frame, 0], trail[frame, 1] = number, n
        frames, columns = step_back(sums, frame, n, costs[row_of[codes[begin + frame]], n])
        frame, n = frame - frames, n - columns
    return begin + frame
