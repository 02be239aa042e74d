"""This module computes missing costs of segments: the minimum of the template's distance curve in the segment."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinedex.ops.arrays import F64, I64, U64
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.templates.templates import QuantisedTemplate


def least_costs(
    templates: Sequence[QuantisedTemplate], words: U64, ranges: Sequence[I64], chosen: I64, starts: I64, stops: I64
) -> F64:
    """Return the smallest distance of the template's paths that end in each segment.

    No path to a template of N columns is longer than 2 N − 1 frames, so the curve is only computed for each segment and
    the 2 N − 1 frames before it.

    Parameters
    ----------
    templates : sequence of QuantisedTemplate
        T templates.
    words : uint64 array (L,)
        One word a frame; `NO_WORD` where the frame is invalid.
    ranges : sequence of int64 array (R, 2)
        For each template the half-open ranges in which it is matched, ascending and disjoint.
    chosen : int64 array (S,)
        The template of each segment.
    starts, stops : int64 array (S,)
        The half-open range of each segment, within one of the ranges of its template.

    Returns
    -------
    float64 array (S,)
        ∞ where no path ends.
    """
    costs = np.full(len(chosen), np.inf)
    for index in np.unique(chosen).tolist():
        own, template = np.flatnonzero(chosen == index), templates[index]
        within = ranges[index][np.searchsorted(ranges[index][:, 0], starts[own], side="right") - 1, 0]
        begins = np.maximum(starts[own] - 2 * (len(template) - 1), within)
        edges = np.concatenate([[0], np.cumsum(stops[own] - begins)])
        parts = [words[begin:stop] for begin, stop in zip(begins.tolist(), stops[own].tolist(), strict=True)]
        pieces = np.stack([edges[:-1], edges[1:]], axis=1)
        curve = distance_curves([template], np.concatenate(parts), pieces)[0]
        inside = np.stack([edges[1:] - (stops[own] - starts[own]), edges[1:]], axis=1)
        costs[own] = [curve[first:end].min() for first, end in inside.tolist()]
    return costs
