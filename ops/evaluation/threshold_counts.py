"""This module counts frames and segments above a threshold, for many thresholds in one pass."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.errors import ParameterError
from kinedex.ops.evaluation.metrics import Bounds, Counts


def threshold_counts(values: F64, manual: Bounds, thresholds: Sequence[float]) -> list[Counts]:
    """Compare the runs of frames above each threshold with manual segments, like `metrics.compare` for one threshold.

    A run at τ ends when the value falls to τ or less. Hence the number of runs is the number of frames above τ minus
    the number of adjacent pairs of frames that are both above τ. The number of runs that overlap a manual segment is
    the number of manual frames above τ minus the number of pairs of successive manual frames between which all values
    are above τ. Each of these is a count of numbers above τ, which a sorted array gives for all thresholds.

    Parameters
    ----------
    values : float64 array (T,)
        The value of each frame, without NaN.
    manual : int64 array (S, 2) or sequence of (int, int)
        Half-open ranges of frames, in any order; frames of overlapping ranges are counted once.
    thresholds : sequence of float
        The thresholds τ, ascending.

    Returns
    -------
    list of Counts
        The counts for each threshold.

    Raises
    ------
    ParameterError
        Thresholds do not ascend, a value is NaN, or a segment is empty or beyond the frames.
    """
    limits = np.asarray(thresholds, np.float64)
    if not (np.diff(limits) > 0).all():
        raise ParameterError("thresholds", "ascending", list(thresholds))
    if np.isnan(values).any():
        raise ParameterError("values", "numbers", "NaN")
    bounds = np.asarray(manual, np.int64).reshape(-1, 2)
    if len(bounds) and not (bounds.min() >= 0 and (bounds[:, 0] < bounds[:, 1]).all() and bounds.max() <= len(values)):
        raise ParameterError("manual", f"ranges with 0 ≤ start < stop ≤ {len(values)}", bounds.tolist()[:4])
    edges = np.zeros(len(values) + 1, np.int64)
    np.add.at(edges, bounds[:, 0], 1)
    np.add.at(edges, bounds[:, 1], -1)
    marked = np.flatnonzero(np.cumsum(edges[:-1]) > 0)
    both = _above(values[marked], limits)
    automatic = _above(values, limits)
    runs = automatic - _above(np.minimum(values[:-1], values[1:]), limits)
    hit = both - _above(_least_between(values, marked), limits)
    peaks = np.array([values[start:stop].max() for start, stop in bounds.tolist()], np.float64)
    found = _above(peaks, limits)
    columns = (both, automatic, hit, runs, found)
    return [
        Counts(int(b), int(a), len(marked), int(h), int(r), int(f), len(bounds))
        for b, a, h, r, f in zip(*columns, strict=True)
    ]


def _above(values: F64, limits: F64) -> I64:
    """Return the number of values above each threshold."""
    passed = np.bincount(np.searchsorted(limits, values, side="left"), minlength=len(limits) + 1)
    return np.asarray(passed[::-1].cumsum()[::-1][1:])


def _least_between(values: F64, marked: I64) -> F64:
    """Return the smallest value from each marked frame up to and including the next."""
    if len(marked) < 2:
        return np.empty(0)
    # each piece ends before the next marked frame, whose own value is added
    least = np.minimum.reduceat(values[: marked[-1] + 1], marked)[:-1]
    return np.minimum(least, values[marked[1:]])
