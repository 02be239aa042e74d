"""This module computes the depth of cones along the rays of a camera by ray marching.

Positions are in the axes of the camera: x right, y down, z forward, in metres. A ray goes through the origin and (a, b,
1), and its depth is z. The surface of the body in front of the camera consists of round cones with clothes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.errors import ParameterError

REFERENCE_HEIGHT_M = 1.70
"""The standing height in metres of the body for which radii are given."""


HIT_M = 0.001
"""Distance in metres from the surface at which a ray ends."""

SHADOW_M = 0.01
"""Tolerance in metres of shadows; a point is lit if the light is blocked less than this distance in front of it."""

_NEAREST_M = 0.05
"""Depth in metres below which a cone may project anywhere in the image."""


@dataclass(frozen=True, eq=False)
class Clothes:
    """Clothes modelled as bumps of the surface.

    Attributes
    ----------
    waves_m : float
        Height w of waves in the axes of the camera, in metres: the radius grows by
        w sin(40x + φ) sin(37y + 2φ) sin(33z), with φ drawn from 0 to 6.
    folds_m, fold_length_m : float64 array (C,)
        Height h of the folds around each cone, and the distance ℓ between two folds, in metres. At a distance of a
        metres along the axis, the radius grows by h sin²(π a / ℓ + ψ), with ψ drawn from 0 to π for each cone.
    """

    waves_m: float
    folds_m: F64
    fold_length_m: F64

    def __post_init__(self) -> None:
        if not 0 <= self.waves_m < np.inf or not ((self.folds_m >= 0) & np.isfinite(self.folds_m)).all():
            raise ParameterError("clothes", "bumps of 0 or more metres", [self.waves_m, self.folds_m.tolist()])
        if not (self.fold_length_m > 0).all():
            raise ParameterError("fold_length_m", "above 0", self.fold_length_m.tolist())


@dataclass(frozen=True, eq=False)
class Flesh:
    """C round cones attached to the joints of a body, before the sizes of a person are drawn.

    The end e of cone c lies at Σ weights[c, e, j] · joint j + forward_m[c, e] · facing, with a sum over the joints j.
    The second end is then moved by beyond_m[c] metres in the direction from joint beyond[c, 0] to joint beyond[c, 1].

    Attributes
    ----------
    weights : float64 array (C, 2, 24)
        Weights of the joints, in the order of `JOINTS`.
    forward_m : float64 array (C, 2)
        Forward shift of each end in metres; negative for a backward shift.
    beyond : int64 array (C, 2)
        Two joints that define the direction in which the second end is moved.
    beyond_m : float64 array (C,)
        The distance in metres by which the second end is moved in this direction.
    radii : float64 array (C, 2)
        Radii in metres of a body that stands 1.70 m high.
    kinds : int64 array (C,)
        The kind of body part of each cone; parts of the same kind share a factor.
    factors : float64 array (K, 2)
        The smallest and the largest factor of the radii of each kind.
    clothes : Clothes
        The bumps of the surface that model clothes.
    """

    weights: F64
    forward_m: F64
    beyond: I64
    beyond_m: F64
    radii: F64
    kinds: I64
    factors: F64
    clothes: Clothes


class Surface(NamedTuple):
    """The sizes and bumps of the C cones of one person, in metres.

    Attributes
    ----------
    radii : float64 array (C, 2)
        Radii at both ends of each cone.
    wave_m, wave_phase : float
        Height and phase of waves.
    folds : float64 array (C, 3)
        Height, radians per metre and phase of the folds around each cone.
    """

    radii: F64
    wave_m: float
    wave_phase: float
    folds: F64

    @property
    def step(self) -> float:
        """Return the fraction of the distance by which a ray may safely advance: 0.9, or less if folds are steep."""
        steepest = float((self.folds[:, 0] * self.folds[:, 1]).max(initial=0.0))
        return 0.9 / (1.0 + steepest)


def draw_surface(flesh: Flesh, height_m: float, generator: np.random.Generator) -> Surface:
    """Draw the sizes of a person's body parts and the phases of the clothes.

    Parameters
    ----------
    flesh : Flesh
        The cones.
    height_m : float
        Standing height of the person in metres.
    generator : numpy.random.Generator
        The generator from which factors and phases are drawn.
    """
    if not 0 < height_m < np.inf:
        raise ParameterError("height_m", "above 0", height_m)
    factors = generator.uniform(flesh.factors[:, 0], flesh.factors[:, 1])
    radii = flesh.radii * factors[flesh.kinds, None] * (height_m / REFERENCE_HEIGHT_M)
    phase = float(generator.uniform(0.0, 6.0))
    clothes = flesh.clothes
    rotations = generator.uniform(0.0, np.pi, len(radii))
    folds = np.stack([clothes.folds_m, np.pi / clothes.fold_length_m, rotations], axis=1)
    return Surface(np.ascontiguousarray(radii), clothes.waves_m, phase, np.ascontiguousarray(folds))


def facing(joints: F64) -> F64:
    """Return the horizontal unit vectors (…, 3) that bodies face, from joints (…, 24, 3) with Y up.

    They are perpendicular to the lines from the right to the left shoulder and hip. A vector is 0 if these lines are
    vertical.
    """
    at = {name: joints[..., JOINTS.index(name), :] for name in ("lshoulder", "rshoulder", "lhip", "rhip")}
    across = (at["lshoulder"] - at["rshoulder"]) + (at["lhip"] - at["rhip"])
    ahead = np.cross(across, joints[..., JOINTS.index("neck"), :] - joints[..., JOINTS.index("root"), :])
    ahead[..., 1] = 0.0
    length = np.linalg.norm(ahead, axis=-1, keepdims=True)
    unit: F64 = np.divide(ahead, length, out=np.zeros_like(ahead), where=length > 0)
    return unit


def cone_ends(flesh: Flesh, joints: F64) -> F64:
    """Return the ends (T, C, 2, 3) of the cones' axes, from joints (T, 24, 3) in metres with Y up."""
    ends = np.einsum("cej,tjk->tcek", flesh.weights, joints)
    ends += flesh.forward_m[None, :, :, None] * facing(joints)[:, None, None, :]
    ways = joints[:, flesh.beyond[:, 1]] - joints[:, flesh.beyond[:, 0]]
    length = np.linalg.norm(ways, axis=-1, keepdims=True)
    ends[:, :, 1] += flesh.beyond_m[:, None] * np.divide(ways, length, out=np.zeros_like(ways), where=length > 0)
    found: F64 = ends
    return found


