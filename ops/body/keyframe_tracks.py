"""This module samples animation tracks at any times: steps, straight lines, slerp of quaternions, and cubic splines."""

from __future__ import annotations

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.body.transforms import slerp
from kinedex.ops.errors import ParameterError

USUAL_RATES_HZ = (24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 72.0, 75.0, 90.0, 100.0, 120.0, 144.0, 150.0, 180.0, 200.0,
                  240.0, 250.0, 300.0, 360.0, 400.0, 480.0, 500.0, 1000.0)  # fmt: skip
"""Rates of cameras and capture systems, slowest first."""

OFF_GRID = 0.02
"""Tolerance of a key's time as a fraction of a frame, for files that write times with few digits."""


def sample_track(times: F64, values: F64, at: F64, interpolation: str, turns: bool, late: float = 0.0) -> F64:
    """Return the values of a track at some times; outside the keys, the first or last value is repeated.

    Parameters
    ----------
    times : float64 array (K,)
        Seconds of the keys, ascending.
    values : float64 array (K, C) or (3 K, C)
        Values of the keys; for "CUBICSPLINE" incoming tangent, value and outgoing tangent of each,
        as glTF has them.
    at : float64 array (T,)
        Seconds of the samples.
    interpolation : str
        "STEP", "LINEAR" or "CUBICSPLINE".
    turns : bool
        True for unit quaternions, which are interpolated along arcs, and of which the result has length 1.
    late : float
        Tolerance in seconds: a step that comes this late after a sample still applies to it, as times may have few
        digits.

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
    """Return the frame rate that keys were probably made at: the slowest usual one whose frames hold all keys.

    Parameters
    ----------
    times : float64 array (K,)
        Seconds of all keys, ascending.

    Returns
    -------
    tuple[float, bool]
        Frames per second, and True for a usual rate; otherwise the rate comes from the median step between keys.
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
