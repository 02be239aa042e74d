"""This module matches a body's contour with the boundary of silhouettes (thesis, Section 6.2.3).

A capsule that is seen from a camera has a contour line on either side, whose points are computed exactly. A plane
through the camera's centre C touches the cylinder of radius r about an axis point p, with axis direction a, at p + r
(cos β v ± sin β u). Here u is a × (p − C) normalised, v is ± (u × a) with the sign for which v points to the camera,
and cos β is r divided by the distance of C from the axis.

From each contour point that projects inside no other capsule, the boundary of the foreground is searched along the
normal of the contour in the image. The ray through the boundary and the surface point form a correspondence of Eq. 6.4.
The correspondences of a frame are summed, and added to the frame's normal equations H, g.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64, U8, Bool
from kinedex.ops.body.capsules import Capsules
from kinedex.ops.body.kinematic_chain import ChainArrays, ChainBody, point_jacobian
from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking.blocks import FrameBuffers, add_point
from kinedex.ops.tracking.observations import MIN_CONFIDENCE, BodyPoints, JointPositions, Rays
from kinedex.ops.tracking.views import View, capsule_box, mask_pixel, ray_distance, seen_joints

SPACING_M = 0.03
"""Spacing in metres of contour points along the axis of a capsule."""

INSIDE = 0.97
"""Fraction of a capsule's radius; contour points of other capsules nearer to the axis count as hidden or inside."""

HALF = 127.5
"""The mask value at the boundary: a foreground probability of one half, scaled to 0 … 255."""

_NORMAL_M = 0.01  # metres that a point is moved along its normal to find the normal's direction in the image

WEIGHT, SIGMA_PX = 0.15, 3.0
"""Weight of a correspondence, and standard deviation of the boundary in pixels of the camera."""

_NEAREST_M = 0.3  # least depth in metres at which the size of a pixel is computed, as for rays of keypoints


class Masks(Protocol):
    """The interface of silhouettes over time, one mask for each camera and frame.

    Frame t has one uint8 array (H, W) for each camera, the probability of foreground times 255, or only 0 and 255. It
    is None if a camera has no image.
    """

    def __len__(self) -> int: ...

    def __getitem__(self, frame: int, /) -> tuple[U8 | None, ...]: ...


class Silhouettes(NamedTuple):
    """Silhouettes of a person in calibrated cameras, and the surface of the body.

    Attributes
    ----------
    views : tuple of View
        The cameras, see `kinedex.ops.tracking.views.camera_view`.
    masks : Masks
        The masks of T frames.
    capsules : Capsules
        The surface of the body.
    """

    views: tuple[View, ...]
    masks: Masks
    capsules: Capsules

    def seen(self, t: int) -> list[tuple[View, U8]]:
        """Return the cameras that show foreground in frame t, with their masks.

        Raises
        ------
        ParameterError
            The numbers of masks and cameras differ, or a mask does not have the camera's size.
        """
        masks = self.masks[t]
        if len(masks) != len(self.views):
            raise ParameterError(f"masks of frame {t}", f"those of {len(self.views)} cameras", len(masks))
        found = []
        for v, (view, mask) in enumerate(zip(self.views, masks, strict=True)):
            if mask is not None and mask.shape != view.plane.shape[:2]:
                raise ParameterError(f"mask of camera {v} in frame {t}", f"of shape {view.plane.shape[:2]}", mask.shape)
            if mask is not None and mask.any():
                constant = mask.view()
                # read-only, as masks from files are, since kernels are compiled for this type only
                constant.flags.writeable = False
                found.append((view, constant))
        return found