class ConeRays:
    """Casts rays of a camera at cones, with preallocated arrays.

    Parameters
    ----------
    surface : Surface
        Sizes and bumps of C cones.
    focal_px : float
        Focal length in pixels.
    centre : tuple of (float, float)
        Column and row of the optical axis.
    size : tuple of (int, int)
        Width and height of the images in pixels.
    """

    def __init__(self, surface: Surface, focal_px: float, centre: tuple[float, float], size: tuple[int, int]) -> None:
        self.surface, self.view, self.size = surface, np.array([focal_px, *centre]), size
        cones = len(surface.radii)
        self._boxes = np.zeros((cones, 6))
        self._bumps = np.array([surface.wave_m, surface.wave_phase, surface.step])

    def depth(self, ends: F64) -> F64:
        """Return the depth (H, W) of cones with ends (C, 2, 3); infinite if the ray of a pixel meets no cone."""
        width, height = self.size
        image = np.full((height, width), np.inf)
        margin = self.surface.wave_m + self.surface.folds[:, 0]
        _bound(ends, self.surface.radii, margin, self.view, self._boxes)
        _render(ends, self.surface, self._bumps, self.view, self._boxes, image)
        return image

    def shadow(self, ends: F64, depth: F64, baseline_m: float) -> Bool:
        """Return a mask (H, W) of the pixels whose points lie in the shadow of cones from a projector.

        Parameters
        ----------
        ends : float64 array (C, 2, 3)
            Ends of the cones.
        depth : float64 array (H, W)
            Depth of each pixel in metres.
        baseline_m : float
            Distance of the projector to the right of the camera in metres.
        """
        hidden = np.zeros(depth.shape, np.bool_)
        moved = ends - np.array([baseline_m, 0.0, 0.0])
        margin = self.surface.wave_m + self.surface.folds[:, 0]
        _bound(moved, self.surface.radii, margin, self.view, self._boxes)
        _shade(moved, self.surface, self._bumps, self.view, self._boxes, depth, baseline_m, hidden)
        return hidden


@njit(cache=True)
def _bound(ends: F64, radii: F64, margin: F64, view: F64, boxes: F64) -> None:
    """Compute the bounds of each cone in columns, rows and depths: u0, u1, v0, v1, z0, z1."""
    focal = view[0]
    for c in range(len(ends)):
        z0, z1 = np.inf, -np.inf
        for e in range(2):
            radius = radii[c, e] + margin[c]
            z0, z1 = min(z0, ends[c, e, 2] - radius), max(z1, ends[c, e, 2] + radius)
        boxes[c, 4], boxes[c, 5] = max(z0, 0.0), z1
        for axis in range(2):
            low, high = np.inf, -np.inf
            for e in range(2):
                radius = radii[c, e] + margin[c]
                near, far = ends[c, e, 2] - radius, ends[c, e, 2] + radius
                left, right = ends[c, e, axis] - radius, ends[c, e, axis] + radius
                if near > 0.0:
                    low = min(low, left / (near if left < 0.0 else far))
                    high = max(high, right / (near if right > 0.0 else far))
            boxes[c, 2 * axis] = focal * low + view[1 + axis]
            boxes[c, 2 * axis + 1] = focal * high + view[1 + axis]
            if z0 < _NEAREST_M:
                boxes[c, 2 * axis], boxes[c, 2 * axis + 1] = -np.inf, np.inf


