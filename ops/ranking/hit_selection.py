"""The kernels of ranking: groups of candidates by their bounds, minima by their costs, the best taken first."""

from __future__ import annotations

import heapq

import numba as nb
import numpy as np
import numpy.typing as npt

from kinedex.ops.annotation.segments import TOLERANCE
from kinedex.ops.distances.costs import F64, I32, I64
from kinedex.ops.distances.sweep import CAP, U16
from kinedex.ops.distances.window_sums import sum_window, walk_back, workspace
from kinedex.ops.words import U64

KEYS = 1e9
"""Costs are compared as whole billionths: those that are closer are equal, and the earlier frame comes first."""


@nb.njit(cache=True, nogil=True)
def take_best(
    vocabulary: U64, codes: I32, values: U64, parts: U64, worths: F64, counted: F64, threshold: float, units: U16,
    unit: float, candidates: I64, possible: npt.NDArray[np.bool_], groups: I64, begins: I64, homes: I64, order: I64,
    starts: I64, ends: I64, costs: F64,
) -> int:  # fmt: skip
    """Take hits, the best first, until there are enough or none is left; return how many (kernel).

    candidates, possible: see `ops.distances.pruning.possible_minima`. groups: int64 (G + 1,), those from groups[g] on
    are computed together. begins, homes: int64 (C,), where the stretch of each begins, and its take. order: int64 (T,),
    the places of takes among equal hits. starts, ends, costs: what is found; their length is how many are enough.

    A minimum is decided by its neighbours. Where one of these is in another group, as where a still stretch is divided,
    it is computed here too.
    """
    columns = len(values)
    longest = 0
    for g in range(len(groups) - 1):
        longest = max(longest, candidates[groups[g + 1] - 1] - candidates[groups[g]])
    grid, local, row_of, used, trail = workspace(longest + 2 + 2 * columns, columns, len(vocabulary))
    sums = np.empty(longest + 3)
    newest = np.full(len(order), -1, np.int64)  # the last hit taken in each take, and the one before each hit
    older = np.empty(len(costs), np.int64)
    exact, paths = np.empty(len(candidates)), np.empty(len(candidates), np.int64)
    heap = first_bounds(units, unit, candidates, possible, groups, homes, order)
    count = 0
    while len(heap) > 0 and count < len(costs):
        _, known, _, c = heapq.heappop(heap)
        if known == 1:
            count = take(paths[c], candidates[c], exact[c], homes[c], newest, older, starts, ends, costs, count)
            continue
        first, stop = groups[c], groups[c + 1]
        home = homes[first]
        most_units = units_left(units, candidates, possible, first, stop, newest[home], older, starts, ends)
        if most_units < 0:
            continue
        low, high = with_neighbours(candidates, begins, first, stop)
        begin = max(candidates[low] - 2 * (columns - 1), begins[first])
        found = sums[: candidates[high - 1] + 1 - candidates[low]]
        # A path that has the least units costs less than these and N more; no more is of interest.
        limit = (most_units + columns + 1) * unit * columns
        sum_window(
            vocabulary, codes, values, parts, worths, counted, begin, candidates[low], found, limit, grid, local,
            row_of, used,
        )  # fmt: skip
        found /= columns
        trail[: candidates[high - 1] + 1 - begin] = -1
        for i in range(first, stop):
            if possible[i] and least_beside(candidates, found, low, i, threshold):
                exact[i] = found[candidates[i] - candidates[low]]
                paths[i] = walk_back(grid, local, row_of, codes, begin, candidates[i], i, trail, paths)
                key = np.int64(np.rint(exact[i] * KEYS))
                heapq.heappush(heap, (key, np.int64(1), np.int64(order[home]), np.int64(i)))
    return count


