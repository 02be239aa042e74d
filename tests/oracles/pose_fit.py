"""A step of the local optimisation by its definition: every row with all unknowns, and the cost of a pose."""

from __future__ import annotations

import numpy as np

from kinedex.ops.depth.cones import BEHIND, ConeBody
from kinedex.ops.depth.points import FrameCloud
from tests.oracles import cone_body


def weights(body: ConeBody, cone: int, s: float) -> np.ndarray:
    """The weight of each joint in a place of a cone's axis: (24,)."""
    found = np.zeros(24)
    for end, share in ((0, 1 - s), (1, s)):
        np.add.at(found, body.joints[cone, end], share * body.shares[cone, end])
    return found


def moves(body: ConeBody, pose: np.ndarray, cone: int, s: float) -> np.ndarray:
    """The derivative of a place of a cone's axis by the displacement and all turns: (3, 3 + 3 P)."""
    rows, w = [np.eye(3)], weights(body, cone, s)
    for pivot in body.pivots:
        a = sum(w[j] * (pose[j] - pose[pivot]) for j in range(24) if cone_body.below(j, pivot))
        rows.append(-cross(np.zeros(3) + a))
    return np.concatenate(rows, axis=1)


def turns(body: ConeBody, cone: int, s: float, offset: np.ndarray) -> np.ndarray:
    """The derivative of what lies beside the axis by the displacement and all turns: (3, 3 + 3 P)."""
    rows = [np.zeros((3, 3))]
    for pivot in body.pivots:
        share = 0.0
        for end, part in ((0, 1 - s), (1, s)):
            others = body.joints[cone, 1 - end][body.shares[cone, 1 - end] > 0]
            for j, w in zip(body.joints[cone, end], body.shares[cone, end], strict=True):
                turned = j == pivot and any(cone_body.below(other, pivot) for other in others)
                share += part * w * (cone_body.below(j, pivot) or turned)
        rows.append(-share * cross(offset))
    return np.concatenate(rows, axis=1)


def cross(v: np.ndarray) -> np.ndarray:
    """The matrix of v × ·."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def camera_place(turn: np.ndarray, point: np.ndarray) -> np.ndarray:
    """A point in the camera's axes, x right, y down, z forward."""
    return (turn.T @ point) * (1, -1, -1)


def correspondence(
    matrix: np.ndarray, turn: np.ndarray, cloud: FrameCloud, sample: np.ndarray, reach: int
) -> tuple[int, int, bool]:
    """The point of a sample, its pixels to the nearest foreground, and whether it is hidden."""
    seen = camera_place(turn, sample)
    u, v = (matrix @ (seen / seen[2]))[:2]
    height, width = cloud.numbers.shape
    u, v = round(min(max(u, 0), width - 1)), round(min(max(v, 0), height - 1))
    u0, v0, u1, v1 = cloud.box
    inside = np.array([min(max(u, u0), u1 - 1), min(max(v, v0), v1 - 1)])
    squares = ((cloud.pixels - inside) ** 2).sum(axis=1)
    order = np.lexsort((cloud.pixels[:, 1], cloud.pixels[:, 0], squares))
    i, j = cloud.pixels[order[0]]
    near = (np.abs(cloud.pixels - (i, j)) <= reach).all(axis=1)
    number = np.flatnonzero(near)[np.argmin(((cloud.points[near] - sample) ** 2).sum(axis=1))]
    point = camera_place(turn, cloud.points[number])
    hidden = seen[2] - point[2] > 0.12 and np.linalg.norm(point[:2] / point[2] - seen[:2] / seen[2]) < 0.02
    return int(number), max(abs(i - u), abs(j - v)), bool(hidden)


def seen_side(body: ConeBody, pose: np.ndarray, point: np.ndarray, height: float) -> tuple:
    """The normal and the distance of the side that the camera sees, the cone, and the place on its axis."""
    d, cone, s, n = cone_body.distance(body, pose, point, height)
    ray = point / np.linalg.norm(point)
    if n @ ray > BEHIND:
        a, b = cone_body.ends(body, pose)[cone]
        one, other = body.radii[cone] * height / body.height_m
        return -ray, (point - a - s * (b - a)) @ -ray - (one + s * (other - one)), cone, s
    return n, d, cone, s


def step(
    body: ConeBody, height: float, matrix: np.ndarray, turn: np.ndarray, pose: np.ndarray, cloud: FrameCloud,
    sigma: float, form: str,
) -> np.ndarray:  # fmt: skip
    """The pose after one step."""
    size = 3 + 3 * len(body.pivots)
    normal, right = 1e-3 * np.eye(size), np.zeros(size)
    normal[3:, 3:] += np.diag(np.repeat(3 * body.stiffness, 3))
    if form == "best":
        for point in cloud.points[:: max(1, len(cloud.points) // 700)]:
            n, d, cone, s = seen_side(body, pose, point, height)
            row = n @ moves(body, pose, cone, s)
            w = (1 + d * d / sigma**2) ** -2
            normal += w * np.outer(row, row)
            right += w * d * row
    axes = cone_body.ends(body, pose)
    for i, sample in enumerate(cone_body.samples(body, pose, height)):
        number, pixels, hidden = correspondence(matrix, turn, cloud, sample, 3)
        if hidden or (form == "best" and pixels <= 1):
            continue
        cone, s = body.sample_cones[i], body.sample_places[i]
        offset = sample - axes[cone, 0] - s * (axes[cone, 1] - axes[cone, 0])
        rows, r = moves(body, pose, cone, s) + turns(body, cone, s, offset), cloud.points[number] - sample
        w = (2 if form == "best" else 1) * (1 + r @ r / (4 * sigma**2)) ** -2
        normal += w * rows.T @ rows
        right += w * rows.T @ r
    found = np.linalg.solve(normal, right)
    angles = found[3:].reshape(-1, 3)
    lengths = np.linalg.norm(angles, axis=1)
    angles *= np.minimum(1, 0.6 / np.maximum(lengths, 1e-300))[:, None]
    return cone_body.turned(body.pivots, pose, angles, found[:3])


def cost(
    body: ConeBody, height: float, matrix: np.ndarray, turn: np.ndarray, pose: np.ndarray, cloud: FrameCloud,
    extrema: np.ndarray,
) -> tuple[float, float, float]:  # fmt: skip
    """The three parts of the cost of a pose."""
    surface = []
    for sample in cone_body.samples(body, pose, height):
        number, _, hidden = correspondence(matrix, turn, cloud, sample, 4)
        surface.append(0.03 if hidden else min(np.linalg.norm(cloud.points[number] - sample), 0.5))
    ends = [abs(cone_body.distance(body, pose, point, height)[0]) for point in extrema]
    every = max(1, len(cloud.points) // 700)
    points = [min(abs(cone_body.distance(body, pose, point, height)[0]), 0.15) for point in cloud.points[::every]]
    return float(np.mean(surface)), float(np.mean(ends)), float(2 * np.mean(points))
