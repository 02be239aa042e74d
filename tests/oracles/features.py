"""Naive twin of the 40 features: plain loops over frames, written from the table of definitions, without the YAML."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

JOINTS = (
    "root lhip lknee lankle ltoes rhip rknee rankle rtoes belly chest neck head headtop "
    "lclavicle lshoulder lelbow lwrist lfingers rclavicle rshoulder relbow rwrist rfingers"
).split()

Vector = np.ndarray


class Body:
    """One take: `p(joint)` is its (T, 3) trajectory."""

    def __init__(self, positions: np.ndarray, x_axes: np.ndarray, rate: float) -> None:
        self.positions = positions  # (J, 3, T)
        self.x_axes = x_axes  # (T, 3): the root's X axis
        self.rate = rate
        self.frames = positions.shape[2]

    def p(self, joint: str) -> Vector:
        return self.positions[JOINTS.index(joint)].T

    def dist(self, a: str, b: str) -> float:
        return float(np.linalg.norm(self.p(a)[0] - self.p(b)[0]))

    def vel(self, x: Vector, w: float) -> Vector:
        samples = max(1, math.ceil(round(w / 1000 * self.rate, 9)))
        frames = len(x)
        if frames == 1:
            return np.zeros((1, 3))
        difference = np.diff(x, axis=0)
        difference = np.concatenate([difference, difference[-1:]])
        if frames < samples:
            difference = np.pad(difference, ((0, samples - frames), (0, 0)), mode="symmetric")
        pad = math.ceil(samples / 2)
        padded = np.pad(difference, ((pad, pad), (0, 0)), mode="symmetric")
        smooth = np.stack([np.convolve(padded[:, k], np.full(samples, 1 / samples)) for k in range(3)], axis=1)
        return smooth[samples : samples + frames] * self.rate

    def plane(self, a: str, b: str, c: str, q: str) -> list[float]:
        return [_dot(_unit(_cross(A - C, B - C)), Q - C) for A, B, C, Q in self._zip(a, b, c, q)]

    def vplane(self, a: str, b: str, c: str, q: str, w: float) -> list[float]:
        v = self.vel(self.p(q) - self.p(c), w)
        normals = [_unit(_cross(A - C, B - C)) for A, B, C in self._zip(a, b, c)]
        return [_dot(n, u) for n, u in zip(normals, v, strict=True)]

    def nplane(self, a: str, b: str, c: str, q: str) -> list[float]:
        return [_dot(_unit(B - A), Q - C) for A, B, C, Q in self._zip(a, b, c, q)]

    def vnplane(self, a: str, b: str, c: str, q: str, w: float) -> list[float]:
        v = self.vel(self.p(q) - self.p(c), w)
        return [_dot(_unit(B - A), u) for (A, B), u in zip(self._zip(a, b), v, strict=True)]

    def speed(self, j: str, w: float) -> list[float]:
        return [float(np.linalg.norm(v)) for v in self.vel(self.p(j), w)]

    def angle(self, a: str, b: str, q: str) -> list[float]:
        return [_angle(A - Q, B - Q) for A, B, Q in self._zip(a, b, q)]

    def segments(self, a: str, b: str, c: str, d: str) -> list[float]:
        return [_angle(A - B, C - D) for A, B, C, D in self._zip(a, b, c, d)]

    def ymin(self, t: int, without: tuple[str, ...] = ()) -> float:
        return min(float(self.p(j)[t, 1]) for j in JOINTS if j not in without)

    def ymax(self, t: int) -> float:
        return max(float(self.p(j)[t, 1]) for j in JOINTS)

    def _zip(self, *joints: str) -> zip[tuple[Vector, ...]]:
        return zip(*(self.p(j) for j in joints), strict=True)


def _cross(u: Vector, v: Vector) -> Vector:
    return np.array([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])


def _dot(u: Vector, v: Vector) -> float:
    return float(u[0] * v[0] + u[1] * v[1] + u[2] * v[2])


def _unit(v: Vector) -> Vector:
    size = math.sqrt(_dot(v, v))
    return v / size if size > 0 else np.full(3, np.nan)


def _angle(u: Vector, v: Vector) -> float:
    size = math.sqrt(_dot(u, u)) * math.sqrt(_dot(v, v))
    return math.degrees(math.acos(max(-1.0, min(1.0, _dot(u, v) / size)))) if size > 0 else math.nan


Quantity = tuple[list[float], str, tuple[float, ...], tuple[float, ...]]


class _Quantities:
    """A list of quantities that grows in the order of the features."""

    def __init__(self) -> None:
        self.found: list[Quantity] = []

    def add(self, values: list[float], compare: str, weak: float, strong: float) -> None:
        self.found.append((values, compare, (weak,), (strong,)))

    def both(self, make: Callable[[str], list[float]], compare: str, weak: float, strong: float) -> None:
        for side in "rl":
            self.add(make(side), compare, weak, strong)


def quantities(body: Body) -> list[Quantity]:
    """For F1 to F40: the quantity in every frame, the comparison, the weak and the strong threshold."""
    return [*_upper(body), *_lower(body), *_mix(body)]


def _upper(body: Body) -> list[Quantity]:
    """F1 to F14."""
    humerus = body.dist("rshoulder", "relbow")
    humerus_l = body.dist("lshoulder", "lelbow")
    shoulders = body.dist("rshoulder", "lshoulder")
    chest_len = body.dist("chest", "neck")
    listed = _Quantities()
    add, both = listed.add, listed.both
    both(lambda s: body.vplane("neck", "rhip", "lhip", s + "wrist", 250), ">", 1.3 * humerus_l, 1.8 * humerus_l)
    both(lambda s: body.nplane("chest", "neck", "neck", s + "wrist"), ">=", 0.0, 0.2 * chest_len)
    both(lambda s: body.vnplane("chest", "neck", "neck", s + "wrist", 250), ">", 1.3 * humerus_l, 1.8 * humerus_l)
    both(lambda s: body.angle(s + "shoulder", s + "wrist", s + "elbow"), "<=", 120, 110)
    add(
        [abs(v) for v in body.nplane("lshoulder", "rshoulder", "lwrist", "rwrist")],
        ">=",
        2 * shoulders,
        2.5 * shoulders,
    )
    add(body.vnplane("lwrist", "rwrist", "rwrist", "lwrist", 100), ">=", 1.2 * humerus, 1.4 * humerus)
    both(lambda s: body.vnplane(s + "wrist", "root", s + "wrist", "root", 0), ">=", 1.2 * humerus, 1.4 * humerus)
    both(lambda s: body.speed(s + "fingers", 100), ">=", 2 * humerus, 2.5 * humerus)
    return listed.found


def _lower(body: Body) -> list[Quantity]:
    """F15 to F26."""
    humerus, hips = body.dist("rshoulder", "relbow"), body.dist("rhip", "lhip")
    listed = _Quantities()
    add, both = listed.add, listed.both

    def toes_above(s: str) -> list[float]:
        y = body.p(s + "toes")[:, 1]
        return [float(y[t]) - body.ymin(t) for t in range(body.frames)]

    add(body.plane("root", "lhip", "lankle", "rankle"), ">=", 0, 0.375 * humerus)
    add(body.plane("root", "rankle", "rhip", "lankle"), ">=", 0, 0.375 * humerus)
    both(toes_above, ">=", humerus, 1.2 * humerus)
    add([abs(v) for v in body.nplane("lhip", "rhip", "lankle", "rankle")], ">=", 1.8 * humerus, 2.1 * humerus)
    both(lambda s: body.angle(s + "hip", s + "ankle", s + "knee"), "<=", 120, 110)
    right, left = body.nplane("lhip", "rhip", "lhip", "rankle"), body.nplane("lhip", "rhip", "lhip", "lankle")
    add([a - b for a, b in zip(right, left, strict=True)], "<=", 0, -0.125 * hips)
    vleft = body.vnplane("lhip", "rhip", "rhip", "lankle", 100)
    vright = body.vnplane("lhip", "rhip", "rhip", "rankle", 100)
    together = [a - b for a, b in zip(vleft, vright, strict=True)]
    add(together, ">=", 1.3 * humerus, 1.5 * humerus)
    add([-v for v in together], ">=", 1.3 * humerus, 1.5 * humerus)
    both(
        lambda s: [min(a, b) for a, b in zip(body.speed(s + "toes", 100), body.speed(s + "ankle", 100), strict=True)],
        ">=", 2 * humerus, 2.5 * humerus,
    )  # fmt: skip
    return listed.found


def _mix(body: Body) -> list[Quantity]:
    """F27 to F40."""
    humerus, humerus_l = body.dist("rshoulder", "relbow"), body.dist("lshoulder", "lelbow")
    chain = ["rankle rknee", "rknee rhip", "root belly", "belly chest", "chest neck", "neck head", "head headtop"]
    size = sum(body.dist(*pair.split()) for pair in chain)
    frames = range(body.frames)
    listed = _Quantities()
    add, both = listed.add, listed.both

    def fingers_above(s: str) -> list[float]:
        y = body.p(s + "fingers")[:, 1]
        return [float(y[t]) - body.ymin(t, (s + "fingers", s + "wrist")) for t in frames]

    both(lambda s: body.segments("neck", "root", s + "elbow", s + "shoulder"), "<", 155, 150)
    both(lambda s: body.segments("neck", "root", s + "hip", s + "knee"), ">", 45, 50)
    add(body.plane("lankle", "neck", "rankle", "root"), "<", -0.35 * humerus, -0.5 * humerus)
    spine = [_angle(n - r, np.array([0.0, 1.0, 0.0])) for n, r in zip(body.p("neck"), body.p("root"), strict=True)]
    listed.found.append((spine, "within", (60, 120), (70, 110)))
    both(fingers_above, "<", 1.4 * humerus, 1.2 * humerus)
    s_left, s_right = (body.plane("rhip", "lhip", "neck", side + "shoulder") for side in "lr")
    s = [a - b for a, b in zip(s_left, s_right, strict=True)]
    add(s, ">", 0.35 * humerus_l, 0.40 * humerus_l)
    add(s, "<", -0.35 * humerus_l, -0.40 * humerus_l)
    add([body.ymax(t) - body.ymin(t) for t in frames], "<=", 0.9 * size, 0.8 * size)
    far = ["lankle", "rankle", "lwrist", "rwrist", "headtop", "root"]
    xz = [[math.hypot(*(body.p(a)[t] - body.p(b)[t])[[0, 2]]) for a in far for b in far] for t in frames]
    add([max(row) for row in xz], ">=", 3 * humerus, 3.25 * humerus)
    add(body.speed("root", 0), ">=", 2 * humerus, 2.3 * humerus)
    add(_turning(body), ">=", 50, 100)
    return listed.found


def _turning(body: Body) -> list[float]:
    flat = body.x_axes[:, [0, 2]]
    rates = []
    for t in range(body.frames):
        if t + 1 == body.frames or min(np.linalg.norm(flat[t]), np.linalg.norm(flat[t + 1])) < 1e-12:
            rates.append(0.0)
            continue
        a, b = math.atan2(flat[t][1], flat[t][0]), math.atan2(flat[t + 1][1], flat[t + 1][0])
        turned = abs(math.remainder(b - a, 2 * math.pi))
        rates.append(math.degrees(turned) * body.rate)
    return rates


def _true(value: float, compare: str, bounds: tuple[float, ...]) -> bool:
    if math.isnan(value):
        return False
    return {
        ">": value > bounds[0],
        ">=": value >= bounds[0],
        "<": value < bounds[0],
        "<=": value <= bounds[0],
        "within": bounds[0] <= value <= bounds[-1],
    }[compare]


def words(body: Body) -> list[int]:
    """The word of every frame."""
    result = [0] * body.frames
    for bit, (values, compare, weak, strong) in enumerate(quantities(body)):
        on = False
        for t, value in enumerate(values):
            rises = _true(value, compare, strong) and not (t > 0 and _true(values[t - 1], compare, strong))
            on = rises or (on and _true(value, compare, weak))
            result[t] |= int(on) << bit
    return result


def margins(body: Body) -> np.ndarray:
    """(40, T): how far each quantity is from the nearest of its thresholds, for leaving out what rounding decides."""
    rows = []
    for values, _, weak, strong in quantities(body):
        rows.append([min((abs(v - b) for b in (*weak, *strong)), default=math.inf) for v in values])
    return np.array(rows)
