"""This module models the surface of a body by round cones: signed distances of points, and samples facing the camera.

A round cone is the union of balls along an axis from A to B whose radius changes evenly from r_A to r_B; A and B are
joints, or mixtures of joints. Lengths are in metres; the camera is at the origin. Pivots are joints about which all
joints below them rotate, so that bones keep their lengths without joint angles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.body.joint_tree import PARENTS
from kinedex.ops.errors import ParameterError

START, AXIS, INVERSE, RADIUS, GROWTH, MIDDLE, REACH = 0, 3, 6, 7, 8, 9, 12
"""Columns of placed cones: A, B − A, 1/‖B − A‖² (0 if A = B), r_A, r_B − r_A, and centre and radius of a bounding ball.
"""

COLUMNS = 13

BEHIND = 0.4
"""A surface point faces away from the camera if the cosine of the angle between its normal and the ray exceeds this."""

_SLACK = 1e-9  # tolerance in metres for rounding errors of a bound


class Pivots(NamedTuple):
    """The pivots of a body, as arrays for kernels.

    Attributes
    ----------
    joints : int64 array (P,)
        The joint of each pivot; the root first, parents before children.
    parents : int64 array (P,)
        The parent pivot of each pivot; −1 for the root.
    starts : int64 array (P + 1,)
        Pivot p moves the joints moved[starts[p]] to moved[starts[p + 1] − 1].
    moved : int64 array
        The joints below each pivot.
    """

    joints: I64
    parents: I64
    starts: I64
    moved: I64


def pivots_of(joints: I64) -> Pivots:
    """Return the pivots at the given joints, as arrays for kernels.

    Parameters
    ----------
    joints : int64 array (P,)
        The joints: the root first, parents before children.
    """
    moved = moved_joints(joints)
    numbers = {int(joint): k for k, joint in enumerate(joints)}
    parents = np.array([numbers.get(int(PARENTS[joint]), -1) for joint in joints], np.int64)
    starts = np.concatenate([[0], np.cumsum(moved.sum(axis=1))]).astype(np.int64)
    return Pivots(joints, parents, starts, np.nonzero(moved)[1].astype(np.int64))


def moved_joints(joints: I64) -> Bool:
    """Return a mask (P, 24), True where a pivot moves a joint: for all joints below it, not for itself."""
    moved = np.zeros((len(joints), len(PARENTS)), np.bool_)
    for k, pivot in enumerate(joints):
        for joint in range(len(PARENTS)):
            above = PARENTS[joint]
            while above >= 0 and above != pivot:
                above = PARENTS[above]
            moved[k, joint] = above == pivot
    return moved


@njit(cache=True, nogil=True, error_model="numpy")
def turn_pose(pivots: Pivots, pose: F64, rotations: F64, shift: F64) -> None:
    """Rotate every pivot of a pose in place, the deepest ones first, and then translate it.

    `rotations` (P, 3) are rotation vectors in radians; bones keep their lengths.
    """
    for k in range(len(pivots.joints) - 1, -1, -1):
        a, b, c = rotations[k, 0], rotations[k, 1], rotations[k, 2]
        angle = math.sqrt(a * a + b * b + c * c)
        if angle == 0.0:
            continue
        half = math.sin(0.5 * angle)
        one, two = math.sin(angle) / angle, 2.0 * half * half / (angle * angle)
        centre = pose[pivots.joints[k]]
        for i in range(pivots.starts[k], pivots.starts[k + 1]):
            place = pose[pivots.moved[i]]
            x, y, z = place[0] - centre[0], place[1] - centre[1], place[2] - centre[2]
            u, v, w = b * z - c * y, c * x - a * z, a * y - b * x
            place[0] += one * u + two * (b * w - c * v)
            place[1] += one * v + two * (c * u - a * w)
            place[2] += one * w + two * (a * v - b * u)
    for j in range(len(pose)):
        pose[j, 0] += shift[0]
        pose[j, 1] += shift[1]
        pose[j, 2] += shift[2]


@dataclass(frozen=True, eq=False)
class ConeBody:
    """A body that is fitted to depth images: its cones, their samples, and the pivots that move it.

    Attributes
    ----------
    name : str
        The name of the body.
    cone_names : tuple of str
        The names of the C cones.
    joints : int64 array (C, 2, M)
        The joints whose weighted mean is each end of a cone's axis.
    shares : float64 array (C, 2, M)
        The weights of these joints, which add up to 1; 0 for unused entries of `joints`.
    radii : float64 array (C, 2)
        Radii at both ends in metres, for a body that is `height_m` high.
    height_m : float
        The standing height in metres of the body that has these radii.
    height_bones : float64 array (24,)
        Factors of the bone lengths in the standing height, which is a weighted sum of bone lengths plus a constant.
    height_plus_m : float
        The constant of that sum in metres.
    sample_cones : int64 array (S,)
        The cone of each sample of the surface.
    sample_places : float64 array (S,)
        The position of each sample on the axis of its cone, from 0 to 1.
    sample_angles : float64 array (S,)
        The angle of each sample about the axis in radians, from the side towards the camera.
    pivots : int64 array (P,)
        The joints about which all joints below them rotate; the root first, parents before children.
    stiffness : float64 array (P,)
        The damping of each pivot in a step of a fit.
    """

    name: str
    cone_names: tuple[str, ...]
    joints: I64
    shares: F64
    radii: F64
    height_m: float
    height_bones: F64
    height_plus_m: float
    sample_cones: I64
    sample_places: F64
    sample_angles: F64
    pivots: I64
    stiffness: F64

    def standing_height(self, bone_lengths: npt.ArrayLike) -> float:
        """Return the standing height in metres of an actor.

        Parameters
        ----------
        bone_lengths : float64 array (24,)
            The length in metres of the bone that ends at each joint; 0 for the root.
        """
        return float(self.height_bones @ np.asarray(bone_lengths, np.float64)) + self.height_plus_m

    def cones(self, height: float) -> Cones:
        """Return the cones of an actor of the given standing height in metres, as arrays for kernels.

        Raises
        ------
        ParameterError
            The height is not positive and finite.
        """
        if not (math.isfinite(height) and height > 0):
            raise ParameterError("height", "positive and finite, in metres", height)
        return Cones(self.joints, self.shares, self.radii * (height / self.height_m))

    @cached_property
    def samples(self) -> Samples:
        """Return the samples of the surface as arrays for kernels."""
        angles = self.sample_angles
        return Samples(self.sample_cones, self.sample_places, np.cos(angles), np.sin(angles), angles == 0.0)


class Cones(NamedTuple):
    """The cones of an actor as arrays; see `ConeBody` for their meaning, with radii scaled to the actor."""

    joints: I64
    shares: F64
    radii: F64


class Samples(NamedTuple):
    """Samples of the surface, see `ConeBody`: cone, position, cosine and sine of the angle, True for an angle of 0."""

    cones: I64
    positions: F64
    cosines: F64
    sines: F64
    straight: Bool


class SurfaceDistances(NamedTuple):
    """The signed distances of points from a body's surface, with the nearest cone of each.

    Attributes
    ----------
    d : float64 array (n,)
        Signed distances in metres, negative inside.
    cone : int64 array (n,)
        The nearest cone of each point; the first of equally near cones.
    s : float64 array (n,)
        The position on the cone's axis, from 0 to 1.
    normals : float64 array (n, 3)
        Unit vectors from the axis to the point; 0 on the axis.
    """

    d: F64
    cone: I64
    s: F64
    normals: F64


def body_distance(body: ConeBody, pose: F64, points: F64, height: float | None = None) -> SurfaceDistances:
    """Return the signed distances of points from the surface of a body.

    Parameters
    ----------
    body : ConeBody
        The body.
    pose : float64 array (24, 3)
        Joints in metres.
    points : float64 array (n, 3)
        Points in metres.
    height : float, optional
        The actor's standing height in metres; by default the height for which the body's radii are given.

    Returns
    -------
    SurfaceDistances
        The signed distances, and the nearest cone of each point.
    """
    cones = body.cones(body.height_m if height is None else height)
    placed = np.empty((len(cones.radii), COLUMNS))
    place_cones(cones, np.ascontiguousarray(pose, np.float64), placed)
    count = len(points)
    found = SurfaceDistances(np.empty(count), np.empty(count, np.int64), np.empty(count), np.empty((count, 3)))
    _distances(placed, np.ascontiguousarray(points, np.float64), found)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def place_cones(cones: Cones, pose: F64, placed: F64) -> None:
    """Write the cones of a pose into `placed`.

    Parameters
    ----------
    cones : Cones
        The cones of an actor.
    pose : float64 array (24, 3)
        Joints in metres.
    placed : float64 array (C, 13)
        The placed cones, with the columns `START` to `REACH`, which are written.
    """
    for c in range(len(cones.radii)):
        row = placed[c]
        length = 0.0
        for i in range(3):
            a, b = 0.0, 0.0
            for m in range(cones.joints.shape[2]):
                a += cones.shares[c, 0, m] * pose[cones.joints[c, 0, m], i]
                b += cones.shares[c, 1, m] * pose[cones.joints[c, 1, m], i]
            row[START + i], row[AXIS + i], row[MIDDLE + i] = a, b - a, 0.5 * (a + b)
            length += (b - a) * (b - a)
        row[INVERSE] = 1.0 / length if length > 0.0 else 0.0
        row[RADIUS], row[GROWTH] = cones.radii[c, 0], cones.radii[c, 1] - cones.radii[c, 0]
        row[REACH] = 0.5 * math.sqrt(length) + max(cones.radii[c, 0], cones.radii[c, 1]) + _SLACK


@njit(cache=True, nogil=True, error_model="numpy")
def cone_distance(cone: F64, x: float, y: float, z: float) -> tuple[float, float]:
    """Return the signed distance of a point from a placed cone, and the nearest position on the cone's axis."""
    u, v, w = x - cone[START], y - cone[START + 1], z - cone[START + 2]
    a, b, c = cone[AXIS], cone[AXIS + 1], cone[AXIS + 2]
    s = min(max((u * a + v * b + w * c) * cone[INVERSE], 0.0), 1.0)
    u, v, w = u - s * a, v - s * b, w - s * c
    return math.sqrt(u * u + v * v + w * w) - (cone[RADIUS] + s * cone[GROWTH]), s


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_cone(placed: F64, x: float, y: float, z: float, guess: int) -> tuple[float, int, float]:
    """Return the signed distance of a point from the body, the nearest cone and the position on its axis.

    Parameters
    ----------
    placed : float64 array (C, 13)
        The placed cones.
    x, y, z : float
        The point in metres.
    guess : int
        A cone that is probably near, so that the bounding balls of most other cones exclude them at once.

    Returns
    -------
    tuple of (float, int, float)
        The distance in metres, negative inside; the cone, the first of equally near ones; the position from 0 to 1.
    """
    nearest = guess
    d, s = cone_distance(placed[guess], x, y, z)
    for c in range(len(placed)):
        row = placed[c]
        u, v, w = x - row[MIDDLE], y - row[MIDDLE + 1], z - row[MIDDLE + 2]
        limit = d + row[REACH]
        if c == guess or limit < 0.0 or u * u + v * v + w * w > limit * limit:
            continue
        other, place = cone_distance(row, x, y, z)
        if other < d or (other == d and c < nearest):
            d, s, nearest = other, place, c
    return d, nearest, s


