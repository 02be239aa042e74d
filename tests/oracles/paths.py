"""The best paths of subsequence DTW by the whole matrix of sums, with numpy, for takes that are long."""

from __future__ import annotations

import numpy as np

from kinedex.ops.arrays import F64, I64, U64
from kinedex.ops.distances.costs import column_layout, cost_table, encode
from kinedex.ops.templates.templates import QuantisedTemplate


def best_paths(template: QuantisedTemplate, words: U64, ends: I64, ranges: I64 | None = None) -> tuple[I64, F64]:
    """Return the frame where the best path starts that ends at each of some frames, −1 for none, and its distance.

    Among equally cheap paths the one is taken that, read from its end, prefers (1,1), then (1,2), then (2,1).
    """
    coded = encode(words)
    costs = cost_table(column_layout([template]), coded.vocabulary)[coded.codes, : len(template)]
    starts, distances = np.full(len(ends), -1), np.full(len(ends), np.inf)
    for begin, stop in [(0, len(words))] if ranges is None else ranges.tolist():
        sums = _sums(costs[begin:stop])
        for place in np.flatnonzero((ends >= begin) & (ends < stop)).tolist():
            end = int(ends[place]) - begin
            distances[place] = sums[end + 2, -1] / len(template)
            if np.isfinite(distances[place]):
                starts[place] = begin + _start(sums, costs[begin:stop], end)
    return starts, distances


def start_frames(template: QuantisedTemplate, words: U64, ends: I64, ranges: I64 | None = None) -> I64:
    """Return the frame where the best path starts that ends at each of some frames (thesis, Section 5.2: a_l)."""
    return best_paths(template, words, ends, ranges)[0]


def _sums(costs: F64) -> F64:
    frames, columns = costs.shape
    sums = np.full((frames + 2, columns + 2), np.inf)
    for frame, own in enumerate(costs):
        before, behind = sums[frame], sums[frame + 1]
        sums[frame + 2, 2:] = np.minimum(np.minimum(behind[1:-1], before[1:-1]) + own, behind[:-2] + (own + own))
        sums[frame + 2, 2] = own[0]
    return sums


def _start(sums: F64, costs: F64, frame: int) -> int:
    n = costs.shape[1] - 1
    while n > 0:
        cost = costs[frame, n]
        ways = [sums[frame + 1, n + 1] + cost, sums[frame, n + 1] + cost, sums[frame + 1, n] + (cost + cost)]
        frames, columns = ((1, 1), (2, 1), (1, 2))[int(np.argmin(ways))]
        frame, n = frame - frames, n - columns
    return frame
