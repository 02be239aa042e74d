"""This module holds the inner loops of subsequence DTW, frame by frame over adjacent columns, for several pieces.

Coarse sums of many templates are computed together, with columns arranged in stripes for SIMD instructions on bytes. If
the columns of a template were adjacent in memory, column n would need the values of columns n − 1 and n − 2 in the
previous frame. Loading them would straddle vectors that were just stored, so that the processor would stall until the
stores reach the cache. In stripes, each column lies `SLOTS` bytes after the previous column of its template, so that
every vector is loaded as it was stored.
"""

from __future__ import annotations

import numba as nb
import numpy as np

from kinedex.ops.arrays import F64, I32, I64, U8, U16, U64
from kinedex.ops.copies import copy_table
from kinedex.ops.distances.costs import CodedWords, Layout, Table, TemplateColumns, fill_bounds, in_units
from kinedex.ops.distances.recurrence import COARSE_CAP, coarse_path_cost, path_cost
from kinedex.ops.words import NO_WORD

LANES = 4
"""The number of pieces that are computed together, each in a lane. A frame depends on the previous frame, whose stores
may not have completed; while one piece waits for its stores, another piece is computed. (The number is a constant, so
that the loop over lanes is unrolled.)
"""

CHUNK = 512
"""The number of frames after which the lanes write their results."""

CAP = 21845
"""The number at which sums of whole units saturate; a (2,1) step of the greatest cost on top still fits 16 bits.
"""

SLOTS = 64
"""The number of columns in a row, which is the number of bytes of the widest vector and of a cache line."""

BLOCK = 8
"""The number of frames in a block, for which a single smallest sum is stored."""


