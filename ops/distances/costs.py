"""This module computes local costs of templates (thesis, Eq. 5.2), tabulated for each different word."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numba as nb
import numpy as np

from kinedex.ops.arrays import F64, I32, I64, U64, Array, Bool
from kinedex.ops.bits import count_bits
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import NO_WORD

Table = Array  # float32, float64, or uint16 and uint8 of lower bounds

PADDING = 32
"""Width in columns of which tables are a multiple, so that vectorised loops over columns have no remainder."""

_NO_WORD = np.uint64(NO_WORD)
_SHAVE = 1 - 1e-9  # factor of a unit for rounding, see `bound_table`
_LOWER, _SPREAD, _SPREAD_TOO = np.uint64(0xFFFF_FFFF), np.uint64(0x9E37_79B9), np.uint64(0x85EB_CA6B)
_32 = np.uint64(32)


@dataclass(frozen=True)
class CodedWords:
    """The words of frames as indices of a vocabulary, so that costs are computed once for each different word.

    Parameters
    ----------
    vocabulary : uint64 array (W,)
        The different words in the order of their first occurrence.
    codes : int32 array (L,)
        For each frame the index of its word in the vocabulary.
    """

    vocabulary: U64
    codes: I32

    def __len__(self) -> int:
        return len(self.codes)


class TemplateColumns(NamedTuple):
    """The columns of one or several templates, for kernels that compute local costs.

    Features of equal weight form a group. There are at most G groups, and one group if there are no weights. The cost
    of a column is a sum over the groups, of `group_weights` times the number of the group's bits that a word
    contradicts, divided by `total_weights`.

    Parameters
    ----------
    values : uint64 array (N,)
        The required bits of each column.
    group_masks : uint64 array (G, N)
        The bits of each group that are fixed.
    group_weights : float64 array (G, N)
        The weight of a feature of each group.
    total_weights : float64 array (N,)
        The total weight of all fixed bits of each column, 1 for a column without fixed bits.
    """

    values: U64
    group_masks: U64
    group_weights: F64
    total_weights: F64


@dataclass(frozen=True)
class Layout:
    """The columns of several templates side by side, separated by a column of infinite cost and padded at the end.

    Parameters
    ----------
    columns : TemplateColumns
        S columns, a multiple of `PADDING`.
    firsts, lasts : int64 array (T,)
        The first and the last column of each template.
    padding : int64 array
        The columns that belong to no template.
    """

    columns: TemplateColumns
    firsts: I64
    lasts: I64
    padding: I64

    @property
    def lengths(self) -> I64:
        """Return the number of columns of each template, int64 (T,)."""
        return self.lasts - self.firsts + 1

    @property
    def width(self) -> int:
        """Return the number of columns S, including padding."""
        return len(self.columns.values)


def encode(words: U64, ranges: I64 | None = None) -> CodedWords:
    """Replace words by indices of a vocabulary of the different words, in the order of their first occurrence.

    Parameters
    ----------
    words : uint64 array (L,)
        One word for each frame; `NO_WORD` if the frame is invalid.
    ranges : int64 array (R, 2), optional
        Half-open ranges of frames, ascending and disjoint. Only the words in these ranges get codes; the other codes
        are undefined. None for all frames.
    """
    codes = np.empty(len(words), np.int32)
    whole = np.array([[0, len(words)]], np.int64)
    wanted = whole if ranges is None else np.ascontiguousarray(ranges, np.int64).reshape(-1, 2)
    frames = int((wanted[:, 1] - wanted[:, 0]).sum())
    vocabulary = np.empty(frames, np.uint64)
    slots = np.full(1 << max(4, (2 * frames).bit_length()), -1, np.int32)
    given, count = np.ascontiguousarray(words, np.uint64), 0
    for start, stop in wanted.tolist():
        count = number_words(given[start:stop], slots, vocabulary, count, codes[start:stop])
    return CodedWords(vocabulary[:count].copy(), codes)


def template_columns(template: QuantisedTemplate) -> TemplateColumns:
    """Return the columns of one template in the form that kernels expect."""
    bits, weights = _weight_groups(template)
    masks = template.mask & bits[:, None]
    group_weights = np.repeat(weights[:, None], len(template), axis=1)
    return TemplateColumns(np.array(template.value), masks, group_weights, _total_weights(masks, group_weights))


def column_layout(templates: Sequence[QuantisedTemplate]) -> Layout:
    """Arrange the columns of templates side by side, see `Layout`."""
    lengths = np.array([len(template) for template in templates], np.int64)
    firsts = np.concatenate(([0], np.cumsum(lengths + 1)[:-1])).astype(np.int64)
    lasts = firsts + lengths - 1
    width = -(-(int(lasts[-1]) + 1) // PADDING) * PADDING
    values, own = np.zeros(width, np.uint64), np.zeros(width, np.bool_)
    groups = [_weight_groups(template) for template in templates]
    most = max(len(bits) for bits, _ in groups)
    masks, weights = np.zeros((most, width), np.uint64), np.ones((most, width))
    for template, (bits, each), first, last in zip(templates, groups, firsts.tolist(), lasts.tolist(), strict=True):
        values[first : last + 1] = template.value
        own[first : last + 1] = True
        masks[: len(bits), first : last + 1] = template.mask & bits[:, None]
        weights[: len(bits), first : last + 1] = each[:, None]
    columns = TemplateColumns(values, masks, weights, _total_weights(masks, weights))
    return Layout(columns, firsts, lasts, np.flatnonzero(~own))


def _weight_groups(template: QuantisedTemplate) -> tuple[U64, F64]:
    """Group features of equal weight; return the bits of each group, uint64 (G,), and its weight, float64 (G,)."""
    if template.feature_weights is None:
        return np.array([~np.uint64(0)]), np.ones(1)
    weights, group = np.unique(template.feature_weights, return_inverse=True)
    bits = np.zeros(len(weights), np.uint64)
    np.bitwise_or.at(bits, group, np.uint64(1) << np.arange(len(group), dtype=np.uint64))
    if not (weights > 0).any():  # as for a column of wildcards, nothing can be contradicted
        return np.zeros(1, np.uint64), np.ones(1)
    return bits[weights > 0], weights[weights > 0]


def _total_weights(masks: U64, weights: F64) -> F64:
    """Return the total weight of all fixed bits of each column, 1 for a column without fixed bits."""
    total: F64 = (weights * np.bitwise_count(masks)).sum(axis=0)
    total[total == 0] = 1.0
    return total


def cost_table(layout: Layout, vocabulary: U64, dtype: type[np.floating[Any]] = np.float64) -> Table:
    """Tabulate the local cost of every word against every column, one row for each word.

    A cost is the weight of the column's fixed bits that the word contradicts, divided by the weight of all its fixed
    bits; without weights, each bit has the weight 1. It is 0 for a column with only wildcards, and ∞ for `NO_WORD` and
    for padding. In float32, costs are rounded to multiples of `grid_step`.

    Parameters
    ----------
    layout : Layout
        The columns of the templates.
    vocabulary : uint64 array (W,)
        The different words, see `CodedWords`.
    dtype : type
        float64 or float32.

    Returns
    -------
    array of dtype (W, S)
    """
    step = grid_step(int(layout.lengths.max())) if dtype is np.float32 else 0.0
    table = np.empty((len(vocabulary), layout.width), dtype)
    fill_costs(vocabulary, layout.columns, step, table)
    for last in layout.lasts[:-1].tolist():
        table[:, last + 1] = np.inf
    table[:, int(layout.lasts[-1]) + 1 :] = np.inf
    return table


def bound_table(
    layout: Layout, vocabulary: U64, units: F64, most: int, dtype: type[np.unsignedinteger[Any]], needed: Bool
) -> Table:
    """Tabulate lower bounds of local costs in whole units, min(⌊cost / unit⌋, most).

    Costs are scaled down slightly, so that rounding never makes a bound too high.

    Parameters
    ----------
    layout : Layout
        The columns of the templates.
    vocabulary : uint64 array (W,)
        The different words, see `CodedWords`.
    units : float64 array (T,)
        The cost that a unit of each template stands for.
    most : int
        The value for all greater costs, for `NO_WORD` and for columns that belong to no template.
    dtype : type
        uint16 or uint8.
    needed : bool array (W,)
        The words whose rows are filled; the other rows are undefined.

    Returns
    -------
    array of dtype (W, S)
    """
    table = np.empty((len(vocabulary), layout.width), dtype)
    fill_bounds(vocabulary, in_units(layout, units), most, needed, table)
    table[np.ix_(np.flatnonzero(needed), layout.padding)] = most
    return table


def in_units(layout: Layout, units: F64) -> TemplateColumns:
    """Return the columns with group weights divided by each template's unit, scaled slightly down; 0 for padding.

    Parameters
    ----------
    layout : Layout
        The columns of the templates.
    units : float64 array (T,)
        The cost that a unit of each template stands for.
    """
    columns = layout.columns
    scales = np.zeros(layout.width)
    for first, last, unit in zip(layout.firsts.tolist(), layout.lasts.tolist(), units.tolist(), strict=True):
        scales[first : last + 1] = _SHAVE / unit / columns.total_weights[first : last + 1]
    return columns._replace(group_weights=columns.group_weights * scales)


def grid_step(columns: int) -> float:
    """Return the step to whose multiples float32 costs are rounded: 2^−24 times the smallest power of two ≥ `columns`.

    A complete path through a template of N columns has a total weight of N, since a (2,1) step counts twice, and each
    local cost is at most 1. Costs that are multiples of the step therefore add up to at most 2^24 steps. float32
    represents all these sums exactly, so that no further rounding occurs, in whatever order the costs are added.

    A float32 distance therefore differs from the exact one by at most step / 2 + 2^−24. Rounding changes a local cost
    by at most half a step, and the cost of a path of weight N by at most N / 2 steps. The same bound holds for the
    lowest cost over all paths, since |min a − min b| ≤ max |a − b|. After the division by N the error is half a step;
    the division rounds a number of at most 1 by at most 2^−25, and float64 errs by far less than another 2^−25.
    """
    return float(2.0 ** (max(columns - 1, 0).bit_length() - 24))


@nb.njit(cache=True, nogil=True)
def number_words(words: U64, slots: I32, vocabulary: U64, count: int, codes: I32) -> int:
    """Number words in the order of their first occurrence, with open addressing; return their number (kernel).

    The first `count` entries of the vocabulary were numbered before.
    """
    last = len(slots) - 1
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
    """Count the fixed bits of a column that a word contradicts (kernel)."""
    return count_bits((word ^ value) & mask)


@nb.njit(cache=True, nogil=True)
def column_costs(word: np.uint64, columns: TemplateColumns, costs: F64) -> None:
    """Fill in the costs of columns against a word other than `NO_WORD` (kernel).

    Parameters
    ----------
    word : uint64
        The word.
    columns : TemplateColumns
        The columns of the templates.
    costs : float64 array (N,)
        The results.
    """
    values, masks, weights, total = columns
    if len(masks) == 1:
        mask, weight = masks[0], weights[0]
        for n in range(len(costs)):
            costs[n] = np.float64(contradictions(word, mask[n], values[n])) * weight[n] / total[n]
        return
    contradicted_weights(word, columns, costs)
    for n in range(len(costs)):
        costs[n] /= total[n]


@nb.njit(cache=True, nogil=True)
def contradicted_weights(word: np.uint64, columns: TemplateColumns, sums: F64) -> None:
    """Fill in the total weight of the bits of each column that a word contradicts (kernel)."""
    values, masks, weights, _ = columns
    for g in range(len(masks)):
        mask, weight = masks[g], weights[g]
        if g == 0:
            for n in range(len(sums)):
                sums[n] = np.float64(contradictions(word, mask[n], values[n])) * weight[n]
        else:
            for n in range(len(sums)):
                sums[n] += np.float64(contradictions(word, mask[n], values[n])) * weight[n]


@nb.njit(cache=True, nogil=True)
def fill_costs(vocabulary: U64, columns: TemplateColumns, step: float, table: Table) -> None:
    """Fill a table with costs, rounded to multiples of `step` unless it is 0 (kernel)."""
    costs = np.empty(len(columns.values))
    for w in range(len(vocabulary)):
        if vocabulary[w] == _NO_WORD:
            table[w, :] = np.inf
            continue
        column_costs(vocabulary[w], columns, costs)
        if step == 0.0:
            for n in range(len(costs)):
                table[w, n] = costs[n]
        else:
            for n in range(len(costs)):
                table[w, n] = np.rint(costs[n] / step) * step


@nb.njit(cache=True, nogil=True)
def fill_bounds(vocabulary: U64, columns: TemplateColumns, cap: int, needed: Bool, table: Table) -> None:
    """Fill a table with lower bounds of costs in whole units, at most `cap` (kernel).

    Parameters
    ----------
    vocabulary : uint64 array (W,)
        The different words, see `CodedWords`.
    columns : TemplateColumns
        The columns with weights in units, see `in_units`.
    cap : int
        The greatest bound.
    needed : bool array (W,)
        The words whose rows are filled.
    table : array (W, S)
        The results.
    """
    most = np.float64(cap)
    units = np.empty(len(columns.values))
    for w in range(len(vocabulary)):
        word = vocabulary[w]
        if not needed[w]:
            continue
        if word == _NO_WORD:
            table[w, :] = cap
            continue
        contradicted_weights(word, columns, units)
        row = table[w]
        for n in range(len(units)):
            row[n] = np.uint16(units[n] if units[n] < most else most)
