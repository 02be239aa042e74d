"""The best hits of a template, looked for block by block in the order of the coarse bounds.

Where a few hits are asked for, most blocks that may hold one below some threshold hold none that is good enough. Finer
bounds of all of them would cost more than the sums of those few whose turn comes.
"""

from __future__ import annotations

import heapq

import numba as nb
import numpy as np

from kinedex.ops.annotation.segments import TOLERANCE
from kinedex.ops.distances.costs import F64, I32, I64
from kinedex.ops.distances.stripes import BLOCK, U8
from kinedex.ops.distances.window_sums import sum_window, walk_back, workspace
from kinedex.ops.ranking.hit_selection import KEYS, ruled_out, take
from kinedex.ops.words import U64


@nb.njit(cache=True, nogil=True)
def gather_blocks(blocks: I64, sums: U8, stretches: I64, homes: I64, columns: int) -> I64:
    """Gather blocks that are close to each other, in windows that share most of their work (kernel).

    Parameters
    ----------
    blocks: int64 (B,), ascending, those to look at. sums: uint8, the coarse sum of each block there is.
    stretches: int64 (R, 2), see `ops.ranges.checked_ranges`. homes: int64 (R,), the take of each. columns: N.

    Returns
    -------
    int64 (G, 6): the frames [start, stop) of a group, the stretch they are in, [opens, closes), its take, and the
    least sum.
    """
    groups = np.empty((len(blocks) + len(stretches), 6), np.int64)
    count, place, known = 0, 0, -1
    for block in blocks:
        begin, end, least = block * BLOCK, (block + 1) * BLOCK, np.int64(sums[block])
        while place < len(stretches) and stretches[place, 1] <= begin:
            place += 1
        within = place
        while within < len(stretches) and stretches[within, 0] < end:
            start, stop = max(begin, stretches[within, 0]), min(end, stretches[within, 1])
            near = known == within and start - groups[count - 1, 1] <= columns // 8
            if near and groups[count - 1, 0] // (columns + 8) == start // (columns + 8):
                groups[count - 1, 1] = stop
                groups[count - 1, 5] = min(groups[count - 1, 5], least)
            else:
                groups[count] = (start, stop, stretches[within, 0], stretches[within, 1], homes[within], least)
                count += 1
            known = within
            within += 1
    return groups[:count].copy()


@nb.njit(cache=True, nogil=True)
def take_from_blocks(
    vocabulary: U64, codes: I32, values: U64, parts: U64, worths: F64, counted: F64, threshold: float, groups: I64,
    unit: float, order: I64, starts: I64, ends: I64, costs: F64,
) -> tuple[int, int]:  # fmt: skip
    """Take hits below a threshold, the best first, until there are enough or none is left (kernel).

    Groups and minima wait in one heap, as in `ops.ranking.hit_selection.take_best`: a group by its least sum, which is
    a
    lower bound, and a minimum by its cost. The minima of a group are found when its turn comes.

    groups: see `gather_blocks`; outside of them no distance is below the threshold. unit: what a sum is worth, as a
    distance. order: int64 (T,), the places of takes among equal hits. starts, ends, costs: what is found; their length
    is how many are enough.

    Returns
    -------
    How many hits were taken, and how many frames were computed.
    """
    columns = len(values)
    heap, numbers, longest = groups_by_bound(groups, unit, order)
    grid, local, row_of, used, trail = workspace(longest + 2 + 2 * columns, columns, len(vocabulary))
    sums = np.empty(longest + 2)
    newest = np.full(len(order), -1, np.int64)  # the last hit taken in each take, and the one before each hit
    older = np.empty(len(costs), np.int64)
    # Of minima, by their numbers: the frames of groups are numbered one after the other.
    exact, paths = np.empty(numbers[len(groups)]), np.empty(numbers[len(groups)], np.int64)
    group_of = np.empty(numbers[len(groups)], np.int64)
    # Rounding does not make a sum of a hit greater than this.
    limit = threshold * columns * (1 + 1e-9)
    count, computed = 0, 0
    while len(heap) > 0 and count < len(costs):
        _, known, _, c = heapq.heappop(heap)
        g = group_of[c] if known == 1 else c
        start, stop, opens, closes, home, _ = groups[g]
        if known == 1:
            end = start + c - numbers[g]
            count = take(paths[c], end, exact[c], home, newest, older, starts, ends, costs, count)
            continue
        shift = numbers[g] - start
        start, stop = left_of(start, stop, newest[home], older, starts, ends)
        if start == stop:
            continue
        # A minimum is decided by its neighbours.
        low, high = max(start - 1, opens), min(stop + 1, closes)
        begin = max(low - 2 * (columns - 1), opens)
        computed += high - begin
        found = sums[: high - low]
        sum_window(
            vocabulary, codes, values, parts, worths, counted, begin, low, found, limit, grid, local, row_of, used
        )
        found /= columns
        trail[: high - begin] = -1
        for frame in range(start, stop):
            if least_there(found, frame - low, threshold):
                c = frame + shift
                exact[c], group_of[c] = found[frame - low], g
                paths[c] = walk_back(grid, local, row_of, codes, begin, frame, c, trail, paths)
                key = np.int64(np.rint(exact[c] * KEYS))
                heapq.heappush(heap, (key, np.int64(1), np.int64(order[home]), np.int64(c)))
    return count, computed


@nb.njit(cache=True, nogil=True)
def left_of(start: int, stop: int, hit: int, older: I64, starts: I64, ends: I64) -> tuple[int, int]:
    """Leave out the frames at both sides of a group where a hit of its take, or one before it, rules out ends (kernel).

    Returns the frames that are left, [start, stop).
    """
    while start < stop and ruled_out(0, start, hit, older, starts, ends, False):
        start += 1
    while stop > start and ruled_out(0, stop - 1, hit, older, starts, ends, False):
        stop -= 1
    return start, stop


@nb.njit(cache=True, nogil=True)
def least_there(costs: F64, at: int, threshold: float) -> bool:
    """Whether a cost is below the threshold and not above those beside it (kernel)."""
    if not costs[at] < threshold - TOLERANCE:
        return False
    if at > 0 and costs[at] > costs[at - 1] + TOLERANCE:
        return False
    return not (at + 1 < len(costs) and costs[at] > costs[at + 1] + TOLERANCE)


@nb.njit(cache=True, nogil=True)
def groups_by_bound(
    groups: I64, unit: float, order: I64
) -> tuple[list[tuple[np.int64, np.int64, np.int64, np.int64]], I64, int]:
    """Make a heap of groups by their bounds; return it (kernel).

    Also returned are the number of each group's first frame, int64 (G + 1,), and the most frames of one.
    Of equal keys a bound (0) comes before a cost (1): what it stands for may have to go first.
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