def pieces_of(ranges: I64, longest: int, lead_in: int) -> I64:
    """Divide ranges into pieces that can be computed independently of each other.

    A path through N columns begins at most 2(N − 1) frames before its end. So the results in a piece equal those of the
    whole range if the computation begins that many frames earlier (the lead-in), or at the start of the range.

    Parameters
    ----------
    ranges : int64 array (R, 2)
        Half-open ranges of frames, none of them empty.
    longest : int
        The maximum number of frames of a piece, without the lead-in.
    lead_in : int
        2(N − 1) for the longest template.

    Returns
    -------
    int64 array (P, 3)
        The frame where the computation begins, and the half-open range of the frames whose results are wanted.
    """
    counts = -(-(ranges[:, 1] - ranges[:, 0]) // longest)
    source = np.repeat(np.arange(len(ranges)), counts)
    place = np.arange(len(source)) - np.repeat(np.cumsum(counts) - counts, counts)
    starts = ranges[source, 0] + place * longest
    stops = np.minimum(starts + longest, ranges[source, 1])
    return np.stack([np.maximum(starts - lead_in, ranges[source, 0]), starts, stops], axis=1)


@nb.njit(cache=True, nogil=True)
def refill(pieces: I64, following: int, lanes: I64, state: Table, initial: float) -> tuple[int, int]:
    """Assign the next pieces to lanes that have finished theirs (kernel).

    Parameters
    ----------
    pieces : int64 array (P, 3)
        See `pieces_of`.
    following : int
        The next piece.
    lanes : int64 array (LANES, 3)
        For each lane the next frame to compute, the first frame whose result is wanted, and the stop frame, which is -1
        for a lane without a piece; such a lane repeats the work of another.
    state : array (3, LANES, columns + 2)
        The sums of each lane, which become `initial` at the beginning of a piece.
    initial : float
        The value of sums before the first frame of a piece.

    Returns
    -------
    (int, int)
        The next unassigned piece, and the number of frames that all lanes can still compute.
    """
    steps = 0
    for k in range(len(lanes)):
        if lanes[k, 0] == lanes[k, 2] and following < len(pieces):
            for field in range(3):
                lanes[k, field] = pieces[following, field]
            state[:, k, :] = initial
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
def write_results(lanes: I64, steps: int, found: Table, sums: Table, first: int) -> None:
    """Write the results of the lanes into `sums`, from the frame `first` on, and advance the lanes (kernel)."""
    for k in range(len(lanes)):
        at = lanes[k, 0]
        start = max(at, lanes[k, 1])
        if lanes[k, 2] >= 0 and start < at + steps:
            copy_table(sums[:, first + start : first + at + steps], found[:, k, start - at : steps])
        lanes[k, 0] = at + steps


@nb.njit(cache=True, nogil=True)
def sweep(table: Table, codes: I32, pieces: I64, firsts: I64, lasts: I64, sums: Table, first: int) -> None:
    """Fill in the costs of the best paths of all templates of a layout, in the precision of the table (kernel).

    All three steps advance in the take, so that a frame depends only on the two frames before it, and the columns of a
    frame are independent of each other. Hence the loop over columns vectorises. A column of ∞ before the first column
    of each template prevents (2,1) steps from the previous template; the first column holds only the local cost.

    Parameters
    ----------
    table : array (W, S)
        See `ops.distances.costs.cost_table`.
    codes : int32 array (L,)
        The index in the vocabulary of the word of each frame, see `CodedWords`.
    pieces : int64 array (P, 3)
        The pieces of frames to compute, see `pieces_of`.
    firsts, lasts : int64 array (T,)
        The first and the last column of each template.
    sums : array (T, M)
        The results; frames outside the pieces are left as they are.
    first : int
        The index in `sums` of the first code's result.
    """
    columns = table.shape[1]
    state = np.full((3, LANES, columns + 2), np.inf, table.dtype)
    found = np.empty((len(firsts), LANES, CHUNK), table.dtype)
    lanes = np.zeros((LANES, 3), np.int64)
    previous, last, here = 0, 1, 2
    following, steps = refill(pieces, np.int64(0), lanes, state, np.inf)
    while steps > 0:
        before, behind, now = state[previous], state[last], state[here]
        for step in range(steps):
            for k in range(LANES):
                cost = table[codes[lanes[k, 0] + step]]
                a, b, c = before[k], behind[k], now[k]
                for n in range(columns):
                    c[n + 2] = path_cost(b[n + 1], a[n + 1], b[n], cost[n])
                for t in range(len(firsts)):
                    c[firsts[t] + 2] = cost[firsts[t]]
                for t in range(len(firsts)):
                    found[t, k, step] = c[lasts[t] + 2]
            before, behind, now = behind, now, before
        turn = steps % 3
        previous, last, here = (previous + turn) % 3, (last + turn) % 3, (here + turn) % 3
        write_results(lanes, steps, found, sums, first)
        following, steps = refill(pieces, following, lanes, state, np.inf)


@nb.njit(cache=True, nogil=True)
def sweep_bounds(table: U16, codes: I32, pieces: I64, final: int, sums: U16) -> None:
    """Fill in one template's lower bounds in whole units, saturated at `CAP` (kernel).

    This is `sweep` with saturating sums: a cell has the value `CAP` if no path of fewer units reaches it.

    Parameters
    ----------
    table : uint16 array (W, S)
        See `ops.distances.costs.bound_table`.
    codes : int32 array (L,)
        The index in the vocabulary of the word of each frame, see `CodedWords`.
    pieces : int64 array (P, 3)
        The pieces of frames to compute, see `pieces_of`.
    final : int
        The template's last column.
    sums : uint16 array (1, L)
        The results.
    """
    columns = table.shape[1]
    cap = np.uint16(CAP)
    state = np.full((3, LANES, columns + 2), cap, np.uint16)
    found = np.empty((1, LANES, CHUNK), np.uint16)
    lanes = np.zeros((LANES, 3), np.int64)
    previous, last, here = 0, 1, 2
    following, steps = refill(pieces, np.int64(0), lanes, state, CAP)
    while steps > 0:
        before, behind, now = state[previous], state[last], state[here]
        for step in range(steps):
            for k in range(LANES):
                cost = table[codes[lanes[k, 0] + step]]
                a, b, c = before[k], behind[k], now[k]
                for n in range(columns):
                    least = path_cost(b[n + 1], a[n + 1], b[n], cost[n])
                    c[n + 2] = least if least < cap else cap
                c[2] = cost[0]
                found[0, k, step] = c[final + 2]
            before, behind, now = behind, now, before
        turn = steps % 3
        previous, last, here = (previous + turn) % 3, (last + turn) % 3, (here + turn) % 3
        write_results(lanes, steps, found, sums, np.int64(0))
        following, steps = refill(pieces, following, lanes, state, CAP)


def least_sums(layout: Layout, coded: CodedWords, units: F64, pieces: I64) -> U8:
    """Return the smallest sum of coarse units over the paths of each template that end in each block of `BLOCK` frames.

    *Layout.* The columns of all templates are stacked in slots of R rows, slot after slot. A template occupies whole
    slots, and is shifted down in them so that its last column is in the last row, with at least one empty cell above
    its first column. So each column's predecessor is in the row above it, or in the last row of the slot before, and
    all templates end in the same row.

    *Starts.* The cells above a first column always hold 0, so that the first column costs c alone. The second column
    has such a cell two columns before it, which allows additional paths that skip the first column and count the second
    one twice. The smallest sum over more paths is no greater, so it is still a lower bound. Values carried over from
    another template are at least 0, so they do not lower these cells.

    Parameters
    ----------
    layout : Layout
        T templates, at most `SLOTS` / 2.
    coded : CodedWords
        The words of the frames.
    units : float64 array (T,)
        The cost that a unit of each template stands for.
    pieces : int64 array (P, 3)
        See `ops.distances.sweep.pieces_of`.

    Returns
    -------
    uint8 array (T, B)
        The sums, saturated at `COARSE_CAP`, which is also the value outside the pieces.
    """
    rows, slots, positions = place_columns(layout.lengths)
    sums = np.full((len(slots), -(-len(coded) // BLOCK)), COARSE_CAP, np.uint8)
    if not len(pieces):
        return sums
    width = rows * SLOTS
    others = np.setdiff1d(np.arange(width), positions)
    table = _table(layout, coded.vocabulary, units, positions, others, width)
    initial = aligned_bytes((2 * SLOTS + width,), COARSE_CAP)
    initial[2 * SLOTS + others] = 0
    above = aligned_bytes((2 * SLOTS,), COARSE_CAP)
    above[SLOTS + np.concatenate(([0], slots[:-1] + 1))] = 0
    longest = int((pieces[:, 2] - pieces[:, 1]).max())
    least = aligned_bytes((longest // BLOCK + 3, SLOTS), COARSE_CAP)
    state = aligned_bytes((3, len(initial)), COARSE_CAP)
    sweep_stripes(table, coded.codes, pieces, initial, above, state, least, slots, sums)
    return sums


def place_columns(lengths: I64) -> tuple[int, I64, I64]:
    """Assign the columns of templates to rows of `SLOTS` bytes.

    Parameters
    ----------
    lengths : int64 array (T,)
        The number of columns of each template, at most `SLOTS` / 2 templates.

    Returns
    -------
    rows : int
        The number of rows.
    slots : int64 array (T,)
        The slot in which each template ends.
    places : int64 array
        The byte position of each column, template after template.
    """
    # The number is even, as compilers process two vectors at a time and a single last one byte by byte.
    rows = 2 * max(1, -(-int((lengths + 1).sum()) // (2 * SLOTS)))
    while int(-(-(lengths + 1) // rows).sum()) > SLOTS:
        rows += 2
    ends = np.cumsum(-(-(lengths + 1) // rows))
    down = np.arange(int(lengths.sum())) + np.repeat(ends * rows - np.cumsum(lengths), lengths)
    return rows, ends - 1, down % rows * SLOTS + down // rows


def _table(layout: Layout, vocabulary: U64, units: F64, positions: I64, others: I64, width: int) -> U8:
    """Tabulate the units of every word against every column at the columns' byte positions; other bytes are 0."""
    own = np.setdiff1d(np.arange(layout.width), layout.padding)
    columns, groups = in_units(layout, units), len(layout.columns.group_masks)
    values, masks, weights = np.zeros(width, np.uint64), np.zeros((groups, width), np.uint64), np.zeros((groups, width))
    values[positions], masks[:, positions] = columns.values[own], columns.group_masks[:, own]
    weights[:, positions] = columns.group_weights[:, own]
    table = aligned_bytes((len(vocabulary), width))
    placed = TemplateColumns(values, masks, weights, np.ones(width))
    fill_bounds(vocabulary, placed, COARSE_CAP, np.ones(len(vocabulary), np.bool_), table)
    table[np.ix_(vocabulary == NO_WORD, others)] = 0
    return table


def aligned_bytes(shape: tuple[int, ...], value: int | None = None) -> U8:
    """Return an array of bytes that begins at a cache line, filled with a value if one is given.

    Loads of vectors across two cache lines take longer.
    """
    size = int(np.prod(shape))
    memory = np.empty(size + SLOTS, np.uint8)
    begin = -memory.ctypes.data % SLOTS
    cells: U8 = memory[begin : begin + size].reshape(shape)
    if value is not None:
        cells.fill(value)
    return cells


@nb.njit(cache=True, nogil=True)
def sweep_stripes(
    table: U8, codes: I32, pieces: I64, initial: U8, above: U8, state: U8, least: U8, slots: I64, sums: U8
) -> None:  # fmt: skip
    """Lower `sums` to the smallest sums of the paths of all templates that end in the blocks of pieces (kernel).

    The two rows above the first one repeat the last two, shifted by one slot, with 0 where a template begins.

    Parameters
    ----------
    table : uint8 array (W, S)
        The units of words, S = R · `SLOTS`, R even.
    codes : int32 array (L,)
        The index in the vocabulary of the word of each frame, see `CodedWords`.
    pieces : int64 array (P, 3)
        The pieces of frames to compute, see `pieces_of`.
    initial : uint8 array (S + 2 · `SLOTS`,)
        The sums before the first frame of a piece.
    above : uint8 array (2 · `SLOTS`,)
        Upper limits of the values in the two rows above the first row.
    state : uint8 array (3, S + 2 · `SLOTS`)
        Memory for the sums of three frames.
    least : uint8 array (BL, `SLOTS`)
        Memory for the sums of the blocks of a piece, one block more than the longest piece has.
    slots : int64 array (T,)
        See `place_columns`.
    sums : uint8 array (T, B)
        The results.
    """
    columns, cap = table.shape[1], np.uint8(COARSE_CAP)
    for piece in range(len(pieces)):
        before, behind, here = state[0], state[1], state[2]
        for n in range(len(initial)):
            before[n] = behind[n] = here[n] = initial[n]
        begin, first = pieces[piece, 1], pieces[piece, 1] // BLOCK
        count = (pieces[piece, 2] - 1) // BLOCK + 1 - first
        least[: count + 1] = cap
        for frame in range(pieces[piece, 0], pieces[piece, 2]):
            cost, lasts, ends = table[codes[frame]], behind[columns - 1 :], here[columns + SLOTS :]
            lowest = least[frame // BLOCK - first if frame >= begin else count]
            for n in range(2 * SLOTS):
                one, two = lasts[n], above[n]
                behind[n] = one if one < two else two
            for n in range(columns):
                here[n + 2 * SLOTS] = coarse_path_cost(behind[n + SLOTS], before[n + SLOTS], behind[n], cost[n])
            for slot in range(SLOTS):
                one, two = ends[slot], lowest[slot]
                lowest[slot] = one if one < two else two
            before, behind, here = behind, here, before
        for t in range(len(slots)):
            lower(sums[t, first : first + count], least[:count, slots[t]])


@nb.njit(cache=True, nogil=True)
def lower(sums: U8, others: U8) -> None:
    """Replace each sum by the other one if that is less (kernel)."""
    for n in range(len(sums)):
        one, two = sums[n], others[n]
        sums[n] = one if one < two else two