@nb.njit(cache=True, nogil=True)
def take(
    start: int, end: int, cost: float, home: int, newest: I64, older: I64, starts: I64, ends: I64, costs: F64,
    count: int,
) -> int:  # fmt: skip
    """Take a hit, unless one that was taken before rules it out; return how many there are then (kernel).

    home: its take. newest: int64 (T,), the last hit taken in each take, older: int64 (H,), the one before each hit, −1
    for none. starts, ends, costs: the hits, of which `count` are taken.
    """
    if ruled_out(start, end, newest[home], older, starts, ends, True):
        return count
    starts[count], ends[count], costs[count] = start, end, cost
    older[count] = newest[home]
    newest[home] = count
    return count + 1


@nb.njit(cache=True, nogil=True)
def units_left(
    units: U16, candidates: I64, possible: npt.NDArray[np.bool_], first: int, stop: int, hit: int, older: I64,
    starts: I64, ends: I64,
) -> int:  # fmt: skip
    """The most units of those in a group that can be minima; −1 where hits of the take rule all out (kernel)."""
    left, most = False, 0
    for i in range(first, stop):
        if possible[i]:
            left = left or not ruled_out(0, candidates[i], hit, older, starts, ends, False)
            most = max(most, int(units[candidates[i]]))
    return most if left else -1


@nb.njit(cache=True, nogil=True)
def with_neighbours(candidates: I64, begins: I64, first: int, stop: int) -> tuple[int, int]:
    """Widen a group by the candidate on each side that is the next frame of the same stretch (kernel)."""
    low, high = first, stop
    if first > 0 and begins[first - 1] == begins[first] and candidates[first - 1] == candidates[first] - 1:
        low -= 1
    if stop < len(candidates) and begins[stop] == begins[first] and candidates[stop] == candidates[stop - 1] + 1:
        high += 1
    return low, high


@nb.njit(cache=True, nogil=True)
def least_beside(candidates: I64, costs: F64, low: int, i: int, threshold: float) -> bool:
    """Whether a candidate is below the threshold and not above its neighbours (kernel).

    costs: float64, of the frames from the candidate `low` on. A frame beside it that is no candidate is provably
    dearer.
    """
    at = candidates[i] - candidates[low]
    if not costs[at] < threshold - TOLERANCE:
        return False
    if i > low and candidates[i - 1] == candidates[i] - 1 and costs[at] > costs[at - 1] + TOLERANCE:
        return False
    after = at + 1 < len(costs) and candidates[i + 1] == candidates[i] + 1
    return not (after and costs[at] > costs[at + 1] + TOLERANCE)


@nb.njit(cache=True, nogil=True)
def first_bounds(
    units: U16, unit: float, candidates: I64, possible: npt.NDArray[np.bool_], groups: I64, homes: I64, order: I64
) -> list[tuple[np.int64, np.int64, np.int64, np.int64]]:
    """Make a heap of groups by the least bound in each (kernel).

    Of equal keys a bound (0) comes before a cost (1): what it stands for may have to go first.
    """
    heap = [(np.int64(0), np.int64(0), np.int64(0), np.int64(0))]
    heap.pop()
    for g in range(len(groups) - 1):
        least = CAP
        for i in range(groups[g], groups[g + 1]):
            if possible[i]:
                least = min(least, int(units[candidates[i]]))
        key = np.int64(np.floor(least * unit * KEYS))
        heap.append((key, np.int64(0), np.int64(order[homes[groups[g]]]), np.int64(g)))
    heapq.heapify(heap)
    return heap


@nb.njit(cache=True, nogil=True)
def ruled_out(start: int, end: int, hit: int, older: I64, starts: I64, ends: I64, started: bool) -> bool:
    """Whether a hit of a take, or one before it, rules a place out: by its end, or by its start if known (kernel)."""
    while hit >= 0:
        length = ends[hit] + 1 - starts[hit]
        later = end - ends[hit]
        if -length <= 2 * later and 10 * later <= length:
            return True
        later = start - starts[hit]
        if started and -length <= 10 * later and 2 * later <= length:
            return True
        hit = older[hit]
    return False
