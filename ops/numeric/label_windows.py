"""This module computes the descriptors of labels and examples from the frames of their takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.errors import ParameterError
from kinedex.ops.numeric.channels import channels
from kinedex.ops.numeric.span_descriptors import SpanSums

LEAST_FRAMES = 3
"""The fewest frames of a label that can be described."""


class Window(NamedTuple):
    """The frames of a label, and some around it.

    Attributes
    ----------
    positions : float64 array (L, J, 3)
        The joints in metres, Y up; NaN where they are not known.
    start, stop : int
        The label, a half-open range of these frames.
    """

    positions: F64
    start: int
    stop: int


def known_part(window: Window) -> Window:
    """Return the frames around a label in which all joints are known.

    Raises
    ------
    ParameterError
        The label is too short, or a joint is not known in one of its frames.
    """
    if window.stop - window.start < LEAST_FRAMES:
        raise ParameterError("a label", f"of {LEAST_FRAMES} frames or more", "fewer")
    unknown = np.flatnonzero(~np.isfinite(window.positions).all(axis=(1, 2)))
    first = int(unknown[unknown < window.start].max(initial=-1)) + 1
    last = int(unknown[unknown >= window.start].min(initial=len(window.positions)))
    if last < window.stop:
        raise ParameterError("a label", "of frames in which all joints are known", "frames without")
    return Window(window.positions[first:last], window.start - first, window.stop - first)


def described(window: Window, joints: Sequence[str], rate_hz: float) -> F64:
    """Return the descriptor of a label, float64 (D,).

    Parameters
    ----------
    window : Window
        The label, with known joints.
    joints : sequence of str
        The names of the joints, the root first.
    rate_hz : float
        Frames per second.

    Raises
    ------
    ParameterError
        The body has no legs, or faces no direction.
    """
    sums = SpanSums(channels(window.positions, joints, rate_hz), rate_hz)
    found: F64 = sums.describe(np.array([window.start]), np.array([window.stop]))[0]
    return found
