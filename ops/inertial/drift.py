"""This module corrects heading drift: a slow rotation about the vertical of a sensor without a magnetometer."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.inertial.rotations import conjugate, exp, multiply

KNOT_S = 20.0
ROUNDS = 8
SCALE_DEG, FARTHEST_DEG = 6.0, 25.0


@dataclass(frozen=True)
class HeadingDrift:
    """A piecewise linear curve of the rotation about Z in degrees that corrects a sensor's orientations.

    Attributes
    ----------
    times : float64 array (K,)
        The knots in seconds of the take; without knots there is no correction.
    degrees : float64 array (K,)
        The rotation at each knot.
    """

    times: F64
    degrees: F64

    @classmethod
    def none(cls) -> HeadingDrift:
        """Return the curve without any correction."""
        return cls(np.empty(0), np.empty(0))

    def at(self, times: F64) -> F64:
        """Return the corrections (T,) in degrees at times of the take, constant beyond the first and last knot."""
        return np.interp(times, self.times, self.degrees) if len(self.times) else np.zeros(len(times))

    def corrected(self, times: F64, sensor: F64) -> F64:
        """Return the orientations (T, 4) of the sensor in F_GI, with the drift removed."""
        return multiply(self._turns(times), sensor) if len(self.times) else sensor

    def uncorrected(self, times: F64, sensor: F64) -> F64:
        """Return orientations (T, 4) as a sensor with this drift would report them."""
        return multiply(conjugate(self._turns(times)), sensor) if len(self.times) else sensor

    def _turns(self, times: F64) -> F64:
        return exp(np.radians(self.at(times))[:, None] * np.array([0.0, 0.0, 1.0]))


def heading_deg(sensor: F64, track: F64, q_global: F64, q_mount: F64) -> F64:
    """Return the heading error (T,) of the sensor's orientations in degrees, −180 to 180.

    It is 2·atan2(z, w) of the quaternion q̄_G ∘ q_T ∘ q_L ∘ q̄_I (global, track, mount, sensor).
    """
    turn = multiply(multiply(multiply(conjugate(q_global), track), q_mount), conjugate(sensor))
    heading = np.degrees(2.0 * np.arctan2(turn[:, 3], turn[:, 0]))
    return 180.0 - (180.0 - heading) % 360.0


def fit_drift(times: F64, headings: F64) -> HeadingDrift:
    """Fit a piecewise linear curve to headings, reweighted so that wrong frames lose their influence.

    Parameters
    ----------
    times : float64 array (T,)
        Seconds of the take, ascending.
    headings : float64 array (T,)
        Degrees; see `heading_deg`. Values beyond 25° are ignored.

    Returns
    -------
    HeadingDrift
        Knots every 20 s, at least two; no correction if all headings are ignored.
    """
    near = np.abs(headings) <= FARTHEST_DEG
    if not near.any() or not times[-1] > times[0]:
        return HeadingDrift.none()
    knots = np.linspace(times[0], times[-1], max(2, math.ceil((times[-1] - times[0]) / KNOT_S) + 1))
    times, headings = times[near], headings[near]
    left = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 2)
    share = (times - knots[left]) / (knots[1] - knots[0])
    # a small stiffness interpolates over knots without frames nearby
    bend = np.diff(np.eye(len(knots)), 2, axis=0)
    stiff = 1e-6 * len(times) * (bend.T @ bend)
    weights = np.ones(len(times))
    values = np.zeros(len(knots))
    for _ in range(ROUNDS):
        values = _weighted(left, share, headings, weights, stiff)
        residual = headings - (values[left] * (1.0 - share) + values[left + 1] * share)
        weights = (SCALE_DEG**2 / (SCALE_DEG**2 + residual**2)) ** 2
    return HeadingDrift(knots, values)


def _weighted(left: I64, share: F64, headings: F64, weights: F64, stiff: F64) -> F64:
    """Return the headings at the curve's knots, by weighted least squares."""
    count = len(stiff)
    hessian = stiff + 1e-12 * np.eye(count)
    gradient = np.zeros(count)
    for first, own in ((0, 1.0 - share), (1, share)):
        gradient += np.bincount(left + first, weights * own * headings, count)
        for second, other in ((0, 1.0 - share), (1, share)):
            sums = np.bincount(left, weights * own * other, count - 1)
            hessian[np.arange(count - 1) + first, np.arange(count - 1) + second] += sums
    return np.asarray(np.linalg.solve(hessian, gradient), np.float64)
