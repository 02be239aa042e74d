"""The floor of a room in plain loops, from the same triples."""

from __future__ import annotations

import math

import numpy as np

Plane = tuple[list[float], float]


def plane_through(a: list[float], b: list[float], c: list[float]) -> Plane | None:
    """Return unit normal and height of the plane through three points; None if they are in a line."""
    u, v = ([q - p for p, q in zip(a, other, strict=True)] for other in (b, c))
    normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    length = math.sqrt(sum(n * n for n in normal))
    if length <= 1e-6:
        return None
    normal = [n / length for n in normal]
    return normal, sum(n * p for n, p in zip(normal, a, strict=True))


def largest_plane(points: np.ndarray, up: list[float], degrees: float, seed: int) -> tuple[int, Plane] | None:
    """Return the number of points within 3 cm of the largest of 300 level planes below the origin, and that plane."""
    best: tuple[int, Plane] | None = None
    tried = 0
    for triple in np.random.default_rng(seed).integers(0, len(points), (30_000, 3)):
        if tried == 300:
            break
        found = plane_through(*(points[k].tolist() for k in triple))
        if found is None:
            continue
        normal, height = found
        cosine = sum(n * u for n, u in zip(normal, up, strict=True))
        if cosine < 0:
            normal, height, cosine = [-n for n in normal], -height, -cosine
        if cosine < math.cos(math.radians(degrees)) or height >= 0:
            continue
        tried += 1
        count = 0
        for point in points.tolist():
            count += abs(sum(n * p for n, p in zip(normal, point, strict=True)) - height) <= 0.03
        if best is None or count > best[0]:
            best = count, (normal, height)
    return best
