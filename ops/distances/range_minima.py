"""Minima of distance curves within short ranges, such as keyframes or bounds leave.

Where ranges are long or many, `ops.distances.pruning` excludes most frames by finer and finer bounds, and goes over
what remains twice, for distances and for paths. Within a few hundred frames that is more work than the distances
themselves: here the costs of all paths are computed once, and kept until the paths have been followed back.
"""

from __future__ import annotations

from collections.abc import Sequence

import numba as nb
import numpy as np

from kinedex.ops.annotation.segments import Matches
from kinedex.ops.distances.costs import F64, I32, I64, CodedWords, TemplateColumns, encode, lay_out
from kinedex.ops.distances.pruning import CoarseBound, pieces_below
from kinedex.ops.distances.window_sums import is_minimum, make_window, path_start, reshaped, sum_window
from kinedex.ops.errors import ParameterError
from kinedex.ops.ranges import checked_ranges
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import U64

_PIECE = 512  # frames of a range whose sums are kept at once, besides those that lead in


def minima_within(
    templates: Sequence[QuantisedTemplate],
    words: U64,
    thresholds: F64,
    ranges: Sequence[I64],
    coded: CodedWords | None = None,
    coarse: Sequence[CoarseBound | None] | None = None,
) -> Matches:
    """Find the local minima of distance curves below a threshold within ranges, with the paths that lead to them.

    They are those of the whole curves of `ops.distances.dtw.distance_curves` in float64, to the bit.

    Parameters
    ----------
    templates : sequence of QuantisedTemplate
        T templates.
    words : uint64 array (L,)
    thresholds : float64 array (T,)
        The threshold τ > 0 of each template.
    ranges : sequence of int64 array (R, 2)
        For each template half-open ranges of frames, ascending and disjoint; each is computed as if it were a take of
        its own.
    coded : CodedWords, optional
        `ops.distances.costs.encode(words)`, where it is known.
    coarse : sequence of CoarseBound, optional
        For each template a bound of its curve (`ops.distances.pruning.coarse_bounds`), made for these ranges or wider
        ones and for its threshold or a greater one; then only frames that it leaves are computed. None: all frames.

    Raises
    ------
    ParameterError
        If a threshold is not above 0, or ranges are wrong.
    """
    if len(thresholds) != len(templates) or len(ranges) != len(templates) or not np.all(thresholds > 0):
        raise ParameterError("thresholds", f"above 0, one for each of {len(templates)} templates", thresholds.tolist())
    if not templates:
        return Matches.of([])
    bounds = [None] * len(templates) if coarse is None else coarse
    pieces = [
        _pieces(checked_ranges(own, len(words)), bound, len(template), tau)
        for template, own, bound, tau in zip(templates, ranges, bounds, thresholds.tolist(), strict=True)
    ]
    edges = np.cumsum([0, *map(len, pieces)]).astype(np.int64)
    layout = lay_out(templates)
    coded = encode(words) if coded is None else coded
    taus = np.ascontiguousarray(thresholds, np.float64)
    found = fill_matches(
        coded.vocabulary, coded.codes, layout.columns, layout.firsts, layout.lengths, taus, np.concatenate(pieces),
        edges,
    )  # fmt: skip
    return Matches(*found)


def _pieces(ranges: I64, bound: CoarseBound | None, columns: int, threshold: float) -> I64:
    """Return where paths may start and the half-open range where they may end, int64 (P, 3)."""
    if bound is None:
        return np.stack([ranges[:, 0], ranges[:, 0], ranges[:, 1]], axis=1)
    return pieces_below(bound, threshold, ranges, 2 * (columns - 1))


@nb.njit(cache=True, nogil=True)
def fill_matches(
    vocabulary: U64, codes: I32, columns: TemplateColumns, firsts: I64, lengths: I64, thresholds: F64, pieces: I64,
    edges: I64,
) -> tuple[I64, I64, I64, F64]:  # fmt: skip
    """Find the minima of all templates in their pieces, and return the arrays of `Matches` (kernel).

    Parameters
    ----------
    vocabulary : uint64 array (W,)
    codes : int32 array (L,)
    columns : TemplateColumns
        Those of a `Layout`.
    firsts, lengths : int64 array (T,)
        The first column of each template, and the number of its columns.
    thresholds : float64 array (T,)
    pieces : int64 array (P, 3)
        See `_pieces`; beside a piece no distance is below the threshold.
    edges : int64 array (T + 1,)
        Template t has the pieces edges[t] to edges[t + 1] - 1.
    """
    memory = make_window(_PIECE + 2 * lengths.max(), lengths.max(), len(vocabulary))
    sums = np.empty(_PIECE + 2)
    offsets = np.zeros(len(lengths) + 1, np.int64)
    starts, ends, distances = np.empty(1024, np.int64), np.empty(1024, np.int64), np.empty(1024)
    count = 0
    for t in range(len(lengths)):
        size = lengths[t]
        window = reshaped(memory, size)
        own = slice(firsts[t], firsts[t] + size)
        template = TemplateColumns(
            columns.values[own], np.ascontiguousarray(columns.group_masks[:, own]),
            np.ascontiguousarray(columns.group_weights[:, own]), columns.total_weights[own],
        )  # fmt: skip
        limit = thresholds[t] * size * (1 + 1e-9)  # rounding does not make the cost of a match greater than this
        for place in range(edges[t], edges[t + 1]):
            opens, closes = pieces[place, 0], pieces[place, 2]
            for start in range(pieces[place, 1], closes, _PIECE):
                stop = min(start + _PIECE, closes)
                # A minimum is decided by its neighbours.
                low, high = max(start - 1, opens), min(stop + 1, closes)
                begin = max(low - 2 * (size - 1), opens)
                found = sums[: high - low]
                sum_window(vocabulary, codes, template, begin, low, found, limit, window)
                found /= size
                window.trail[: high - begin] = -1
                while count + stop - start > len(ends):
                    starts, ends = np.concatenate((starts, starts)), np.concatenate((ends, ends))
                    distances = np.concatenate((distances, distances))
                for frame in range(start, stop):
                    if is_minimum(found, frame - low, thresholds[t]):
                        ends[count], distances[count] = frame, found[frame - low]
                        starts[count] = path_start(window, codes, begin, frame, count, starts)
                        count += 1
        offsets[t + 1] = count
    return offsets, starts[:count].copy(), ends[:count].copy(), distances[:count].copy()
