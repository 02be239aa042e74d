"""This module measures the orientation error between a take and a sensor, and finds runs of large error.

The error e of a frame is the angle of D = q̄_T ∘ q_G ∘ q_I ∘ q̄_L, the rotation from the limb of the take to the limb
that the sensor reports, in the segment's axes (thesis, Eq. 7.16). Its twist is the rotation about the limb's long axis,
which is hardly visible in a mesh. Its swing is the rotation of the long axis itself. They satisfy
cos(e/2) = cos(swing/2) · cos(twist/2).

Quaternions are denoted as in `ops.inertial.hand_eye`; F_GI is the inertial world, with Z up.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial.rotations import (
    angle,
    conjugate,
    inverse_product,
    multiply,
    product,
    product_inverse,
    rotate,
    row,
)

TAU_DEG = 45.0
"""The error in degrees above which a frame counts as wrong, as in the thesis."""

MIN_AUTO_DEG, AUTO_DEVIATIONS, MAD_TO_SIGMA = 15.0, 4.0, 1.4826


class OrientationErrors(NamedTuple):
    """The errors of a stream's frames, float64 arrays (T,) in degrees; NaN where a quaternion is unknown."""

    degrees: F64
    swing: F64
    twist: F64


def frame_errors(sensor: F64, track: F64, q_global: F64, q_mount: F64, axis: F64) -> OrientationErrors:
    """Compute the error of each frame, its swing and its twist (thesis, Eq. 7.16).

    Parameters
    ----------
    sensor : float64 array (T, 4)
        Orientations of the sensor at the take's frames, sensor → F_GI.
    track : float64 array (T, 4)
        Orientations of the limb, segment → the take's world.
    q_global : float64 array (4,)
        The rotation F_GI → the take's world.
    q_mount : float64 array (4,)
        The rotation sensor → segment.
    axis : float64 array (3,)
        The limb's long axis in the segment's axes, of any length but 0.

    Returns
    -------
    OrientationErrors
        The errors in degrees, 0 to 180.

    Raises
    ------
    ParameterError
        The shapes do not agree, or the axis is 0.
    """
    if sensor.shape != track.shape or sensor.ndim != 2 or sensor.shape[1] != 4:
        raise ParameterError("sensor and track", "both of shape (T, 4)", (sensor.shape, track.shape))
    length = float(np.linalg.norm(axis))
    if not length > 0.0:
        raise ParameterError("axis", "a vector that is not 0", np.asarray(axis).tolist())
    out = np.empty((3, len(sensor)))
    _errors(
        np.ascontiguousarray(sensor, np.float64),
        np.ascontiguousarray(track, np.float64),
        np.ascontiguousarray(q_global, np.float64),
        np.ascontiguousarray(q_mount, np.float64),
        np.asarray(axis, np.float64) / length,
        out,
    )
    return OrientationErrors(out[0], out[1], out[2])


@njit(cache=True, nogil=True, error_model="numpy")
def _errors(sensor: F64, track: F64, q_global: F64, q_mount: F64, axis: F64, out: F64) -> None:
    world = (q_global[0], q_global[1], q_global[2], q_global[3])
    mount = (q_mount[0], q_mount[1], q_mount[2], q_mount[3])
    a, b, c = axis[0], axis[1], axis[2]
    degrees = 180.0 / math.pi
    for k in range(len(sensor)):
        limb = product_inverse(product(world, row(sensor, k)), mount)
        turn = inverse_product(row(track, k), limb)
        w, x, y, z = turn
        along = x * a + y * b + z * c
        p, q, r = x - along * a, y - along * b, z - along * c
        out[0, k] = degrees * angle(turn)
        out[1, k] = degrees * 2.0 * math.atan2(math.sqrt(p * p + q * q + r * r), math.sqrt(w * w + along * along))
        out[2, k] = degrees * 2.0 * math.atan2(abs(along), abs(w))


def mount_direction(sensor: F64, directions: F64, q_global: F64) -> F64:
    """Return the limb's long axis in the sensor's axes, for limbs where only the long axis is known.

    The result is a weighted mean over the frames, computed iteratively. A frame of error e has the weight
    (s²/(s² + e²))², with s = 12° in the first iteration and 6° in the next six.

    Parameters
    ----------
    sensor : float64 array (T, 4)
        Orientations of the sensor, sensor → F_GI; NaN where unknown.
    directions : float64 array (T, 3)
        Unit vectors along the limb in the take's world; NaN where unknown.
    q_global : float64 array (4,)
        F_GI → the take's world, from another limb.

    Returns
    -------
    float64 array (3,)
        A unit vector.

    Raises
    ------
    ParameterError
        No frame is known, or the directions cancel each other.
    """
    known = np.isfinite(sensor).all(axis=1) & np.isfinite(directions).all(axis=1)
    if not known.any():
        raise ParameterError("sensor and directions", "known together in some frame", "none")
    local = rotate(conjugate(multiply(q_global, sensor[known])), directions[known])
    # the medoid of evenly spread frames is an initial value that is robust to wrong frames
    some = local[np.linspace(0, len(local) - 1, min(len(local), 300)).astype(np.int64)]
    apart = np.arccos(np.clip(some @ some.T, -1.0, 1.0))
    found = some[int(np.minimum(apart, math.radians(15.0)).sum(axis=1).argmin())]
    for scale_deg in (12.0, 6.0, 6.0, 6.0, 6.0, 6.0, 6.0):
        e = np.degrees(np.arctan2(np.linalg.norm(np.cross(local, found), axis=1), local @ found))
        found = _unit(np.average(local, axis=0, weights=(scale_deg**2 / (scale_deg**2 + e**2)) ** 2))
    return found


