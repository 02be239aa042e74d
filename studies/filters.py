"""Filters of points over time, which tracks of a body are compared with: all work on one coordinate after the other.

Arrays are (T, …): frames first, whatever follows is filtered alike.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]


def without_gaps(points: F64) -> F64:
    """Return points (T, P, 3) with NaN replaced by linear interpolation over time, the nearest value at the ends."""
    filled = points.copy()
    frames = np.arange(len(points))
    for p in range(points.shape[1]):
        seen = np.isfinite(points[:, p, 0])
        if seen.any():
            for axis in range(3):
                filled[:, p, axis] = np.interp(frames, frames[seen], points[seen, p, axis])
    return filled


def butterworth(values: F64, cutoff_hz: float, rate_hz: float) -> F64:
    """Filter forwards and backwards by a Butterworth filter of second order.

    Parameters
    ----------
    values : float64 array (T, …)
        The values.
    cutoff_hz : float
        Its cutoff, in Hz.
    rate_hz : float
        Frames a second.

    Returns
    -------
    float64 array (T, …)
        The filtered values. Both ends are continued by nine frames, turned about their last value.
    """
    k = np.tan(np.pi * cutoff_hz / rate_hz)
    norm = 1.0 + np.sqrt(2.0) * k + k * k
    b = np.array([k * k, 2.0 * k * k, k * k]) / norm
    a = np.array([2.0 * (k * k - 1.0), 1.0 - np.sqrt(2.0) * k + k * k]) / norm
    pad = min(9, len(values) - 1)
    before, after = 2.0 * values[:1] - values[pad:0:-1], 2.0 * values[-1:] - values[-2 : -pad - 2 : -1]
    once = _recursive(np.concatenate([before, values, after]), b, a)
    return _recursive(once[::-1], b, a)[::-1][pad : pad + len(values)]


def _recursive(values: F64, b: F64, a: F64) -> F64:
    """Filter by the difference equation, in the state that a constant first value leaves."""
    second = (b[2] - a[1]) * values[0]
    first = (b[1] - a[0]) * values[0] + second
    filtered = np.empty_like(values)
    for t, value in enumerate(values):
        filtered[t] = b[0] * value + first
        first = b[1] * value - a[0] * filtered[t] + second
        second = b[2] * value - a[1] * filtered[t]
    return filtered


def savitzky_golay(values: F64, frames: int, degree: int) -> F64:
    """Fit a polynomial to the frames around each frame.

    Parameters
    ----------
    values : float64 array (T, …)
        The values.
    frames : int
        Odd length of the window; at the ends, the polynomial of the first and the last whole window holds.
    degree : int
        Degree of the polynomial.

    Returns
    -------
    float64 array (T, …)
        The value of the polynomial at each frame.
    """
    half = min(frames, len(values) - 1 + len(values) % 2) // 2
    positions = np.arange(-half, half + 1.0)
    powers = positions[:, None] ** np.arange(degree + 1)
    smoother = powers @ np.linalg.pinv(powers)  # row i: the value at place i of the window
    flat = values.reshape(len(values), -1)
    windows = np.lib.stride_tricks.sliding_window_view(flat, 2 * half + 1, axis=0)
    middle = windows @ smoother[half]
    first, last = smoother[:half] @ flat[: 2 * half + 1], smoother[half + 1 :] @ flat[-2 * half - 1 :]
    return np.concatenate([first, middle, last]).reshape(values.shape)


def one_euro(points: F64, cutoff_hz: float, speed_factor: float, rate_hz: float, derivative_hz: float = 1.0) -> F64:
    """Filter by the one-euro filter, whose cutoff rises with the speed of the point.

    Parameters
    ----------
    points : float64 array (T, P, 3)
        The points, in metres.
    cutoff_hz : float
        Cutoff at rest.
    speed_factor : float
        Hz that a speed of 1 m/s adds to the cutoff.
    rate_hz : float
        Frames a second.
    derivative_hz : float
        Cutoff of the filter of the velocity.

    Returns
    -------
    float64 array (T, P, 3)
        The filtered points; they lag, since the filter knows the past alone.
    """

    def share(cutoff_hz: F64 | float) -> F64 | float:
        return 1.0 / (1.0 + rate_hz / (2.0 * np.pi * cutoff_hz))

    filtered = np.empty_like(points)
    filtered[0], velocity = points[0], np.zeros_like(points[0])
    for t in range(1, len(points)):
        step = points[t] - filtered[t - 1]
        velocity = velocity + share(derivative_hz) * (step * rate_hz - velocity)
        speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
        filtered[t] = filtered[t - 1] + share(cutoff_hz + speed_factor * speed) * step
    return filtered


def kalman_smoother(points: F64, rate_hz: float, sigma_m: float, acceleration: float) -> F64:
    """Smooth points by a Kalman filter with constant velocity, and the pass of Rauch, Tung and Striebel backwards.

    Parameters
    ----------
    points : float64 array (T, P, 3)
        Points in metres; frames with NaN are predicted.
    rate_hz : float
        Frames a second.
    sigma_m : float
        Standard deviation of a measured coordinate in metres.
    acceleration : float
        Standard deviation of the acceleration, constant within a frame, in m/s².

    Returns
    -------
    float64 array (T, P, 3)
        The smoothed points.
    """
    smoothed = np.empty_like(points)
    for p in range(points.shape[1]):
        smoothed[:, p] = _smoothed(points[:, p], 1.0 / rate_hz, sigma_m, acceleration)
    return smoothed


def _smoothed(points: F64, dt: float, sigma_m: float, acceleration: float) -> F64:
    """Smooth one point (T, 3); its three coordinates have the same covariances."""
    move = np.array([[1.0, dt], [0.0, 1.0]])
    push = np.array([0.5 * dt * dt, dt])
    noise = np.outer(push, push) * acceleration**2
    seen = np.isfinite(points[:, 0])
    state = np.zeros((2, points.shape[1]))
    state[0] = points[np.argmax(seen)]
    spread = np.diag([sigma_m**2, 1.0])
    states, spreads, ahead, ahead_spreads = [], [], [], []
    for t, point in enumerate(points):
        if t:
            state, spread = move @ state, move @ spread @ move.T + noise
        ahead.append(state)
        ahead_spreads.append(spread)
        if seen[t]:
            gain = spread[:, 0] / (spread[0, 0] + sigma_m**2)
            state = state + gain[:, None] * (point - state[0])
            spread = spread - np.outer(gain, spread[0])
        states.append(state)
        spreads.append(spread)
    for t in range(len(points) - 2, -1, -1):
        back = spreads[t] @ move.T @ np.linalg.inv(ahead_spreads[t + 1])
        states[t] = states[t] + back @ (states[t + 1] - ahead[t + 1])
    return np.stack([one[0] for one in states])
