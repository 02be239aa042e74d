"""Intervals of means by drawing groups and units again."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import ParameterError


def two_stage_interval(
    strata: Sequence[Sequence[npt.NDArray[np.int64]]], draws: int = 2000, level: float = 0.95, seed: int = 0
) -> tuple[float, float]:
    """Return a percentile interval of a mean of shares, where groups of units were sampled within strata.

    For instance segments (units) of people (groups) by class (strata): classes stay as they are, in each people are
    drawn with replacement, and of each person drawn segments. So people who differ make the interval wide.

    Parameters
    ----------
    strata : sequence of sequence of int64 array (n, 2)
        The groups of each stratum; a group has a part and a whole for each of n ≥ 1 units. Its share is the sum of
        parts divided by the sum of wholes, which are above 0. The mean is over all groups of all strata.
    draws : int
        How often groups and units are drawn.
    level : float
        The fraction of draws within the interval.
    seed : int

    Returns
    -------
    (float, float)
        NaN twice where there is no group.

    Raises
    ------
    ParameterError
        If the level is not in (0, 1), there is no draw, or a group has no unit or a whole of 0.
    """
    if not 0.0 < level < 1.0:
        raise ParameterError("level", "above 0 and below 1", level)
    if draws < 1:
        raise ParameterError("draws", "1 or more", draws)
    groups = [group for stratum in strata for group in stratum]
    if any(not len(group) or (group[:, 1] <= 0).any() for group in groups):
        raise ParameterError("strata", "groups of one unit or more, with wholes above 0", [len(one) for one in groups])
    if not groups:
        return math.nan, math.nan
    random = np.random.default_rng(seed)
    total = np.zeros(draws)
    for stratum in strata:
        for _ in stratum:
            drawn = random.integers(len(stratum), size=draws)
            for index, group in enumerate(stratum):
                rows = np.flatnonzero(drawn == index)
                units = group[random.integers(len(group), size=(len(rows), len(group)))].sum(axis=1)
                total[rows] += units[:, 0] / units[:, 1]
    low, high = np.quantile(total / len(groups), [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)
