"""This module computes with rotations as unit quaternions w x y z, and with streams of them over time.

A quaternion maps a local frame to a global one: `rotate(q, v)` is the global vector of a local v. `multiply(p, q)`
applies q first. Signs do not matter: q and −q are the same rotation. The kernels do the same for single quaternions.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, Bool
from kinedex.ops.body import kinematics, transforms
from kinedex.ops.errors import ParameterError

Z_TO_Y = np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0])
"""The rotation from a world with Z up to the take's world with Y up."""

LONGEST_GAP_S = 0.05
"""The longest time in seconds between two samples that is bridged by interpolation."""

_SMALL = 1e-12  # length of the imaginary part below which the rotation vector is taken as twice that part

Quaternion = tuple[float, float, float, float]


def multiply(p: F64, q: F64) -> F64:
    """Return p ∘ q, the rotation by q followed by the rotation by p.

    Parameters
    ----------
    p, q : float64 array (..., 4)
        Quaternions, whose leading shapes are broadcast.

    Returns
    -------
    float64 array (..., 4)
    """
    a, b, c, d = p[..., 0], p[..., 1], p[..., 2], p[..., 3]
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    return np.stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ],
        axis=-1,
    )


def conjugate(q: F64) -> F64:
    """Return the inverse rotations (..., 4)."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def rotate(q: F64, v: F64) -> F64:
    """Rotate vectors by unit quaternions.

    Parameters
    ----------
    q : float64 array (..., 4)
        Unit quaternions.
    v : float64 array (..., 3)
        Vectors; leading shapes are broadcast.

    Returns
    -------
    float64 array (..., 3)
    """
    axis = q[..., 1:]
    twice = 2.0 * np.cross(axis, v)
    return np.asarray(v + q[..., :1] * twice + np.cross(axis, twice))


def exp(v: F64) -> F64:
    """Return the unit quaternions (..., 4) of rotation vectors v (..., 3) in radians."""
    v = np.asarray(v, np.float64)
    angle = np.sqrt(np.einsum("...a,...a->...", v, v))[..., None]
    # sinc is sin(πx)/(πx), and 1 at 0
    return np.concatenate([np.cos(0.5 * angle), 0.5 * np.sinc(angle / (2.0 * np.pi)) * v], axis=-1)


def log(q: F64) -> F64:
    """Return the rotation vectors (..., 3) in radians, at most π long, of unit quaternions (..., 4).

    This is Eq. 7.10 of the thesis with a correction of the sign, without which a quaternion with a negative real part
    would give an angle above π.
    """
    q = np.where(q[..., :1] < 0.0, -q, q)
    imaginary = q[..., 1:]
    sine = np.sqrt(np.einsum("...a,...a->...", imaginary, imaginary))[..., None]
    small = sine < _SMALL
    ratio = 2.0 * np.arctan2(sine, q[..., :1]) / np.where(small, 1.0, sine)
    return np.where(small, 2.0, ratio) * imaginary


def distance_deg(p: F64, q: F64) -> F64:
    """Return the angles (...) in degrees, 0 to 180, by which rotations p and q (..., 4) differ.

    This is Eq. 7.2 of the thesis, computed with the arctangent, since the arccosine loses half of the digits near 0.
    """
    between = multiply(conjugate(p), q)
    sine = np.sqrt(np.einsum("...a,...a->...", between[..., 1:], between[..., 1:]))
    return np.degrees(2.0 * np.arctan2(sine, np.abs(between[..., 0])))


def matrix(q: F64) -> F64:
    """Return the rotation matrices (..., 3, 3) of quaternions (..., 4)."""
    return transforms.rotations(q)


def from_matrix(matrices: F64) -> F64:
    """Return the unit quaternions (..., 4) of rotation matrices (..., 3, 3)."""
    rows = np.ascontiguousarray(matrices, np.float64).reshape(-1, 9).T
    return np.ascontiguousarray(kinematics.quaternions(rows).T).reshape(*matrices.shape[:-2], 4)


def continuous(q: F64) -> F64:
    """Return a stream (T, 4) with signs chosen such that consecutive quaternions have a non-negative dot product."""
    known = np.flatnonzero(np.isfinite(q).all(axis=1))
    turned = np.array(q, np.float64)
    if len(known) > 1:
        row = turned[known]
        opposite = np.einsum("ta,ta->t", row[1:], row[:-1]) < 0.0
        turned[known[1:]] *= np.where(np.cumsum(opposite) % 2, -1.0, 1.0)[:, None]
    return turned


def interpolate(times: F64, quaternions: F64, at: F64, longest_gap_s: float = LONGEST_GAP_S) -> tuple[F64, Bool]:
    """Interpolate a stream of quaternions at other times, along the shorter arc.

    Parameters
    ----------
    times : float64 array (T,)
        Times in seconds, ascending.
    quaternions : float64 array (T, 4)
        Unit quaternions; NaN where nothing was measured.
    at : float64 array (N,)
        The wanted times in seconds.
    longest_gap_s : float
        The longest time in seconds between two known samples that is bridged by interpolation.

    Returns
    -------
    tuple[float64 array (N, 4), bool array (N,)]
        The quaternions, NaN outside the stream and in gaps, and a mask of those that are known.

    Raises
    ------
    ParameterError
        The shapes do not agree, or the times do not ascend.
    """
    if quaternions.shape != (len(times), 4):
        raise ParameterError("quaternions", f"of shape ({len(times)}, 4), one for each time", quaternions.shape)
    if len(times) > 1 and not (np.diff(times) >= 0.0).all():
        raise ParameterError("times", "ascending", "times that run back")
    known = np.isfinite(quaternions).all(axis=1) & np.isfinite(times)
    times, quaternions = times[known], quaternions[known]
    result = np.full((len(at), 4), np.nan)
    if not len(times):
        return result, np.zeros(len(at), bool)
    after = np.minimum(np.searchsorted(times, at), len(times) - 1)
    before = np.where(times[after] == at, after, np.maximum(after - 1, 0))
    gap = times[after] - times[before]
    valid = (at >= times[0]) & (at <= times[-1]) & (gap <= longest_gap_s * (1.0 + 1e-9))
    share = np.divide(at - times[before], gap, out=np.zeros(len(at)), where=gap > 0.0)
    mixed = transforms.slerp(quaternions[before[valid]], quaternions[after[valid]], share[valid])
    result[valid] = mixed / np.sqrt(np.einsum("ta,ta->t", mixed, mixed))[:, None]
    return result, valid


def angular_speed(times: F64, quaternions: F64) -> tuple[F64, F64]:
    """Return the angular speeds between consecutive frames.

    Parameters
    ----------
    times : float64 array (T,)
        Times in seconds, ascending.
    quaternions : float64 array (T, 4)
        Unit quaternions; NaN where unknown.

    Returns
    -------
    tuple[float64 array (T − 1,), float64 array (T − 1,)]
        The midpoint times between frames, and radians per second; NaN next to an unknown frame.
    """
    rotations = log(multiply(conjugate(quaternions[:-1]), quaternions[1:]))
    steps = np.diff(times)
    speeds = np.full(len(steps), np.nan)
    np.divide(np.sqrt(np.einsum("ta,ta->t", rotations, rotations)), steps, out=speeds, where=steps > 0.0)
    return 0.5 * (times[1:] + times[:-1]), speeds


@njit(cache=True, nogil=True, error_model="numpy")
def product(p: Quaternion, q: Quaternion) -> Quaternion:
    """Return the product p ∘ q."""
    a, b, c, d = p
    w, x, y, z = q
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def inverse_product(p: Quaternion, q: Quaternion) -> Quaternion:
    """Return p̄ ∘ q, with the conjugate of p."""
    a, b, c, d = p
    w, x, y, z = q
    return (
        a * w + b * x + c * y + d * z,
        a * x - b * w - c * z + d * y,
        a * y + b * z - c * w - d * x,
        a * z - b * y + c * x - d * w,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def product_inverse(p: Quaternion, q: Quaternion) -> Quaternion:
    """Return p ∘ q̄, with the conjugate of q."""
    a, b, c, d = p
    w, x, y, z = q
    return (
        a * w + b * x + c * y + d * z,
        b * w - a * x - c * z + d * y,
        c * w - a * y + b * z - d * x,
        d * w - a * z - b * y + c * x,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def row(stream: F64, k: int) -> Quaternion:
    """Return the quaternion in row k of a stream (T, 4)."""
    return stream[k, 0], stream[k, 1], stream[k, 2], stream[k, 3]


@njit(cache=True, nogil=True, error_model="numpy")
def angle(q: Quaternion) -> float:
    """Return the angle of a rotation in radians, 0 to π."""
    w, x, y, z = q
    return 2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), abs(w))
