"""Minima of distance curves within short ranges, such as keyframes or bounds leave: all sums of one fit into the cache.

Where ranges are long or many, `ops.distances.pruning` rules most frames out by finer and finer bounds, and goes over
what remains twice, for distances and for paths. Within a few hundred frames that is more work than the distances
themselves: here every sum is computed once, kept while its range lasts, and paths are read from it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numba as nb
import numpy as np

from kinedex.ops.annotation.segments import TOLERANCE, Matches
from kinedex.ops.distances.costs import F64, I32, I64, CodedWords, column_costs, encode, lay_out
from kinedex.ops.distances.pruning import Coarse, surviving
from kinedex.ops.distances.window_sums import step_back
from kinedex.ops.errors import ParameterError
from kinedex.ops.ranges import checked_ranges
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import NO_WORD, U64

_NO_WORD = np.uint64(NO_WORD)
_PIECE = 512  # frames of a range whose sums are kept at once, besides those that lead in
_ROWS = 4096  # words whose costs are kept at once


def minima_within(
    templates: Sequence[QuantisedTemplate],
    words: U64,
    thresholds: F64,
    ranges: Sequence[I64],
    coded: CodedWords | None = None,
    coarse: Sequence[Coarse | None] | None = None,
) -> Matches:
    """Find the local minima of distance curves below a threshold within ranges, with the paths that lead to them.

    They are those of the whole curves of `ops.distances.dtw.distance_curves` in float64, to the bit.

    Parameters
    ----------
    templates: T templates. words: uint64 (L,). thresholds: float64 (T,), τ > 0 of each template.
    ranges: for each template int64 (R, 2), half-open stretches of frames, ascending and apart; each is computed as if
        it were a take of its own.
    coded: `ops.distances.costs.encode(words)`, where it is known.
    coarse: for each template a bound of its curve (`ops.distances.pruning.coarse_bounds`), made for these ranges or
        wider ones and for its threshold or a greater one; then only frames are gone over that it leaves. None: all.

    Raises
    ------
    ParameterError: a threshold that is not above 0, or wrong ranges.
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
    found = fill_matches(
        coded.vocabulary, coded.codes, layout.values, layout.parts, layout.worths, layout.counted, layout.firsts,
        layout.lengths, np.ascontiguousarray(thresholds, np.float64), np.concatenate(pieces), edges,
    )  # fmt: skip
    return Matches(*found)


def _pieces(stretches: I64, bound: Coarse | None, columns: int, threshold: float) -> I64:
    """The frames to go over, int64 (P, 3): where paths may begin, and the frames [start, stop) where they may end."""
    if bound is None:
        return np.stack([stretches[:, 0], stretches[:, 0], stretches[:, 1]], axis=1)
    return surviving(bound.below(threshold), stretches, 2 * (columns - 1))


@nb.njit(cache=True, nogil=True)
def fill_matches(
    vocabulary: U64, codes: I32, values: U64, parts: U64, worths: F64, counted: F64, firsts: I64, lengths: I64,
    thresholds: F64, pieces: I64, edges: I64,
) -> tuple[I64, I64, I64, F64]:  # fmt: skip
    """Go over the ranges of all templates, and return the parts of `Matches` (kernel).

    values … lengths: of a `Layout`. pieces: int64 (P, 3), see `_pieces`, those of template t from edges[t] to
    edges[t + 1]; beside the frames of a piece no distance is below the threshold.
    """
    longest, room = lengths.max(), _PIECE + 2 * lengths.max()
    # Two rows and two columns of ∞ are before the first frame and the first column, so that no step asks for the edge.
    sums = np.full((room + 2, longest + 2), np.inf)
    table, used = np.empty((max(room, _ROWS), longest)), 0
    row_of, filled_in, turn = np.empty(len(vocabulary), np.int32), np.full(len(vocabulary), -1, np.int64), 0
    rows = np.empty(room, np.int32)
    offsets = np.zeros(len(lengths) + 1, np.int64)
    starts, ends, distances = np.empty(1024, np.int64), np.empty(1024, np.int64), np.empty(1024)
    count = 0
    for t in range(len(lengths)):
        columns, used, turn = lengths[t], 0, turn + 1
        own = slice(firsts[t], firsts[t] + columns)
        own_values, own_counted = values[own], counted[own]
        own_parts, own_worths = np.ascontiguousarray(parts[:, own]), np.ascontiguousarray(worths[:, own])
        for place in range(edges[t], edges[t + 1]):
            opens, closes = pieces[place, 0], pieces[place, 2]
            for begin in range(pieces[place, 1], closes, _PIECE):
                stop = min(begin + _PIECE, closes)
                # A path that ends in the frame before the piece, a neighbour of its first one, leads in from here.
                first = max(begin - 1 - 2 * (columns - 1), opens)
                frames = min(stop + 1, closes) - first
                if used + frames > len(table):
                    used, turn = 0, turn + 1
                used = look_up(
                    vocabulary, codes[first : first + frames], own_values, own_parts, own_worths, own_counted, table,
                    row_of, filled_in, turn, used, rows,
                )  # fmt: skip
                fill_sums(table, rows[:frames], columns, sums)
                while count + stop - begin > len(ends):
                    starts, ends = np.concatenate((starts, starts)), np.concatenate((ends, ends))
                    distances = np.concatenate((distances, distances))
                for frame in range(begin - first, stop - first):
                    distance = sums[frame + 2, columns + 1] / columns
                    if not distance < thresholds[t] - TOLERANCE:
                        continue
                    if distance > sums[frame + 1, columns + 1] / columns + TOLERANCE:
                        continue
                    if frame + 1 < frames and distance > sums[frame + 3, columns + 1] / columns + TOLERANCE:
                        continue
                    ends[count], distances[count] = first + frame, distance
                    starts[count] = first + begin_of(table, rows, columns, sums, frame)
                    count += 1
        offsets[t + 1] = count
    return offsets, starts[:count].copy(), ends[:count].copy(), distances[:count].copy()


