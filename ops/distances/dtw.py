"""This module computes distance curves, the distances of a template to all parts of a take by their last frames.

The method is subsequence dynamic time warping (DTW).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from kinedex.ops.arrays import I64, U64, Array
from kinedex.ops.distances.costs import column_layout, cost_table, encode
from kinedex.ops.distances.sweep import pieces_of, sweep
from kinedex.ops.ranges import checked_ranges
from kinedex.ops.templates.templates import QuantisedTemplate

_TABLE_CELLS = 4_000_000  # most cells of a cost table at a time: 32 MB, however long the takes are
_PIECE = 4096  # frames of a range that are computed independently of its other frames


def distance_curves(
    templates: Sequence[QuantisedTemplate],
    words: U64,
    ranges: I64 | None = None,
    dtype: type[np.floating[Any]] = np.float64,
) -> Array:
    """Return the distance curve of every template (thesis, Eq. 5.1 to 5.3).

    The local cost of a column and a frame is the fraction of the column's fixed entries f that the frame contradicts,
    weighted if features have weights: Σ_f weight_f · contradicted_f / Σ_f weight_f. It is 0 for a column with only
    wildcards, and ∞ for a frame without a word. Steps (template, take) are (1,1), (1,2) and (2,1); a (2,1) step counts
    the local cost twice. A path may start at any frame, in the template's first column.

    The time is proportional to columns × frames. Besides the result, 20 to 28 bytes per frame are needed while words
    are numbered, and 4 to 12 bytes after that. The size of other tables does not depend on the length of the take.

    Parameters
    ----------
    templates : sequence of QuantisedTemplate
        T templates, of N_1 … N_T columns.
    words : uint64 array (L,)
        The words of a take, or the concatenated words of many takes, which `ranges` separate.
    ranges : int64 array (R, 2), optional
        Half-open ranges of frames, ascending and disjoint; each is computed like a separate take. None if `words` is a
        single take.
    dtype : type
        float64; or float32, which is twice as fast and within the bound of `ops.distances.costs.grid_step`.

    Returns
    -------
    array of dtype (T, L)
        For each frame the cost of the best path that ends there, divided by N. It is ∞ if there is no path: in about
        the first N / 2 frames of a range, near frames without a word, and outside the ranges.

    Raises
    ------
    ParameterError
        If the ranges do not ascend or lie outside the words.
    """
    checked = checked_ranges(ranges, len(words))
    curves = np.full((len(templates), len(words)), np.inf, dtype)
    if not templates or not len(checked):
        return curves
    layout = column_layout(templates)
    lead_in = 2 * (int(layout.lengths.max()) - 1)
    most_words = max(1, _TABLE_CELLS // layout.width)
    # If there are few different words, one table is used for all frames; otherwise each part of the ranges has its own.
    start, stop = int(checked[0, 0]), int(checked[-1, 1])
    coded = encode(words[start:stop])
    few = len(coded.vocabulary) <= most_words
    pieces_of_ranges = pieces_of(checked, _PIECE if few else min(_PIECE, most_words), lead_in)
    for pieces in _batches(pieces_of_ranges, stop if few else most_words):
        if not few:
            start, stop = int(pieces[0, 0]), int(pieces[-1, 2])
            coded = encode(words[start:stop])
        table = cost_table(layout, coded.vocabulary, dtype)
        sweep(table, coded.codes, pieces - start, layout.firsts, layout.lasts, curves, start)
    curves /= layout.lengths[:, None].astype(dtype)
    return curves


def _batches(pieces: I64, frames: int) -> Iterator[I64]:
    """Divide pieces into consecutive groups that span at most the given number of frames, or are a single piece."""
    first = 0
    for place in range(1, len(pieces) + 1):
        if place == len(pieces) or pieces[place, 2] - pieces[first, 0] > frames:
            yield pieces[first:place]
            first = place
