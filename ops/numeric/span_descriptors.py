"""This module describes spans of a take by pooled numbers, each at the cost of a difference of two sums.

A descriptor has the means and deviations of poses, of logarithms of speeds, and of the root's channels; the net turn,
with and without its sign; the displacement sideways and forwards; and the logarithm of the duration. A tenth of a
second at either end counts for the duration only, as smoothing there reaches across a cut.
"""

from __future__ import annotations

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.errors import ParameterError
from kinedex.ops.numeric.channels import Channels

SLOW = 0.05
"""Leg lengths a second that are added to speeds before their logarithm is taken."""

TRIMMED_S = 0.1
"""The time in seconds that is left out at either end of a span which is four times as long."""


class SpanSums:
    """The sums of a take's channels before each frame, from which spans are described.

    Parameters
    ----------
    found : Channels
        The channels of the take.
    rate_hz : float
        Frames per second.
    """

    def __init__(self, found: Channels, rate_hz: float) -> None:
        numbers = np.concatenate([found.pose, np.log(found.speeds + SLOW), found.root], axis=1)
        powers = np.concatenate([numbers, numbers**2], axis=1)
        self._sums = np.concatenate([np.zeros((1, powers.shape[1])), np.cumsum(powers, axis=0)])
        self._velocity = found.pose.shape[1] + found.speeds.shape[1]
        self._yaw, self._rate_hz = found.yaw, rate_hz

    def describe(self, starts: I64, stops: I64) -> F64:
        """Return the descriptors of S spans, float64 (S, D).

        Parameters
        ----------
        starts, stops : int64 array (S,)
            The first frame of each span, and the frame after its last.

        Raises
        ------
        ParameterError
            A span is empty, or reaches beyond the take.
        """
        frames = stops - starts
        if np.any(frames < 1) or np.any(starts < 0) or np.any(stops > len(self._yaw)):
            raise ParameterError("spans", f"with frames of 0 to {len(self._yaw)}", "others")
        trimmed = round(TRIMMED_S * self._rate_hz)
        ends = np.where(frames >= 4 * trimmed, trimmed, 0)
        first, last = starts + ends, stops - ends
        sums = self._sums[last] - self._sums[first]
        pooled = sums / (last - first)[:, None]
        mean, square = np.split(pooled, 2, axis=1)
        deviation = np.sqrt(np.maximum(square - mean**2, 0.0))
        turn = self._yaw[last - 1] - self._yaw[first]
        way = sums[:, [self._velocity, self._velocity + 2]] / self._rate_hz
        duration = np.log(frames / self._rate_hz)
        return np.concatenate([mean, deviation, turn[:, None], np.abs(turn)[:, None], way, duration[:, None]], axis=1)
