"""This module computes limb orientations from markers or from hinge joints, and finds frames of solver jumps.

There are three kinds of data from which an orientation is computed: `full` (the rotation of a node, or three or more
markers of a segment), `hinge` (the long axis and the plane of a hinge joint) and `none` (only the long axis).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, Bool
from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial.rotations import conjugate, distance_deg, from_matrix, rotate

FULL, HINGE, NONE = "full", "hinge", "none"

MIN_SPREAD_M = 0.02
"""Second singular value in metres below which markers are nearly collinear and leave one rotation undetermined.
"""

MIN_BEND_DEG = 15.0
"""Bend of a hinge in degrees below which the joints do not determine the plane of the hinge."""

FASTEST_DEG_S = 2500.0
"""Rotation speed in degrees per second that no person reaches; a faster rotation is a jump of the solver."""

SHAPE_ROUNDS = 5


@dataclass(frozen=True, eq=False)
class SegmentFit:
    """The orientation of a segment, fitted to its markers.

    Attributes
    ----------
    orientation : float64 array (T, 4)
        Unit quaternions w x y z from the median shape to the world; NaN in invalid frames.
    valid : bool array (T,)
        The frames in which the visible markers determine the orientation.
    rms_m : float64 array (T,)
        Root mean square distance of the markers to the rotated shape; NaN in invalid frames.
    shape : float64 array (M, 3)
        The median shape about its centre, oriented as in the first complete frame.
    spread_m : float
        The second singular value of the shape in metres.
    """

    orientation: F64
    valid: Bool
    rms_m: F64
    shape: F64
    spread_m: float


def segment_orientation(markers: F64) -> SegmentFit:
    """Return the orientation of a rigid segment by Kabsch's fit of its markers to their median shape.

    The first shape is that of the first complete frame. All frames are aligned to the shape, and the median position of
    each marker gives the next shape; this is repeated five times.

    Parameters
    ----------
    markers : float64 array (T, M, 3)
        Positions of three or more markers in metres; NaN if a marker was not seen.

    Raises
    ------
    ParameterError
        There are fewer than three markers, no frame has all of them, or they lie nearly on a line.
    """
    if markers.ndim != 3 or markers.shape[1] < 3 or markers.shape[2] != 3:
        raise ParameterError("markers", "of shape (frames, 3 or more markers, 3)", markers.shape)
    seen = np.logical_and.reduce(np.isfinite(markers), axis=2)
    whole = seen.all(axis=1)
    if not whole.any():
        raise ParameterError("markers", "seen together in one frame at least", f"none of {len(markers)} frames")
    first = markers[int(np.argmax(whole))]
    shape: F64 = first - first.mean(axis=0)
    usable = seen.sum(axis=1) >= 3
    positions = np.where(seen[..., None], markers, 0.0)
    for _ in range(SHAPE_ROUNDS):
        turned, middle, centre = _aligned(shape, positions[usable], seen[usable])
        back = np.einsum("tab,tma->tmb", turned, positions[usable] - middle[:, None]) + centre[:, None]
        back[~seen[usable]] = np.nan
        shape = np.nanmedian(back, axis=0)
        shape = shape - shape.mean(axis=0)
    spread = _spread(shape)
    if spread < MIN_SPREAD_M:
        raise ParameterError(
            "markers",
            f"off one line by {1000 * MIN_SPREAD_M:.0f} mm or more (second singular value)",
            f"{1000 * spread:.1f} mm",
        )
    valid = usable & _fixes(shape, seen)
    orientation, rms = np.full((len(markers), 4), np.nan), np.full(len(markers), np.nan)
    if valid.any():
        turned, middle, centre = _aligned(shape, positions[valid], seen[valid])
        orientation[valid] = from_matrix(turned)
        fitted = np.einsum("tab,tmb->tma", turned, shape - centre[:, None]) + middle[:, None]
        off = np.where(seen[valid], np.square(fitted - positions[valid]).sum(axis=2), 0.0)
        rms[valid] = np.sqrt(off.sum(axis=1) / seen[valid].sum(axis=1))
    return SegmentFit(orientation, valid, rms, shape, spread)


def _aligned(shape: F64, positions: F64, seen: Bool) -> tuple[F64, F64, F64]:
    """Return the rotations (T, 3, 3) from a shape to frames, and the centres of the visible markers in both."""
    count = seen.sum(axis=1)[:, None]
    middle = (positions * seen[..., None]).sum(axis=1) / count
    centre = np.einsum("tm,ma->ta", seen.astype(np.float64), shape) / count
    apart = (positions - middle[:, None]) * seen[..., None]
    covariance = np.einsum("tma,tmb->tab", apart, shape - centre[:, None])
    left, _, right = np.linalg.svd(covariance)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return left @ right, middle, centre


def _spread(shape: F64) -> float:
    """Return the second singular value of a shape about its centre."""
    return float(np.linalg.svd(shape - shape.mean(axis=0), compute_uv=False)[1])


def _fixes(shape: F64, seen: Bool) -> Bool:
    """Return a mask of the frames whose visible markers are not collinear, so that they determine the rotation."""
    patterns, of = np.unique(seen, axis=0, return_inverse=True)
    good = np.array([one.sum() >= 3 and _spread(shape[one]) >= MIN_SPREAD_M for one in patterns])
    return good[of.reshape(-1)]


def unit_direction(near: F64, far: F64) -> F64:
    """Return the unit directions (T, 3) from near to far joints (T, 3); NaN where unknown or of length 0."""
    way = far - near
    length = np.linalg.norm(way, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        direction: F64 = np.where(length > 1e-9, way / length, np.nan)
    return direction


def hinge_orientation(near: F64, far: F64, bend: F64, beyond: bool) -> tuple[F64, Bool]:
    """Return the orientation of a limb from its long axis and the plane of a hinge.

    X of the segment is the long axis, and Z is the normal of the plane. In frames in which the hinge bends by less than
    15°, the last good normal is carried on by the shortest rotation of the long axis. Before the first good frame, the
    first good normal is carried backwards in time.

    Parameters
    ----------
    near, far : float64 array (T, 3)
        The joints at the ends of the limb.
    bend : float64 array (T, 3)
        The third joint of the hinge.
    beyond : bool
        True if the third joint is beyond the far end (the ankle for a thigh), False if it is before the near end.

    Returns
    -------
    orientation : float64 array (T, 4)
        Unit quaternions w x y z; NaN in invalid frames.
    valid : bool array (T,)
        The frames in which the ends are known; False in all frames if the hinge never bends.
    """
    if not near.shape == far.shape == bend.shape or near.ndim != 2 or near.shape[1] != 3:
        raise ParameterError("near, far and bend", "of one shape (frames, 3)", (near.shape, far.shape, bend.shape))
    axis = unit_direction(near, far)
    other = unit_direction(far, bend) if beyond else unit_direction(bend, near)
    normal = np.cross(axis, other) if beyond else np.cross(other, axis)
    sine = np.linalg.norm(normal, axis=1)
    cosine = np.einsum("ta,ta->t", axis, other)
    with np.errstate(invalid="ignore"):
        good = np.arctan2(sine, cosine) >= np.deg2rad(MIN_BEND_DEG)
        good &= sine > 1e-6  # a limb folded onto itself does not determine a plane
        normal = normal / np.where(sine > 0, sine, 1.0)[:, None]
    valid = np.isfinite(axis).all(axis=1) & good.any()
    orientation = np.full((len(near), 4), np.nan)
    if not valid.any():
        return orientation, valid
    normal = np.where(good[:, None], normal, 0.0)
    _carry(np.ascontiguousarray(np.nan_to_num(axis)), valid, good, normal)
    x, z = axis[valid], normal[valid]
    columns = np.stack([x, np.cross(z, x), z], axis=2)
    orientation[valid] = from_matrix(columns)
    return orientation, valid


@njit(cache=True, nogil=True)
def _carry(axis: F64, valid: Bool, good: Bool, normal: F64) -> None:
    """Fill in the normals of frames that are not good by rotations of the axis, forwards and then backwards."""
    frames = len(axis)
    first = -1
    last = -1
    for t in range(frames):
        if not valid[t]:
            continue
        if good[t]:
            if first < 0:
                first = t
        elif last >= 0:
            _turn_along(axis[last], axis[t], normal[last], normal[t])
        if first >= 0:
            last = t
    last = first
    for t in range(first - 1, -1, -1):
        if valid[t]:
            _turn_along(axis[last], axis[t], normal[last], normal[t])
            last = t


@njit(cache=True, nogil=True)
def _turn_along(before: F64, after: F64, vector: F64, out: F64) -> None:
    """Rotate a vector by the shortest rotation between two unit vectors, and make it orthogonal to the second."""
    cx = before[1] * after[2] - before[2] * after[1]
    cy = before[2] * after[0] - before[0] * after[2]
    cz = before[0] * after[1] - before[1] * after[0]
    cosine = before[0] * after[0] + before[1] * after[1] + before[2] * after[2]
    if cosine > -1.0 + 1e-12:
        share = (cx * vector[0] + cy * vector[1] + cz * vector[2]) / (1.0 + cosine)
        x = cosine * vector[0] + cy * vector[2] - cz * vector[1] + share * cx
        y = cosine * vector[1] + cz * vector[0] - cx * vector[2] + share * cy
        z = cosine * vector[2] + cx * vector[1] - cy * vector[0] + share * cz
    else:  # for opposite vectors: half a turn about the normal itself
        x, y, z = vector[0], vector[1], vector[2]
    along = x * after[0] + y * after[1] + z * after[2]
    x, y, z = x - along * after[0], y - along * after[1], z - along * after[2]
    length = np.sqrt(x * x + y * y + z * z)
    out[0], out[1], out[2] = x / length, y / length, z / length


def long_axis(orientation: F64, direction: F64) -> F64:
    """Return the long axis of a limb in its own frame, as the median over a take.

    Parameters
    ----------
    orientation : float64 array (T, 4)
        Unit quaternions w x y z of the segment; NaN where they are not known.
    direction : float64 array (T, 3)
        Unit directions from the near to the far joint in the world.

    Returns
    -------
    float64 array (3,)
        A unit vector; NaN if orientation and direction are known together in no frame.
    """
    known = np.isfinite(orientation).all(axis=1) & np.isfinite(direction).all(axis=1)
    if not known.any():
        return np.full(3, np.nan)
    middle = np.median(rotate(conjugate(orientation[known]), direction[known]), axis=0)
    length = float(np.linalg.norm(middle))
    axis: F64 = middle / length if length > 1e-9 else np.full(3, np.nan)
    return axis


def jumps(orientation: F64, rate_hz: float, fastest_deg_s: float = FASTEST_DEG_S) -> Bool:
    """Return the frames at both ends of a rotation that is too fast for a person, where the solver has jumped.

    Parameters
    ----------
    orientation : float64 array (T, 4)
        Unit quaternions w x y z; NaN where they are not known; rotations across such frames are ignored.
    rate_hz : float
        Frames per second.
    fastest_deg_s : float, optional
        The greatest speed of rotation in degrees per second.
    """
    if rate_hz <= 0:
        raise ParameterError("rate_hz", "positive", rate_hz)
    found = np.zeros(len(orientation), np.bool_)
    if len(orientation) < 2:
        return found
    fast = distance_deg(orientation[:-1], orientation[1:]) * rate_hz > fastest_deg_s
    found[:-1] |= fast
    found[1:] |= fast
    return found
