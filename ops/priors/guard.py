"""The guard compares each hit's fit to the observations with that of a track without priors (not in the thesis)."""

from __future__ import annotations

import numpy as np

from kinedex.ops.arrays import F64, Bool
from kinedex.ops.errors import ParameterError
from kinedex.ops.priors.allocation import Allocation

GUARD = 1.12
"""Ratio of observation costs, with to without priors, above which a hit's priors are withdrawn (docs/studies.md)."""

LOCAL_GUARD, LOCAL_S = 1.05, 0.5
"""Ratio of costs over a window, in seconds, above which archive poses are withdrawn locally (docs/studies.md)."""


def cost_ratios(allocation: Allocation, costs: F64, without: F64) -> F64:
    """Return for each hit the ratio of the observation costs of the track with priors and without.

    Parameters
    ----------
    allocation : Allocation
        The hits of the frames.
    costs : float64 array (T,)
        The cost of the observations in each frame of the track with priors.
    without : float64 array (T,)
        The same of the track without priors.

    Returns
    -------
    float64 array (H,)
        The ratio of the sums over the frames of each hit; 1 where a hit has no frame, or both sums are 0.

    Raises
    ------
    ParameterError
        If the costs are not those of all frames.
    """
    if not len(costs) == len(without) == len(allocation.owners):
        raise ParameterError("costs", f"those of {len(allocation.owners)} frames", (len(costs), len(without)))
    places = allocation.owners + 1  # frames without a hit are counted in bin 0
    ours, theirs = (np.bincount(places, weights=c, minlength=len(allocation.hits) + 1)[1:] for c in (costs, without))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(theirs > 0, ours / theirs, np.where(ours > 0, np.inf, 1.0))


def allowed_ratios(qualities: F64, guard: float) -> F64:
    """Return the greatest cost ratio at which each hit is still accepted.

    The limit falls linearly from `guard` for hits of cost 0 to 1 for hits of cost τ. On takes of known and unknown
    motion, priors of hits with a cost of 0.10 to 0.13 did harm from a ratio of 1.03 on, and those of hits with a cost
    below 0.06 helped up to 1.07.

    Parameters
    ----------
    qualities : float64 array (H,)
        1 − cost / τ of each hit.
    guard : float
        The greatest ratio of a hit of cost 0; infinite to accept all.

    Returns
    -------
    float64 array (H,)
    """
    if not np.isfinite(guard):
        return np.full(len(qualities), np.inf)
    limits: F64 = 1.0 + (guard - 1.0) * qualities
    return limits


def refuted_frames(allocation: Allocation, costs: F64, without: F64, rate_hz: float) -> Bool:
    """Return the frames around which a track fits the observations worse than the track without priors does.

    A hit may be right as a whole and wrong in some frames. Moving averages over `LOCAL_S` are compared; where the ratio
    exceeds `LOCAL_GUARD`, the priors of the frames within the window are withdrawn.

    Parameters
    ----------
    allocation : Allocation
        The hits of T frames.
    costs, without : float64 array (T,)
        The cost of the observations in each frame of the track with priors, and of the one without.
    rate_hz : float
        Frames per second.

    Returns
    -------
    bool array (T,)
        True in the frames whose priors are withdrawn.
    """
    half = max(1, round(0.5 * LOCAL_S * rate_hz))
    window = np.ones(2 * half + 1)
    ours, theirs = (np.convolve(one, window)[half:-half] for one in (costs, without))
    worse = (allocation.owners >= 0) & (ours > LOCAL_GUARD * theirs)
    return np.convolve(worse, window)[half:-half] > 0.5
