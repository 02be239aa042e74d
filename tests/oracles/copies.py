"""A naive twin of the comparison of poses: one frame at a time, by numpy, with the turn found by a fine search."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]


def pose_at(take: F64, moment: float) -> F64 | None:
    """Return the pose (J, 3) at a moment, by the four nearest frames and Catmull and Rom's basis; None outside."""
    last = len(take) - 1
    if not 0 <= moment <= last:
        return None
    at = min(math.floor(moment), last - 1) if last else 0
    f = moment - at
    before, left, right, after = (take[min(max(at + k, 0), last)] for k in (-1, 0, 1, 2))
    powers = np.array([1.0, f, f**2, f**3])
    basis = 0.5 * np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]])
    weights = powers @ basis
    return weights[0] * before + weights[1] * left + weights[2] * right + weights[3] * after if f else left


def distance(first: F64, second: F64, t: int, moment: float) -> float:
    """Return the root mean square distance of the known joints, at the best place and turn about the vertical."""
    one, other = pose_at(first, moment), second[t]
    if one is None:
        return math.nan
    known = np.isfinite(one).all(axis=1) & np.isfinite(other).all(axis=1)
    if not known.any():
        return math.nan
    one, other = one[known] - one[known].mean(axis=0), other[known] - other[known].mean(axis=0)

    def far(angle: float) -> float:
        c, s = math.cos(angle), math.sin(angle)
        turned = one @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        return float(np.sqrt(np.square(turned - other).sum(axis=1).mean()))

    centre, width = 0.0, math.pi
    while width > 1e-10:
        angles = np.linspace(centre - width, centre + width, 41)
        centre = float(min(angles, key=far))
        width /= 8
    return far(centre)
