"""This module finds the best hits of a template block by block, in the order of coarse lower bounds.

If only a few hits are requested, most blocks that may contain a hit below the threshold are not needed. Computing finer
bounds for all blocks would take longer than computing the exact sums of the few blocks that are needed.
"""

from __future__ import annotations

import heapq

import numba as nb
import numpy as np

from kinedex.ops.arrays import I32, I64, U8, U64
from kinedex.ops.copies import copy_row
from kinedex.ops.distances.costs import TemplateColumns
from kinedex.ops.distances.sweep import BLOCK
from kinedex.ops.distances.window_sums import is_minimum, make_window, path_start, sum_window
from kinedex.ops.ranking.hit_selection import KEYS, Heap, Selection, add_hit, excluded, make_selection


@nb.njit(cache=True, nogil=True)
def gather_blocks(blocks: I64, sums: U8, ranges: I64, takes: I64, columns: int) -> I64:
    """Group blocks that are close to each other, so that they share most of their work (kernel).

    Parameters
    ----------
    blocks : int64 array (B,)
        The blocks to search, ascending.
    sums : uint8 array
        The coarse sum of every block.
    ranges : int64 array (R, 2)
        The ranges that paths must not leave, see `ops.ranges.checked_ranges`.
    takes : int64 array (R,)
        The take of each range.
    columns : int
        The number of columns N of the template.

    Returns
    -------
    int64 array (G, 6)
        For each group its half-open range of frames, the range of `ranges` that contains it, its take, and its smallest
        sum.
    """
    groups = np.empty((len(blocks) + len(ranges), 6), np.int64)
    count, place, known = 0, 0, -1
    for block in blocks:
        begin, end, least = block * BLOCK, (block + 1) * BLOCK, np.int64(sums[block])
        while place < len(ranges) and ranges[place, 1] <= begin:
            place += 1
        within = place
        while within < len(ranges) and ranges[within, 0] < end:
            start, stop = max(begin, ranges[within, 0]), min(end, ranges[within, 1])
            near = known == within and start - groups[count - 1, 1] <= columns // 8
            if near and groups[count - 1, 0] // (columns + 8) == start // (columns + 8):
                groups[count - 1, 1] = stop
                groups[count - 1, 5] = min(groups[count - 1, 5], least)
            else:
                copy_row(groups[count], (start, stop, ranges[within, 0], ranges[within, 1], takes[within], least))
                count += 1
            known = within
            within += 1
    return groups[:count].copy()


@nb.njit(cache=True, nogil=True)
def select_from_blocks(
    vocabulary: U64, codes: I32, template: TemplateColumns, threshold: float, groups: I64, unit: float, order: I64,
    most: int,
) -> tuple[Selection, int]:  # fmt: skip
    """Select hits below a threshold, the best first, until there are enough or none is left (kernel).

    Groups and minima are in one heap, as in `ops.ranking.hit_selection.select_best`. The key of a group is its smallest
    sum, which is a lower bound, and the key of a minimum is its cost. The minima of a group are computed when the group
    comes first in the heap. The number of a minimum is its position among the frames of all groups.

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
    groups : int64 array (G, 6)
        The groups, see `gather_blocks`; outside the groups no distance is below the threshold.
    unit : float
        The distance that corresponds to one unit of the sums.
    order : int64 array (T,)
        The rank of each take among hits of equal cost.
    most : int
        The number of hits at which the selection ends.

    Returns
    -------
    Selection
        The hits.
    int
        The number of frames that were computed.
    """
    columns = len(template.values)
    heap, numbers, longest = group_heap(groups, unit, order)
    window = make_window(longest + 2 + 2 * columns, columns, len(vocabulary))
    sums = np.empty(longest + 2)
    hits = make_selection(most, len(order))
    exact, starts = np.empty(numbers[len(groups)]), np.empty(numbers[len(groups)], np.int64)
    group_of = np.empty(numbers[len(groups)], np.int64)
    limit = threshold * columns * (1 + 1e-9)  # upper limit of a hit's cost, with a margin for rounding
    computed = 0
    while len(heap) > 0 and hits.found[0] < most:
        _, known, _, number = heapq.heappop(heap)
        g = group_of[number] if known == 1 else number
        start, stop, opens, closes, take, _ = groups[g]
        shift = numbers[g] - start
        if known == 1:
            add_hit(hits, starts[number], number - shift, exact[number], take)
            continue
        start, stop = not_excluded(start, stop, hits, take)
        if start == stop:
            continue
        # The neighbours of a frame are needed to judge if it is a minimum.
        low, high = max(start - 1, opens), min(stop + 1, closes)
        begin = max(low - 2 * (columns - 1), opens)
        computed += high - begin
        found = sums[: high - low]
        sum_window(vocabulary, codes, template, begin, low, found, limit, window)
        found /= columns
        window.trail[: high - begin] = -1
        for frame in range(start, stop):
            if is_minimum(found, frame - low, threshold):
                number = frame + shift
                exact[number], group_of[number] = found[frame - low], g
                starts[number] = path_start(window, codes, begin, frame, number, starts)
                key = np.int64(np.rint(exact[number] * KEYS))
                heapq.heappush(heap, (key, np.int64(1), np.int64(order[take]), np.int64(number)))
    return hits, computed


@nb.njit(cache=True, nogil=True)
def not_excluded(start: int, stop: int, hits: Selection, take: int) -> tuple[int, int]:
    """Shorten a half-open range by the frames at both ends that a selected hit of the take excludes (kernel)."""
    while start < stop and excluded(hits, take, 0, start, False):
        start += 1
    while stop > start and excluded(hits, take, 0, stop - 1, False):
        stop -= 1
    return start, stop


@nb.njit(cache=True, nogil=True)
def group_heap(groups: I64, unit: float, order: I64) -> tuple[Heap, I64, int]:
    """Make a heap of groups, ordered by their bounds (kernel).

    Returns
    -------
    heap : list of tuple
        See `ops.ranking.hit_selection.Heap`.
    numbers : int64 array (G + 1,)
        The number of the first frame of each group.
    longest : int
        The number of frames of the longest group.
    """
    heap = [(np.int64(0), np.int64(0), np.int64(0), np.int64(0))]
    heap.pop()
    numbers = np.zeros(len(groups) + 1, np.int64)
    longest = 0
    for g in range(len(groups)):
        numbers[g + 1] = numbers[g] + groups[g, 1] - groups[g, 0]
        longest = max(longest, groups[g, 1] - groups[g, 0])
        key = np.int64(np.floor(groups[g, 5] * unit * KEYS))
        heap.append((key, np.int64(0), np.int64(order[groups[g, 4]]), np.int64(g)))
    heapq.heapify(heap)
    return heap, numbers, longest
