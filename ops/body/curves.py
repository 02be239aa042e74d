"""This module evaluates animation curves of one number: steps, straight lines and cubics between keys."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64, I64

CONSTANT, LINEAR, CUBIC = 0x2, 0x4, 0x8
"""Flags of a key for the interpolation up to the next key."""

NEXT_VALUE = 0x100
"""Flag of a constant key whose interval takes the next key's value."""

OWN_SLOPES = 0x400
"""Flag of a cubic key that states its slopes; other slopes are computed from the neighbouring keys."""


@dataclass(frozen=True, eq=False)
class Curve:
    """An animation curve of one number over time.

    Attributes
    ----------
    times : float64 array (K,)
        Seconds of the keys, ascending.
    values : float64 array (K,)
        Their values.
    flags : int64 array (K,), optional
        `CONSTANT`, `LINEAR` or `CUBIC`, and more; None for straight lines.
    slopes : float64 array (K, 4), optional
        Slope after the key and slope before the next one, in values a second; the last two columns are not used.
    """

    times: F64
    values: F64
    flags: I64 | None = None
    slopes: F64 | None = None

    def at(self, seconds: F64, late: float = 0.0) -> F64:
        """Return the values at some times; outside the keys, the value of the first or last key is repeated.

        Parameters
        ----------
        seconds : float64 array (T,)
            The times.
        late : float
            Tolerance in seconds: a constant key that comes this late after a sample still applies to it.
        """
        straight: F64 = np.interp(seconds, self.times, self.values)
        if self.flags is None or self.slopes is None or len(self.times) < 2:
            return straight
        last = len(self.times) - 1
        key = np.clip(np.searchsorted(self.times, seconds, side="right") - 1, 0, last - 1)
        inside = (seconds > self.times[key]) & (seconds < self.times[key + 1])
        cubic = inside & (self.flags[key] & CUBIC > 0)
        if cubic.any():
            straight[cubic] = self._cubic(key[cubic], seconds[cubic])
        step = np.clip(np.searchsorted(self.times, seconds + late, side="right") - 1, 0, last)
        constant = (self.flags[step] & CONSTANT > 0) & (step < last)
        shown = np.where(self.flags[step] & NEXT_VALUE > 0, np.minimum(step + 1, last), step)
        straight[constant] = self.values[shown[constant]]
        return straight

    def _cubic(self, key: I64, seconds: F64) -> F64:
        """Return the values of Hermite cubics on the intervals that begin at the given keys."""
        flags, slopes = self.flags, self.slopes
        assert flags is not None
        assert slopes is not None
        length = self.times[key + 1] - self.times[key]
        s = (seconds - self.times[key]) / length
        smooth = self._smooth()
        own = flags[key] & OWN_SLOPES > 0
        after = np.where(own, slopes[key, 0], smooth[key])
        before = np.where(own, slopes[key, 1], smooth[key + 1])
        first, second = self.values[key], self.values[key + 1]
        return (
            (2 * s**3 - 3 * s**2 + 1) * first
            + length * (s**3 - 2 * s**2 + s) * after
            + (3 * s**2 - 2 * s**3) * second
            + length * (s**3 - s**2) * before
        )

    def _smooth(self) -> F64:
        """Return a slope at each key: that of the line through both neighbours, and 0 at both ends and at extrema."""
        slopes = np.zeros(len(self.times))
        span = self.times[2:] - self.times[:-2]
        rise = self.values[2:] - self.values[:-2]
        extreme = (self.values[1:-1] - self.values[:-2]) * (self.values[2:] - self.values[1:-1]) <= 0
        np.divide(rise, span, out=slopes[1:-1], where=(span > 0) & ~extreme)
        return slopes
