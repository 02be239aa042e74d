"""This module bounds distance curves from below using only the coarse copy of bit slices, without words.

The coarse copy of `ops.search.bit_slices` has, for every granule of 8 frames, the features that are on in some frame
and those that are off in some. A feature that a template requires to be on is contradicted in every frame of a granule
where it is on in none. This bounds the cost of a path through a granule, whichever frames it visits.

*Blocks of columns.* The columns of a template are taken B at a time, the last ones at the end; fewer than B at its
beginning are ignored. A path collects a weight of B − 1 or more in a block: B for its columns, less one where a (2,1)
step skips the last of them, which counts in the block after. Each of these units costs at least what the block costs in
the cheapest granule that the path visits within it, and that is at least the fraction of entries, fixed alike in all
columns of the block, that the granule contradicts.

*Steps.* From a cell of a block to one of the next there are at most 2B − 1 columns, and so twice as many frames; the
granules of two consecutive blocks are therefore apart by 0 to (7 + 4B − 2) / 8. The cheapest choice of granules within
these steps, by dynamic programming, costs no more than the path divided by B − 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numba as nb
import numpy as np

from kinedex.ops.arrays import F32
from kinedex.ops.bits import count_bits
from kinedex.ops.distances.costs import I64, template_columns
from kinedex.ops.search.bit_slices import GRANULE, GRANULES, BitSlices, transpose
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import U64

LONG = 40
"""Number of columns from which templates are divided into blocks of 8 columns; others have blocks of 4."""

_ROUNDING = 1 + 1e-4
"""Factor by which sums in float32 may be too high."""


class GranuleBlocks(NamedTuple):
    """The blocks of columns of a template.

    Parameters
    ----------
    must_on, must_off : uint64 array (G, K)
        The features of each group of weights that all columns of a block require to be on, or off.
    weights : float32 array (G, K)
        The weight of a feature of each group as a fraction of all weights of a column.
    """

    must_on: U64
    must_off: U64
    weights: F32


@dataclass(frozen=True)
class GranuleWords:
    """The features that are on, and off, in some frame of each granule.

    Parameters
    ----------
    on, off : uint64 array
        One word per granule; take t begins at granule 8 · first[t] of the slices.
    """

    on: U64
    off: U64


def granule_words(slices: BitSlices, first: int, stop: int) -> GranuleWords:
    """Return the features that are on and off in the granules of takes `first` to `stop` − 1.

    Parameters
    ----------
    slices : BitSlices
        The slices.
    first, stop : int
        A range of takes. The granules begin with the first one of the range.
    """
    begin, end = int(slices.first[first]) * GRANULES, int(slices.first[stop]) * GRANULES
    on, off = np.empty(end - begin, np.uint64), np.empty(end - begin, np.uint64)
    _gather(slices.coarse, slices.features, len(slices.coarse) // (2 * slices.features + 1), begin, on, off)
    return GranuleWords(on, off)


@nb.njit(cache=True, nogil=True)
def _gather(coarse, features, width, begin, on, off):  # type: ignore[no-untyped-def]
    """Write the on and off words of the granules from `begin`, by transposing the coarse slices (kernel)."""
    square = np.empty(64, np.uint64)
    end = begin + len(on)
    for word in range(begin // 64, -(-end // 64)):
        low, high = max(begin, 64 * word), min(end, 64 * word + 64)
        for side in range(2):
            square[features:] = 0
            for row in range(features):
                square[row] = coarse[(side * features + row) * width + word]
            transpose(square)
            into = on if side == 0 else off
            for granule in range(low, high):
                into[granule - begin] = square[granule - 64 * word]


def granule_blocks(template: QuantisedTemplate) -> tuple[GranuleBlocks, int]:
    """Return the blocks of a template, and the number of columns B of each."""
    size = 8 if len(template) >= LONG else 4
    count = len(template) // size
    columns = template_columns(template)
    own = slice(len(template) - count * size, None)

    def common(masks: U64) -> U64:
        found: U64 = np.bitwise_and.reduce(masks[:, own].reshape(len(masks), count, size), axis=2)
        return np.ascontiguousarray(found)

    on, off = common(columns.group_masks & columns.values), common(columns.group_masks & ~columns.values)
    totals = columns.total_weights[own].reshape(count, size).max(axis=1) if count else np.ones(0)
    weights = columns.group_weights[:, :1] / totals[None, :]
    return GranuleBlocks(on, off, np.ascontiguousarray(weights, np.float32)), size


def granule_bounds(template: QuantisedTemplate, words: GranuleWords, edges: I64) -> F32:
    """Return a lower bound of the distance of all paths that end in each granule.

    Parameters
    ----------
    template : QuantisedTemplate
        N columns.
    words : GranuleWords
        The granules of T takes.
    edges : int64 array (T + 1,)
        Take t has the granules edges[t] to edges[t + 1].

    Returns
    -------
    float32 array
        No path that ends in a granule costs less.
    """
    blocks, size = granule_blocks(template)
    bounds = np.zeros(len(words.on), np.float32)
    if blocks.weights.shape[1]:
        steps, ends = (7 + 4 * size - 2) // GRANULE, (7 + 2 * (size - 1)) // GRANULE
        longest = int(np.diff(edges).max(initial=0))
        _bound(blocks, words.on, words.off, edges, steps, ends, np.empty((2, longest + max(steps, ends)), np.float32),
               bounds)  # fmt: skip
        bounds *= np.float32((size - 1) / (len(template) * _ROUNDING))
    return bounds


@nb.njit(cache=True, nogil=True)
def _bound(blocks, on, off, edges, steps, ends, memory, bounds):  # type: ignore[no-untyped-def]
    """Fill in the smallest sums over blocks of the paths that end in each granule (kernel)."""
    must_on, must_off, weights = blocks
    pad = max(steps, ends)
    for take in range(len(edges) - 1):
        start, stop = edges[take], edges[take + 1]
        count = stop - start
        before, here = memory[0, : count + pad], memory[1, : count + pad]
        before[:] = np.float32(0)
        before[:pad] = np.float32(np.inf)
        own_on, own_off = on[start:stop], off[start:stop]
        for block in range(weights.shape[1]):
            here[:pad] = np.float32(np.inf)
            target = here[pad:]
            _least(before, pad, steps, target)
            for group in range(len(weights)):
                wanted, unwanted, weight = must_on[group, block], must_off[group, block], weights[group, block]
                for g in range(count):
                    wrong = count_bits(wanted & ~own_on[g]) + count_bits(unwanted & ~own_off[g])
                    target[g] += np.float32(wrong) * weight
            before, here = here, before
        _least(before, pad, ends, bounds[start:stop])


@nb.njit(cache=True, nogil=True)
def _least(values, pad, back, found):  # type: ignore[no-untyped-def]
    """Fill in the minima of each value and the `back` values before it (kernel)."""
    for g in range(len(found)):
        found[g] = values[g + pad]
    for step in range(1, back + 1):
        earlier = values[pad - step :]
        for g in range(len(found)):
            one, other = found[g], earlier[g]
            found[g] = one if one < other else other