@njit(cache=True, nogil=True, error_model="numpy")
def seen_side(cone: F64, s: float, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return the normal of a cone on the side that the camera at the origin can see, and a point's distance to it.

    The nearest point of the surface may face away from the camera, so that no pixel can show it: a shank slightly in
    front of its points would be fitted to them with its calf. In this case the side towards the camera is used instead,
    and the point lies behind it.

    Parameters
    ----------
    cone : float64 array (13,)
        A placed cone.
    s : float
        The position on the axis that is nearest to the point.
    x, y, z : float
        The point in metres.

    Returns
    -------
    tuple of (float, float, float, float)
        The unit vector, and the signed distance in metres; all 0 for a point on the axis.
    """
    u, v = x - cone[START] - s * cone[AXIS], y - cone[START + 1] - s * cone[AXIS + 1]
    w = z - cone[START + 2] - s * cone[AXIS + 2]
    apart, radius = math.sqrt(u * u + v * v + w * w), cone[RADIUS] + s * cone[GROWTH]
    if apart <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    far = math.sqrt(x * x + y * y + z * z)
    along = u * x + v * y + w * z
    if along > BEHIND * far * apart:
        return -x / far, -y / far, -z / far, -along / far - radius
    return u / apart, v / apart, w / apart, apart - radius


@njit(cache=True, nogil=True, error_model="numpy")
def _distances(placed: F64, points: F64, found: SurfaceDistances) -> None:
    guess = 0
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        d, guess, s = nearest_cone(placed, x, y, z, np.int64(guess))
        row = placed[guess]
        found.d[i], found.cone[i], found.s[i] = d, guess, s
        apart = d + row[RADIUS] + s * row[GROWTH]
        scale = 1.0 / apart if apart > 0.0 else 0.0
        found.normals[i, 0] = (x - row[START] - s * row[AXIS]) * scale
        found.normals[i, 1] = (y - row[START + 1] - s * row[AXIS + 1]) * scale
        found.normals[i, 2] = (z - row[START + 2] - s * row[AXIS + 2]) * scale


@njit(cache=True, nogil=True, error_model="numpy")
def place_samples(samples: Samples, placed: F64, points: F64, offsets: F64) -> None:
    """Write the samples of a pose's surface, on the side towards the camera at the origin.

    Parameters
    ----------
    samples : Samples
        The samples of a body.
    placed : float64 array (C, 13)
        The placed cones.
    points, offsets : float64 array (S, 3)
        The samples in metres, and their offsets from their cone's axis; both are written.
    """
    for i in range(len(samples.cones)):
        row, s = placed[samples.cones[i]], samples.positions[i]
        unit = math.sqrt(row[INVERSE])
        e, f, g = unit * row[AXIS], unit * row[AXIS + 1], unit * row[AXIS + 2]
        x, y, z = row[START] + s * row[AXIS], row[START + 1] + s * row[AXIS + 1], row[START + 2] + s * row[AXIS + 2]
        along = x * e + y * f + z * g
        u, v, w = _unit(along * e - x, along * f - y, along * g - z)
        if s == 1.0 and samples.straight[i]:  # the tip of the cone
            u, v, w = _unit(u + e, v + f, w + g)
        radius = row[RADIUS] + s * row[GROWTH]
        cosine, sine = radius * samples.cosines[i], radius * samples.sines[i]
        offsets[i, 0] = cosine * u + sine * (f * w - g * v)
        offsets[i, 1] = cosine * v + sine * (g * u - e * w)
        offsets[i, 2] = cosine * w + sine * (e * v - f * u)
        points[i, 0], points[i, 1], points[i, 2] = x + offsets[i, 0], y + offsets[i, 1], z + offsets[i, 2]


@njit(cache=True, nogil=True, error_model="numpy")
def _unit(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return a vector normalised to length 1; zero for a vector shorter than 1e-12."""
    length = math.sqrt(x * x + y * y + z * z)
    scale = 1.0 / length if length > 1e-12 else 0.0
    return x * scale, y * scale, z * scale
