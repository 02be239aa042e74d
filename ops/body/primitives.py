"""This module computes the geometric primitives of relational features in compiled loops over the frames of one take.

Positions are float64 (J, 3, T). A primitive fills the array `out` with its values in the frames from `start` on. With
short arrays, a kernel can work on one block of a take after the other and keep each block in the cache of a core.
Vectors are (3, n), one row per coordinate, so that the loops over frames vectorise. A vector of length zero gives NaN
(0/0), for which every feature is off.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64, U64
from kinedex.ops.body.feature_rules import ABOVE, AT_LEAST, AT_MOST, BELOW

DEGREES = 180.0 / math.pi


@njit(cache=True, nogil=True, error_model="numpy")
def difference(positions: F64, q: int, c: int, start: int, out: F64) -> None:
    """Fill in the vectors from joint c to joint q, (3, n)."""
    stop = start + out.shape[1]
    for k in range(3):
        tip, foot, row = positions[q, k, start:stop], positions[c, k, start:stop], out[k]
        for t in range(len(row)):
            row[t] = tip[t] - foot[t]


@njit(cache=True, nogil=True, error_model="numpy")
def _reflect(index: int, length: int) -> int:
    """Return the index inside 0 … length − 1 that an index maps to by symmetric reflection (edge value repeated)."""
    if 0 <= index < length:  # the division below is slow, so the common case returns first
        return index
    period = 2 * length
    index %= period
    return index if index < length else period - 1 - index


@njit(cache=True, nogil=True, error_model="numpy")
def velocity(positions: F64, q: int, c: int, window: int, rate_hz: float, start: int, out: F64) -> None:
    """Fill in the velocities (3, n) of joint q relative to joint c, or to the world for c < 0, over W samples.

    Velocities are smoothed by a moving average of W first differences. Away from the ends of the take, this sum
    telescopes to the difference of two positions W frames apart, divided by W. At the ends, the reflected differences
    are summed one by one.
    """
    frames, stop = positions.shape[2], start + out.shape[1]
    pad = (window + 1) // 2
    first = min(max(pad - 1, 0), frames)
    last = max(min(frames - 1 - window + pad, frames), first)
    low = min(max(first, start), stop)
    high = max(min(last, stop), low)
    scale = rate_hz / window
    for k in range(3):
        row = out[k, low - start : high - start]
        after, before = low + window - pad + 1, low + 1 - pad
        ahead, behind = positions[q, k, after : after + len(row)], positions[q, k, before : before + len(row)]
        if c < 0:
            for t in range(len(row)):
                row[t] = (ahead[t] - behind[t]) * scale
        else:
            base, base_behind = positions[c, k, after : after + len(row)], positions[c, k, before : before + len(row)]
            for t in range(len(row)):
                row[t] = ((ahead[t] - base[t]) - (behind[t] - base_behind[t])) * scale
    for t in range(start, low):
        _velocity_at_end(positions, q, c, window, scale, t, out[:, t - start])
    for t in range(high, stop):
        _velocity_at_end(positions, q, c, window, scale, t, out[:, t - start])


@njit(cache=True, nogil=True, error_model="numpy")
def _velocity_at_end(positions: F64, q: int, c: int, window: int, scale: float, frame: int, out: F64) -> None:
    """Fill in the velocity (3,) in a frame whose window extends past an end of the take."""
    frames = positions.shape[2]
    begin, extended = frame + 1 - (window + 1) // 2, max(frames, window)
    x, y, z = 0.0, 0.0, 0.0
    if frames > 1:
        for j in range(begin, begin + window):
            i = min(_reflect(_reflect(j, extended), frames), frames - 2)
            x += _place(positions, q, c, 0, i + 1) - _place(positions, q, c, 0, i)
            y += _place(positions, q, c, 1, i + 1) - _place(positions, q, c, 1, i)
            z += _place(positions, q, c, 2, i + 1) - _place(positions, q, c, 2, i)
    out[0], out[1], out[2] = x * scale, y * scale, z * scale


@njit(cache=True, nogil=True, error_model="numpy")
def _place(positions: F64, q: int, c: int, axis: int, frame: int) -> float:
    """Return a coordinate of joint q relative to joint c, or to the world for c < 0."""
    return positions[q, axis, frame] if c < 0 else positions[q, axis, frame] - positions[c, axis, frame]


@njit(cache=True, nogil=True, error_model="numpy")
def cross(u: F64, v: F64, out: F64) -> None:
    """Fill in the vector products u × v, (3, n)."""
    for k in range(3):
        first, second, row = (k + 1) % 3, (k + 2) % 3, out[k]
        a, b, c, d = u[first], v[second], u[second], v[first]
        for t in range(len(row)):
            row[t] = a[t] * b[t] - c[t] * d[t]


@njit(cache=True, nogil=True, error_model="numpy")
def along(n: F64, v: F64, out: F64) -> None:
    """Fill in n · v / |n|, the components of vectors v along the directions of vectors n."""
    nx, ny, nz, vx, vy, vz = n[0], n[1], n[2], v[0], v[1], v[2]
    for t in range(len(out)):
        norm = math.sqrt(nx[t] * nx[t] + ny[t] * ny[t] + nz[t] * nz[t])
        out[t] = (nx[t] * vx[t] + ny[t] * vy[t] + nz[t] * vz[t]) / norm


@njit(cache=True, nogil=True, error_model="numpy")
def norm(v: F64, out: F64) -> None:
    """Fill in the lengths of vectors."""
    x, y, z = v[0], v[1], v[2]
    for t in range(len(out)):
        out[t] = math.sqrt(x[t] * x[t] + y[t] * y[t] + z[t] * z[t])


@njit(cache=True, nogil=True, error_model="numpy")
def angle_between(u: F64, v: F64, out: F64) -> None:
    """Fill in the angles between vectors in degrees; NaN if a vector has length 0."""
    ux, uy, uz, vx, vy, vz = u[0], u[1], u[2], v[0], v[1], v[2]
    for t in range(len(out)):
        dot = ux[t] * vx[t] + uy[t] * vy[t] + uz[t] * vz[t]
        uu = ux[t] * ux[t] + uy[t] * uy[t] + uz[t] * uz[t]
        vv = vx[t] * vx[t] + vy[t] * vy[t] + vz[t] * vz[t]
        out[t] = dot / (math.sqrt(uu) * math.sqrt(vv))
    for t in range(len(out)):
        cosine = out[t]
        if cosine > 1.0:
            cosine = 1.0
        elif cosine < -1.0:
            cosine = -1.0
        out[t] = math.acos(cosine) * DEGREES


@njit(cache=True, nogil=True, error_model="numpy")
def lowest(positions: F64, joints: I64, start: int, out: F64) -> None:
    """Fill in the lowest Y of the given joints, ignoring NaN."""
    out[:] = np.inf
    for j in joints:
        height = positions[j, 1, start : start + len(out)]
        for t in range(len(out)):
            if height[t] < out[t]:
                out[t] = height[t]


@njit(cache=True, nogil=True, error_model="numpy")
def highest(positions: F64, joints: I64, start: int, out: F64) -> None:
    """Fill in the highest Y of the given joints, ignoring NaN."""
    out[:] = -np.inf
    for j in joints:
        height = positions[j, 1, start : start + len(out)]
        for t in range(len(out)):
            if height[t] > out[t]:
                out[t] = height[t]


@njit(cache=True, nogil=True, error_model="numpy")
def widest_xz(positions: F64, joints: I64, start: int, out: F64) -> None:
    """Fill in the largest horizontal distance between any two of the given joints."""
    stop = start + len(out)
    out[:] = 0.0
    for m in range(len(joints)):
        for n in range(m + 1, len(joints)):
            i, j = joints[m], joints[n]
            x, z, other_x, other_z = (
                positions[i, 0, start:stop], positions[i, 2, start:stop],
                positions[j, 0, start:stop], positions[j, 2, start:stop],
            )  # fmt: skip
            for t in range(len(out)):
                dx, dz = x[t] - other_x[t], z[t] - other_z[t]
                d = dx * dx + dz * dz
                if d > out[t]:
                    out[t] = d
    for t in range(len(out)):
        out[t] = math.sqrt(out[t])


@njit(cache=True, nogil=True, error_model="numpy")
def turn_rate(orientation: F64, rate_hz: float, start: int, out: F64) -> None:
    """Fill in the absolute angular speed about Y in degrees per second, from unit quaternions (4, T).

    The X axis is rotated by the orientation and projected on the XZ plane, and the speed follows from its directions in
    a frame and in the next frame. The speed is 0 in the last frame of the take, and if a projection has length 0.
    """
    out[:] = 0.0
    ax, az = 0.0, 0.0
    for t in range(start, min(start + len(out) + 1, orientation.shape[1])):
        w, x, y, z = orientation[0, t], orientation[1, t], orientation[2, t], orientation[3, t]
        bx = 1.0 - 2.0 * (y * y + z * z)
        bz = 2.0 * (x * z - w * y)
        if t > start:
            cross, dot = az * bx - ax * bz, ax * bx + az * bz
            if ax * ax + az * az > 1e-24 and bx * bx + bz * bz > 1e-24:
                out[t - 1 - start] = abs(math.atan2(cross, dot)) * DEGREES * rate_hz
        ax, az = bx, bz


@njit(cache=True, nogil=True, error_model="numpy")
def bounds(comparison: int, low: float, high: float) -> tuple[float, float]:
    """Return the smallest and largest number for which a comparison holds; only WITHIN uses `high`."""
    if comparison == ABOVE:
        return np.nextafter(low, np.inf), np.inf
    if comparison == AT_LEAST:
        return low, np.inf
    if comparison == BELOW:
        return -np.inf, np.nextafter(low, -np.inf)
    if comparison == AT_MOST:
        return -np.inf, low
    return low, high


@njit(cache=True, nogil=True, error_model="numpy")
def add_bit(x: F64, low: float, high: float, bit: int, words: U64) -> None:
    """Set a bit of each word whose value lies in [low, high]; NaN does not set it."""
    place = np.uint64(bit)
    for t in range(len(x)):
        words[t] |= np.uint64((x[t] >= low) & (x[t] <= high)) << place


@njit(cache=True, nogil=True, error_model="numpy")
def hysteresis(weak: U64, strong: U64, state: U64, words: U64) -> None:
    """Fill in the words of consecutive frames by hysteresis, for all features at once.

    A feature turns on when its strong condition becomes true, and stays on until its weak condition is false.

    Parameters
    ----------
    weak, strong : uint64 array (n,)
        The bits of the features whose conditions hold.
    state : uint64 array (2,)
        The word and the strong bits of the previous frame, 0 at the start; replaced by those of the last frame.
    words : uint64 array (n,)
        The words.
    """
    on, before = state[0], state[1]
    for t in range(len(words)):
        on = (on & weak[t]) | (strong[t] & ~before)
        before = strong[t]
        words[t] = on
    state[0], state[1] = on, before
