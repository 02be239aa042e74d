"""These kernels select the best hits from groups of candidates, ordered by bounds and then by exact costs."""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numba as nb
import numpy as np

from kinedex.ops.annotation.segments import TOLERANCE
from kinedex.ops.arrays import F64, I32, I64, U16, U64, Bool
from kinedex.ops.distances.costs import TemplateColumns
from kinedex.ops.distances.sweep import CAP
from kinedex.ops.distances.window_sums import make_window, path_start, sum_window

KEYS = 1e9
"""Factor from costs to integer keys; costs that differ by less than about a billionth have the same key."""

Heap = list[tuple[np.int64, np.int64, np.int64, np.int64]]
"""Heap entries: the key, 0 for a bound or 1 for a cost, the rank of the take among equal hits, and the number. At equal
keys a bound precedes a cost, since the group may contain a minimum that has to be selected first.
"""


class Selection(NamedTuple):
    """Selected hits, the best first, in arrays with a capacity of H.

    Parameters
    ----------
    starts, ends : int64 array (H,)
        The first and the last frame of each hit, both included.
    costs : float64 array (H,)
        The distance at the last frame.
    newest : int64 array (T,)
        The hit of each take that was selected last, -1 for none.
    older : int64 array (H,)
        The hit of the same take that was selected before each hit, -1 for none.
    found : int64 array (1,)
        The number of hits.
    """

    starts: I64
    ends: I64
    costs: F64
    newest: I64
    older: I64
    found: I64


class Candidates(NamedTuple):
    """Candidate frames for minima of a distance curve and their neighbours, in groups that are computed together.

    Parameters
    ----------
    frames : int64 array (C,)
        Ascending frames, see `ops.distances.pruning.possible_minima`.
    possible : bool array (C,)
        True for frames that can be minima, False for neighbours.
    groups : int64 array (G + 1,)
        Group g has the candidates groups[g] to groups[g + 1] - 1.
    range_starts, takes : int64 array (C,)
        For each candidate the first frame of its range, and its take.
    """

    frames: I64
    possible: Bool
    groups: I64
    range_starts: I64
    takes: I64


@nb.njit(cache=True, nogil=True)
def make_selection(most: int, takes: int) -> Selection:
    """Make an empty selection with the given capacity (kernel)."""
    return Selection(
        np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most), np.full(takes, -1, np.int64),
        np.empty(most, np.int64), np.zeros(1, np.int64),
    )  # fmt: skip


@nb.njit(cache=True, nogil=True)
def select_best(
    vocabulary: U64, codes: I32, template: TemplateColumns, threshold: float, units: U16, unit: float,
    candidates: Candidates, order: I64, most: int,
) -> Selection:  # fmt: skip
    """Select hits, the best first, until there are enough or none is left (kernel).

    The neighbours of a frame are needed to judge if it is a minimum. If a neighbour is in another group, as in a
    motionless interval that was divided, it is computed with this group as well.

    Parameters
    ----------
    vocabulary : uint64 array (W,)
        The different words, see `CodedWords`.
    codes : int32 array (L,)
        The index in the vocabulary of the word of each frame, see `CodedWords`.
    template : TemplateColumns
        The columns of the template.
    threshold : float
        The threshold τ.
    units : uint16 array (L,)
        See `ops.distances.pruning.FineBound`.
    unit : float
        The distance that corresponds to one unit.
    candidates : Candidates
        The frames that can be minima, and their neighbours.
    order : int64 array (T,)
        The rank of each take among hits of equal cost.
    most : int
        The number of hits at which the selection ends.
    """
    frames, possible, groups, range_starts, takes = candidates
    columns = len(template.values)
    longest = 0
    for g in range(len(groups) - 1):
        longest = max(longest, frames[groups[g + 1] - 1] - frames[groups[g]])
    window = make_window(longest + 2 + 2 * columns, columns, len(vocabulary))
    sums = np.empty(longest + 3)
    hits = make_selection(most, len(order))
    exact, starts = np.empty(len(frames)), np.empty(len(frames), np.int64)
    heap = group_heap(units, unit, candidates, order)
    while len(heap) > 0 and hits.found[0] < most:
        _, known, _, number = heapq.heappop(heap)
        if known == 1:
            add_hit(hits, starts[number], frames[number], exact[number], takes[number])
            continue
        first, stop = groups[number], groups[number + 1]
        take = takes[first]
        most_units = units_left(units, candidates, first, stop, hits, take)
        if most_units < 0:
            continue
        low, high = with_neighbours(candidates, first, stop)
        begin = max(frames[low] - 2 * (columns - 1), range_starts[first])
        found = sums[: frames[high - 1] + 1 - frames[low]]
        # The path of least units costs less than these plus N units; costlier paths need not be computed.
        limit = (most_units + columns + 1) * unit * columns
        sum_window(vocabulary, codes, template, begin, frames[low], found, limit, window)
        found /= columns
        window.trail[: frames[high - 1] + 1 - begin] = -1
        for i in range(first, stop):
            if possible[i] and is_least(frames, found, low, i, threshold):
                exact[i] = found[frames[i] - frames[low]]
                starts[i] = path_start(window, codes, begin, frames[i], i, starts)
                key = np.int64(np.rint(exact[i] * KEYS))
                heapq.heappush(heap, (key, np.int64(1), np.int64(order[take]), np.int64(i)))
    return hits


