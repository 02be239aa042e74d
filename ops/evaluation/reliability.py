"""This module tests confidences: their calibration, and how well they separate right from wrong segments."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist

import numpy as np

from kinedex.ops.arrays import F64, Bool
from kinedex.ops.errors import ParameterError


def wilson(hits: int, total: int, level: float = 0.95) -> tuple[float, float]:
    """Return the Wilson score interval of a proportion (Wilson 1927), which also holds for few counts, none and all.

    Parameters
    ----------
    hits : int
        The number of successes, 0 or more.
    total : int
        The number of trials.
    level : float
        The probability that the interval covers the true proportion.

    Returns
    -------
    (float, float)
        The interval of all proportions p for which hits / total differs from p by at most z standard errors
        √(p (1 − p) / total); (0, 1) if there is no trial.

    Raises
    ------
    ParameterError
        If the level is not in (0, 1), or there are more hits than trials.
    """
    if not 0.0 < level < 1.0:
        raise ParameterError("level", "above 0 and below 1", level)
    if not 0 <= hits <= total:
        raise ParameterError("hits", f"between 0 and the total, {total}", hits)
    if not total:
        return 0.0, 1.0
    z = NormalDist().inv_cdf(0.5 + level / 2)
    share, weight = hits / total, z * z / total
    middle = (share + weight / 2) / (1 + weight)
    half = z * math.sqrt(share * (1 - share) / total + weight / (4 * total)) / (1 + weight)
    # the bounds for none and for all are exact, without rounding errors
    return middle - half if hits else 0.0, middle + half if hits < total else 1.0


EDGES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
"""The edges of five bins of confidence."""


@dataclass(frozen=True)
class ConfidenceBin:
    """The segments whose confidence is in [low, high), or in [low, high] for the last bin.

    Attributes
    ----------
    low, high : float
        The edges.
    count, right : int
        The number of segments, and the number of those with the right label.
    confidence : float
        The mean confidence of the segments; NaN if there are none.
    share : float
        The fraction of segments with the right label; NaN if there are none.
    interval : (float, float)
        The Wilson interval of the fraction, at 95 %, as if segments were independent.
    """

    low: float
    high: float
    count: int
    right: int
    confidence: float
    share: float
    interval: tuple[float, float]


def reliability(confidences: F64, right: Bool, edges: Sequence[float] = EDGES) -> list[ConfidenceBin]:
    """Sort segments into bins of confidence, as in a reliability diagram.

    Parameters
    ----------
    confidences : float64 array (S,)
        Confidences, from the first edge to the last.
    right : bool array (S,)
        True where the label is right.
    edges : sequence of float
        Ascending edges of the bins.
    """
    _check(confidences, right)
    positions = np.clip(np.searchsorted(np.asarray(edges), confidences, side="right") - 1, 0, len(edges) - 2)
    found = []
    for place, (low, high) in enumerate(pairwise(edges)):
        own, truth = confidences[positions == place], right[positions == place]
        mean, share = (float(one.mean()) if len(own) else float("nan") for one in (own, truth))
        count, hits = len(own), int(truth.sum())
        found.append(ConfidenceBin(low, high, count, hits, mean, share, wilson(hits, count)))
    return found


def auroc(scores: F64, right: Bool) -> float:
    """Return the probability that a right segment has a higher score than a wrong one; ties count half.

    This is the area under the receiver operating characteristic (Hanley and McNeil, 1982). It is NaN if all segments
    are right or all are wrong.

    Parameters
    ----------
    scores : float64 array (S,)
        Scores that are higher for segments that are more likely right.
    right : bool array (S,)
        True where the label is right.
    """
    _check(scores, right)
    _, inverse, counts = np.unique(scores, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(counts) - (counts - 1) / 2)[inverse]
    hits = int(right.sum())
    pairs = hits * (len(right) - hits)
    return float((ranks[right].sum() - hits * (hits + 1) / 2) / pairs) if pairs else float("nan")


def brier(confidences: F64, right: Bool) -> float:
    """Return the mean squared difference of confidence and truth, 0 at best (Brier, 1950); NaN without segments."""
    _check(confidences, right)
    return float(np.mean((confidences - right) ** 2)) if len(right) else float("nan")


def _check(scores: F64, right: Bool) -> None:
    if len(scores) != len(right):
        raise ParameterError("right", f"one value for each of {len(scores)} segments", len(right))
