"""How sure a share is: Wilson intervals of counts, and intervals of means by drawing groups and units again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import ParameterError

F64 = npt.NDArray[np.float64]


def wilson(hits: int, total: int, level: float = 0.95) -> tuple[float, float]:
    """A confidence interval of a share from counts (Wilson 1927), which is honest for few, none, and all.

    Parameters
    ----------
    hits: how many of total, 0 or more, did. level: how often the interval holds the true share.

    Returns
    -------
    (low, high): the shares p from which hits / total is no more than z standard errors √(p (1 − p) / total) away;
    (0, 1) of nothing.
    """
    _check_level(level)
    if not 0 <= hits <= total:
        raise ParameterError("hits", f"between 0 and the total, {total}", hits)
    if not total:
        return 0.0, 1.0
    z = NormalDist().inv_cdf(0.5 + level / 2)
    share, weight = hits / total, z * z / total
    middle = (share + weight / 2) / (1 + weight)
    half = z * math.sqrt(share * (1 - share) / total + weight / (4 * total)) / (1 + weight)
    # the ends of nothing and of all are exact, whatever rounding makes of them
    return middle - half if hits else 0.0, middle + half if hits < total else 1.0


def two_stage_interval(
    strata: Sequence[Sequence[npt.NDArray[np.int64]]], draws: int = 2000, level: float = 0.95, seed: int = 0
) -> tuple[float, float]:
    """A percentile interval of a mean of shares, where what was sampled are groups of units within strata.

    For instance segments (units) of people (groups) by class (strata): classes stay as they are, in each people are
    drawn with replacement, and of each person drawn segments. So people who differ make the interval wide.

    Parameters
    ----------
    strata: groups of each stratum; a group is int64 (n, 2), a part and a whole for each of n ≥ 1 units. Its share is
        the sum of parts by the sum of wholes, which are above 0. The mean is over all groups of all strata.

    Returns
    -------
    (low, high); NaN twice where there is no group.
    """
    _check_level(level)
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


def _check_level(level: float) -> None:
    if not 0.0 < level < 1.0:
        raise ParameterError("level", "above 0 and below 1", level)
