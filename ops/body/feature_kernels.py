"""This module has the kernel that evaluates all rules of a feature set in one pass over a take, block by block."""

from __future__ import annotations

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64, U64
from kinedex.ops.body import primitives as p
from kinedex.ops.body.feature_rules import JOINTS_OF

BLOCK = 256
"""Frames per block: the data between positions and words then stay in a core's cache."""

KINDS = {name: kind for kind, name in enumerate(JOINTS_OF)}
"""The number of each primitive, by name."""

GIVEN = len(KINDS)
"""The number that stands for a primitive whose values are computed elsewhere and passed in."""

PLANE, NPLANE, VPLANE, VNPLANE, SPEED, ANGLE, SEGMENTS, TILT, HEIGHT, EXTENT_Y, EXTENT_XZ, TURN_RATE = range(GIVEN)
A, B, C, Q, FIRST, STOP, KIND, WINDOW, ABSOLUTE, COLUMNS = range(10)
"""The columns of a term's row: four joints, its range of joints in the list of joints, and its properties."""


@njit(cache=True, nogil=True, error_model="numpy")
def frame_words(
    positions: F64, orientation: F64, rate_hz: float, terms: I64, factors: F64, lists: I64, given: F64, rules: I64,
    thresholds: F64, words: U64,
) -> None:  # fmt: skip
    """Fill in the words of consecutive valid frames.

    Parameters
    ----------
    positions : float64 array (J, 3, T)
        In metres, Y up.
    orientation : float64 array (4, T)
        The root's unit quaternion.
    rate_hz : float
        Frames per second.
    terms : int64 array (N, COLUMNS)
        The terms of all rules, each once.
    factors : float64 array (N,)
        Their factors.
    lists : int64 array
        The joints of terms of any number of them, and the terms of rules.
    given : float64 array (G, T)
        The values of terms that are no primitives of this module.
    rules : int64 array (R, 3)
        Where the terms of each rule begin and end in `lists`, and its comparison.
    thresholds : float64 array (R, 4)
        The low and high weak, and the low and high strong threshold of each rule.
    words : uint64 array (T,)
        The words.
    """
    frames = len(words)
    state = np.zeros(2, np.uint64)
    for start in range(0, frames, BLOCK):
        count = min(BLOCK, frames - start)
        values, vectors = np.empty((len(terms), count)), np.empty((3, 3, count))
        for i in range(len(terms)):
            out = values[i]
            _evaluate(positions, orientation, rate_hz, terms[i], lists, given, vectors, start, out)
            if terms[i, ABSOLUTE]:
                for t in range(count):
                    out[t] = abs(out[t])
            if factors[i] != 1.0:
                for t in range(count):
                    out[t] *= factors[i]
        weak, strong = np.zeros(count, np.uint64), np.zeros(count, np.uint64)
        for bit in range(len(rules)):
            total = _total(values, lists[rules[bit, 0] : rules[bit, 1]], vectors[0, 0])
            low, high = p.bounds(rules[bit, 2], thresholds[bit, 0], thresholds[bit, 1])
            p.add_bit(total, low, high, bit, weak)
            low, high = p.bounds(rules[bit, 2], thresholds[bit, 2], thresholds[bit, 3])
            p.add_bit(total, low, high, bit, strong)
        p.hysteresis(weak, strong, state, words[start : start + count])


@njit(cache=True, nogil=True, error_model="numpy")
def _total(values: F64, terms: I64, total: F64) -> F64:
    """Return the sum of the given rows of values."""
    if len(terms) == 1:
        return values[terms[0]]
    one, other = values[terms[0]], values[terms[1]]
    for t in range(len(total)):
        total[t] = one[t] + other[t]
    for i in range(2, len(terms)):
        more = values[terms[i]]
        for t in range(len(total)):
            total[t] += more[t]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _evaluate(
    x: F64, orientation: F64, rate_hz: float, term: I64, lists: I64, given: F64, vectors: F64, start: int, out: F64
) -> None:
    """Fill in the values of a term without its factor, in the frames from `start` on."""
    a, b, c, q, kind, window = term[A], term[B], term[C], term[Q], term[KIND], term[WINDOW]
    joints = lists[term[FIRST] : term[STOP]]
    n, v, w = vectors[0], vectors[1], vectors[2]
    if kind in (PLANE, VPLANE):
        p.difference(x, a, c, start, v)
        p.difference(x, b, c, start, w)
        p.cross(v, w, n)
    elif kind in (NPLANE, VNPLANE):
        p.difference(x, b, a, start, n)
    if kind in (PLANE, NPLANE):
        p.difference(x, q, c, start, v)
        p.along(n, v, out)
    elif kind in (VPLANE, VNPLANE):
        p.velocity(x, q, c, window, rate_hz, start, v)
        p.along(n, v, out)
    elif kind == SPEED:
        _least_speed(x, joints, window, rate_hz, vectors, start, out)
    elif kind == ANGLE:
        p.difference(x, a, c, start, v)
        p.difference(x, b, c, start, w)
        p.angle_between(v, w, out)
    elif kind == SEGMENTS:
        p.difference(x, a, b, start, v)
        p.difference(x, c, q, start, w)
        p.angle_between(v, w, out)
    elif kind == TILT:
        p.difference(x, b, a, start, v)
        w[:] = 0.0
        w[1] = 1.0
        p.angle_between(v, w, out)
    elif kind == HEIGHT:
        p.lowest(x, joints, start, out)
        height = x[a, 1, start : start + len(out)]
        for t in range(len(out)):
            out[t] = height[t] - out[t]
    elif kind == EXTENT_Y:
        p.highest(x, joints, start, out)
        low = v[0]
        p.lowest(x, joints, start, low)
        for t in range(len(out)):
            out[t] -= low[t]
    elif kind == EXTENT_XZ:
        p.widest_xz(x, joints, start, out)
    elif kind == TURN_RATE:
        p.turn_rate(orientation, rate_hz, start, out)
    elif kind == GIVEN:
        out[:] = given[a, start : start + len(out)]


@njit(cache=True, nogil=True, error_model="numpy")
def _least_speed(x: F64, joints: I64, window: int, rate_hz: float, vectors: F64, start: int, out: F64) -> None:
    """Fill in the smallest speed of some joints, NaN where one is unknown."""
    v, speed = vectors[0], vectors[1, 0]
    for i in range(len(joints)):
        p.velocity(x, joints[i], -1, window, rate_hz, start, v)
        p.norm(v, out if i == 0 else speed)
        if i:
            for t in range(len(out)):
                if out[t] == out[t] and not speed[t] >= out[t]:
                    out[t] = speed[t]
