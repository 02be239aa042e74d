"""Minima below a threshold one after the other: the bounds that rankings use, then the distances of what they leave.

The paths that end at them are traced in windows of their own, in float64.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
import numpy.typing as npt

from kinedex.ops.annotation.segments import TOLERANCE
from kinedex.ops.distances.costs import F64, I32, I64, CodedWords, encode, lay_out
from kinedex.ops.distances.pruning import Coarse, bounds_below, coarse_bound, possible_minima
from kinedex.ops.distances.window_sums import sum_window, walk_back, workspace
from kinedex.ops.errors import ParameterError
from kinedex.ops.ranges import checked_ranges
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import U64

_TABLE_CELLS = 4_000_000  # of a window's sums: 32 MB


@dataclass(frozen=True)
class Minima:
    """Local minima of one template's distance curve below a threshold, by frame.

    ends: int64 (M,), their frames. starts: int64 (M,), the first frame of the best path that ends there. costs: float64
    (M,), the distances. frames: how many frames the curve has. computed: in how many a bound of it was computed column
    by column in 16 bits, those that lead in to others included; the rest was skipped.
    """

    ends: I64
    starts: I64
    costs: F64
    frames: int
    computed: int

    @property
    def skipped(self) -> float:
        """The share of the frames that was skipped."""
        return max(0.0, 1 - self.computed / self.frames) if self.frames else 0.0


def minima_below(
    template: QuantisedTemplate,
    words: U64,
    threshold: float,
    ranges: I64 | None = None,
    coded: CodedWords | None = None,
    prune: bool = True,
    coarse: Coarse | None = None,
) -> Minima:
    """Find the local minima of a distance curve below a threshold, with the paths that lead to them.

    The result is that of `ops.annotation.segments.local_minima` on the curve of `ops.distances.dtw.distance_curves`
    in float64, with `start_frames`: what the bounds of `ops.distances.pruning` leave is computed, and decides.

    Parameters
    ----------
    template, words, ranges: as in `ops.distances.dtw.distance_curves`.
    threshold: τ > 0.
    coded: `encode(words)`, where several templates share it.
    prune: False leaves out the coarse bound, to compare.
    coarse: the coarse bound, where it is known: made for these words and ranges, and for this τ or a greater one.

    Raises
    ------
    ParameterError: a threshold that is not above 0, or wrong ranges.
    """
    stretches = checked_ranges(ranges, len(words))
    coded = encode(words) if coded is None else coded
    if prune and coarse is None:
        coarse = coarse_bound(template, coded, threshold, stretches)
    bounds = bounds_below(template, coded, threshold, stretches, coarse)
    candidates, possible = possible_minima(bounds.units, bounds.spans, bounds.slack)
    limits = (bounds.units[candidates] + (len(template) + 1.0)) * bounds.unit  # see bound 1
    starts, costs = best_paths(template, words, candidates, stretches, limits, coded)
    kept = possible & _true_minima(candidates, costs, stretches, threshold)
    return Minima(candidates[kept], starts[kept], costs[kept], bounds.frames, bounds.computed)


def _true_minima(candidates: I64, costs: F64, stretches: I64, threshold: float) -> npt.NDArray[np.bool_]:
    """Which candidates are minima, with the distances of all frames that could deny it (float64)."""
    home = np.searchsorted(stretches[:, 0], candidates, side="right")
    low = costs < threshold - TOLERANCE
    joined = (np.diff(candidates) == 1) & (np.diff(home) == 0)
    low[1:] &= ~joined | (costs[1:] <= costs[:-1] + TOLERANCE)
    low[:-1] &= ~joined | (costs[:-1] <= costs[1:] + TOLERANCE)
    return low


def start_frames(template: QuantisedTemplate, words: U64, ends: I64, ranges: I64 | None = None) -> I64:
    """Return where the best path that ends at each of some frames begins (thesis, 5.2: the frame a_l).

    Among equally cheap paths the one is taken that, read from its end, prefers (1,1), then (1,2), then (2,1).

    Parameters
    ----------
    template, words, ranges: as in `ops.distances.dtw.distance_curves`.
    ends: int64 (E,), ascending frames at which the curve is finite.

    Returns
    -------
    int64 (E,).

    Raises
    ------
    ParameterError: if an end is outside the words or the ranges, no path ends there, or ends do not ascend.
    """
    starts, distances = best_paths(template, words, ends, ranges)
    if np.any(np.isinf(distances)):
        raise ParameterError("ends", "frames at which a path ends", np.asarray(ends)[np.isinf(distances)].tolist()[:8])
    return starts


def best_paths(
    template: QuantisedTemplate,
    words: U64,
    ends: I64,
    ranges: I64 | None = None,
    limits: F64 | None = None,
    coded: CodedWords | None = None,
) -> tuple[I64, F64]:
    """Return where the best path that ends at each of some frames begins, and its distance.

    A path of N columns that ends at frame l begins at l − 2(N − 1) or later, so a window is enough; ends that
    lie close together share one.

    Parameters
    ----------
    template, words, ranges: as in `ops.distances.dtw.distance_curves`.
    ends: int64 (E,), ascending frames.
    limits: float64 (E,), what the distances are known not to exceed: dearer cells need not be computed.
    coded: `encode(words)`, where it is known: then each word's costs are computed once.

    Returns
    -------
    int64 (E,), −1 where no path ends; float64 (E,), what `ops.distances.dtw.distance_curves` has there.

    Raises
    ------
    ParameterError: if an end is outside the words or the ranges, or ends do not ascend.
    """
    stretches = checked_ranges(ranges, len(words))
    ends = np.ascontiguousarray(ends, np.int64)
    if np.any(np.diff(ends) <= 0):
        raise ParameterError("ends", "ascending", ends.tolist()[:8])
    home = np.searchsorted(stretches[:, 0], ends, side="right") - 1
    if len(ends) and (home.min() < 0 or np.any(ends >= stretches[home, 1])):
        raise ParameterError("ends", "frames within the ranges", ends.tolist()[:8])
    starts, sums = np.empty(len(ends), np.int64), np.empty(len(ends))
    if not len(ends):
        return starts, sums
    columns = len(template)
    reach = 2 * (columns - 1)
    opens = np.maximum(ends - reach, stretches[home, 0])
    # A window of its own costs 0.75 N² cells; a shared one N for each frame between two ends. One that would grow large
    # is divided, which costs another window but no path.
    block = ends // max(reach + 1, _TABLE_CELLS // columns)
    apart = (np.diff(ends) > 0.75 * columns) | (home[1:] != home[:-1]) | (block[1:] != block[:-1])
    groups = np.concatenate(([0], np.flatnonzero(apart) + 1, [len(ends)])).astype(np.int64)
    layout = lay_out([template])
    most = np.full(len(groups) - 1, np.inf)
    if limits is not None:
        most = np.maximum.reduceat(limits, groups[:-1]) * columns * (1 + 1e-9)
    if coded is None:
        coded = CodedWords(np.ascontiguousarray(words, np.uint64), np.arange(len(words), dtype=np.int32))
    trace_paths(
        coded.vocabulary, coded.codes, layout.values[:columns], layout.parts[:, :columns], layout.worths[:, :columns],
        layout.counted[:columns], ends, opens, groups, most, starts, sums,
    )  # fmt: skip
    return starts, sums / columns


@nb.njit(cache=True, nogil=True)
def trace_paths(
    vocabulary: U64, codes: I32, values: U64, parts: U64, worths: F64, counted: F64, ends: I64, opens: I64,
    groups: I64, limits: F64, starts: I64, sums: F64,
) -> None:  # fmt: skip
    """Find the best path that ends at each of some frames, in float64 (kernel).

    ends: int64 (E,), ascending frames. opens: int64 (E,), where the window of each begins, 2(N − 1) frames before or
    where its stretch does. groups: int64 (G + 1,): ends groups[g] to groups[g + 1] − 1 share a window. limits: float64
    (G,), of no interest are paths of a group that cost more. starts (E,) gets the first frame of each path, −1 where
    there is none; sums (E,) its cost.
    """
    longest = 0
    for g in range(len(groups) - 1):
        longest = max(longest, ends[groups[g + 1] - 1] + 1 - opens[groups[g]])
    grid, costs, row_of, used, trail = workspace(longest, len(values), len(vocabulary))
    found = np.empty(longest)
    for g in range(len(groups) - 1):
        begin, end, last = opens[groups[g]], ends[groups[g]], ends[groups[g + 1] - 1]
        sum_window(
            vocabulary, codes, values, parts, worths, counted, begin, end, found[: last + 1 - end], limits[g], grid,
            costs, row_of, used,
        )  # fmt: skip
        trail[: last + 1 - begin] = -1
        for place in range(groups[g], groups[g + 1]):
            starts[place], sums[place] = -1, found[ends[place] - end]
            if sums[place] < np.inf:
                starts[place] = walk_back(grid, costs, row_of, codes, begin, ends[place], place, trail, starts)
