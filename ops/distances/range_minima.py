"""This module finds minima of distance curves within short ranges, such as those left by keyframes or bounds.

For long or many ranges, `ops.distances.pruning` excludes most frames by successively finer bounds, and makes two passes
over the remaining frames, for distances and for paths. For a few hundred frames, computing the bounds would take longer
than computing the distances. Therefore this module computes the costs of all paths once, and keeps them until the paths
have been traced back. The kernels of `ops.distances.window_sums`, which also skip cells above a limit, are slower for
such ranges.
"""

from __future__ import annotations

from collections.abc import Sequence

import numba as nb
import numpy as np

from kinedex.ops.annotation.segments import TOLERANCE, Matches
from kinedex.ops.arrays import F64, I32, I64, U64
from kinedex.ops.distances.costs import CodedWords, TemplateColumns, column_costs, column_layout, encode
from kinedex.ops.distances.pruning import CoarseBound, pieces_below
from kinedex.ops.distances.recurrence import path_cost, step_back
from kinedex.ops.errors import ParameterError
from kinedex.ops.ranges import checked_ranges
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import NO_WORD

_NO_WORD = np.uint64(NO_WORD)
_TABLE_ROWS = 4096  # most words whose costs are in memory at once
_PIECE = 512  # most frames of a range whose sums are in memory at once, besides the lead-in


def minima_within(
    templates: Sequence[QuantisedTemplate],
    words: U64,
    thresholds: F64,
    ranges: Sequence[I64],
    coded: CodedWords | None = None,
    coarse: Sequence[CoarseBound | None] | None = None,
) -> Matches:
    """Find the local minima of distance curves below a threshold within ranges, with their warping paths.

    The minima equal those of the full curves of `ops.distances.dtw.distance_curves` in float64, to the bit.

    Parameters
    ----------
    templates : sequence of QuantisedTemplate
        T templates.
    words : uint64 array (L,)
        The words of the frames.
    thresholds : float64 array (T,)
        The threshold τ > 0 of each template.
    ranges : sequence of int64 array (R, 2)
        For each template half-open ranges of frames, ascending and disjoint; each is computed like a separate take.
    coded : CodedWords, optional
        The result of `ops.distances.costs.encode(words)`; computed if it is not given.
    coarse : sequence of CoarseBound, optional
        For each template a bound of its curve (`ops.distances.pruning.coarse_bounds`), made for these ranges or wider
        ones and for its threshold or a greater one. Frames that the bound excludes are not computed. None to compute
        all frames.

    Raises
    ------
    ParameterError
        If a threshold is not above 0, or ranges are invalid.
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
    layout = column_layout(templates)
    coded = encode(words) if coded is None else coded
    taus = np.ascontiguousarray(thresholds, np.float64)
    found = fill_matches(
        coded.vocabulary, coded.codes, layout.columns, layout.firsts, layout.lengths, taus, np.concatenate(pieces),
        edges,
    )  # fmt: skip
    return Matches(*found)


def _pieces(ranges: I64, bound: CoarseBound | None, columns: int, threshold: float) -> I64:
    """Return for each piece the first possible start of a path and the half-open range of its ends, int64 (P, 3)."""
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
        The different words, see `CodedWords`.
    codes : int32 array (L,)
        The index in the vocabulary of the word of each frame, see `CodedWords`.
    columns : TemplateColumns
        The columns of a `Layout`.
    firsts, lengths : int64 array (T,)
        The first column of each template, and the number of its columns.
    thresholds : float64 array (T,)
        The threshold τ of each template.
    pieces : int64 array (P, 3)
        See `_pieces`; outside the pieces no distance is below the threshold.
    edges : int64 array (T + 1,)
        Template t has the pieces edges[t] to edges[t + 1] - 1.
    """
    room = _PIECE + 2 * lengths.max()
    # Two rows and two columns of ∞ lie before the first frame and the first column, so that no step needs a check.
    sums = np.full((room + 2, lengths.max() + 2), np.inf)
    table, used = np.empty((max(room, _TABLE_ROWS), lengths.max())), 0
    row_of, filled, turn = np.empty(len(vocabulary), np.int32), np.full(len(vocabulary), -1, np.int64), 0
    rows = np.empty(room, np.int32)
    offsets = np.zeros(len(lengths) + 1, np.int64)
    starts, ends, distances = np.empty(1024, np.int64), np.empty(1024, np.int64), np.empty(1024)
    count = 0
    for t in range(len(lengths)):
        size, used, turn = lengths[t], 0, turn + 1
        own = slice(firsts[t], firsts[t] + size)
        template = TemplateColumns(
            columns.values[own], np.ascontiguousarray(columns.group_masks[:, own]),
            np.ascontiguousarray(columns.group_weights[:, own]), columns.total_weights[own],
        )  # fmt: skip
        for place in range(edges[t], edges[t + 1]):
            opens, closes = pieces[place, 0], pieces[place, 2]
            for begin in range(pieces[place, 1], closes, _PIECE):
                stop = min(begin + _PIECE, closes)
                # The earliest start of a path that ends in the frame before the piece, the left neighbour of its first
                # frame.
                first = max(begin - 1 - 2 * (size - 1), opens)
                frames = min(stop + 1, closes) - first
                if used + frames > len(table):
                    used, turn = 0, turn + 1
                own_codes = codes[first : first + frames]
                used = _fill_costs(vocabulary, own_codes, template, table, row_of, filled, turn, used, rows)
                _fill_sums(table, rows[:frames], size, sums)
                while count + stop - begin > len(ends):
                    starts, ends = np.concatenate((starts, starts)), np.concatenate((ends, ends))
                    distances = np.concatenate((distances, distances))
                for frame in range(begin - first, stop - first):
                    distance = sums[frame + 2, size + 1] / size
                    if not distance < thresholds[t] - TOLERANCE:
                        continue
                    if distance > sums[frame + 1, size + 1] / size + TOLERANCE:
                        continue
                    if frame + 1 < frames and distance > sums[frame + 3, size + 1] / size + TOLERANCE:
                        continue
                    ends[count], distances[count] = first + frame, distance
                    starts[count] = first + _start_frame(table, rows, size, sums, frame)
                    count += 1
        offsets[t + 1] = count
    return offsets, starts[:count].copy(), ends[:count].copy(), distances[:count].copy()


