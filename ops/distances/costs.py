"""Local costs of templates (thesis, Eq. 5.2): words as places in a vocabulary, and a table of costs for each word."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numba as nb
import numpy as np
import numpy.typing as npt

from kinedex.ops.bits import count_bits
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import NO_WORD, U64

F64 = npt.NDArray[np.float64]
I32 = npt.NDArray[np.int32]
I64 = npt.NDArray[np.int64]
Table = npt.NDArray[Any]  # float32, float64, or uint16 and uint8 of lower bounds

PADDING = 32
"""Tables are a multiple of this many columns wide, so that the loops over columns leave no rest behind."""

_NO_WORD = np.uint64(NO_WORD)
_SHAVE = 1 - 1e-9  # of a unit, see `bound_table`
_LOWER, _SPREAD, _SPREAD_TOO = np.uint64(0xFFFF_FFFF), np.uint64(0x9E37_79B9), np.uint64(0x85EB_CA6B)
_32 = np.uint64(32)


@dataclass(frozen=True)
class CodedWords:
    """Words as places in their vocabulary, so that what depends on the word only is computed once.

    vocabulary: uint64 (W,), the different words in the order in which they first occur. codes: int32 (L,).
    """

    vocabulary: U64
    codes: I32

    def __len__(self) -> int:
        return len(self.codes)


@dataclass(frozen=True)
class Layout:
    """The columns of several templates side by side, one column of infinite cost between two, padded at the end.

    The features of a template are grouped by their weight, into G groups at most; without weights there is one. A
    column's cost is Σ_g worths_g · (the bits of group g that a word contradicts) / counted.

    masks, values: uint64 (S,), S a multiple of `PADDING`. firsts, lasts: int64 (T,), the first and the last column of
    each template. padding: int64, the columns that belong to none. parts: uint64 (G, S), the bits of each group that
    are fixed. worths: float64 (G, S), the weight of each. counted: float64 (S,), the weight of all fixed bits, 1 where
    there is none.
    """

    masks: U64
    values: U64
    firsts: I64
    lasts: I64
    padding: I64
    parts: U64
    worths: F64
    counted: F64

    @property
    def lengths(self) -> I64:
        """Columns of each template, int64 (T,)."""
        return self.lasts - self.firsts + 1


def encode(words: U64) -> CodedWords:
    """Number the different words of a sequence of frames.

    Parameters
    ----------
    words: uint64 (L,), `NO_WORD` for an invalid frame.
    """
    codes = np.empty(len(words), np.int32)
    vocabulary = np.empty(len(words), np.uint64)
    slots = np.full(1 << max(4, (2 * len(words)).bit_length()), -1, np.int32)
    count = number_words(np.ascontiguousarray(words, np.uint64), slots, vocabulary, codes)
    return CodedWords(vocabulary[:count].copy(), codes)


def lay_out(templates: Sequence[QuantisedTemplate]) -> Layout:
    """Put the columns of templates side by side, see `Layout`."""
    lengths = np.array([len(template) for template in templates], np.int64)
    firsts = np.concatenate(([0], np.cumsum(lengths + 1)[:-1])).astype(np.int64)
    lasts = firsts + lengths - 1
    width = -(-(int(lasts[-1]) + 1) // PADDING) * PADDING
    masks, values, own = np.zeros(width, np.uint64), np.zeros(width, np.uint64), np.zeros(width, np.bool_)
    grouped = [_groups(template) for template in templates]
    most = max(len(bits) for bits, _ in grouped)
    parts, worths = np.zeros((most, width), np.uint64), np.ones((most, width))
    for template, (bits, weights), first, last in zip(templates, grouped, firsts.tolist(), lasts.tolist(), strict=True):
        masks[first : last + 1], values[first : last + 1] = template.mask, template.value
        own[first : last + 1] = True
        parts[: len(bits), first : last + 1] = template.mask & bits[:, None]
        worths[: len(bits), first : last + 1] = weights[:, None]
    counted = (worths * np.bitwise_count(parts)).sum(axis=0)
    counted[counted == 0] = 1.0
    return Layout(masks, values, firsts, lasts, np.flatnonzero(~own), parts, worths, counted)


def _groups(template: QuantisedTemplate) -> tuple[U64, F64]:
    """The features of each weight, as bits: uint64 (G,), and the weights, float64 (G,)."""
    if template.feature_weights is None:
        return np.array([~np.uint64(0)]), np.ones(1)
    weights, home = np.unique(template.feature_weights, return_inverse=True)
    bits = np.zeros(len(weights), np.uint64)
    np.bitwise_or.at(bits, home, np.uint64(1) << np.arange(len(home), dtype=np.uint64))
    if not (weights > 0).any():  # as wildcards alone: nothing is contradicted
        return np.zeros(1, np.uint64), np.ones(1)
    return bits[weights > 0], weights[weights > 0]


def cost_table(layout: Layout, vocabulary: U64, dtype: type[np.floating[Any]] = np.float64) -> Table:
    """Tabulate the local cost of every word against every column, word-major.

    A cost is the weight of a column's bits that the word contradicts as a share of the weight of all its bits (without
    weights: the share of its bits), 0 for a column of wildcards alone, ∞ for `NO_WORD` and in columns that belong to no
    template. In float32 costs are rounded to the grid of `grid_step`.

    Returns
    -------
    dtype (W, S).
    """
    step = grid_step(int(layout.lengths.max())) if dtype is np.float32 else 0.0
    table = np.empty((len(vocabulary), len(layout.masks)), dtype)
    fill_costs(vocabulary, layout.values, layout.parts, layout.worths, layout.counted, step, table)
    _fill_padding(layout, table, np.inf)
    return table


def _fill_padding(layout: Layout, table: Table, cost: float) -> None:
    """Give the columns between templates, and those behind the last one, a cost."""
    for last in layout.lasts[:-1].tolist():
        table[:, last + 1] = cost
    table[:, int(layout.lasts[-1]) + 1 :] = cost


def bound_table(
    layout: Layout,
    vocabulary: U64,
    units: F64,
    most: int,
    dtype: type[np.unsignedinteger[Any]],
    needed: npt.NDArray[np.bool_],
) -> Table:
    """Tabulate whole units that local costs hold at least: ⌊cost / unit⌋, and `most` where it is more or no cost.

    Units are counted a little low, so that rounding never makes a bound too high.

    Parameters
    ----------
    units: float64 (T,), what a unit of each template is worth, as a cost.
    needed: bool (W,), the words that are asked for; rows of others are left as they are.

    Returns
    -------
    dtype (W, S).
    """
    table = np.empty((len(vocabulary), len(layout.masks)), dtype)
    fill_bounds(
        vocabulary, layout.values, layout.parts, layout.worths * unit_scales(layout, units), most, needed, table
    )
    table[np.ix_(np.flatnonzero(needed), layout.padding)] = most
    return table


def unit_scales(layout: Layout, units: F64) -> F64:
    """Return how many units a weight of 1 is in each column, a little less: float64 (S,), 0 where no template is.

    units: float64 (T,), what a unit of each template is worth, as a cost.
    """
    scales = np.zeros(len(layout.masks))
    for first, last, unit in zip(layout.firsts.tolist(), layout.lasts.tolist(), units.tolist(), strict=True):
        scales[first : last + 1] = _SHAVE / unit / layout.counted[first : last + 1]
    return scales


def grid_step(columns: int) -> float:
    """The grid that float32 costs lie on, a power of two: 2^−24 times the least power of two ≥ the columns.

    A complete path of a template of N columns has N units of weight (a (2,1) step counts twice) and costs of at most 1
    a unit. Costs that are multiples of this step therefore add up to at most 2^24 steps, and float32 holds every such
    sum exactly: on the grid nothing is rounded, in whatever order the costs are added.
    """
    return float(2.0 ** (max(columns - 1, 0).bit_length() - 24))


def error_bound(columns: int) -> float:
    """How far a float32 distance can be from the exact one, for templates of so many columns at most.

    Proof. Rounding to the grid moves a local cost by half a step at most, and so a path of N units of weight by N/2
    steps; sums on the grid are exact (`grid_step`). The least cost over all paths moves by no more than the path that
    moves most: |min a − min b| ≤ max |a − b|. Divided by N that is half a step, and the division itself rounds a number
    of at most 1 by 2^−25 at most. Another 2^−25 is room for float64, which errs by far less.
    """
    return grid_step(columns) / 2 + 2.0**-24


@nb.njit(cache=True, nogil=True)
def number_words(words: U64, slots: I32, vocabulary: U64, codes: I32) -> int:
    """Number words in the order of their first occurrence, with open addressing; return how many there are (kernel)."""
    last = len(slots) - 1
    count = 0
    for frame in range(len(words)):
        word = words[frame]
        if frame > 0 and word == words[frame - 1]:
            codes[frame] = codes[frame - 1]
            continue
        mixed = (word & _LOWER) * _SPREAD ^ (word >> _32) * _SPREAD_TOO
        place = np.int64((mixed ^ (mixed >> _32)) & _LOWER) & last
        while slots[place] >= 0 and vocabulary[slots[place]] != word:
            place = (place + 1) & last
        if slots[place] < 0:
            slots[place] = count
            vocabulary[count] = word
            count += 1
        codes[frame] = slots[place]
    return count


@nb.njit(cache=True, nogil=True)
def contradictions(word: np.uint64, mask: np.uint64, value: np.uint64) -> np.int64:
    """Count the bits of a column that a word contradicts (kernel)."""
    return count_bits((word ^ value) & mask)


@nb.njit(cache=True, nogil=True)
def column_costs(word: np.uint64, values: U64, parts: U64, worths: F64, counted: F64, costs: F64) -> None:
    """Fill the costs of columns against a word that is one, as `Layout` says (kernel).

    values, counted, costs: of so many columns; parts, worths: (G, columns).
    """
    part, worth = parts[0], worths[0]
    if len(parts) == 1:
        for n in range(len(costs)):
            costs[n] = np.float64(contradictions(word, part[n], values[n])) * worth[n] / counted[n]
        return
    add_units(word, values, parts, worths, costs)
    for n in range(len(costs)):
        costs[n] /= counted[n]


@nb.njit(cache=True, nogil=True)
def add_units(word: np.uint64, values: U64, parts: U64, units: F64, sums: F64) -> None:
    """Fill the sums, over the groups, of contradictions and what one is worth (kernel)."""
    for g in range(len(parts)):
        part, unit = parts[g], units[g]
        if g == 0:
            for n in range(len(sums)):
                sums[n] = np.float64(contradictions(word, part[n], values[n])) * unit[n]
        else:
            for n in range(len(sums)):
                sums[n] += np.float64(contradictions(word, part[n], values[n])) * unit[n]


@nb.njit(cache=True, nogil=True)
def fill_costs(vocabulary: U64, values: U64, parts: U64, worths: F64, counted: F64, step: float, table: Table) -> None:
    """Fill a table with costs, rounded to multiples of a step where that is not 0 (kernel)."""
    costs = np.empty(len(values))
    for w in range(len(vocabulary)):
        if vocabulary[w] == _NO_WORD:
            table[w, :] = np.inf
            continue
        column_costs(vocabulary[w], values, parts, worths, counted, costs)
        if step == 0.0:
            table[w, :] = costs
        else:
            for n in range(len(costs)):
                table[w, n] = np.rint(costs[n] / step) * step


@nb.njit(cache=True, nogil=True)
def fill_bounds(
    vocabulary: U64, values: U64, parts: U64, units: F64, cap: int, needed: npt.NDArray[np.bool_], table: Table
) -> None:
    """Fill a table with whole units that a cost holds at least, `cap` where it is more (kernel).

    units: float64 (G, S), the units that one contradiction of each group of a column is worth.
    """
    most = np.float64(cap)
    costs = np.empty(len(values))
    for w in range(len(vocabulary)):
        word = vocabulary[w]
        if not needed[w]:
            continue
        if word == _NO_WORD:
            table[w, :] = cap
            continue
        add_units(word, values, parts, units, costs)
        row = table[w]
        for n in range(len(costs)):
            row[n] = np.uint16(costs[n] if costs[n] < most else most)
