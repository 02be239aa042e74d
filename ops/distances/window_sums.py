"""This module computes the costs of the paths that end in a few frames, in float64, and traces the paths.

Paths that end in neighbouring frames pass through the same frames before. A *window* is an interval with all these
frames; the costs of the paths to all of its cells are kept until the paths of interest have been traced back.
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

    Cells from which no path leads to one of the ends are skipped. In frame f, the columns N − 1 − 2(e − f) to
    N − 1 − (e − f)/2 lead to the end e. For all ends together, the first column is determined by the last end, and the
    last column by the first end. Every step back from such a cell leads to another such cell, or out of the window.
    Cells that are only reached by paths above the limit are skipped as well: costs never decrease along a path, so a
    path within the limit contains no such cell.

    Parameters
    ----------
    vocabulary : uint64 array (W,)
        The different words, see `CodedWords`.
    codes : int32 array (L,)
        The words, see `CodedWords`.
    template : TemplateColumns
        The columns of the template.
    begin : int
        The first frame of the window, which is the start of the range or 2(N − 1) frames before the first end.
    end : int
        The first frame for which the cost is computed.
    sums : float64 array (E,)
        The results: N times the distances. Results above the limit may be too high, or ∞.
    limit : float
        The largest cost of paths that must be computed exactly.
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

    Skipped cells that the next two rows read are set to ∞. The first cell of a row is one column after the first cell
    within the limit in the two previous rows, or the first cell from which an end can be reached, which moves by two
    columns per row. The last cell is two columns after the last cell within the limit in the previous row, or one
    column after that of the row before. The next rows therefore read at most three columns before the first cell of
    this row, and at most three after its last cell. The last column is also read at ends.

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
    """Return the first and the last column from `first` to `last` within the limit; (N, −1) if none is (kernel)."""
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

    Of equally cheap paths, the choice is made step by step from the end of the path: a (1,1) step is preferred to
    (1,2), and (1,2) to (2,1). The choice depends only on the current cell, so that a path which meets an earlier path
    has the same start.

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
