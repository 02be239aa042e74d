"""This module chooses the distance threshold that best separates the clips of a class from all other clips."""

from __future__ import annotations

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.errors import ParameterError


def best_threshold(own: F64, others: F64) -> tuple[float, float]:
    """Return the threshold τ with the greatest F-measure, and that F-measure.

    Clips with a distance below τ are assigned to the class. F = 2 TP / (2 TP + FP + FN), where TP counts the clips of
    the class below τ, FP the other clips below τ, and FN the clips of the class not below τ. Every τ between two
    successive distances gives the same F, so τ is the midpoint of such an interval. Of several intervals with the
    greatest F, the widest is chosen, and of equally wide ones the lowest. The interval above the greatest distance is
    taken to end at twice that distance.

    Parameters
    ----------
    own : float64 array (A,)
        The smallest distance in each clip of the class; ∞ if no path fits into the clip.
    others : float64 array (B,)
        The smallest distance in each clip of other classes.

    Returns
    -------
    (float, float)
        The threshold τ, and its F-measure.

    Raises
    ------
    ParameterError
        If there is no finite distance in `own`, or one below 0.
    """
    lows, scores = threshold_scores(own, others)
    highs = np.append(lows[1:], max(2 * lows[-1], lows[-1] + 1e-6))
    middles = (lows + highs) / 2
    best = np.flatnonzero(scores >= scores.max() - 1e-12)
    gaps = (highs - lows)[best]
    place = best[int(np.argmax(gaps >= gaps.max() - 1e-12))]
    return float(middles[place]), float(scores[place])


def threshold_scores(own: F64, others: F64) -> tuple[F64, F64]:
    """Return the F-measure as a function of the threshold, a step function that changes at the distances of clips.

    Parameters
    ----------
    own, others : float64 array
        As in `best_threshold`.

    Returns
    -------
    distances : float64 array (D,)
        The different distances of all clips, ascending.
    scores : float64 array (D,)
        The F-measure of a τ above this distance and not above the next distance.

    Raises
    ------
    ParameterError
        If there is no finite distance in `own`, or one below 0.
    """
    own, others = np.sort(np.asarray(own, np.float64)), np.sort(np.asarray(others, np.float64))
    finite = np.unique(np.concatenate([own[np.isfinite(own)], others[np.isfinite(others)]]))
    if not len(own) or not np.isfinite(own[0]) or finite[0] < 0:
        raise ParameterError("own", "distances from 0, at least one of them finite", own.tolist()[:8])
    hits = np.searchsorted(own, finite, side="right")
    false = np.searchsorted(others, finite, side="right")
    scores: F64 = 2 * hits / (hits + false + len(own))
    return finite, scores
