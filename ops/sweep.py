"""The inner loops of subsequence DTW: frame by frame over columns side by side, several stretches at a time."""

from __future__ import annotations

import numba as nb
import numpy as np
import numpy.typing as npt

from ops.costs import F64, I32, I64, Table, contradictions
from ops.words import NO_WORD, U64

U16 = npt.NDArray[np.uint16]

_NO_WORD = np.uint64(NO_WORD)

LANES = 4
"""Stretches computed at a time. A frame waits for the one before it, which has just been written; while one stretch
waits, another one computes."""

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
def refill(pieces: I64, slots: I64, active: int, following: int) -> tuple[int, int, int]:
    """Give slots that are done the next piece; close those for which there is none (kernel).

    slots: int64 (LANES, 4): frame to compute next, where to keep results from, where to stop, and 1 for a new piece;
    −1 − k instead of 1 for one moved here from slot k. Returns how many slots are active, the next piece, and
    how many frames all of them can go on.
    """
    for k in range(len(slots)):
        slots[k, 3] = 0
    k = 0
    while k < active or (active < len(slots) and following < len(pieces)):
        if k == active:
            active += 1
        elif slots[k, 0] < slots[k, 2]:
            k += 1
            continue
        elif following == len(pieces):
            active -= 1
            if k < active:
                slots[k, :3] = slots[active, :3]
                slots[k, 3] = -1 - active
            continue
        slots[k, :3] = pieces[following]
        slots[k, 3] = 1
        following += 1
        k += 1
    steps = 0
    for k in range(active):
        left = slots[k, 2] - slots[k, 0]
        steps = left if k == 0 or left < steps else steps
    return active, following, steps


@nb.njit(cache=True, nogil=True)
def sweep(table: Table, codes: I32, pieces: I64, firsts: I64, lasts: I64, sums: Table) -> None:
    """Fill the costs of the best paths of all templates of a layout, in the table's own precision (kernel).

    All three steps advance the take and none stays in its row, so a frame depends on the two frames before it only, and
    nothing within a frame depends on anything: the loop over columns vectorises. A column of ∞ before a template's
    first keeps the (2,1) step out; the first column is the local cost alone.
    """
    columns = table.shape[1]
    state = np.full((3, LANES, columns + 2), np.inf, table.dtype)
    previous, last, here = state[0], state[1], state[2]
    slots = np.zeros((LANES, 4), np.int64)
    active, following, steps = refill(pieces, slots, 0, 0)
    while active > 0:
        for k in range(LANES):
            if slots[k, 3] == 1:
                previous[k, :] = np.inf
                last[k, :] = np.inf
            elif slots[k, 3] < 0:
                previous[k, :] = previous[-1 - slots[k, 3]]
                last[k, :] = last[-1 - slots[k, 3]]
        for step in range(steps):
            for k in range(active):
                frame = slots[k, 0] + step
                cost = table[codes[frame]]
                before, behind, now = previous[k], last[k], here[k]
                for n in range(columns):
                    one, two = behind[n + 1], before[n + 1]
                    single = (one if one < two else two) + cost[n]
                    double = behind[n] + (cost[n] + cost[n])
                    now[n + 2] = double if double < single else single
                for t in range(len(firsts)):
                    now[firsts[t] + 2] = cost[firsts[t]]
                if frame >= slots[k, 1]:
                    for t in range(len(firsts)):
                        sums[t, frame] = now[lasts[t] + 2]
            previous, last, here = last, here, previous
        slots[:active, 0] += steps
        active, following, steps = refill(pieces, slots, active, following)


