"""This module refines a clock offset by least squares on whitened orientation errors, after the fine search.

In each frame, the sensor's orientation and the prediction from the take differ by a small rotation vector r. It is
linear in the remaining errors of the offset (δ, times the sensor's angular velocity ω), of the sensor's heading (ψ,
about the vertical z) and of its mount (a), plus noise n:
    r(t) = −δ ω(t) + ψ R(t)ᵀz + a + n(t).
The noise of trackers and of skin is smooth. Since errors of neighbouring frames are correlated, ordinary least squares
would mistake slow noise for a delay. Therefore an autoregressive model of n is fitted to the residuals. Its innovations
are white, so that least squares on them give the best linear estimate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.inertial.rotations import conjugate, exp, interpolate, log, multiply, rotate
from kinedex.ops.inertial.time_offset import FineSearch

ORDER = 5
"""The order of the autoregressive noise model, in frames."""

CUT, CUT_DEG = 3.5, 15.0
"""A frame is wrong if its error exceeds the first, in robust standard deviations of an axis, or the second, in degrees.
"""

OUTLIER = 2.0
"""Whitened error in standard deviations at which a frame has a quarter of the full weight."""

HALF_STEP_S = 0.01
"""Half of the time step, in seconds, over which angular velocities are computed by differences."""

FARTHEST_S, STILL_S = 0.02, 2e-5
"""Change of the offset in seconds beyond which the result is discarded, and below which the search ends."""

ROUNDS, WEIGHTINGS = 4, 6
MAX_FRAMES, BLOCK = 6_000, 300
"""Maximum number of frames of each limb that are compared, and the length of the evenly spread blocks that they come
in.
"""

_AXIS_SCALE = 2.366  # the median of the sum of squares of three standard normal variables
RIDGE, WORST_CONDITION = 1e-9, 1e12


class _Rows(NamedTuple):
    """The rows of one limb: residual rotations (n, 3), design (n, 3, columns), and counts of preceding frames (n,)."""

    residuals: F64
    design: F64
    follows: I64


def whitened_offset(
    limbs: Sequence[FineSearch], offset_s: float, ppm: float = 0.0, drifts: bool = False
) -> tuple[float, float]:
    """Improve offset and drift of a clock by weighted least squares on whitened orientation errors.

    Parameters
    ----------
    limbs : sequence of FineSearch
        The limbs of one take and one recording, calibrated with the first offset.
    offset_s : float
        The first offset, which should be wrong by a few milliseconds at most.
    ppm : float, optional
        The first drift in parts per million.
    drifts : bool, optional
        True to fit the drift as well.

    Returns
    -------
    tuple[float, float]
        The offset in seconds and the drift in parts per million. The first values are returned if too few frames fit,
        or if the search leads more than 20 ms away.
    """
    limbs = [_blocks(limb) for limb in limbs if len(limb.take_times) > ORDER + 1]
    offset, drift = offset_s, ppm
    for _ in range(ROUNDS):
        found = [_rows(limb, offset, drift, drifts) for limb in limbs]
        rows = [one for one in found if one is not None]
        solutions = _solve(rows, 1 + drifts) if rows else None
        if solutions is None:
            return offset_s, ppm
        limbs = [limb for limb, one in zip(limbs, found, strict=True) if one is not None]
        limbs = [_improved(limb, own[1 + drifts :]) for limb, own in zip(limbs, solutions, strict=True)]
        step = float(solutions[0][0])
        offset += step
        drift += 1e6 * float(solutions[0][1]) if drifts else 0.0
        if not abs(offset - offset_s) <= FARTHEST_S:
            return offset_s, ppm
        if abs(step) < STILL_S:
            break
    return offset, drift


def _improved(limb: FineSearch, rotations: F64) -> FineSearch:
    """Return a limb with its heading and mount corrected by the solution."""
    heading = exp(np.array([0.0, 0.0, rotations[0]]))
    return limb._replace(predicted=multiply(multiply(heading, limb.predicted), exp(rotations[1:])))


def _blocks(limb: FineSearch) -> FineSearch:
    """Return a limb reduced to evenly spread blocks of its frames, if it has too many."""
    count = len(limb.take_times)
    if count <= MAX_FRAMES:
        return limb
    starts = np.linspace(0, count - BLOCK, MAX_FRAMES // BLOCK).astype(np.int64)
    frames = (starts[:, None] + np.arange(BLOCK)).reshape(-1)
    return limb._replace(take_times=limb.take_times[frames], predicted=limb.predicted[frames])


def _rows(limb: FineSearch, offset_s: float, ppm: float, drifts: bool) -> _Rows | None:
    """Return the least squares rows of a limb without wrong frames; None if too few frames are consecutive."""
    at = limb.take_times * (1.0 + 1e-6 * ppm) + offset_s
    read, known = interpolate(limb.sensor_times, limb.sensor, at)
    before, known_before = interpolate(limb.sensor_times, limb.sensor, at - HALF_STEP_S)
    after, known_after = interpolate(limb.sensor_times, limb.sensor, at + HALF_STEP_S)
    frames = np.flatnonzero(known & known_before & known_after)
    if len(frames) <= ORDER:
        return None
    predicted = limb.predicted[frames]
    residuals = log(multiply(conjugate(predicted), read[frames]))
    squares = np.einsum("ta,ta->t", residuals, residuals)
    largest = min(CUT * math.sqrt(float(np.median(squares)) / _AXIS_SCALE), math.radians(CUT_DEG))
    near = squares <= largest * largest
    frames, predicted, residuals = frames[near], predicted[near], residuals[near]
    follows = _follows(limb.take_times[frames])
    if not (follows >= ORDER).any():
        return None
    velocity = log(multiply(conjugate(before[frames]), after[frames])) / (2.0 * HALF_STEP_S)
    columns = [-velocity]
    if drifts:
        columns.append(-velocity * limb.take_times[frames, None])
    columns.append(rotate(conjugate(predicted), np.array([0.0, 0.0, 1.0])))
    design = np.concatenate([np.stack(columns, axis=2), np.tile(np.eye(3), (len(frames), 1, 1))], axis=2)
    return _Rows(residuals, design, follows)


def _follows(times: F64) -> I64:
    """Return for each frame (n,) the number of consecutive frames that precede it without a gap."""
    steps = np.diff(times)
    starts = (
        np.concatenate([[0], np.flatnonzero(steps > 1.5 * np.median(steps)) + 1]) if len(steps) else np.zeros(1, int)
    )
    frames = np.arange(len(times))
    return frames - starts[np.searchsorted(starts, frames, side="right") - 1]


def _solve(rows: Sequence[_Rows], shared: int) -> list[F64] | None:
    """Solve the weighted least squares of whitened rows for each limb; the first columns are shared by all limbs.

    Return None if the shared unknowns are not determined.
    """
    model = _noise_model(rows)
    white = [(_whitened(one.residuals, one.follows, model), _whitened(one.design, one.follows, model)) for one in rows]
    solutions = [np.zeros(design.shape[2]) for _, design in white]
    for _ in range(WEIGHTINGS):
        left = [residuals - design @ own for (residuals, design), own in zip(white, solutions, strict=True)]
        squares = [np.einsum("ta,ta->t", one, one) for one in left]
        variance = max(float(np.median(np.concatenate(squares))) / _AXIS_SCALE, 1e-30)
        roots = [1.0 / (1.0 + square / (3.0 * OUTLIER**2 * variance)) for square in squares]
        sums = [_sums(*own, root) for own, root in zip(white, roots, strict=True)]
        # the unknowns of single limbs are eliminated first (Schur complement)
        gains = [np.linalg.solve(normal[shared:, shared:], normal[shared:, :shared]) for normal, _ in sums]
        normal = sum(
            own[:shared, :shared] - own[:shared, shared:] @ gain for (own, _), gain in zip(sums, gains, strict=True)
        )
        right = sum(y[:shared] - gain.T @ y[shared:] for (_, y), gain in zip(sums, gains, strict=True))
        if not np.linalg.cond(normal) < WORST_CONDITION:
            return None
        steps = np.linalg.solve(normal, right)
        solutions = [
            np.concatenate([steps, np.linalg.solve(own[shared:, shared:], y[shared:]) - gain @ steps])
            for (own, y), gain in zip(sums, gains, strict=True)
        ]
    return solutions


def _sums(residuals: F64, design: F64, roots: F64) -> tuple[F64, F64]:
    """Return the normal equations of one limb, with a ridge for unknowns that its movements do not determine."""
    x = (roots[:, None, None] * design).reshape(-1, design.shape[2])
    return x.T @ x + RIDGE * len(x) * np.eye(x.shape[1]), x.T @ (roots[:, None] * residuals).reshape(-1)


def _noise_model(rows: Sequence[_Rows]) -> F64:
    """Fit the autoregressive coefficients (ORDER,) that predict a residual, the same for all axes and limbs."""
    products, counts = np.zeros(ORDER + 1), np.zeros(ORDER + 1)
    for one in rows:
        noise = one.residuals - one.residuals.mean(axis=0)
        for lag in range(ORDER + 1):
            behind = np.flatnonzero(one.follows >= lag)
            products[lag] += float(np.einsum("ta,ta->", noise[behind], noise[behind - lag]))
            counts[lag] += len(behind)
    covariances = products / np.maximum(counts, 1.0)
    lags = np.abs(np.arange(ORDER)[:, None] - np.arange(ORDER))
    # a little white noise keeps the equations regular for very smooth residuals
    normal = covariances[lags] + 1e-4 * max(covariances[0], 1e-30) * np.eye(ORDER)
    return np.asarray(np.linalg.solve(normal, covariances[1:]), np.float64)


def _whitened(values: F64, follows: I64, model: F64) -> F64:
    """Return the innovations (errors of the model's prediction) of frames with enough consecutive predecessors."""
    frames = np.flatnonzero(follows >= len(model))
    found = values[frames].copy()
    for lag, share in enumerate(model, 1):
        found -= share * values[frames - lag]
    return found
