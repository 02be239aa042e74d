"""This module computes channels: numbers that describe each frame of a body, whatever its place, heading and size.

Lengths are in leg lengths of the body, and directions are those of its heading: left, up, forwards. Jumps, as where
two clips meet, reach channels of velocity only, which are limited.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.body.facing_direction import facing_yaw
from kinedex.ops.errors import ParameterError

MAX_SPEED = 8.0
"""Velocities beyond so many leg lengths a second are limited to it."""

MAX_TURN = 15.0
"""Turning rates beyond so many radians a second are limited to it."""

SMOOTHED_S = 1 / 6
"""The heading is the mean over this time, in seconds."""

EXTREMITIES = ("ltoes", "rtoes", "lfingers", "rfingers", "head")
"""The joints whose velocities are channels."""


class Channels(NamedTuple):
    """The channels of the L frames of a take with J joints.

    Attributes
    ----------
    pose : float64 array (L, 3 (J − 1))
        The joints other than the root, relative to the ground below the root, in leg lengths, as left, up, forwards.
    velocities : float64 array (L, 15)
        The velocities of `EXTREMITIES` in leg lengths a second.
    speeds : float64 array (L, J)
        The speeds of all joints in leg lengths a second.
    root : float64 array (L, 6)
        The root's velocity (left, up, forwards), the turning rate in radians a second (positive to the left), its
        absolute value, and the root's height.
    yaw : float64 array (L,)
        The heading in radians without jumps of 2π; it grows in turns to the left.
    """

    pose: F64
    velocities: F64
    speeds: F64
    root: F64
    yaw: F64

    @property
    def frames(self) -> F64:
        """The channels by which frames are compared, float64 (L, C): all but the heading."""
        return np.concatenate([self.pose, self.velocities, self.speeds, self.root], axis=1)


def channels(positions: F64, joints: Sequence[str], rate_hz: float) -> Channels:
    """Compute the channels of a take.

    Parameters
    ----------
    positions : float64 array (L, J, 3)
        The joints in metres, Y up.
    joints : sequence of str, length J
        The names of the joints; the first is the root.
    rate_hz : float
        Frames per second.

    Raises
    ------
    ParameterError
        There are fewer than two frames, a position is not known, or the legs have no length.
    """
    if len(positions) < 2:
        raise ParameterError("positions", "of two frames or more", f"{len(positions)}")
    if not np.isfinite(positions).all():
        raise ParameterError("positions", "of known joints", "unknown places")
    place = {name: index for index, name in enumerate(joints)}
    yaw = running_mean(_heading(positions, place), SMOOTHED_S * rate_hz)
    leg = _leg_length(positions, place)
    ground = positions[:, :1] * np.array([1.0, 0.0, 1.0])
    pose = _along_heading(positions - ground, yaw) / leg
    velocities = _along_heading(np.gradient(positions, axis=0) * (rate_hz / leg), yaw)
    turning = np.clip(np.gradient(yaw) * rate_hz, -MAX_TURN, MAX_TURN)
    limited = np.clip(velocities, -MAX_SPEED, MAX_SPEED)
    root = [limited[:, 0], turning[:, None], np.abs(turning)[:, None], pose[:, 0, 1:2]]
    return Channels(
        pose[:, 1:].reshape(len(pose), -1),
        limited[:, [place[name] for name in EXTREMITIES]].reshape(len(pose), -1),
        np.minimum(np.linalg.norm(velocities, axis=2), MAX_SPEED),
        np.concatenate(root, axis=1),
        yaw,
    )


def running_mean(values: F64, frames: float) -> F64:
    """Return the mean of an odd number of values around each; the first and the last value are repeated at the ends.

    Parameters
    ----------
    values : float64 array (L, …)
        The values.
    frames : float
        The number of values, rounded to the nearest odd number.
    """
    half = round((frames - 1) / 2)
    if half < 1:
        return values
    padded = np.concatenate([np.repeat(values[:1], half, axis=0), values, np.repeat(values[-1:], half, axis=0)])
    sums = np.cumsum(np.concatenate([np.zeros_like(values[:1]), padded]), axis=0)
    return (sums[2 * half + 1 :] - sums[: -2 * half - 1]) / (2 * half + 1)


def _leg_length(positions: F64, place: dict[str, int]) -> float:
    """Return the length of the legs, the median over frames and the mean of both sides."""
    sides = []
    for side in "lr":
        hip, knee, ankle = (positions[:, place[side + name]] for name in ("hip", "knee", "ankle"))
        sides.append(np.median(np.linalg.norm(hip - knee, axis=1) + np.linalg.norm(knee - ankle, axis=1)))
    leg = float(np.mean(sides))
    if leg <= 0:
        raise ParameterError("positions", "with legs that have a length", "0 m")
    return leg


def _along_heading(vectors: F64, yaw: F64) -> F64:
    """Return vectors (L, J, 3) in the directions left, up, forwards of a heading (L,)."""
    cosine, sine = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([cosine * x - sine * z, y, sine * x + cosine * z], axis=-1)


def _heading(positions: F64, place: dict[str, int]) -> F64:
    """Return the heading of each frame without jumps of 2π; it is kept where it is not determined."""
    left, right = ([place[side + name] for name in ("hip", "shoulder")] for side in "lr")
    yaw = facing_yaw(positions[:, left], positions[:, right])
    known = np.flatnonzero(np.isfinite(yaw))
    if not len(known):
        raise ParameterError("positions", "with hips or shoulders that are apart from above", "a vertical line")
    nearest = known[np.searchsorted(known, np.arange(len(yaw)), side="right").clip(1) - 1]
    return np.unwrap(yaw[nearest])
