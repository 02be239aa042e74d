"""This module defines the motion of a limb over time, and selects the markers from which it is computed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64, Bool


@dataclass(frozen=True, eq=False)
class LimbMotion:
    """The motion of one limb over time.

    Attributes
    ----------
    limb : str
        Its name.
    basis : str
        The source of the orientation: full, hinge or none.
    times : float64 array (T,)
        Times from the beginning of the take, in seconds.
    orientation : float64 array (T, 4)
        Unit quaternions (w, x, y, z) from the limb's own frame to the world; NaN if unknown.
    position : float64 array (T, 3)
        The midpoint of its two joints in metres, Y up; NaN if unknown.
    direction : float64 array (T, 3)
        Unit vectors from the proximal to the distal joint; NaN if unknown.
    valid : bool array (T,)
        The frames with an orientation, or with a direction if the basis is none.
    jump : bool array (T,)
        The frames in which the limb turns faster than a person can.
    fit_m : float64 array (T,) or None
        Root mean square distance of the markers from their rigid shape, in metres; None without markers.
    """

    limb: str
    basis: str
    times: F64
    orientation: F64
    position: F64
    direction: F64
    valid: Bool
    jump: Bool
    fit_m: F64 | None = None


def common_markers(markers: F64) -> F64:
    """Return the markers (T, M, 3) without rarely seen ones, so that at least one frame has all remaining markers.

    At least three markers are kept, even if no frame has all of them.
    """
    seen = np.logical_and.reduce(np.isfinite(markers), axis=2)
    kept = list(range(markers.shape[1]))
    while len(kept) > 3 and not seen[:, kept].all(axis=1).any():
        kept.remove(min(kept, key=lambda place: (int(seen[:, place].sum()), -place)))
    return np.ascontiguousarray(markers[:, kept])
