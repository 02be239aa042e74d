"""This module triangulates keypoints robustly, and computes the initial poses of a track from the points."""

from __future__ import annotations

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.body.kinematic_chain import ChainBody, Poses
from kinedex.ops.body.pose_fit import fit_poses
from kinedex.ops.copies import copy_row
from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking.observations import BodyPoints, JointPositions, Rays

MIN_CONFIDENCE = 0.3
"""Minimum confidence of a keypoint that is used in triangulation."""

MAX_ERROR_PX = 20.0
"""Maximum mean reprojection error in pixels of a valid point."""

MAX_CAMERAS = 10
"""Maximum number of cameras for which all subsets are tried; with more, cameras are removed one by one."""

START_SIGMA_M, START_STEPS = 0.05, 15
"""Standard deviation of a point in metres, and maximum number of steps, when the chain is fitted to initial points."""

# least relative eigenvalue of a point's matrix, which for two rays is half of the squared sine of their angle
_FLAT = 1e-3


def triangulate(rays: Rays) -> tuple[F64, I64]:
    """Triangulate every keypoint of every frame.

    A point is the least-squares intersection of the rays, weighted by confidence. If its mean reprojection error
    exceeds `MAX_ERROR_PX`, the best subset of the cameras without one camera is tried, then without two cameras, and so
    on down to two cameras. With more than `MAX_CAMERAS` cameras, the best subset is found by removing one camera after
    the other.

    Parameters
    ----------
    rays : Rays
        Rays of P keypoints in T frames.

    Returns
    -------
    points : float64 array (T, P, 3)
        Points in metres; NaN if there is none.
    seen : int64 array (T, P)
        The number of cameras from which each point was triangulated; 0 if there is no point.
    """
    frames, _, count = rays.confidence.shape
    points, seen = np.full((frames, count, 3), np.nan), np.zeros((frames, count), np.int64)
    usable = (rays.confidence >= MIN_CONFIDENCE) & np.isfinite(rays.directions).all(axis=3)
    _triangulate(
        np.ascontiguousarray(rays.centres, np.float64),
        np.ascontiguousarray(rays.focal_px, np.float64),
        np.ascontiguousarray(rays.directions, np.float64),
        np.ascontiguousarray(np.where(usable, rays.confidence, 0.0)),
        points,
        seen,
    )
    return points, seen


@njit(cache=True, nogil=True)
def _triangulate(centres: F64, focal_px: F64, directions: F64, weights: F64, points: F64, seen: I64) -> None:
    frames, cameras, count = weights.shape
    chosen, best, point, nearest = np.zeros(cameras, np.bool_), np.zeros(cameras, np.bool_), np.empty(3), np.empty(3)
    for t in range(frames):
        for p in range(count):
            usable = np.flatnonzero(weights[t, :, p] > 0.0)
            chosen[:] = False
            chosen[usable] = True
            for left in range(len(usable), 1, -1):
                error = np.inf
                if left == len(usable):
                    error = _intersect(centres, focal_px, directions[t, :, p], weights[t, :, p], chosen, nearest)
                    copy_row(best, chosen)
                elif len(usable) <= MAX_CAMERAS:
                    for choice in range(1 << len(usable)):
                        if not _choose(usable, choice, left, chosen):
                            continue
                        new = _intersect(centres, focal_px, directions[t, :, p], weights[t, :, p], chosen, point)
                        if new < error:
                            error = new
                            copy_row(nearest, point)
                            copy_row(best, chosen)
                else:
                    copy_row(chosen, best)
                    before = best.copy()
                    for v in np.flatnonzero(before):
                        copy_row(chosen, before)
                        chosen[v] = False
                        new = _intersect(centres, focal_px, directions[t, :, p], weights[t, :, p], chosen, point)
                        if new < error:
                            error = new
                            copy_row(nearest, point)
                            copy_row(best, chosen)
                    if error == np.inf:
                        break
                if error <= MAX_ERROR_PX:
                    copy_row(points[t, p], nearest)
                    seen[t, p] = left
                    break


@njit(cache=True, nogil=True)
def _choose(usable: I64, choice: int, left: int, chosen: Bool) -> bool:
    """Set the cameras of a subset, given as bits, and return True if there are `left` of them."""
    chosen[:] = False
    count = 0
    for n in range(len(usable)):
        if choice >> n & 1:
            chosen[usable[n]] = True
            count += 1
    return count == left


@njit(cache=True, nogil=True)
def _intersect(centres: F64, focal_px: F64, directions: F64, weights: F64, chosen: Bool, point: F64) -> float:
    """Compute the least-squares point of chosen rays, and return its mean reprojection error in pixels.

    The error is infinite if the rays are parallel, or if the point lies behind a camera.
    """
    a, b, c, d, e, f = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0  # the matrix (a b c; b d e; c e f) of the normal equations
    x, y, z, total = 0.0, 0.0, 0.0, 0.0
    for v in range(len(centres)):
        if not chosen[v]:
            continue
        i, j, k = directions[v]
        p, q, r = centres[v]
        w = weights[v]
        along = p * i + q * j + r * k
        a, b, c = a + w * (1.0 - i * i), b - w * i * j, c - w * i * k
        d, e, f = d + w * (1.0 - j * j), e - w * j * k, f + w * (1.0 - k * k)
        x, y, z = x + w * (p - along * i), y + w * (q - along * j), z + w * (r - along * k)
        total += w
    one, two, three = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * one + b * two + c * three
    if not determinant > _FLAT * total**3:
        return np.inf
    point[0] = (one * x + two * y + three * z) / determinant
    point[1] = (two * x + (a * f - c * c) * y + (b * c - a * e) * z) / determinant
    point[2] = (three * x + (b * c - a * e) * y + (a * d - b * b) * z) / determinant
    error, count = 0.0, 0
    for v in range(len(centres)):
        if not chosen[v]:
            continue
        i, j, k = directions[v]
        x, y, z = point[0] - centres[v, 0], point[1] - centres[v, 1], point[2] - centres[v, 2]
        depth = x * i + y * j + z * k
        if depth <= 0.0:
            return np.inf
        x, y, z = x - depth * i, y - depth * j, z - depth * k
        error += focal_px[v] * np.sqrt(x * x + y * y + z * z) / depth
        count += 1
    return error / count


