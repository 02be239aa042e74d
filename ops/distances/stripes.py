"""Coarse sums of many templates at once, their columns dealt out so that every step of a path stays in its byte lane.

Where columns lie one after the other, column n needs what columns n − 1 and n − 2 had a frame before: vectors that were
written across the borders of those that are read, for which a processor waits until they are in the cache. Here each
column lies `SLOTS` bytes behind the one before it, so that vectors are read as they were written.
"""

from __future__ import annotations

import numba as nb
import numpy as np
import numpy.typing as npt

from kinedex.ops.distances.costs import F64, I32, I64, CodedWords, Layout, fill_bounds, unit_scales
from kinedex.ops.words import NO_WORD, U64

U8 = npt.NDArray[np.uint8]

SLOTS = 64
"""Columns that lie side by side in a row: the bytes of the widest vector, and of a line of the cache."""

COARSE_CAP = 255
"""Sums of coarse units stop here, the greatest number of 8 bits: every addition stops there by itself."""

BLOCK = 8
"""Frames whose least sum is kept."""


def least_sums(layout: Layout, coded: CodedWords, units: F64, pieces: I64) -> U8:
    """Return the least sum of coarse units that a path of each template has, by blocks of `BLOCK` frames.

    *Places.* The columns of all templates stand one below the other in slots: R rows a slot, slot after slot. A
    template takes up whole slots, and is moved down in them so that its last column is in the last row; one cell or
    more is left above its first column. So the column before another one is in the row above it, or in the last row of
    the slot before, and all templates end in one row.

    *Sums.* They are those of `ops.distances.sweep.sweep` in whole units that stop at 255. Additions that stop there can
    be done in any order, and what all sides of a comparison get can be added afterwards: of the least of
    d(f−1, n−1) + c, d(f−2, n−1) + c, and d(f−1, n−2) + 2c is left c + min(d(f−1, n−1), d(f−2, n−1), d(f−1, n−2) + c).

    *Begins.* The cells above a first column always hold 0, so that it costs c alone: they begin with 0, cost nothing,
    and what is above the highest of them is 0. The second column has such a cell two columns before it. So there are
    more paths than there should be: those that leave out the first column and count the second one twice. The least sum
    of more paths is no greater: it is a lower bound all the same. What comes over from another template is no less than
    the 0 that is there already.

    Parameters
    ----------
    layout: T templates, at most `SLOTS` / 2. units: float64 (T,), what a unit is worth, as a cost.
    pieces: see `ops.distances.sweep.pieces_of`.

    Returns
    -------
    uint8 (T, B), `COARSE_CAP` for all that is no less, and outside the pieces.
    """
    rows, slots, places = deal(layout.lengths)
    sums = np.full((len(slots), -(-len(coded) // BLOCK)), COARSE_CAP, np.uint8)
    if not len(pieces):
        return sums
    width = rows * SLOTS
    others = np.setdiff1d(np.arange(width), places)
    table = _table(layout, coded.vocabulary, units, places, others, width)
    fresh = aligned((2 * SLOTS + width,), COARSE_CAP)
    fresh[2 * SLOTS + others] = 0
    above = aligned((2 * SLOTS,), COARSE_CAP)
    above[SLOTS + np.concatenate(([0], slots[:-1] + 1))] = 0
    longest = int((pieces[:, 2] - pieces[:, 1]).max())
    least = aligned((longest // BLOCK + 3, SLOTS))
    sweep_stripes(table, coded.codes, pieces, fresh, above, aligned((3, len(fresh))), least, slots, sums)
    return sums


def deal(lengths: I64) -> tuple[int, I64, I64]:
    """Deal out the columns of templates.

    Parameters
    ----------
    lengths: int64 (T,), columns of each, at most `SLOTS` / 2 templates.

    Returns
    -------
    The number of rows; the slot in which each template ends, int64 (T,); and for all columns, template after template,
    the place in rows of `SLOTS`.
    """
    # An even number, because compilers go over two vectors at a time and over a last one byte by byte.
    rows = 2 * max(1, -(-int((lengths + 1).sum()) // (2 * SLOTS)))
    while int(-(-(lengths + 1) // rows).sum()) > SLOTS:
        rows += 2
    ends = np.cumsum(-(-(lengths + 1) // rows))
    down = np.arange(int(lengths.sum())) + np.repeat(ends * rows - np.cumsum(lengths), lengths)
    return rows, ends - 1, down % rows * SLOTS + down // rows


def _table(layout: Layout, vocabulary: U64, units: F64, places: I64, others: I64, width: int) -> U8:
    """Tabulate the units of every word against every column, each in its place; all others cost nothing."""
    own = np.setdiff1d(np.arange(len(layout.masks)), layout.padding)
    values, groups = np.zeros(width, np.uint64), len(layout.parts)
    parts, worths = np.zeros((groups, width), np.uint64), np.zeros((groups, width))
    values[places], parts[:, places] = layout.values[own], layout.parts[:, own]
    worths[:, places] = (layout.worths * unit_scales(layout, units))[:, own]
    table = aligned((len(vocabulary), width))
    fill_bounds(vocabulary, values, parts, worths, COARSE_CAP, np.ones(len(vocabulary), np.bool_), table)
    table[np.ix_(vocabulary == NO_WORD, others)] = 0
    return table


def aligned(shape: tuple[int, ...], value: int | None = None) -> U8:
    """An array of bytes that begins with a line of the cache, filled if told; vectors across two lines take longer."""
    size = int(np.prod(shape))
    room = np.empty(size + SLOTS, np.uint8)
    begin = -room.ctypes.data % SLOTS
    cells: U8 = room[begin : begin + size].reshape(shape)
    if value is not None:
        cells.fill(value)
    return cells


@nb.njit(cache=True, nogil=True)
def sweep_stripes(
    table: U8, codes: I32, pieces: I64, fresh: U8, above: U8, state: U8, least: U8, slots: I64, sums: U8
) -> None:  # fmt: skip
    """Lower `sums` to the least that the paths of all templates have in the blocks of pieces (kernel).

    The two rows above the first one repeat the last two, each cell one slot further, and 0 where a template begins.

    Parameters
    ----------
    table: uint8 (W, S), S = R · `SLOTS`, R even. fresh: uint8 (S + 2 · `SLOTS`,), the sums before the first frame of a
        piece. above: uint8 (2 · `SLOTS`,), what the two rows above the first hold at most.
    state: uint8 (3, S + 2 · `SLOTS`), and least: uint8 (BL, `SLOTS`), for more blocks than the longest piece has: room.
    slots: int64 (T,), see `deal`. sums: uint8 (T, B).
    """
    columns, cap = table.shape[1], np.uint8(COARSE_CAP)
    for piece in range(len(pieces)):
        before, behind, here = state[0], state[1], state[2]
        for n in range(len(fresh)):
            before[n] = behind[n] = here[n] = fresh[n]
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
                one, two, own = behind[n + SLOTS], before[n + SLOTS], cost[n]
                far = np.uint8(behind[n] + own)
                far = far if far >= own else cap
                near = one if one < two else two
                near = near if near < far else far
                total = np.uint8(near + own)
                here[n + 2 * SLOTS] = total if total >= own else cap
            for slot in range(SLOTS):
                one, two = ends[slot], lowest[slot]
                lowest[slot] = one if one < two else two
            before, behind, here = behind, here, before
        for t in range(len(slots)):
            lower(sums[t, first : first + count], least[:count, slots[t]])


@nb.njit(cache=True, nogil=True)
def lower(sums: U8, others: U8) -> None:
    """Lower sums to others where these are less (kernel)."""
    for n in range(len(sums)):
        one, two = sums[n], others[n]
        sums[n] = one if one < two else two