@njit(cache=True)
def _cone_distance(ends: F64, surface: Surface, c: int, x: float, y: float, z: float) -> float:
    """Return the signed distance of a point from a cone with its folds."""
    radii, folds = surface.radii, surface.folds
    ax, ay, az = ends[c, 0, 0], ends[c, 0, 1], ends[c, 0, 2]
    dx, dy, dz = ends[c, 1, 0] - ax, ends[c, 1, 1] - ay, ends[c, 1, 2] - az
    square = dx * dx + dy * dy + dz * dz
    s = 0.0
    if square > 0.0:
        s = min(max(((x - ax) * dx + (y - ay) * dy + (z - az) * dz) / square, 0.0), 1.0)
    qx, qy, qz = x - ax - s * dx, y - ay - s * dy, z - az - s * dz
    radius = radii[c, 0] + s * (radii[c, 1] - radii[c, 0])
    if folds[c, 0] > 0.0:
        bump = math.sin(folds[c, 1] * s * math.sqrt(square) + folds[c, 2])
        radius += folds[c, 0] * bump * bump
    return math.sqrt(qx * qx + qy * qy + qz * qz) - radius


@njit(cache=True)
def _march(ends: F64, surface: Surface, bumps: F64, listed: I64, a: float, b: float, begin: float, end: float) -> float:
    """Return the first depth at which a ray meets a listed cone between two depths; infinity if it meets none."""
    z = begin
    factor = bumps[2] / math.sqrt(1.0 + a * a + b * b)
    while z < end:
        x, y = a * z, b * z
        distance = np.inf
        for c in listed:
            distance = min(distance, _cone_distance(ends, surface, c, x, y, z))
        if bumps[0] > 0.0:
            phase = bumps[1]
            wave = math.sin(40.0 * x + phase) * math.sin(37.0 * y + 2.0 * phase) * math.sin(33.0 * z)
            distance -= bumps[0] * wave
        if distance < HIT_M:
            return z
        z += factor * distance
    return np.inf


@njit(cache=True)
def _row_cones(boxes: F64, v: int, row: I64) -> int:
    """List the cones that may be visible in a row, and return their number."""
    count = 0
    for c in range(len(boxes)):
        if boxes[c, 2] <= v <= boxes[c, 3]:
            row[count] = c
            count += 1
    return count


@njit(cache=True)
def _column_cones(boxes: F64, row: I64, in_row: int, u: float, listed: I64) -> tuple[int, float, float]:
    """List the cones of a row that may be visible in a column; return their number and smallest and largest depth."""
    count, begin, end = 0, np.inf, -np.inf
    for i in range(in_row):
        c = row[i]
        if boxes[c, 0] <= u <= boxes[c, 1]:
            listed[count] = c
            count += 1
            begin, end = min(begin, boxes[c, 4]), max(end, boxes[c, 5])
    return count, begin, end


@njit(cache=True)
def _render(ends: F64, surface: Surface, bumps: F64, view: F64, boxes: F64, image: F64) -> None:
    height, width = image.shape
    row, listed = np.empty(len(ends), np.int64), np.empty(len(ends), np.int64)
    for v in range(height):
        in_row = _row_cones(boxes, v, row)
        if in_row == 0:
            continue
        for u in range(width):
            count, begin, end = _column_cones(boxes, row, in_row, float(u), listed)
            if count > 0:
                a, b = (u - view[1]) / view[0], (v - view[2]) / view[0]
                image[v, u] = _march(ends, surface, bumps, listed[:count], a, b, begin, end)


@njit(cache=True)
def _shade(
    ends: F64, surface: Surface, bumps: F64, view: F64, boxes: F64, depth: F64, baseline: float, hidden: Bool
) -> None:
    """Mark the pixels whose points are in the shadow of cones; the ends are given in the projector's axes."""
    height, width = depth.shape
    row, listed = np.empty(len(ends), np.int64), np.empty(len(ends), np.int64)
    for v in range(height):
        in_row = _row_cones(boxes, v, row)
        if in_row == 0:
            continue
        for u in range(width):
            z = depth[v, u]
            a, b = (u - view[1]) / view[0] - baseline / z, (v - view[2]) / view[0]
            count, begin, end = _column_cones(boxes, row, in_row, view[0] * a + view[1], listed)
            if count > 0:
                end = min(end, z - SHADOW_M)
                hidden[v, u] = _march(ends, surface, bumps, listed[:count], a, b, begin, end) < end