def start_from_triangulation(body: ChainBody, points: F64, body_points: BodyPoints) -> Poses:
    """Return initial poses for a track on rays.

    Gaps of the points are filled linearly. Joints without a keypoint are derived from the others. Root, belly, chest,
    neck, head and headtop are placed on the line from the middle of the hips to the middle of the shoulders, at
    distances given by the bone lengths; clavicles are placed at the neck, and fingers in line with the forearm. The
    chain is then fitted to all joints.

    Parameters
    ----------
    body : ChainBody
        A body of the shipped chain's joints.
    points : float64 array (T, P, 3)
        Triangulated keypoints in metres; NaN if there is none.
    body_points : BodyPoints
        The points of the body that correspond to the keypoints.

    Returns
    -------
    Poses
        T poses.

    Raises
    ------
    ParameterError
        A hip or a shoulder is triangulated in no frame.
    """
    frames = len(points)
    positions = np.full((frames, len(body.chain.joints), 3), np.nan)
    for p, joint in enumerate(body_points.joints):
        if joint >= 0:
            positions[:, joint] = filled(points[:, p])
    return _fit_start(body, positions)


def start_from_positions(body: ChainBody, observations: JointPositions) -> Poses:
    """Return initial poses for a 3D track, with gaps filled linearly and missing joints derived from others.

    Parameters
    ----------
    body : ChainBody
        A body of the shipped chain's joints.
    observations : JointPositions
        Positions of the body's joints.

    Raises
    ------
    ParameterError
        A hip or a shoulder is tracked in no frame.
    """
    positions = np.stack([filled(observations.positions[:, j]) for j in range(len(body.chain.joints))], axis=1)
    return _fit_start(body, positions)


def _fit_start(body: ChainBody, positions: F64) -> Poses:
    """Fit the chain to joints (T, J, 3); joints that are NaN in all frames are derived from the others."""
    chain = body.chain
    for name in ("lhip", "rhip", "lshoulder", "rshoulder"):
        if not np.isfinite(positions[:, chain.joint(name)]).all():
            raise ParameterError(
                f"points of {name}",
                "seen by two cameras that agree, in one frame at least (check the calibration, the order of the "
                "cameras, and the names of keypoints)",
                "none",
            )
    lhip, rhip, lshoulder, rshoulder = (
        positions[:, chain.joint(name)] for name in ("lhip", "rhip", "lshoulder", "rshoulder")
    )
    middle = 0.5 * (lhip + rhip)
    up = _unit(0.5 * (lshoulder + rshoulder) - middle)
    drop = -0.5 * (body.offsets[chain.joint("lhip"), 1] + body.offsets[chain.joint("rhip"), 1])
    place = middle + drop * up
    _put(positions, chain.joint("root"), place)
    for name in ("belly", "chest", "neck", "head", "headtop"):
        place = place + _length(body, name) * up
        _put(positions, chain.joint(name), place)
    for side in "lr":
        _put(positions, chain.joint(f"{side}clavicle"), positions[:, chain.joint("neck")])
        elbow, wrist = positions[:, chain.joint(f"{side}elbow")], positions[:, chain.joint(f"{side}wrist")]
        fingers = chain.joint(f"{side}fingers")
        _put(positions, fingers, wrist + _length(body, chain.joints[fingers]) * _unit(wrist - elbow))
    return fit_poses(body, np.moveaxis(positions, 0, 2), START_SIGMA_M, START_STEPS)


def filled(positions: F64) -> F64:
    """Return positions (T, 3) with gaps filled linearly, and constant at both ends; all NaN if none is known."""
    seen = np.flatnonzero(np.isfinite(positions).all(axis=1))
    if not len(seen):
        return np.full_like(positions, np.nan)
    frames = np.arange(len(positions))
    return np.stack([np.interp(frames, seen, positions[seen, i]) for i in range(3)], axis=1)


def _put(positions: F64, joint: int, places: F64) -> None:
    """Set the positions of a joint that is missing in all frames."""
    if np.isnan(positions[:, joint]).all():
        positions[:, joint] = places


def _length(body: ChainBody, joint: str) -> float:
    return float(np.sqrt((body.offsets[body.chain.joint(joint)] ** 2).sum()))


def _unit(vectors: F64) -> F64:
    with np.errstate(invalid="ignore", divide="ignore"):
        return vectors / np.sqrt((vectors**2).sum(axis=1, keepdims=True))