@dataclass(frozen=True, eq=False)
class Observed:
    """The observations of a recording, or the joints of a 3D track, of one body.

    Attributes
    ----------
    body : ChainBody
        The body.
    rate_hz : float
        Frames per second.
    observations : Rays or JointPositions or None
        Rays of keypoints, or positions of joints, in T frames; None if there are only silhouettes.
    points : BodyPoints, optional
        The points of the body to which the rays belong.
    silhouettes : Silhouettes, optional
        Masks in calibrated cameras.
    cuts : tuple of int
        Frames at which the motion is not continuous with the previous frame.
    """

    body: ChainBody
    rate_hz: float
    observations: Rays | JointPositions | None
    points: BodyPoints | None = None
    silhouettes: Silhouettes | None = None
    cuts: tuple[int, ...] = ()

    @property
    def frames(self) -> int:
        """Return the number of frames of the recording."""
        if isinstance(self.observations, Rays):
            return len(self.observations.confidence)
        if self.observations is not None:
            return len(self.observations.positions)
        assert self.silhouettes is not None
        return len(self.silhouettes.masks)

    @property
    def seen(self) -> Bool:
        """Return a mask (T,) of the frames that have any observation."""
        seen = np.zeros(self.frames, np.bool_)
        if isinstance(self.observations, Rays):
            seen |= (self.observations.confidence >= MIN_CONFIDENCE).any(axis=(1, 2))
        elif self.observations is not None:
            seen |= np.isfinite(self.observations.positions.sum(axis=2)).any(axis=1)
        if self.silhouettes is not None:
            masks = self.silhouettes.masks
            seen |= [any(mask is not None and mask.any() for mask in masks[t]) for t in range(len(masks))]
        return seen


class Contours(NamedTuple):
    """Contour points of a pose in one camera, with the boundary points found for them; arrays of capacity M.

    Attributes
    ----------
    capsules : int64 array (M,)
        The capsule of each point.
    shares : float64 array (M,)
        The position s of each point on the axis, from 0 at the start to 1 at the end.
    points : float64 array (M, 3)
        The points of the surface in metres.
    directions : float64 array (M, 3)
        Unit vectors of the rays through the boundary points.
    shifts : float64 array (M,)
        The distance to the boundary in pixels of the camera, positive outwards.
    """

    capsules: I64
    shares: F64
    points: F64
    directions: F64
    shifts: F64


def contour_buffers(capsules: Capsules, joints: F64) -> Contours:
    """Allocate arrays for all contour points of a body with joints (J, 3) in one camera."""
    bones = joints[capsules.ends] - joints[capsules.starts]
    lengths = np.sqrt((bones * bones).sum(axis=1))
    # a line between joints of different nodes, such as both shoulders, can become longer when the body bends
    most = int(2 * (2 + 2 * np.ceil(lengths / SPACING_M)).sum())
    return Contours(np.zeros(most, np.int64), *(np.zeros((most, *shape)) for shape in ((), (3,), (3,), ())))


@njit(cache=True, nogil=True)
def contour_normals(one: F64, other: F64, radius: float, centre: F64, share: float, normals: F64) -> bool:
    """Compute the two unit normals (2, 3) of a capsule's contour at a position on its axis, from 0 to 1.

    Return False if there are none: the camera is inside the cylinder, or the capsule is a sphere.
    """
    ax, ay, az = other[0] - one[0], other[1] - one[1], other[2] - one[2]
    dx = one[0] + share * ax - centre[0]
    dy = one[1] + share * ay - centre[1]
    dz = one[2] + share * az - centre[2]
    length = np.sqrt(ax * ax + ay * ay + az * az)
    if length < 1e-9:
        return False
    ax, ay, az = ax / length, ay / length, az / length
    ux, uy, uz = ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx
    distance = np.sqrt(ux * ux + uy * uy + uz * uz)  # distance of the camera's centre from the axis
    if distance <= radius:
        return False
    ux, uy, uz = ux / distance, uy / distance, uz / distance
    # u × a points away from the axis on the side of the camera, for u = a × (p − C)
    vx, vy, vz = uz * ay - uy * az, ux * az - uz * ax, uy * ax - ux * ay
    cosine = radius / distance
    sine = np.sqrt(1.0 - cosine * cosine)
    for side in range(2):
        sign = sine if side == 0 else -sine
        normals[side, 0] = cosine * vx + sign * ux
        normals[side, 1] = cosine * vy + sign * uy
        normals[side, 2] = cosine * vz + sign * uz
    return True


