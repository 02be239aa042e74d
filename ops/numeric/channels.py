"""This module computes channels: numbers of each frame that do not depend on a body's position, heading and size.

Lengths are in leg lengths of the body, and directions are those of its heading: left, up, forwards. A jump between two
frames, as where clips were joined, only changes channels of velocities, whose values are limited.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numba as nb
import numpy as np

from kinedex.ops.arrays import F32, F64, I64, Bool
from kinedex.ops.errors import ParameterError

MAX_SPEED = 8.0
"""Velocities beyond so many leg lengths a second are limited to it."""

MAX_TURN = 15.0
"""Turning rates beyond so many radians a second are limited to it."""

SMOOTHED_S = 1 / 6
"""The heading is the mean over this time, in seconds."""

EXTREMITIES = ("ltoes", "rtoes", "lfingers", "rfingers", "head")
"""The joints whose velocities are channels."""


@dataclass(frozen=True)
class Channels:
    """The channels of the L frames of a take with J joints.

    Attributes
    ----------
    frames : float32 array (L, C)
        The channels by which frames are compared: `pose`, `velocities`, `speeds` and `root`, side by side.
    yaw : float64 array (L,)
        The heading in radians without jumps of 2π; it grows in turns to the left.
    known : bool array (J,)
        The joints that are known; channels of others are 0.
    """

    frames: F32
    yaw: F64
    known: Bool

    @property
    def joints(self) -> int:
        """Return the number of joints J."""
        return len(self.known)

    @property
    def pose(self) -> F32:
        """Return the joints other than the root, relative to the ground below the root, float32 (L, 3 (J − 1)).

        They are in leg lengths, as left, up, forwards.
        """
        return self.frames[:, : 3 * self.joints - 3]

    @property
    def velocities(self) -> F32:
        """Return the velocities of `EXTREMITIES` in leg lengths per second, float32 (L, 15)."""
        first = 3 * self.joints - 3
        return self.frames[:, first : first + 3 * len(EXTREMITIES)]

    @property
    def speeds(self) -> F32:
        """Return the speeds of all joints in leg lengths per second, float32 (L, J)."""
        return self.frames[:, -self.joints - 6 : -6]

    @property
    def root(self) -> F32:
        """Return the root's channels, float32 (L, 6).

        Its velocity (left, up, forwards), the turning rate in radians a second (positive to the left), its absolute
        value, and the root's height.
        """
        return self.frames[:, -6:]


def channels(positions: F64 | F32, joints: Sequence[str], rate_hz: float) -> Channels:
    """Compute the channels of a take.

    A joint counts as known if half of the frames have it; in the others its place relative to the root is interpolated.

    Parameters
    ----------
    positions : float64 or float32 array (L, J, 3)
        The joints in metres, Y up; NaN where they are not known.
    joints : sequence of str, length J
        The names of the joints; the first is the root.
    rate_hz : float
        Frames per second.

    Raises
    ------
    ParameterError
        There are fewer than two frames; the root, both hips and shoulders, or both legs are not known; hips and
        shoulders lie on a vertical; or the legs have no length.
    """
    if len(positions) < 2:
        raise ParameterError("positions", "of two frames or more", f"{len(positions)}")
    place = {name: index for index, name in enumerate(joints)}
    known = np.ones(len(joints), np.bool_)
    if not np.isfinite(positions).all():
        positions, known = _bridged(positions)
        if not known[0]:
            raise ParameterError("positions", f"with the joint {joints[0]} in half of the frames", "fewer")
    pairs = np.array([[place["lhip"], place["rhip"]], [place["lshoulder"], place["rshoulder"]]])
    legs = np.array([[place[side + name] for name in ("hip", "knee", "ankle")] for side in "lr"])
    seen, sides = known[pairs].all(axis=1), known[legs].all(axis=1)
    if not seen.any():
        raise ParameterError("positions", "with both hips or both shoulders in half of the frames", "neither")
    if not sides.any():
        raise ParameterError("positions", "with hip, knee and ankle of one side in half of the frames", "neither")
    heading, lengths = _heading_and_legs(positions, pairs[seen], legs[sides])
    leg = float(np.median(lengths, axis=1).mean())
    if leg <= 0:
        raise ParameterError("positions", "with legs that have a length", "0 m")
    if not np.isfinite(heading[0]):
        raise ParameterError("positions", "with hips or shoulders that are apart from above", "a vertical line")
    yaw = running_mean(heading, SMOOTHED_S * rate_hz)
    frames = np.empty((len(positions), 4 * len(joints) + 3 * len(EXTREMITIES) + 3), np.float32)
    _fill_frames(positions, yaw, leg, rate_hz, extremities(joints), frames)
    if not known.all():
        np.nan_to_num(frames, copy=False)
    return Channels(frames, yaw, known)


def extremities(joints: Sequence[str]) -> I64:
    """Return the places of `EXTREMITIES` among the names of joints, int64 (5,)."""
    return np.array([list(joints).index(name) for name in EXTREMITIES])


def _bridged(positions: F64 | F32) -> tuple[F64, Bool]:
    """Return joints (L, J, 3) without gaps, NaN if fewer than half of the frames have them; and which have (J,)."""
    found = np.where(np.isfinite(positions).all(axis=2, keepdims=True), positions, np.nan).astype(np.float64)
    seen = np.isfinite(found[..., 0])
    known: Bool = 2 * seen.sum(axis=0) >= len(found)
    frames = np.arange(len(found))
    root = found[:, 0].copy()
    for joint in np.flatnonzero(known).tolist():
        away = found[:, joint] - (root if joint else 0.0)
        own = np.isfinite(away[:, 0])
        if own.any():
            away = np.stack([np.interp(frames, frames[own], away[own, axis]) for axis in range(3)], axis=1)
        found[:, joint] = np.where(seen[:, joint, None], found[:, joint], away + (found[:, 0] if joint else 0.0))
        known[joint] = own.any()
    found[:, ~known] = np.nan
    return found, known


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


@nb.njit(cache=True, nogil=True)
def _heading_and_legs(positions: F64 | F32, pairs: I64, legs: I64) -> tuple[F64, F64]:
    """Return the heading of each frame without jumps of 2π, and the lengths of both legs (kernel).

    Parameters
    ----------
    positions : float64 or float32 array (L, J, 3)
        The joints in metres, Y up.
    pairs : int64 array (P, 2)
        The left and the right joint of each known pair: of the hips, the shoulders, or both.
    legs : int64 array (S, 3)
        The hip, the knee and the ankle of each known leg.

    Returns
    -------
    heading : float64 array (L,)
        The heading; where it is not determined, that of the frame before, or else of the first frame that has one; NaN
        if no frame has one.
    lengths : float64 array (S, L)
        The length of each leg.
    """
    frames = len(positions)
    heading = np.full(frames, np.nan)
    lengths = np.zeros((len(legs), frames))
    known = 0  # the number of frames with a heading
    for t in range(frames):
        x = z = 0.0
        for k in range(len(pairs)):
            x += np.float64(positions[t, pairs[k, 0], 0]) - np.float64(positions[t, pairs[k, 1], 0])
            z += np.float64(positions[t, pairs[k, 0], 2]) - np.float64(positions[t, pairs[k, 1], 2])
        if x != 0.0 or z != 0.0:
            yaw = math.atan2(-z, x)
            if known == 0:
                heading[:t] = yaw
            else:
                yaw += 2.0 * math.pi * np.rint((heading[t - 1] - yaw) / (2.0 * math.pi))
            heading[t] = yaw
            known += 1
        elif known > 0:
            heading[t] = heading[t - 1]
        for side in range(len(legs)):
            for part in range(2):
                squares = 0.0
                for axis in range(3):
                    from_, to = legs[side, part], legs[side, part + 1]
                    away = np.float64(positions[t, from_, axis]) - np.float64(positions[t, to, axis])
                    squares += away * away
                lengths[side, t] += math.sqrt(squares)
    return heading, lengths


@nb.njit(cache=True, nogil=True)
def _fill_frames(positions: F64 | F32, yaw: F64, leg: float, rate_hz: float, extremities: I64, frames: F32) -> None:
    """Compute pose, velocities, speeds and the root's channels of each frame (kernel).

    Parameters
    ----------
    positions : float64 or float32 array (L, J, 3)
        The joints in metres, Y up.
    yaw : float64 array (L,)
        The heading.
    leg : float
        The length of the legs in metres.
    rate_hz : float
        Frames per second.
    extremities : int64 array (5,)
        The joints whose velocities are channels.
    frames : float32 array (L, C)
        The channels, as in `Channels`; they are written.
    """
    count, joints, _ = positions.shape
    moving = np.zeros((joints, 3))  # velocities along the heading
    for t in range(count):
        cosine, sine = math.cos(yaw[t]), math.sin(yaw[t])
        before, after = max(t - 1, 0), min(t + 1, count - 1)
        per_second = rate_hz / (leg * (after - before))
        here, old, new, row = positions[t], positions[before], positions[after], frames[t]
        ground_x, ground_z = np.float64(here[0, 0]), np.float64(here[0, 2])
        speeds = 3 * joints - 3 + 3 * len(extremities)
        for j in range(joints):
            x, y, z = (
                (np.float64(here[j, 0]) - ground_x) / leg,
                np.float64(here[j, 1]) / leg,
                (np.float64(here[j, 2]) - ground_z) / leg,
            )
            if j > 0:
                row[3 * j - 3] = cosine * x - sine * z
                row[3 * j - 2] = y
                row[3 * j - 1] = sine * x + cosine * z
            x = (np.float64(new[j, 0]) - np.float64(old[j, 0])) * per_second
            y = (np.float64(new[j, 1]) - np.float64(old[j, 1])) * per_second
            z = (np.float64(new[j, 2]) - np.float64(old[j, 2])) * per_second
            moving[j, 0], moving[j, 1], moving[j, 2] = cosine * x - sine * z, y, sine * x + cosine * z
            speed = math.sqrt(x * x + y * y + z * z)
            row[speeds + j] = MAX_SPEED if speed > MAX_SPEED else speed
        for k in range(len(extremities)):
            for axis in range(3):
                row[3 * joints - 3 + 3 * k + axis] = _limited(moving[extremities[k], axis], MAX_SPEED)
        root = speeds + joints
        for axis in range(3):
            row[root + axis] = _limited(moving[0, axis], MAX_SPEED)
        turning = _limited((yaw[after] - yaw[before]) * rate_hz / (after - before), MAX_TURN)
        row[root + 3], row[root + 4], row[root + 5] = turning, abs(turning), np.float64(here[0, 1]) / leg


@nb.njit(cache=True, nogil=True)
def _limited(value: float, limit: float) -> float:
    return limit if value > limit else -limit if value < -limit else value