@nb.njit(cache=True, nogil=True)
def look_up(
    vocabulary: U64, codes: I32, values: U64, parts: U64, worths: F64, counted: F64, table: F64, row_of: I32,
    filled_in: I64, turn: int, used: int, rows: I32,
) -> int:  # fmt: skip
    """Fill the rows of frames in a table of costs, and those costs that are not there; return how many are (kernel).

    Few of the words occur where a template is matched, and those again and again: each costs one row.

    values, parts, worths, counted: the columns of a template, as `Layout` has them. row_of: int32 (W,), the row of each
    word that was filled in this turn, as filled_in, int64 (W,), says.
    """
    for frame in range(len(codes)):
        code = codes[frame]
        if filled_in[code] != turn:
            if vocabulary[code] == _NO_WORD:
                table[used, :] = np.inf
            else:
                column_costs(vocabulary[code], values, parts, worths, counted, table[used, : len(values)])
            filled_in[code], row_of[code] = turn, used
            used += 1
        rows[frame] = row_of[code]
    return used


@nb.njit(cache=True, nogil=True)
def fill_sums(table: F64, rows: I32, columns: int, sums: F64) -> None:
    """Fill the costs of the best paths that end in each column at each frame, in row frame + 2 (kernel).

    The sums are those of `ops.distances.sweep.sweep`, added in the same order. Left out are cells that no path comes to
    (a frame leads on by two columns at most), which are ∞, and those that lead to no end.
    """
    for frame in range(len(rows)):
        least, most = max(0, columns - 1 - 2 * (len(rows) - 1 - frame)), min(columns - 1, 2 * frame)
        # Views that begin with the first cell: the compiler then sees that no index is below 0, and vectorises.
        before, behind, here = sums[frame, least + 1 :], sums[frame + 1, least:], sums[frame + 2, least + 2 :]
        cost = table[rows[frame], least:]
        for n in range(most + 1 - least):
            one, two = behind[n + 1], before[n]
            single = (one if one < two else two) + cost[n]
            double = behind[n] + (cost[n] + cost[n])
            here[n] = double if double < single else single
        for n in range(max(most + 1 - least, 0), columns - least):
            here[n] = np.inf
        if least == 0:
            here[0] = cost[0]


@nb.njit(cache=True, nogil=True)
def begin_of(table: F64, rows: I32, columns: int, sums: F64, frame: int) -> int:
    """The frame in which the best path begins that ends at a frame; of equal ones as in `walk_back` (kernel)."""
    n = columns - 1
    while n > 0:
        cost = table[rows[frame], n]
        straight = sums[frame + 1, n + 1] + cost
        skipped = sums[frame, n + 1] + cost
        doubled = sums[frame + 1, n] + (cost + cost)
        frames, back = step_back(straight, skipped, doubled)
        frame, n = frame - frames, n - back
    return frame