@njit(cache=True, nogil=True)
def find_contours(view: View, mask: U8, joints: F64, capsules: Capsules, found: Contours) -> tuple[int, int]:
    """Find the boundary of the foreground for the contour points of a pose in one camera.

    Parameters
    ----------
    view : View
        The camera.
    mask : uint8 array (H, W)
        The mask of the camera, see `Masks`.
    joints : float64 array (J, 3)
        The joints of the pose in metres.
    capsules : Capsules
        The surface of the body.
    found : Contours
        Output: the correspondences, see `contour_buffers`.

    Returns
    -------
    correspondences : int
        The number of correspondences; a point without a boundary within `view.reach` has no correspondence.
    visible : int
        The number of contour points that the body does not hide.
    """
    count, visible, most = 0, 0, len(found.capsules)
    seen = np.empty_like(joints)
    seen_joints(view, joints, seen)
    boxes, normals, centre = np.empty((len(capsules.radii), 4)), np.empty((2, 3)), np.zeros(3)
    for n in range(len(capsules.radii)):
        capsule_box(seen[capsules.starts[n]], seen[capsules.ends[n]], capsules.radii[n], boxes[n])
    for n in range(len(capsules.radii)):
        one, other, radius = seen[capsules.starts[n]], seen[capsules.ends[n]], capsules.radii[n]
        length = np.sqrt((other[0] - one[0]) ** 2 + (other[1] - one[1]) ** 2 + (other[2] - one[2]) ** 2)
        pieces = int(np.ceil(length / SPACING_M))
        for piece in range(pieces):
            share = (piece + 0.5) / pieces
            if not contour_normals(one, other, radius, centre, share, normals):
                continue
            for side in range(2):
                if count >= most:
                    return count, visible
                x = one[0] + share * (other[0] - one[0]) + radius * normals[side, 0]
                y = one[1] + share * (other[1] - one[1]) + radius * normals[side, 1]
                z = one[2] + share * (other[2] - one[2]) + radius * normals[side, 2]
                if z <= 1e-3 or _hidden(n, x / z, y / z, boxes, seen, capsules):
                    continue
                visible += 1
                shift = _boundary(view, mask, (x, y, z), normals[side], found.directions[count])
                if np.isnan(shift):
                    continue
                found.capsules[count], found.shares[count], found.shifts[count] = n, share, shift
                for i in range(3):  # transform to the world
                    found.points[count, i] = (
                        view.rotation[0, i] * (x - view.translation[0])
                        + view.rotation[1, i] * (y - view.translation[1])
                        + view.rotation[2, i] * (z - view.translation[2])
                    )
                count += 1
    return count, visible


@njit(cache=True, nogil=True)
def _hidden(own: int, x: float, y: float, boxes: F64, seen: F64, capsules: Capsules) -> bool:
    """Return True if a capsule other than `own` covers the ray (x, y, 1) of the camera."""
    for n in range(len(boxes)):
        if n == own or x < boxes[n, 0] or y < boxes[n, 1] or x > boxes[n, 2] or y > boxes[n, 3]:
            continue
        near = INSIDE * capsules.radii[n]
        if ray_distance(seen[capsules.starts[n]], seen[capsules.ends[n]], x, y) < near * near:
            return True
    return False


@njit(cache=True, nogil=True)
def _boundary(view: View, mask: U8, point: tuple[float, float, float], normal: F64, direction: F64) -> float:
    """Find the boundary of the foreground from a contour point in the camera's axes, along its normal in the image.

    Return the distance in pixels of the camera, positive outwards, and write the direction in the world of the ray
    through the boundary to the last array. The distance is NaN if there is no boundary within reach or before the
    border of the image.
    """
    x, y, z = point
    column, row = mask_pixel(view, x / z, y / z)
    depth = z + _NORMAL_M * normal[2]
    to_column, to_row = mask_pixel(view, (x + _NORMAL_M * normal[0]) / depth, (y + _NORMAL_M * normal[1]) / depth)
    along, down = to_column - column, to_row - row
    length = np.sqrt(along * along + down * down)
    value = _foreground(mask, column, row)
    if length == 0.0 or np.isnan(value):
        return np.nan
    outwards = value >= HALF
    sign = 1.0 / length if outwards else -1.0 / length
    along, down = sign * along, sign * down
    way = 0.0
    while way < view.reach:
        before, way = value, min(way + 1.0, view.reach)
        value = _foreground(mask, column + way * along, row + way * down)
        if np.isnan(value):
            return np.nan
        if (value >= HALF) != outwards:
            last = np.ceil(way) - 1.0
            way = last + (way - last) * (before - HALF) / (before - value)
            break
    else:
        return np.nan
    if not _ray(view, column + way * along, row + way * down, direction):
        return np.nan
    return (way if outwards else -way) * view.scale


