"""This module computes relational features, which rules derive from joint trajectories (thesis, Section 2.2)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.arrays import F64, I64, U64, Bool
from kinedex.ops.body import primitives as p
from kinedex.ops.body.feature_rules import JOINTS_OF, Primitive, Rule, Term
from kinedex.ops.errors import ParameterError
from kinedex.ops.words import MAX_FEATURES, NO_WORD

Pairs = tuple[tuple[int, int], ...]

BLOCK = 256
"""Frames per block, chosen so that all intermediate data of a block fit into a core's cache."""

KINDS = {name: kind for kind, name in enumerate(JOINTS_OF)}
"""The number of each primitive, by name."""

GIVEN = len(KINDS)
"""The number of any primitive whose values are computed outside the kernel and passed to it."""

PLANE, NPLANE, VPLANE, VNPLANE, SPEED, ANGLE, SEGMENTS, TILT, HEIGHT, EXTENT_Y, EXTENT_XZ, TURN_RATE = range(GIVEN)
A, B, C, Q, FIRST, STOP, KIND, WINDOW, ABSOLUTE, COLUMNS = range(10)
"""The columns of the array of terms: four joints, a range in the list of joints, and further properties."""


@lru_cache(maxsize=256)
def window_samples(window_ms: float, rate_hz: float) -> int:
    """Return the number of samples in a velocity window, max(1, ceil(w/1000 · rate)), robust to rounding errors."""
    return max(1, math.ceil(round(window_ms / 1000.0 * rate_hz, 9)))


def words(
    positions: F64,
    orientation: F64,
    rate_hz: float,
    rules: Sequence[Rule],
    valid: Bool | None = None,
    primitives: Mapping[str, Primitive] | None = None,
) -> U64:
    """Compute the word of every frame.

    Invalid frames divide the take into segments, and velocities and hysteresis begin anew in each segment. Limb lengths
    are measured in the first valid frame and used for the whole take. If the joints of a length are unknown, one of its
    stand-ins is used.

    Parameters
    ----------
    positions : float64 array
        Joint positions (J, 3, T) in metres, Y up; NaN if a joint is unknown.
    orientation : float64 array (4, T)
        The root's unit quaternion w, x, y, z.
    rate_hz : float
        Frames per second.
    rules : sequence of Rule
        One rule for each feature, that of bit 0 first; at most 63.
    valid : bool array (T,)
        The valid frames; None if all are valid.
    primitives : mapping of str to Primitive, optional
        Primitives that rules use besides those of `JOINTS_OF`.

    Returns
    -------
    uint64 array (T,)
        The words: bit i − 1 is F_i; `NO_WORD` in an invalid frame. A feature is off in frames in which its value is NaN
        or not defined because a vector has length 0.

    Raises
    ------
    ParameterError
        If an array has another shape, the rate is not positive, there are too many rules, or a primitive is unknown.
    """
    positions = np.ascontiguousarray(positions, dtype=np.float64)
    orientation = np.ascontiguousarray(orientation, dtype=np.float64)
    if positions.ndim != 3 or positions.shape[1] != 3:
        raise ParameterError("positions", "of shape (joints, 3, frames)", positions.shape)
    frames = positions.shape[2]
    if orientation.shape != (4, frames):
        raise ParameterError("orientation", f"of shape (4, {frames})", orientation.shape)
    if not (math.isfinite(rate_hz) and rate_hz > 0):
        raise ParameterError("rate_hz", "positive and finite", rate_hz)
    if len(rules) > MAX_FEATURES:
        raise ParameterError("rules", f"at most {MAX_FEATURES}", len(rules))
    if valid is None or valid.all():
        return _segment_words(positions, orientation, rate_hz, rules, positions[:, :, :1], primitives or {})
    if valid.shape != (frames,):
        raise ParameterError("valid", f"of shape ({frames},)", valid.shape)
    out = np.full(frames, NO_WORD)
    first = positions[:, :, valid.argmax() :][:, :, :1]
    edges = np.flatnonzero(np.diff(valid, prepend=False, append=False))
    for start, stop in edges.reshape(-1, 2).tolist():
        part = np.ascontiguousarray(positions[:, :, start:stop]), np.ascontiguousarray(orientation[:, start:stop])
        out[start:stop] = _segment_words(*part, rate_hz, rules, first, primitives or {})
    return out


def words_bytes(rules: Sequence[Rule]) -> int:
    """Return the maximum number of bytes that `words` needs per frame besides its input."""
    given = {term for rule in rules for term in rule.terms if term.primitive not in KINDS}
    return 8 + 8 * len(given) + max((24 * len(term.joints) + 32 for term in given), default=0)


def _segment_words(
    positions: F64,
    orientation: F64,
    rate_hz: float,
    rules: Sequence[Rule],
    measured: F64,
    primitives: Mapping[str, Primitive],
) -> U64:
    """Return the words of consecutive valid frames; `measured` (J, 3, 1) is the frame that gives the limb lengths."""
    out = np.zeros(positions.shape[2], dtype=np.uint64)
    if not len(out):
        return out
    plan = _plan(rules, len(positions), float(rate_hz))
    given = np.empty((len(plan.given), len(out)))
    for row, term in zip(given, plan.given, strict=True):
        row[:] = _given(positions, rate_hz, term, primitives)
    thresholds = plan.thresholds * plan.scales(measured[:, :, 0])
    frame_words(
        positions, orientation, plan.rate_hz, plan.terms, plan.factors, plan.lists, given, plan.limits, thresholds, out
    )
    return out