def _unit(vector: F64) -> F64:
    length = float(np.linalg.norm(vector))
    if not length > 1e-9:
        raise ParameterError("directions", "on one side of the sensor", "directions that cancel each other")
    return np.asarray(vector / length)


def direction_errors(sensor: F64, directions: F64, q_global: F64, direction: F64) -> F64:
    """Compute the angles between a limb's long axis and the one that the sensor reports, where only the axis is known.

    Parameters
    ----------
    sensor : float64 array (T, 4)
        Orientations of the sensor, sensor → F_GI.
    directions : float64 array (T, 3)
        Unit vectors along the limb in the take's world.
    q_global : float64 array (4,)
        F_GI → the take's world.
    direction : float64 array (3,)
        The limb's long axis in the sensor's axes; see `mount_direction`.

    Returns
    -------
    float64 array (T,)
        Angles in degrees, 0 to 180. They are swings only, since the twist is unknown.
    """
    reported = rotate(multiply(q_global, sensor), direction)
    across = np.linalg.norm(np.cross(reported, directions), axis=-1)
    return np.degrees(np.arctan2(across, np.einsum("ta,ta->t", reported, directions)))


def auto_tau(streams: Iterable[tuple[F64, Bool]]) -> float:
    """Choose τ from the errors: median + 4 robust standard deviations, at least 15°.

    The choice fails if half of the frames are wrong.

    Parameters
    ----------
    streams : iterable of (float64 array (T,), bool array (T,))
        The errors of each limb in degrees, and the frames to use.

    Returns
    -------
    float
        τ in degrees; 15 if there are no frames to use.
    """
    parts = [degrees[valid & np.isfinite(degrees)] for degrees, valid in streams]
    values = np.concatenate(parts) if parts else np.empty(0)
    if not len(values):
        return MIN_AUTO_DEG
    median = np.median(values)
    spread = MAD_TO_SIGMA * np.median(np.abs(values - median))
    return max(MIN_AUTO_DEG, float(median + AUTO_DEVIATIONS * spread))


@dataclass(frozen=True)
class RunRules:
    """Rules for runs of frames above a threshold; all but τ are off by default, as in the thesis.

    Attributes
    ----------
    tau_deg : float
        The threshold τ in degrees; a frame is wrong if its error is above τ.
    low_deg : float or None
        A run is extended on both sides as long as the error is above this; None for no extension.
    gap_s : float
        The duration in seconds up to which gaps between runs are closed.
    min_s : float
        The duration in seconds below which runs are dropped.
    """

    tau_deg: float = TAU_DEG
    low_deg: float | None = None
    gap_s: float = 0.0
    min_s: float = 0.0

    def __post_init__(self) -> None:
        if not self.tau_deg >= 0.0:
            raise ParameterError("tau_deg", "0 or more", self.tau_deg)
        if self.low_deg is not None and not 0.0 <= self.low_deg <= self.tau_deg:
            raise ParameterError("low_deg", f"from 0 to τ ({self.tau_deg:g})", self.low_deg)
        for name, value in (("gap_s", self.gap_s), ("min_s", self.min_s)):
            if not (value >= 0.0 and math.isfinite(value)):
                raise ParameterError(name, "0 or more", value)


class Run(NamedTuple):
    """A run of frames [start, stop), with the largest and the mean error over its valid frames."""

    start: int
    stop: int
    peak_deg: float
    mean_deg: float


def wrong_runs(degrees: F64, valid: Bool, rate_hz: float, rules: RunRules) -> list[Run]:
    """Find the runs of frames above τ, extend them, close short gaps, and drop short runs.

    Parameters
    ----------
    degrees : float64 array (T,)
        Errors of the frames.
    valid : bool array (T,)
        The frames to use. A run neither starts in other frames nor is extended to them, but closed gaps may contain
        some.
    rate_hz : float
        Frames per second.
    rules : RunRules
        The thresholds.

    Returns
    -------
    list of Run
        The runs in order of time.
    """
    counted = valid & np.isfinite(degrees)
    above = counted & (degrees > rules.tau_deg)
    ranges = flagged_ranges(above)
    if rules.low_deg is not None:
        grown = flagged_ranges(counted & (degrees > rules.low_deg))
        # runs above τ lie within runs above the lower value; the latter are kept if they contain a run above τ
        holds = np.searchsorted(ranges[:, 0], grown[:, 1]) > np.searchsorted(ranges[:, 0], grown[:, 0])
        ranges = grown[holds]
    if len(ranges) and rules.gap_s > 0.0:
        apart = (ranges[1:, 0] - ranges[:-1, 1]) / rate_hz > rules.gap_s * (1.0 + 1e-9)
        first = np.concatenate([[True], apart])
        ranges = np.stack([ranges[first, 0], ranges[np.concatenate([apart, [True]]), 1]], axis=1)
    ranges = ranges[(ranges[:, 1] - ranges[:, 0]) / rate_hz >= rules.min_s * (1.0 - 1e-9)]
    return [_run(degrees, counted, start, stop) for start, stop in ranges.tolist()]


def jump_runs(degrees: F64, jump: Bool) -> list[Run]:
    """Return the runs of frames in which the limb rotates faster than a person can; their errors may be NaN."""
    return [_run(degrees, np.isfinite(degrees), start, stop) for start, stop in flagged_ranges(jump).tolist()]


def _run(degrees: F64, counted: Bool, start: int, stop: int) -> Run:
    values = degrees[start:stop][counted[start:stop]]
    return Run(start, stop, float(values.max()), float(values.mean())) if len(values) else Run(start, stop, *_NAN)


_NAN = (math.nan, math.nan)


def flagged_ranges(flags: Bool) -> I64:
    """Return the ranges [start, stop) of frames whose flag is set, int64 (R, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return edges.reshape(-1, 2).astype(np.int64)