@njit(cache=True, nogil=True)
def _foreground(mask: U8, column: float, row: float) -> float:
    """Return a mask's value between pixels by bilinear interpolation; NaN outside the image."""
    height, width = mask.shape
    if not (0.0 <= column <= width - 1 and 0.0 <= row <= height - 1):
        return np.nan
    left, top = min(int(column), max(width - 2, 0)), min(int(row), max(height - 2, 0))
    right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
    u, v = column - left, row - top
    upper = (1.0 - u) * mask[top, left] + u * mask[top, right]
    lower = (1.0 - u) * mask[bottom, left] + u * mask[bottom, right]
    value: float = (1.0 - v) * upper + v * lower
    return value


@njit(cache=True, nogil=True)
def _ray(view: View, column: float, row: float, direction: F64) -> bool:
    """Compute the unit vector in the world of the ray through a point of the mask; return False if there is none."""
    height, width = view.plane.shape[:2]
    left, top = min(int(column), max(width - 2, 0)), min(int(row), max(height - 2, 0))
    right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
    u, v = column - left, row - top
    seen = np.ones(3)
    for i in range(2):
        upper = (1.0 - u) * view.plane[top, left, i] + u * view.plane[top, right, i]
        lower = (1.0 - u) * view.plane[bottom, left, i] + u * view.plane[bottom, right, i]
        seen[i] = (1.0 - v) * upper + v * lower
    norm = np.sqrt(seen[0] ** 2 + seen[1] ** 2 + 1.0)
    for i in range(3):
        direction[i] = 0.0
        for a in range(3):
            direction[i] += view.rotation[a, i] * seen[a] / norm
    return bool(np.isfinite(norm))


class ContourSums(NamedTuple):
    """Correspondences as quadratic forms in the displacements of joints from the pose at which they were found.

    A point at position s of a capsule's axis moves by (1 − s) times the start joint's displacement plus s times the end
    joint's.

    Attributes
    ----------
    capsules : Capsules
        The surface of the body.
    joints : float64 array (J, 3)
        The joints of the pose at which the correspondences were found.
    matrices : float64 array (J, 3, 3)
        Sums of (1 − s)² A or s² A with A = w (I − n nᵀ).
    vectors : float64 array (J, 3)
        Sums of (1 − s) b or s b with b = w (I − n nᵀ)(y − C).
    mixed : float64 array (N, 3, 3)
        Sums of s (1 − s) A of each capsule.
    """

    capsules: Capsules
    joints: F64
    matrices: F64
    vectors: F64
    mixed: F64


def contour_sums(capsules: Capsules, joints: int) -> ContourSums:
    """Allocate sums without correspondences, for J joints."""
    shapes = (joints, 3), (joints, 3, 3), (joints, 3), (len(capsules.radii), 3, 3)
    return ContourSums(capsules, *(np.zeros(shape) for shape in shapes))


@njit(cache=True, nogil=True)
def add_contours(view: View, found: Contours, count: int, sums: ContourSums) -> float:
    """Add correspondences of one camera to the sums of a frame (thesis, Eq. 6.4).

    Parameters
    ----------
    view : View
        The camera.
    found : Contours
        The correspondences.
    count : int
        The number of correspondences.
    sums : ContourSums
        The sums, to which the correspondences are added.

    Returns
    -------
    float
        The cost, which is the sum of w ‖(I − n nᵀ)(y − C)‖².
    """
    cost, capsules = 0.0, sums.capsules
    focal = 0.5 * (view.matrix[0, 0] + view.matrix[1, 1])
    apart = np.empty(3)
    for c in range(count):
        n = found.directions[c]
        depth = 0.0
        for i in range(3):
            apart[i] = found.points[c, i] - view.centre[i]
            depth += apart[i] * n[i]
        weight = WEIGHT * (focal / (max(depth, _NEAREST_M) * SIGMA_PX)) ** 2
        capsule, share = found.capsules[c], found.shares[c]
        start, end = capsules.starts[capsule], capsules.ends[capsule]
        for i in range(3):
            apart[i] -= depth * n[i]
            cost += weight * apart[i] * apart[i]
        for i in range(3):
            sums.vectors[start, i] += weight * (1.0 - share) * apart[i]
            sums.vectors[end, i] += weight * share * apart[i]
            for j in range(3):
                part = weight * ((1.0 if i == j else 0.0) - n[i] * n[j])
                sums.matrices[start, i, j] += (1.0 - share) ** 2 * part
                sums.matrices[end, i, j] += share**2 * part
                sums.mixed[capsule, i, j] += share * (1.0 - share) * part
    return cost


