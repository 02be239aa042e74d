"""This module computes confidence intervals of proportions from counts."""

from __future__ import annotations

import math
from statistics import NormalDist

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
        The shares p from which hits / total is no more than z standard errors √(p (1 − p) / total) away; (0, 1) where
        there is no trial.

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
