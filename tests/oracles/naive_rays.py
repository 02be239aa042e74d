"""A naive ray marcher: every ray goes past every cone, in plain loops."""

from __future__ import annotations

import math

import numpy as np

from kinedex.ops.simulation.depth_rays import Surface
from kinedex.ops.simulation.depth_sensors import DepthSensor

Cone = tuple[float, ...]


def cones_of(surface: Surface, ends: np.ndarray) -> list[Cone]:
    """Return each cone as plain numbers: an end, the axis, both radii, and the folds, whose phase runs with s."""
    rows = []
    for (a, b), radii, (height, per_metre, phase) in zip(ends, surface.radii, surface.folds, strict=True):
        length = math.sqrt(float((b - a) @ (b - a)))
        rows.append((*a.tolist(), *(b - a).tolist(), *radii.tolist(), height, per_metre * length, phase))
    return rows


def distance(surface: Surface, cones: list[Cone], x: float, y: float, z: float) -> float:
    """Return the signed distance of a point from all cones with their clothes."""
    found = math.inf
    for ax, ay, az, bx, by, bz, ra, rb, height, per_s, phase in cones:
        px, py, pz = x - ax, y - ay, z - az
        square = bx * bx + by * by + bz * bz
        s = min(max((px * bx + py * by + pz * bz) / square, 0.0), 1.0) if square else 0.0
        radius = ra + s * (rb - ra) + height * math.sin(per_s * s + phase) ** 2
        found = min(found, math.hypot(px - s * bx, py - s * by, pz - s * bz) - radius)
    turn = surface.wave_phase
    return found - surface.wave_m * math.sin(40 * x + turn) * math.sin(37 * y + 2 * turn) * math.sin(33 * z)


def march(surface: Surface, cones: list[Cone], a: float, b: float, end: float) -> float:
    """Return the depth at which a ray along (a, b, 1) comes within a millimetre; infinity beyond `end`."""
    z, length = 0.3, math.hypot(a, b, 1.0)
    while z < end:
        away = distance(surface, cones, z * a, z * b, z)
        if away < 0.001:
            return z
        z += surface.step * away / length
    return math.inf


def ways(sensor: DepthSensor) -> list[list[tuple[float, float]]]:
    """Return the (a, b) of the ray of each pixel, by rows."""
    (width, height), (cx, cy) = sensor.size, sensor.centre
    across = [(u - cx) / sensor.focal_px for u in range(width)]
    return [[(a, (v - cy) / sensor.focal_px) for a in across] for v in range(height)]


def naive_depth(surface: Surface, ends: np.ndarray, sensor: DepthSensor) -> np.ndarray:
    """Return the depth (H, W) of cones; infinite where a ray meets none."""
    cones = cones_of(surface, ends)
    return np.array([[march(surface, cones, a, b, 6.0) for a, b in row] for row in ways(sensor)])


def naive_shadow(
    surface: Surface, ends: np.ndarray, sensor: DepthSensor, depth: np.ndarray, baseline: float
) -> np.ndarray:
    """Return the pixels (H, W) whose points a projector to the right of the camera does not reach."""
    cones = cones_of(surface, ends - np.array([baseline, 0.0, 0.0]))
    hidden = np.zeros(depth.shape, bool)
    for v, row in enumerate(ways(sensor)):
        for u, (a, b) in enumerate(row):
            z = float(depth[v, u])
            hidden[v, u] = march(surface, cones, a - baseline / z, b, z - 0.01) < math.inf
    return hidden