@nb.njit(cache=True, nogil=True)
def sweep_bounds(table: U16, codes: I32, pieces: I64, final: int, curve: U16) -> None:
    """Fill one template's curve of lower bounds in whole units, `CAP` for all that is no less (kernel).

    The same as `sweep` with sums that stop at `CAP`: a cell at `CAP` is reached by no path of fewer units.
    """
    columns = table.shape[1]
    cap = np.uint16(CAP)
    state = np.full((3, LANES, columns + 2), cap, np.uint16)
    previous, last, here = state[0], state[1], state[2]
    slots = np.zeros((LANES, 4), np.int64)
    active, following, steps = refill(pieces, slots, 0, 0)
    while active > 0:
        for k in range(LANES):
            if slots[k, 3] == 1:
                previous[k, :] = cap
                last[k, :] = cap
            elif slots[k, 3] < 0:
                previous[k, :] = previous[-1 - slots[k, 3]]
                last[k, :] = last[-1 - slots[k, 3]]
        for step in range(steps):
            for k in range(active):
                frame = slots[k, 0] + step
                cost = table[codes[frame]]
                before, behind, now = previous[k], last[k], here[k]
                for n in range(columns):
                    one, two = behind[n + 1], before[n + 1]
                    single = np.uint16((one if one < two else two) + cost[n])
                    double = np.uint16(behind[n] + np.uint16(cost[n] + cost[n]))
                    least = double if double < single else single
                    now[n + 2] = least if least < cap else cap
                now[2] = cost[0]
                if frame >= slots[k, 1]:
                    curve[frame] = now[final + 2]
            previous, last, here = last, here, previous
        slots[:active, 0] += steps
        active, following, steps = refill(pieces, slots, active, following)


@nb.njit(cache=True, nogil=True)
def trace_paths(
    words: U64, masks: U64, values: U64, counted: F64, ends: I64, opens: I64, groups: I64, starts: I64, sums: F64
) -> None:
    """Find the best path that ends at each of some frames, in float64 (kernel).

    ends: int64 (E,), ascending frames. opens: int64 (E,), where the window of each begins, 2(N − 1) frames before or
    where its stretch does. groups: int64 (G + 1,): ends groups[g] to groups[g + 1] − 1 share a window. starts (E,) gets
    the first frame of each path, −1 where there is none; sums (E,) its cost.

    Cells from which no end of the group can be reached are left out: from frame f the columns N − 1 − 2(e − f)
    to N − 1 − (e − f)/2 lead to the end e, so that over a group those from the last end's least to the first end's
    most count. Every step back from a cell of these leads to another one, or out of the window.
    """
    columns = len(masks)
    longest = 0
    for g in range(len(groups) - 1):
        longest = max(longest, ends[groups[g + 1] - 1] + 1 - opens[groups[g]])
    grid = np.full((longest + 2, columns + 2), np.inf)
    cost = np.empty((longest, columns))
    for g in range(len(groups) - 1):
        begin = opens[groups[g]]
        lowest, highest = ends[groups[g]] - begin, ends[groups[g + 1] - 1] - begin
        for frame in range(highest + 1):
            here, last, previous, own = grid[frame + 2], grid[frame + 1], grid[frame], cost[frame]
            least = max(0, columns - 1 - 2 * (highest - frame))
            most = columns - 1 - max(0, (lowest - frame + 1) // 2)
            word = words[begin + frame]
            if word == _NO_WORD:
                own[least : most + 1] = np.inf
            else:
                for n in range(least, most + 1):
                    own[n] = np.float64(np.int64(contradictions(word, masks[n], values[n]))) / counted[n]
            for n in range(least, most + 1):
                one, two = last[n + 1], previous[n + 1]
                single = (one if one < two else two) + own[n]
                double = last[n] + (own[n] + own[n])
                here[n + 2] = double if double < single else single
            if least == 0 and most >= 0:
                here[2] = own[0]
        for place in range(groups[g], groups[g + 1]):
            frame, n = ends[place] - begin, columns - 1
            sums[place] = grid[frame + 2, n + 2]
            if sums[place] == np.inf:
                starts[place] = -1
                continue
            while n > 0:
                dear = cost[frame, n]
                best = grid[frame + 1, n + 1] + dear
                skipped = grid[frame, n + 1] + dear
                doubled = grid[frame + 1, n] + (dear + dear)
                if doubled < best and doubled < skipped:
                    frame, n = frame - 1, n - 2
                elif skipped < best:
                    frame, n = frame - 2, n - 1
                else:
                    frame, n = frame - 1, n - 1
            starts[place] = frame + begin
