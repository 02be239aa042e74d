"""This module adds coloured noise: body sway, and the errors of a capture system."""

from __future__ import annotations

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.synth.channels import CHANNELS

# Standard deviations of the sway of channels in their own units (leg lengths, arm lengths, degrees).
_SWAY = {
    "px": 0.008, "py": 0.004, "pz": 0.010, "yaw": 1.2, "pitch": 1.0, "roll": 0.7,
    "bend": 2.4, "side": 1.6, "twist": 3.2, "nod": 2.5, "look": 4.0, "tilt": 1.5,
    "hx": 0.030, "hy": 0.022, "hz": 0.034, "swivel": 5.0, "wrist": 6.0, "hroll": 8.0, "knee": 1.0,
}  # fmt: skip


def coloured(
    rng: np.random.Generator, frames: int, columns: int, rate_hz: float, corner_hz: float, slope: float
) -> F64:
    """Draw noise of unit variance whose spectrum is flat up to a corner frequency and falls by a power law above it.

    Returns
    -------
    float64 array (frames, columns)
    """
    # longer than requested, so that the end is not correlated with the start (the noise is periodic)
    size = frames + round(2 * rate_hz)
    spectrum = np.fft.rfft(rng.standard_normal((columns, size)), axis=1)
    frequency = np.fft.rfftfreq(size, 1 / rate_hz)
    gain = 1.0 / (1.0 + (frequency / corner_hz) ** slope)
    gain[0] = 0.0
    scale = np.sqrt(size / (gain[0] ** 2 + 2 * (gain[1:] ** 2).sum()))
    noise: F64 = np.fft.irfft(spectrum * (gain * scale), size, axis=1)[:, :frames].T
    return noise


def sway(rng: np.random.Generator, channels: F64, rate_hz: float, amount: float) -> F64:
    """Add the sway and small movements of a living body to channels; the feet are not changed."""
    result = channels.copy()
    names = [name for name in CHANNELS if _spread(name) > 0]
    slow = coloured(rng, len(channels), len(names), rate_hz, 0.35, 2.0)
    quick = coloured(rng, len(channels), len(names), rate_hz, 2.2, 3.0)
    for i, name in enumerate(names):
        result[:, CHANNELS.index(name)] += amount * _spread(name) * (1.0 * slow[:, i] + 0.4 * quick[:, i])
    return result


def _spread(name: str) -> float:
    return _SWAY.get(name, _SWAY.get(name[1:], 0.0) if name[0] in "lr" else 0.0)


def capture(rng: np.random.Generator, angles: F64, rate_hz: float, amount: float) -> F64:
    """Add the errors of a capture system to angles: slow drift and fine jitter; the root moves by millimetres."""
    drift = coloured(rng, len(angles), angles.shape[1], rate_hz, 0.15, 2.0)
    jitter = coloured(rng, len(angles), angles.shape[1], rate_hz, 5.0, 2.0)
    noise = amount * (0.45 * drift + 0.07 * jitter)
    noise[:, :3] *= 0.0035
    noise[:, 3:6] *= 0.5
    return angles + noise