@njit(cache=True, nogil=True)
def sums_cost(sums: ContourSums, joints: F64) -> float:
    """Return the change of the correspondences' cost from the pose at which they were found to another pose.

    Parameters
    ----------
    sums : ContourSums
        The sums of the correspondences.
    joints : float64 array (J, 3)
        The joints of another pose in metres.

    Returns
    -------
    float
        The difference of the costs, which is negative if the other pose fits better.
    """
    cost, capsules = 0.0, sums.capsules
    moves = joints - sums.joints
    for j in range(len(joints)):
        for i in range(3):
            along = 2.0 * sums.vectors[j, i]
            for a in range(3):
                along += sums.matrices[j, i, a] * moves[j, a]
            cost += along * moves[j, i]
    for n in range(len(capsules.radii)):
        start, end = capsules.starts[n], capsules.ends[n]
        for i in range(3):
            for a in range(3):
                cost += 2.0 * moves[start, i] * sums.mixed[n, i, a] * moves[end, a]
    return cost


@njit(cache=True, nogil=True)
def add_sums(chain: ChainArrays, sums: ContourSums, joints: F64, buffers: FrameBuffers, gradient: F64) -> float:
    """Add the correspondences to H and g of a frame, and return the change of their cost.

    Parameters
    ----------
    chain : ChainArrays
        The body.
    sums : ContourSums
        The sums of the correspondences.
    joints : float64 array (J, 3)
        The joints of the pose in metres.
    buffers : FrameBuffers
        The arrays of a frame, with the nodes of the pose; its H is added to.
    gradient : float64 array (P,)
        The vector g of the P parameters of the pose, which is added to.

    Returns
    -------
    float
        The change of the cost, as `sums_cost` returns it.
    """
    capsules, moves, vectors = sums.capsules, joints - sums.joints, sums.vectors.copy()
    others = np.empty_like(buffers.columns)
    for n in range(len(capsules.radii)):
        start, end = capsules.starts[n], capsules.ends[n]
        if sums.mixed[n, 0, 0] + sums.mixed[n, 1, 1] + sums.mixed[n, 2, 2] <= 0.0:
            continue
        for i in range(3):
            for a in range(3):
                vectors[start, i] += sums.mixed[n, i, a] * moves[end, a]
                vectors[end, i] += sums.mixed[n, i, a] * moves[start, a]
        one = point_jacobian(
            chain, buffers.turned, buffers.centres, chain.joint_nodes[start], joints[start], buffers.columns
        )
        other = point_jacobian(chain, buffers.turned, buffers.centres, chain.joint_nodes[end], joints[end], others)
        _add_mixed(buffers.columns, one, others, other, sums.mixed[n], buffers.hessian)
    for j in range(len(joints)):
        if sums.matrices[j, 0, 0] + sums.matrices[j, 1, 1] + sums.matrices[j, 2, 2] <= 0.0:
            continue
        for i in range(3):
            for a in range(3):
                vectors[j, i] += sums.matrices[j, i, a] * moves[j, a]
        add_point(chain, buffers, chain.joint_nodes[j], joints[j], sums.matrices[j], vectors[j], gradient)
    return sums_cost(sums, joints)


@njit(cache=True, nogil=True)
def _add_mixed(columns: F64, one: int, others: F64, other: int, matrix: F64, hessian: F64) -> None:
    """Add JᵀAK + KᵀAJ of the derivatives of two points to the lower half of H."""
    for a in range(one):
        p, u, v, w = int(columns[a, 0]), columns[a, 1], columns[a, 2], columns[a, 3]
        x = matrix[0, 0] * u + matrix[0, 1] * v + matrix[0, 2] * w
        y = matrix[1, 0] * u + matrix[1, 1] * v + matrix[1, 2] * w
        z = matrix[2, 0] * u + matrix[2, 1] * v + matrix[2, 2] * w
        for b in range(other):
            q = int(others[b, 0])
            product = x * others[b, 1] + y * others[b, 2] + z * others[b, 3]
            hessian[max(p, q), min(p, q)] += 2.0 * product if p == q else product
