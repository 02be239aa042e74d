"""These kernels multiply quaternions as tuples of four numbers, for use in compiled loops."""

from __future__ import annotations

import math

from numba import njit

from kinedex.ops.arrays import F64

Quaternion = tuple[float, float, float, float]


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
