"""Distance curves: how well a template fits a take up to every frame (subsequence DTW)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.ops.distances.costs import I64, cost_table, encode, lay_out
from kinedex.ops.distances.sweep import pieces_of, sweep
from kinedex.ops.ranges import checked_ranges
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import U64

_TABLE_CELLS = 4_000_000  # of a cost table held at once: 32 MB, whatever the length of the takes
_PIECE = 4096  # frames of a stretch that are computed apart from the rest of it


def distance_curves(
    templates: Sequence[QuantisedTemplate],
    words: U64,
    ranges: I64 | None = None,
    dtype: type[np.floating[Any]] = np.float64,
) -> npt.NDArray[Any]:
    """Return the distance curve of every template (thesis, Eq. 5.1 to 5.3).

    The local cost of a column against a frame is the share of the column's bits that the frame contradicts, of their
    weight where features have weights (Σ_f weight_f · contradicted_f / Σ_f weight_f over the fixed entries f), 0 for
    a column of wildcards alone, ∞ for a frame without a word. Steps (template, take) are (1,1), (1,2) and (2,1); a
    (2,1) step counts the local cost twice. A path starts at any frame, in the template's first column. Time is
    proportional to columns × frames. Memory, besides the result, is 20 to 28 bytes a frame while the words are numbered
    and 4 to 12 after that; tables of costs and sums are bounded, however long the take and however many its words.

    Parameters
    ----------
    templates: T templates, of N_1 … N_T columns.
    words: uint64 (L,), the take's words (or those of many takes, with `ranges` that keep them apart).
    ranges: int64 (R, 2), half-open stretches of frames, ascending and apart; each is computed as if it were a
        take of its own. None: all of `words` is one take.
    dtype: float64; or float32, twice as fast, within `ops.distances.costs.error_bound` of float64.

    Returns
    -------
    dtype (T, L): at frame l the cost of the best path that ends there, divided by N; ∞ where none exists
    (about the first N / 2 frames of a stretch, across frames without a word, and outside the stretches).

    Raises
    ------
    ParameterError: if the ranges are not ascending stretches within the words.
    """
    stretches = checked_ranges(ranges, len(words))
    curves = np.full((len(templates), len(words)), np.inf, dtype)
    if not templates or not len(stretches):
        return curves
    layout = lay_out(templates)
    reach = 2 * (int(layout.lengths.max()) - 1)
    room = max(1, _TABLE_CELLS // len(layout.masks))
    # Where the words together are few, one table serves all frames; else stretches of frames get tables of their own.
    start, stop = int(stretches[0, 0]), int(stretches[-1, 1])
    coded = encode(words[start:stop])
    few = len(coded.vocabulary) <= room
    for pieces in _batches(pieces_of(stretches, _PIECE if few else min(_PIECE, room), reach), stop if few else room):
        if not few:
            start, stop = int(pieces[0, 0]), int(pieces[-1, 2])
            coded = encode(words[start:stop])
        table = cost_table(layout, coded.vocabulary, dtype)
        sweep(table, coded.codes, pieces - start, layout.firsts, layout.lasts, curves[:, start:stop])
    curves /= layout.lengths[:, None].astype(dtype)
    return curves


def _batches(pieces: I64, frames: int) -> Iterator[I64]:
    """Divide pieces into consecutive groups that span so many frames at most, and at least one piece."""
    first = 0
    for place in range(1, len(pieces) + 1):
        if place == len(pieces) or pieces[place, 2] - pieces[first, 0] > frames:
            yield pieces[first:place]
            first = place