@nb.njit(cache=True, nogil=True)
def add_hit(hits: Selection, start: int, end: int, cost: float, take: int) -> None:
    """Select a hit of a take, unless one that was selected before excludes it (kernel)."""
    if excluded(hits, take, start, end, True):
        return
    count = hits.found[0]
    hits.starts[count], hits.ends[count], hits.costs[count] = start, end, cost
    hits.older[count] = hits.newest[take]
    hits.newest[take] = count
    hits.found[0] = count + 1


@nb.njit(cache=True, nogil=True)
def excluded(hits: Selection, take: int, start: int, end: int, start_known: bool) -> bool:
    """Return True if a selected hit of the same take excludes a hit, by its end, or by its start if known (kernel)."""
    starts, ends, _, newest, older, _ = hits
    hit = newest[take]
    while hit >= 0:
        length = ends[hit] + 1 - starts[hit]
        later = end - ends[hit]
        if -length <= 2 * later and 10 * later <= length:
            return True
        later = start - starts[hit]
        if start_known and -length <= 10 * later and 2 * later <= length:
            return True
        hit = older[hit]
    return False


@nb.njit(cache=True, nogil=True)
def units_left(units: U16, candidates: Candidates, first: int, stop: int, hits: Selection, take: int) -> int:
    """Return the greatest units among possible minima of a group that are not excluded, −1 if none is left (kernel)."""
    frames, possible, _, _, _ = candidates
    left, most = False, 0
    for i in range(first, stop):
        if possible[i]:
            left = left or not excluded(hits, take, 0, frames[i], False)
            most = max(most, int(units[frames[i]]))
    return most if left else -1


@nb.njit(cache=True, nogil=True)
def with_neighbours(candidates: Candidates, first: int, stop: int) -> tuple[int, int]:
    """Extend a group by the candidate on each side if that is the next frame of the same range (kernel)."""
    frames, begins = candidates.frames, candidates.range_starts
    low, high = first, stop
    if first > 0 and begins[first - 1] == begins[first] and frames[first - 1] == frames[first] - 1:
        low -= 1
    if stop < len(frames) and begins[stop] == begins[first] and frames[stop] == frames[stop - 1] + 1:
        high += 1
    return low, high


@nb.njit(cache=True, nogil=True)
def is_least(frames: I64, distances: F64, low: int, i: int, threshold: float) -> bool:
    """Return True if a candidate is below the threshold and not above its neighbours (kernel).

    If a neighbouring frame is not a candidate, its cost is known to be greater.

    Parameters
    ----------
    frames : int64 array (C,)
        The frames of candidates.
    distances : float64 array
        The distances of the frames from the candidate `low` on.
    low, i : int
        The numbers of candidates.
    threshold : float
        The threshold τ.
    """
    at = frames[i] - frames[low]
    if not distances[at] < threshold - TOLERANCE:
        return False
    if i > low and frames[i - 1] == frames[i] - 1 and distances[at] > distances[at - 1] + TOLERANCE:
        return False
    after = at + 1 < len(distances) and frames[i + 1] == frames[i] + 1
    return not (after and distances[at] > distances[at + 1] + TOLERANCE)


@nb.njit(cache=True, nogil=True)
def group_heap(units: U16, unit: float, candidates: Candidates, order: I64) -> Heap:
    """Make a heap of groups, ordered by the lowest bound in each (kernel)."""
    frames, possible, groups, _, takes = candidates
    heap = [(np.int64(0), np.int64(0), np.int64(0), np.int64(0))]
    heap.pop()
    for g in range(len(groups) - 1):
        least = CAP
        for i in range(groups[g], groups[g + 1]):
            if possible[i]:
                least = min(least, int(units[frames[i]]))
        key = np.int64(np.floor(least * unit * KEYS))
        heap.append((key, np.int64(0), np.int64(order[takes[groups[g]]]), np.int64(g)))
    heapq.heapify(heap)
    return heap
