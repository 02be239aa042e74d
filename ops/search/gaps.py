"""This module converts gaps between keyframes from distance and stiffness to ranges, and back (thesis, 3.4 and 4.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from kinedex.ops.errors import ParameterError
from kinedex.ops.words import I64

UNBOUNDED = 2**31 - 1
"""The largest gap in frames, which represents infinity, since a take has fewer than 2**31 frames."""


def gap_bounds(distance: int, stiffness: float) -> tuple[int, int]:
    """Return the admissible gap for a distance and a stiffness (thesis, Eq. 3.3, 4.5 and 4.6).

    Products and quotients are rounded to 1e-9 first, because floor(7 / 0.07) is 99 in plain float64.

    Parameters
    ----------
    distance : int
        The distance d in analysis frames, 0 to `UNBOUNDED`.
    stiffness : float
        The stiffness sigma, from 0 (any later frame) to 1 (exactly d frames later).

    Returns
    -------
    (int, int)
        (d_min, d_max) = (ceil(sigma d), floor(d / sigma)), both included; (0, `UNBOUNDED`) for sigma = 0.

    Raises
    ------
    ParameterError
        If the distance or the stiffness is out of its domain.
    """
    if isinstance(distance, bool) or distance != int(distance) or not 0 <= distance <= UNBOUNDED:
        raise ParameterError("distance", f"a whole number of frames from 0 to {UNBOUNDED}", distance)
    if not 0.0 <= stiffness <= 1.0:
        raise ParameterError("stiffness", "between 0 and 1", stiffness)
    if stiffness == 0.0:
        return 0, UNBOUNDED
    low = math.ceil(round(stiffness * distance, 9))
    longest = distance / stiffness
    return low, UNBOUNDED if longest >= UNBOUNDED else math.floor(round(longest, 9))


def nominal_gap(low: int, high: int) -> tuple[float, float]:
    """Return the distance and the stiffness of a gap that is given as a range (thesis, Eq. 4.7 and 4.8).

    Parameters
    ----------
    low, high : int
        The admissible gap in frames, both ends included; `UNBOUNDED` is no upper bound.

    Returns
    -------
    (float, float)
        Distance sqrt(low high) and stiffness sqrt(low / high); (inf, 0) without an upper bound; and (0, 1) for the gap
        [0, 0], where the equation would divide zero by zero and only the same frame is allowed.
    """
    _check_gap(low, high)
    if high >= UNBOUNDED:
        return math.inf, 0.0
    if high == 0:
        return 0.0, 1.0
    return math.sqrt(low * high), math.sqrt(low / high)


def checked_gaps(gaps: Sequence[tuple[int, int]], keyframes: int) -> I64:
    """Return the gaps of a query as an array, clamped to `UNBOUNDED`.

    Parameters
    ----------
    gaps : sequence of (int, int)
        Admissible gaps (low, high) in frames, both ends included.
    keyframes : int
        The number of keyframes K.

    Returns
    -------
    int64 array (K - 1, 2)

    Raises
    ------
    ParameterError
        If the number of gaps is not K - 1, or a gap is not a range.
    """
    if len(gaps) != keyframes - 1:
        raise ParameterError("gaps", f"{keyframes - 1}, one fewer than keyframes", len(gaps))
    for low, high in gaps:
        _check_gap(low, high)
    clamped = [(min(low, UNBOUNDED), min(high, UNBOUNDED)) for low, high in gaps]
    return np.array(clamped, dtype=np.int64).reshape(-1, 2)


def _check_gap(low: int, high: int) -> None:
    if not 0 <= low <= high:
        raise ParameterError("gap", "a range [low, high] of frames with 0 <= low <= high", (low, high))
