"""A naive ray marcher: every ray goes past every cone, in plain loops."""

from __future__ import annotations

import math

import numpy as np

from kinedex.ops.simulation.depth_flesh import Surface
from kinedex.ops.simulation.depth_sensors import DepthSensor


def distance(surface: Surface, ends: np.ndarray, point: np.ndarray) -> float:
    """Return the signed distance of a point from all cones with their clothes."""
    found = math.inf
    for (a, b), (ra, rb), (height, per_metre, phase) in zip(ends, surface.radii, surface.folds, strict=True):
        axis = b - a
        s = min(max(float((point - a) @ axis) / float(axis @ axis), 0.0), 1.0) if axis.any() else 0.0
        radius = ra + s * (rb - ra) + height * math.sin(per_metre * s * math.sqrt(float(axis @ axis)) + phase) ** 2
        found = min(found, float(np.linalg.norm(point - a - s * axis)) - radius)
    x, y, z = point
    turn = surface.wave_phase
    return found - surface.wave_m * math.sin(40 * x + turn) * math.sin(37 * y + 2 * turn) * math.sin(33 * z)


def march(surface: Surface, ends: np.ndarray, way: np.ndarray, end: float) -> float:
    """Return the depth at which a ray along (a, b, 1) comes within a millimetre; infinity beyond `end`."""
    z = 0.3
    while z < end:
        away = distance(surface, ends, z * way)
        if away < 0.001:
            return z
        z += surface.step * away / float(np.linalg.norm(way))
    return math.inf


def naive_depth(surface: Surface, ends: np.ndarray, sensor: DepthSensor) -> np.ndarray:
    """Return the depth (H, W) of cones; infinite where a ray meets none."""
    (width, height), (cx, cy) = sensor.size, sensor.centre
    ways = [
        [np.array([(u - cx), (v - cy), sensor.focal_px]) / sensor.focal_px for u in range(width)] for v in range(height)
    ]
    return np.array([[march(surface, ends, way, 6.0) for way in row] for row in ways])


def naive_shadow(
    surface: Surface, ends: np.ndarray, sensor: DepthSensor, depth: np.ndarray, baseline: float
) -> np.ndarray:
    """Return the pixels (H, W) whose points a projector to the right of the camera does not reach."""
    (width, height), (cx, cy) = sensor.size, sensor.centre
    moved = ends - np.array([baseline, 0.0, 0.0])
    hidden = np.zeros((height, width), bool)
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            way = np.array([(u - cx) / sensor.focal_px - baseline / z, (v - cy) / sensor.focal_px, 1.0])
            hidden[v, u] = march(surface, moved, way, z - 0.01) < math.inf
    return hidden
