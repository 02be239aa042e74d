"""This module describes spans of a take by pooled numbers, each computed as a difference of two cumulative sums.

A descriptor has the means and deviations of poses, of logarithms of speeds, and of the root's channels; the net turn,
with and without its sign; the displacement sideways and forwards; and the logarithm of the duration. A tenth of a
second at either end counts for the duration only, as smoothing there reaches across a cut.
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from kinedex.ops.arrays import F32, F64, I64
from kinedex.ops.errors import ParameterError
from kinedex.ops.numeric.channels import Channels

SLOW = 0.05
"""Leg lengths a second that are added to speeds before their logarithm is taken."""

TRIMMED_S = 0.1
"""The time in seconds that is left out at either end of a span which is four times as long."""


class SpanSums:
    """The channels of a take in the form from which the descriptors of spans are computed by cumulative sums.

    Parameters
    ----------
    found : Channels
        The channels of the take.
    rate_hz : float
        Frames per second.
    """

    def __init__(self, found: Channels, rate_hz: float) -> None:
        self._numbers = (found.pose, np.log(found.speeds + np.float32(SLOW)), found.root)
        self._velocity = found.pose.shape[1] + found.speeds.shape[1]
        self._yaw, self._rate_hz = found.yaw, rate_hz

    def describe(self, starts: I64, stops: I64) -> F64:
        """Return the descriptors of S spans, float64 (S, D).

        The channels are summed up once, to all frames where a span begins or ends.

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
        edges, places = np.unique(np.concatenate([first, last]), return_inverse=True)
        count = sum(one.shape[1] for one in self._numbers)
        sums, squares = np.zeros((2, len(edges), count))
        at = 0
        for one in self._numbers:
            _sum_up(one, edges, sums[:, at : at + one.shape[1]], squares[:, at : at + one.shape[1]])
            at += one.shape[1]
        found = np.empty((len(starts), 2 * count + 5))
        _pool(sums, squares, places[: len(first)], places[len(first) :], last - first, found)
        turn = self._yaw[last - 1] - self._yaw[first]
        seconds = (last - first) / self._rate_hz
        found[:, 2 * count] = turn
        found[:, 2 * count + 1] = np.abs(turn)
        found[:, 2 * count + 2] = found[:, self._velocity] * seconds
        found[:, 2 * count + 3] = found[:, self._velocity + 2] * seconds
        found[:, 2 * count + 4] = np.log(frames / self._rate_hz)
        return found


@nb.njit(cache=True, nogil=True)
def _sum_up(numbers: F32, edges: I64, sums: F64, squares: F64) -> None:
    """Write the sums of numbers (L, n) and of their squares before each of some frames, which ascend (kernel)."""
    width = numbers.shape[1]
    total, total_squares = np.zeros(width), np.zeros(width)
    t = edges[0] if len(edges) else 0
    for k in range(len(edges)):
        while t < edges[k]:
            row = numbers[t]
            for i in range(width):
                number = np.float64(row[i])
                total[i] += number
                total_squares[i] += number * number
            t += 1
        sums[k], squares[k] = total, total_squares


@nb.njit(cache=True, nogil=True)
def _pool(sums: F64, squares: F64, firsts: I64, lasts: I64, frames: I64, found: F64) -> None:
    """Write the means and the deviations of spans, side by side, from sums at their ends (kernel)."""
    width = sums.shape[1]
    for span in range(len(frames)):
        low, high, share = firsts[span], lasts[span], 1.0 / frames[span]
        row = found[span]
        for i in range(width):
            mean = (sums[high, i] - sums[low, i]) * share
            square = (squares[high, i] - squares[low, i]) * share
            row[i] = mean
            row[width + i] = math.sqrt(max(square - mean * mean, 0.0))
