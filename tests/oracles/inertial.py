"""Naive twins of the numbers of inertial sensors: one frame, one lag, one pair at a time, and the thesis as printed."""

from __future__ import annotations

import math

import numpy as np

Array = np.ndarray


def product(p: Array, q: Array) -> Array:
    """Return p ∘ q by the rule of real and imaginary parts."""
    imaginary = p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])
    return np.array([p[0] * q[0] - p[1:] @ q[1:], *imaginary])


def inverse(q: Array) -> Array:
    return np.array([q[0], -q[1], -q[2], -q[3]])


def exp_deg(vector: tuple[float, float, float]) -> Array:
    """Return the rotation by a vector's length in degrees about it."""
    angle = math.radians(math.sqrt(sum(v * v for v in vector)))
    if angle == 0.0:
        return np.array([1.0, 0.0, 0.0, 0.0])
    share = math.sin(angle / 2) / angle
    return np.array([math.cos(angle / 2), *(math.radians(v) * share for v in vector)])


def distance_deg(p: Array, q: Array) -> float:
    """Return the angle between two rotations, by the trace of a matrix."""
    turned = matrix(p).T @ matrix(q)
    return math.degrees(math.acos(min(1.0, max(-1.0, (np.trace(turned) - 1.0) / 2.0))))


def matrix(q: Array) -> Array:
    """Return the rotation matrix whose columns are the turned unit vectors."""
    return np.stack([product(product(q, np.array([0.0, *axis])), inverse(q))[1:] for axis in np.eye(3)], axis=1)


def printed_log(q: Array) -> Array:
    """Thesis, Eq. 7.10, with the sign that makes it the short way round."""
    q = q if q[0] >= 0.0 else -q
    length = math.sqrt(q[1:] @ q[1:])
    return np.zeros(3) if length == 0.0 else 2.0 * math.acos(min(1.0, q[0])) * q[1:] / length


def park_martin(sensor: Array, track: Array, pairs: list[tuple[int, int]]) -> tuple[Array, Array]:
    """Return the matrices of q_G and q_L as the thesis prints their solution (Eqs. 7.9 to 7.15)."""
    rotations = [
        (product(inverse(sensor[s]), sensor[t]), product(inverse(track[s]), track[t]),
         product(sensor[s], inverse(sensor[t])), product(track[s], inverse(track[t])))
        for s, t in pairs
    ]  # fmt: skip
    # q^A ∘ q^X = q^X ∘ q^B with q^X the conjugate of q^L, and of q^G in the dual equation
    mount = _printed_solution([a for a, *_ in rotations], [b for _, b, *_ in rotations]).T
    world = _printed_solution([c for *_, c, _ in rotations], [d for *_, d in rotations]).T
    return world, mount


def _printed_solution(first: list[Array], second: list[Array]) -> Array:
    """Eqs. 7.11 to 7.14."""
    m = sum(np.outer(printed_log(b), printed_log(a)) for a, b in zip(first, second, strict=True))
    values, vectors = np.linalg.eigh(m.T @ m)
    return vectors @ np.diag(values**-0.5) @ vectors.T @ m.T


def error(sensor: Array, track: Array, world: Array, mount: Array, axis: Array) -> tuple[float, float, float]:
    """Return error, swing and twist of one frame in degrees, by matrices."""
    turn = matrix(track).T @ matrix(world) @ matrix(sensor) @ matrix(mount).T
    cosine = lambda value: math.degrees(math.acos(min(1.0, max(-1.0, value))))  # noqa: E731
    axis = axis / np.linalg.norm(axis)
    moved = turn @ axis
    swing = cosine(axis @ moved)
    # the shortest turn of the axis undone, a turn about the axis is left
    across = np.cross(moved, axis)
    length = np.linalg.norm(across)
    back = np.eye(3)
    if length > 1e-9:
        x, y, z = across / length
        k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        back = np.eye(3) + math.sin(math.radians(swing)) * k + (1.0 - math.cos(math.radians(swing))) * k @ k
    twist = cosine((np.trace(back @ turn) - 1.0) / 2.0)
    return cosine((np.trace(turn) - 1.0) / 2.0), swing, twist


def correlation(take: Array, sensor: Array, least: int, variance_share: float) -> Array:
    """Return the normalised correlation at every lag from −(T − 1) to N − 1; −1 where the lag does not count."""
    values = []
    for lag in range(-(len(take) - 1), len(sensor)):
        pairs = [(take[i], sensor[i + lag]) for i in range(len(take)) if 0 <= i + lag < len(sensor)]
        a, b = (np.array(column) for column in zip(*pairs, strict=True))
        a, b = a - a.mean(), b - b.mean()
        whole = (np.var(take) * len(take), np.var(sensor) * len(sensor))
        enough = a @ a >= variance_share * whole[0] and b @ b >= variance_share * whole[1]
        values.append(a @ b / math.sqrt((a @ a) * (b @ b)) if len(pairs) >= least and enough else -1.0)
    return np.array(values)


def wrong_runs(
    degrees: list[float], valid: list[bool], tau: float, low: float | None, gap: int, least: int
) -> list[tuple[int, int]]:
    """Return the runs above τ, frame by frame; gap and least in frames."""
    wrong = [v and e > tau for e, v in zip(degrees, valid, strict=True)]
    if low is not None:
        for order in (range(1, len(wrong)), range(len(wrong) - 2, -1, -1)):
            for k in order:
                before = k - 1 if order.step == 1 else k + 1
                wrong[k] = wrong[k] or (wrong[before] and valid[k] and degrees[k] > low)
    for start in range(len(wrong)):
        if wrong[start]:
            further = [k for k in range(start + 1, len(wrong)) if wrong[k]]
            if further and further[0] - start - 1 <= gap:
                wrong[start : further[0]] = [True] * (further[0] - start)
    found, start = [], None
    for k, flag in enumerate([*wrong, False]):
        if flag and start is None:
            start = k
        if not flag and start is not None:
            if k - start >= least:
                found.append((start, k))
            start = None
    return found


def whitened_steps(
    limbs: list[tuple[Array, Array, Array]], shared: int, model: Array, weightings: int, outlier: float
) -> Array:
    """Return what limbs share, and then what is each one's own, by least squares on one matrix of all whitened frames.

    A limb has its residuals (n, 3), its design (n, 3, columns), and the number of frames that each frame follows.
    """
    own = limbs[0][1].shape[2] - shared
    lines, values = [], []
    for number, (residuals, design, follows) in enumerate(limbs):
        for k in range(len(residuals)):
            if follows[k] < len(model):
                continue
            line = np.zeros((3, shared + own * len(limbs)))
            value = residuals[k].copy()
            part = design[k].copy()
            for lag, share in enumerate(model, 1):
                value -= share * residuals[k - lag]
                part -= share * design[k - lag]
            line[:, :shared] = part[:, :shared]
            line[:, shared + own * number : shared + own * (number + 1)] = part[:, shared:]
            lines.append(line)
            values.append(value)
    found = np.zeros(shared + own * len(limbs))
    for _ in range(weightings):
        squares = [float(np.sum((value - line @ found) ** 2)) for line, value in zip(lines, values, strict=True)]
        variance = np.median(squares) / 2.366
        roots = [1.0 / (1.0 + square / (3.0 * outlier**2 * variance)) for square in squares]
        weighted = zip(lines, values, roots, strict=True)
        a, b = zip(*((root * line, root * value) for line, value, root in weighted), strict=True)
        found = np.linalg.lstsq(np.concatenate(a), np.concatenate(b), rcond=None)[0]
    return found
