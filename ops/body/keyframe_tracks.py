"""This module samples animation tracks at given times, by constant, linear, spherical or cubic interpolation.

A track has vectors or quaternions as values, as in glTF; a curve has single numbers, as in FBX.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.transforms import slerp
from kinedex.ops.errors import ParameterError

USUAL_RATES_HZ = (24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 72.0, 75.0, 90.0, 100.0, 120.0, 144.0, 150.0, 180.0, 200.0,
                  240.0, 250.0, 300.0, 360.0, 400.0, 480.0, 500.0, 1000.0)  # fmt: skip
"""The usual frame rates of cameras and capture systems, ascending."""

OFF_GRID = 0.02
"""Tolerance of a key's time as a fraction of a frame, for files that write times with few digits."""

CONSTANT, LINEAR, CUBIC = 0x2, 0x4, 0x8
"""Flags of a key for the interpolation up to the next key."""

NEXT_VALUE = 0x100
"""Flag of a constant key whose interval takes the next key's value."""

OWN_SLOPES = 0x400
"""Flag of a cubic key that states its slopes; other slopes are computed from the neighbouring keys."""


def sample_track(times: F64, values: F64, at: F64, interpolation: str, turns: bool, late: float = 0.0) -> F64:
    """Return the values of a track at given times; before the first and after the last key the value is constant.

    Parameters
    ----------
    times : float64 array (K,)
        Times of the keys in seconds, ascending.
    values : float64 array (K, C) or (3 K, C)
        Values of the keys; for "CUBICSPLINE" the incoming tangent, value and outgoing tangent of each key, as in glTF.
    at : float64 array (T,)
        Times of the samples in seconds.
    interpolation : str
        "STEP", "LINEAR" or "CUBICSPLINE".
    turns : bool
        True for unit quaternions, which are interpolated along arcs; the results are unit quaternions.
    late : float
        Tolerance in seconds. A step that is at most this much later than a sample applies to the sample, since times in
        files may be rounded.

    Returns
    -------
    float64 array (T, C)

    Raises
    ------
    ParameterError
        There is no key, or there are not as many values as keys.
    """
    per_key = 3 if interpolation == "CUBICSPLINE" else 1
    if not len(times) or len(values) != per_key * len(times):
        raise ParameterError("values", f"{per_key} for each of at least one key", len(values))
    at = np.clip(at, times[0], times[-1])
    later = np.clip(np.searchsorted(times, at, side="right"), 1, max(1, len(times) - 1))
    earlier = later - 1
    if len(times) == 1:
        later = earlier
    length = times[later] - times[earlier]
    share = np.divide(at - times[earlier], length, out=np.zeros_like(at), where=length > 0)
    if interpolation == "STEP":
        result = values[np.clip(np.searchsorted(times, at + late, side="right") - 1, 0, len(times) - 1)]
    elif interpolation == "CUBICSPLINE":
        keys = values.reshape(len(times), 3, -1)
        s, d = share[:, None], length[:, None]
        result = (
            (2 * s**3 - 3 * s**2 + 1) * keys[earlier, 1]
            + d * (s**3 - 2 * s**2 + s) * keys[earlier, 2]
            + (3 * s**2 - 2 * s**3) * keys[later, 1]
            + d * (s**3 - s**2) * keys[later, 0]
        )
    elif turns:
        result = slerp(_unit(values[earlier]), _unit(values[later]), share)
    else:
        result = values[earlier] + share[:, None] * (values[later] - values[earlier])
    return _unit(result) if turns else result


def _unit(quaternions: F64) -> F64:
    length = np.linalg.norm(quaternions, axis=1, keepdims=True)
    unit: F64 = np.divide(quaternions, length, out=np.zeros_like(quaternions), where=length > 0)
    return unit


def likely_rate(times: F64) -> tuple[float, bool]:
    """Return the probable frame rate of keys, which is the lowest usual rate that has a frame at every key.

    Parameters
    ----------
    times : float64 array (K,)
        Times of all keys in seconds, ascending.

    Returns
    -------
    tuple[float, bool]
        Frames per second, and True for a usual rate, or False for a rate computed from the median time between keys,
        which is limited to the range of the usual rates. If all keys are at one time, the rate is 30.
    """
    steps = np.diff(times)
    steps = steps[steps > 1e-5]
    if not len(steps):
        return 30.0, True
    for rate_hz in USUAL_RATES_HZ:
        frames = (times - times[0]) * rate_hz
        if np.abs(frames - np.round(frames)).max() <= OFF_GRID + 1.2e-7 * abs(times[-1]) * rate_hz:
            return rate_hz, True
    return float(np.clip(1.0 / np.median(steps), USUAL_RATES_HZ[0], USUAL_RATES_HZ[-1])), False


@dataclass(frozen=True, eq=False)
class Curve:
    """An animation curve of one number over time.

    Attributes
    ----------
    times : float64 array (K,)
        Times of the keys in seconds, ascending.
    values : float64 array (K,)
        The values of the keys.
    flags : int64 array (K,), optional
        `CONSTANT`, `LINEAR` or `CUBIC`, combined with other flags; None for linear interpolation.
    slopes : float64 array (K, 4), optional
        The slope after each key and the slope before the next key, per second; the last two columns are not used.
    """

    times: F64
    values: F64
    flags: I64 | None = None
    slopes: F64 | None = None

    def at(self, seconds: F64, late: float = 0.0) -> F64:
        """Return the values at given times; before the first and after the last key the value is constant.

        Parameters
        ----------
        seconds : float64 array (T,)
            The times.
        late : float
            Tolerance in seconds: a constant key that is at most this much later than a sample applies to the sample.
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
        """Return a slope at each key: 0 at extrema and at both ends, else the slope between the neighbouring keys."""
        slopes = np.zeros(len(self.times))
        span = self.times[2:] - self.times[:-2]
        rise = self.values[2:] - self.values[:-2]
        extreme = (self.values[1:-1] - self.values[:-2]) * (self.values[2:] - self.values[1:-1]) <= 0
        np.divide(rise, span, out=slopes[1:-1], where=(span > 0) & ~extreme)
        return slopes
