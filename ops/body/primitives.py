"""The geometric primitives of relational features, as compiled loops over the frames of one take.

Arrays are (3, T) float64, one row per coordinate, so that the loops over frames vectorise. A vector of length zero
gives NaN (0/0), which every comparison of a feature turns into "off".
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.body.feature_rules import ABOVE, AT_LEAST, AT_MOST, BELOW

F64 = npt.NDArray[np.float64]

DEGREES = 180.0 / math.pi


@njit(cache=True, nogil=True, error_model="numpy")
def difference(q: F64, c: F64) -> F64:
    """Return the vector from c to q in every frame, (3, T)."""
    return q - c


@njit(cache=True, nogil=True, error_model="numpy")
def _reflect(index: int, length: int) -> int:
    """Return the index that symmetric reflection (edge value repeated) maps an index outside 0 … length − 1 to."""
    period = 2 * length
    index %= period
    return index if index < length else period - 1 - index


@njit(cache=True, nogil=True, error_model="numpy")
def velocity(x: F64, window: int, rate_hz: float) -> F64:
    """Return the velocity of a trajectory, smoothed by a moving average over a window of W samples.

    The moving average of first differences telescopes: away from the ends it is the difference of two positions W
    frames apart, divided by W. At the ends the reflected differences are summed one by one.
    """
    frames = x.shape[1]
    out = np.empty((3, frames))
    pad = (window + 1) // 2
    extended = max(frames, window)
    first = min(max(pad - 1, 0), frames)
    last = max(min(frames - 1 - window + pad, frames), first)
    scale = rate_hz / window
    for k in range(3):
        row = x[k]
        for t in range(first, last):
            out[k, t] = (row[t + window - pad + 1] - row[t + 1 - pad]) * scale
    for t in range(frames):
        if first <= t < last:
            continue
        a, b, c = 0.0, 0.0, 0.0
        if frames > 1:
            for j in range(t + 1 - pad, t + 1 - pad + window):
                i = min(_reflect(_reflect(j, extended), frames), frames - 2)
                a += x[0, i + 1] - x[0, i]
                b += x[1, i + 1] - x[1, i]
                c += x[2, i + 1] - x[2, i]
        out[0, t], out[1, t], out[2, t] = a * scale, b * scale, c * scale
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def along_plane_normal(a: F64, b: F64, c: F64, v: F64) -> F64:
    """Return n · v with the unit normal n = (a − c) × (b − c) / |…| of the plane through a, b, c."""
    frames = v.shape[1]
    out = np.empty(frames)
    for t in range(frames):
        ux, uy, uz = a[0, t] - c[0, t], a[1, t] - c[1, t], a[2, t] - c[2, t]
        wx, wy, wz = b[0, t] - c[0, t], b[1, t] - c[1, t], b[2, t] - c[2, t]
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        norm = math.sqrt(nx * nx + ny * ny + nz * nz)
        out[t] = (nx * v[0, t] + ny * v[1, t] + nz * v[2, t]) / norm
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def along_direction(a: F64, b: F64, v: F64) -> F64:
    """Return n · v with the unit vector n = (b − a) / |b − a|."""
    frames = v.shape[1]
    out = np.empty(frames)
    for t in range(frames):
        nx, ny, nz = b[0, t] - a[0, t], b[1, t] - a[1, t], b[2, t] - a[2, t]
        norm = math.sqrt(nx * nx + ny * ny + nz * nz)
        out[t] = (nx * v[0, t] + ny * v[1, t] + nz * v[2, t]) / norm
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def norm(v: F64) -> F64:
    """Return the length of a vector in every frame, (T,)."""
    frames = v.shape[1]
    out = np.empty(frames)
    for t in range(frames):
        out[t] = math.sqrt(v[0, t] * v[0, t] + v[1, t] * v[1, t] + v[2, t] * v[2, t])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def angle_between(u: F64, v: F64) -> F64:
    """Return the angle between two vectors in degrees, (T,); NaN where one has no length."""
    frames = u.shape[1]
    out = np.empty(frames)
    for t in range(frames):
        dot = u[0, t] * v[0, t] + u[1, t] * v[1, t] + u[2, t] * v[2, t]
        uu = u[0, t] * u[0, t] + u[1, t] * u[1, t] + u[2, t] * u[2, t]
        vv = v[0, t] * v[0, t] + v[1, t] * v[1, t] + v[2, t] * v[2, t]
        cosine = dot / (math.sqrt(uu) * math.sqrt(vv))
        if cosine > 1.0:
            cosine = 1.0
        elif cosine < -1.0:
            cosine = -1.0
        out[t] = math.acos(cosine) * DEGREES
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def lowest(positions: F64, joints: npt.NDArray[np.int64]) -> F64:
    """Return the lowest Y over the given joints of positions (J, 3, T), NaN joints left out, (T,)."""
    frames = positions.shape[2]
    out = np.full(frames, np.inf)
    for j in joints:
        for t in range(frames):
            y = positions[j, 1, t]
            if y < out[t]:
                out[t] = y
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def highest(positions: F64, joints: npt.NDArray[np.int64]) -> F64:
    """Return the highest Y over the given joints of positions (J, 3, T), NaN joints left out, (T,)."""
    frames = positions.shape[2]
    out = np.full(frames, -np.inf)
    for j in joints:
        for t in range(frames):
            y = positions[j, 1, t]
            if y > out[t]:
                out[t] = y
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def widest_xz(positions: F64, joints: npt.NDArray[np.int64]) -> F64:
    """Return the largest horizontal distance between any two of the given joints of positions (J, 3, T), (T,)."""
    frames = positions.shape[2]
    out = np.zeros(frames)
    for m in range(len(joints)):
        for n in range(m + 1, len(joints)):
            i, j = joints[m], joints[n]
            for t in range(frames):
                dx = positions[i, 0, t] - positions[j, 0, t]
                dz = positions[i, 2, t] - positions[j, 2, t]
                d = dx * dx + dz * dz
                if d > out[t]:
                    out[t] = d
    for t in range(frames):
        out[t] = math.sqrt(out[t])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def turn_rate(orientation: F64, rate_hz: float) -> F64:
    """Return the unsigned rate of turning about Y in degrees per second, (T,), from unit quaternions (4, T).

    The X axis, turned by the orientation and projected on the XZ plane, is compared between a frame and the next; 0 in
    the last frame, and where a projection has no length.
    """
    frames = orientation.shape[1]
    out = np.zeros(frames)
    ax, az = 0.0, 0.0
    for t in range(frames):
        w, x, y, z = orientation[0, t], orientation[1, t], orientation[2, t], orientation[3, t]
        bx = 1.0 - 2.0 * (y * y + z * z)
        bz = 2.0 * (x * z - w * y)
        if t > 0:
            cross, dot = az * bx - ax * bz, ax * bx + az * bz
            if ax * ax + az * az > 1e-24 and bx * bx + bz * bz > 1e-24:
                out[t - 1] = abs(math.atan2(cross, dot)) * DEGREES * rate_hz
        ax, az = bx, bz
    return out


def bounds(comparison: int, low: float, high: float) -> tuple[float, float]:
    """Return the lowest and highest number for which a comparison holds; only WITHIN uses `high`."""
    if comparison == ABOVE:
        return math.nextafter(low, math.inf), math.inf
    if comparison == AT_LEAST:
        return low, math.inf
    if comparison == BELOW:
        return -math.inf, math.nextafter(low, -math.inf)
    if comparison == AT_MOST:
        return -math.inf, low
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
def hysteresis(
    x: F64, weak_low: float, weak_high: float, strong_low: float, strong_high: float, bit: int,
    words: npt.NDArray[np.uint64],
) -> None:  # fmt: skip
    """Set a bit of the words in the frames where its feature is on.

    It turns on where the strong condition becomes true and stays on until the weak one is false; a condition holds
    from its low to its high number, both included (`bounds`), and never for NaN.
    """
    on, before = False, False
    for t in range(len(x)):
        strong = (x[t] >= strong_low) & (x[t] <= strong_high)
        weak = (x[t] >= weak_low) & (x[t] <= weak_high)
        on = (on & weak) | (strong & (not before))
        before = strong
        words[t] |= np.uint64(on) << np.uint64(bit)