@nb.njit(cache=True, nogil=True)
def _fill_costs(
    vocabulary: U64, codes: I32, template: TemplateColumns, table: F64, row_of: I32, filled: I64, turn: int, used: int,
    rows: I32,
) -> int:  # fmt: skip
    """Map frames to rows of a cost table, fill in missing rows, and return the number of rows in use (kernel).

    The frames of a piece have few different words, so the table has one row for each word. `row_of` holds the row of
    each word; it is valid if `filled` of the word equals `turn`, the number of the current table.
    """
    for frame in range(len(codes)):
        code = codes[frame]
        if filled[code] != turn:
            if vocabulary[code] == _NO_WORD:
                table[used, :] = np.inf
            else:
                column_costs(vocabulary[code], template, table[used, : len(template.values)])
            filled[code], row_of[code] = turn, used
            used += 1
        rows[frame] = row_of[code]
    return used


@nb.njit(cache=True, nogil=True)
def _fill_sums(table: F64, rows: I32, columns: int, sums: F64) -> None:
    """Fill in the costs of the cheapest paths to each column at each frame, in row frame + 2 (kernel).

    Cells that no path can reach are ∞, since a path advances by at most two columns per frame. Cells from which no path
    can reach the last column are skipped.
    """
    for frame in range(len(rows)):
        least, most = max(0, columns - 1 - 2 * (len(rows) - 1 - frame)), min(columns - 1, 2 * frame)
        # Views that begin at the first cell let the compiler see that no index is negative, so that it vectorises.
        before, behind, here = sums[frame, least + 1 :], sums[frame + 1, least:], sums[frame + 2, least + 2 :]
        cost = table[rows[frame], least:]
        for n in range(most + 1 - least):
            here[n] = path_cost(behind[n + 1], before[n], behind[n], cost[n])
        for n in range(max(most + 1 - least, 0), columns - least):
            here[n] = np.inf
        if least == 0:
            here[0] = cost[0]


@nb.njit(cache=True, nogil=True)
def _start_frame(table: F64, rows: I32, columns: int, sums: F64, frame: int) -> int:
    """Return the start frame of the cheapest path that ends at a frame, as `window_sums.path_start` does (kernel)."""
    n = columns - 1
    while n > 0:
        frames, back = step_back(sums, frame, n, table[rows[frame], n])
        frame, n = frame - frames, n - back
    return frame