class _Plan:
    """Rules as the arrays that the kernel `frame_words` takes.

    Parameters
    ----------
    rules : sequence of Rule
        The rules.
    joints : int
        The number of joints of a body.
    rate_hz : float
        Frames per second.

    Attributes
    ----------
    given : list of Term
        The terms whose values are computed outside the kernel.
    """

    def __init__(self, rules: Sequence[Rule], joints: int, rate_hz: float) -> None:
        self.rules = tuple(rules)
        self.rate_hz = rate_hz
        every = list(dict.fromkeys(term for rule in rules for term in rule.terms))
        self.given = [term for term in every if term.primitive not in KINDS]
        self.terms, lists = np.zeros((len(every), COLUMNS), np.int64), list[int]()
        for term, row in zip(every, self.terms, strict=True):
            used = _several(term, joints)
            row[: min(len(term.joints), 4)] = term.joints[:4]
            row[FIRST], row[STOP] = len(lists), len(lists) + len(used)
            lists += used
            row[KIND] = KINDS.get(term.primitive, GIVEN)
            if row[KIND] == GIVEN:
                row[A] = self.given.index(term)
            row[WINDOW], row[ABSOLUTE] = window_samples(term.window_ms, rate_hz), term.absolute
        self.factors = np.array([term.factor for term in every], np.float64)
        self.limits = np.zeros((len(rules), 3), np.int64)
        for rule, row in zip(rules, self.limits, strict=True):
            row[:] = len(lists), len(lists) + len(rule.terms), rule.comparison
            lists += [every.index(term) for term in rule.terms]
        self.lists = np.array(lists, np.int64)
        self.thresholds = np.array([[*rule.weak, *rule.strong] for rule in rules], np.float64).reshape(-1, 4)
        scales = [((1.0, rule.length), *rule.stand_ins) if rule.length else () for rule in rules]
        self._scales = list(dict.fromkeys(scales))
        self._scale_of_rule = np.array([self._scales.index(scale) for scale in scales], np.int64)

    def scales(self, measured: F64) -> F64:
        """Return the lengths (R, 1) that scale the thresholds of the rules, measured in one frame (J, 3)."""
        lengths: dict[Pairs, float] = {}
        found = [_scale(scale, measured, lengths) for scale in self._scales]
        return np.array(found, np.float64)[self._scale_of_rule, None]


def _scale(ways: Sequence[tuple[float, Pairs]], measured: F64, lengths: dict[Pairs, float]) -> float:
    """Return a length, or its first known stand-in; NaN if none is known, and 1 for unscaled thresholds."""
    for factor, pairs in ways:
        if pairs not in lengths:
            steps = (measured[a] - measured[b] for a, b in pairs)
            lengths[pairs] = float(sum(math.sqrt(step.dot(step)) for step in steps))
        length = factor * lengths[pairs]
        if not math.isnan(length):
            return length
    return math.nan if ways else 1.0


def _several(term: Term, joints: int) -> list[int]:
    """Return the joints of a term whose primitive takes any number of joints."""
    if term.primitive in ("height", "extent_y"):
        return [joint for joint in range(joints) if joint not in term.without]
    return list(term.joints) if term.primitive in ("speed", "extent_xz") else []


_PLANS: dict[tuple[object, ...], _Plan] = {}
"""Cached plans by the identities of their rules; the plans keep the rules alive."""


def _plan(rules: Sequence[Rule], joints: int, rate_hz: float) -> _Plan:
    key = (*map(id, rules), joints, rate_hz)
    plan = _PLANS.get(key)
    if plan is None:
        if len(_PLANS) >= 8:
            _PLANS.clear()
        plan = _PLANS[key] = _Plan(rules, joints, rate_hz)
    return plan


def _given(positions: F64, rate_hz: float, term: Term, primitives: Mapping[str, Primitive]) -> npt.ArrayLike:
    """Return the values of a term whose primitive is not in `JOINTS_OF`."""
    if term.primitive not in primitives:
        raise ParameterError("primitive", f"one of {', '.join((*JOINTS_OF, *primitives))}", term.primitive)
    found = primitives[term.primitive].compute(positions[list(term.joints)], rate_hz)
    if np.shape(found) != positions.shape[2:]:
        expected = f"of shape {positions.shape[2:]}"
        raise ParameterError(f"the result of '{term.primitive}'", expected, np.shape(found))
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def frame_words(
    positions: F64, orientation: F64, rate_hz: float, terms: I64, factors: F64, lists: I64, given: F64, rules: I64,
    thresholds: F64, words: U64,
) -> None:  # fmt: skip
    """Compute the words of consecutive valid frames: one bit for each feature.

    Parameters
    ----------
    positions : float64 array (J, 3, T)
        Joint positions in metres, Y up.
    orientation : float64 array (4, T)
        The root's unit quaternion.
    rate_hz : float
        Frames per second.
    terms : int64 array (N, COLUMNS)
        The different terms of all rules.
    factors : float64 array (N,)
        The factors of the terms.
    lists : int64 array
        Lists of varying length, one after the other: the joints of terms, and the terms of rules.
    given : float64 array (G, T)
        The values of terms that are computed outside the kernel.
    rules : int64 array (R, 3)
        The range in `lists` with the terms of each rule, and the number of its comparison.
    thresholds : float64 array (R, 4)
        The low and high weak, and the low and high strong threshold of each rule.
    words : uint64 array (T,)
        Receives the word of each frame.
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
    """Compute the values of a term without its factor into `out`, in the frames from `start` on."""
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
    """Compute the smallest speed of the given joints into `out`; NaN if the speed of a joint is unknown."""
    v, speed = vectors[0], vectors[1, 0]
    for i in range(len(joints)):
        p.velocity(x, joints[i], -1, window, rate_hz, start, v)
        p.norm(v, out if i == 0 else speed)
        if i:
            for t in range(len(out)):
                if out[t] == out[t] and not speed[t] >= out[t]:
                    out[t] = speed[t]
