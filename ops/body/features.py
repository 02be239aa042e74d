"""Relational features: rules over joint trajectories give one word a frame (thesis, 2.2)."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from kinedex.ops.body import primitives as p
from kinedex.ops.body.feature_rules import JOINTS_OF, Primitive, Rule, Term
from kinedex.ops.errors import ParameterError
from kinedex.ops.words import MOST_FEATURES, NO_WORD

F64 = npt.NDArray[np.float64]
Velocity = tuple[int, int, float]  # a joint, the joint it is relative to or −1 for the room, and the window


@lru_cache(maxsize=256)
def window_samples(window_ms: float, rate_hz: float) -> int:
    """Return the number of samples in a velocity window, max(1, ceil(w/1000 · rate)), without float noise."""
    return max(1, math.ceil(round(window_ms / 1000.0 * rate_hz, 9)))


def words(
    positions: F64,
    orientation: F64,
    rate_hz: float,
    rules: Sequence[Rule],
    valid: npt.NDArray[np.bool_] | None = None,
    primitives: Mapping[str, Primitive] | None = None,
) -> npt.NDArray[np.uint64]:
    """Compute the word of every frame.

    Invalid frames divide the take into segments in which velocities and hysteresis start anew. Limb lengths are
    those of the first valid frame for the whole take; a length whose joints are unknown is taken from its stand-ins.

    Parameters
    ----------
    positions : float64 array
        float64 (J, 3, T) in metres, Y up; NaN where a joint is unknown.
    orientation : float64 array (4, T)
        The root's unit quaternion w, x, y, z.
    rate_hz : float
        Frames per second.
    rules : sequence of Rule
        One per feature, the first is bit 0; at most 63.
    valid : bool array (T,)
        The valid frames; None if all are valid.
    primitives : mapping of str to Primitive, optional
        Primitives that rules use besides those of `JOINTS_OF`.

    Returns
    -------
    uint64 array (T,)
        Bit i − 1 is F_i; `NO_WORD` in an invalid frame. A feature that meets a NaN, or a vector without length, is off
        there.

    Raises
    ------
    ParameterError
        If an array has another shape, or the rate is not positive.
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
    if len(rules) > MOST_FEATURES:
        raise ParameterError("rules", f"at most {MOST_FEATURES}", len(rules))
    if valid is None or valid.all():
        return _stretch(positions, orientation, rate_hz, rules, positions[:, :, :1], primitives or {})
    if valid.shape != (frames,):
        raise ParameterError("valid", f"of shape ({frames},)", valid.shape)
    out = np.full(frames, NO_WORD)
    first = positions[:, :, valid.argmax() :][:, :, :1]
    edges = np.flatnonzero(np.diff(valid, prepend=False, append=False))
    for start, stop in edges.reshape(-1, 2).tolist():
        part = np.ascontiguousarray(positions[:, :, start:stop]), np.ascontiguousarray(orientation[:, start:stop])
        out[start:stop] = _stretch(*part, rate_hz, rules, first, primitives or {})
    return out


def words_bytes(rules: Sequence[Rule]) -> int:
    """Return the most memory that `words` takes for a frame besides its input: terms, velocities and their vectors."""
    left = Counter(key for rule in rules for key in _used(rule))
    live: set[Term | Velocity] = set()
    most = 0
    for rule in rules:
        live.update(_used(rule))
        most = max(most, sum(8 if isinstance(key, Term) else 24 for key in live))
        left.subtract(_used(rule))
        live -= {key for key in _used(rule) if not left[key]}
    return most + 120


def _stretch(
    positions: F64,
    orientation: F64,
    rate_hz: float,
    rules: Sequence[Rule],
    measured: F64,
    primitives: Mapping[str, Primitive],
) -> npt.NDArray[np.uint64]:
    """Return the words of consecutive valid frames; limb lengths are measured in one frame, (J, 3, 1)."""
    out = np.zeros(positions.shape[2], dtype=np.uint64)
    if not len(out):
        return out
    plan = _plan(rules)
    body = _Body(positions, orientation, rate_hz, measured[:, :, 0], primitives, plan)
    for bit, rule in enumerate(plan.rules):
        scale = body.scale(plan.lengths_of_rule[bit])
        weak = p.bounds(rule.comparison, rule.weak[0] * scale, rule.weak[1] * scale)
        strong = p.bounds(rule.comparison, rule.strong[0] * scale, rule.strong[1] * scale)
        p.hysteresis(body.quantity(plan.terms_of_rule[bit]), *weak, *strong, bit, out)
        body.forget(*plan.last_used[bit])
    return out


class _Plan:
    """Rules by the numbers of their terms and lengths, which are found sooner than what they stand for.

    Attributes
    ----------
    rules : tuple of Rule
        The rules.
    terms : list of Term
        Their terms, each once.
    lengths : list of tuple of (int, int)
        The pairs of joints whose distances scale thresholds.
    terms_of_rule : list of list of int
        The terms of every rule.
    lengths_of_rule : list of list of (float, int)
        The length of every rule and its stand-ins, each with its factor.
    last_used : list of (list of int, list of Velocity)
        The terms and velocities that no rule behind one needs.
    """

    def __init__(self, rules: Sequence[Rule]) -> None:
        self.rules = tuple(rules)
        self.terms = list(dict.fromkeys(term for rule in rules for term in rule.terms))
        number = {term: i for i, term in enumerate(self.terms)}
        self.terms_of_rule = [[number[term] for term in rule.terms] for rule in rules]
        scales = [((1.0, rule.length), *rule.stand_ins) if rule.length else () for rule in rules]
        self.lengths = list(dict.fromkeys(pairs for several in scales for _, pairs in several))
        self.lengths_of_rule = [
            [(factor, self.lengths.index(pairs)) for factor, pairs in several] for several in scales
        ]
        last = {key: bit for bit, rule in enumerate(rules) for key in _used(rule)}
        self.last_used: list[tuple[list[int], list[Velocity]]] = [([], []) for _ in rules]
        for key, bit in last.items():
            if isinstance(key, Term):
                self.last_used[bit][0].append(number[key])
            else:
                self.last_used[bit][1].append(key)


_PLANS: dict[tuple[int, ...], _Plan] = {}
"""Plans by the identities of their rules, which they keep alive."""


def _plan(rules: Sequence[Rule]) -> _Plan:
    key = tuple(map(id, rules))
    plan = _PLANS.get(key)
    if plan is None:
        if len(_PLANS) >= 8:
            _PLANS.clear()
        plan = _PLANS[key] = _Plan(rules)
    return plan


def _used(rule: Rule) -> list[Term | Velocity]:
    """Return the terms and velocities that a rule needs."""
    return [*rule.terms, *(velocity for term in rule.terms for velocity in _velocities(term))]


def _velocities(term: Term) -> list[Velocity]:
    match term.primitive:
        case "vplane" | "vnplane":
            return [(term.joints[3], term.joints[2], term.window_ms)]
        case "speed":
            return [(joint, -1, term.window_ms) for joint in term.joints]
    return []


class _Body:
    """The trajectories of consecutive valid frames; quantities that several features share are computed once."""

    def __init__(
        self,
        positions: F64,
        orientation: F64,
        rate_hz: float,
        measured: F64,
        primitives: Mapping[str, Primitive],
        plan: _Plan,
    ) -> None:
        self.positions = positions
        self.primitives = primitives
        self.measured = measured
        self.orientation = orientation
        self.rate_hz = rate_hz
        self._plan = plan
        self._lengths: dict[int, float] = {}
        self._terms: dict[int, F64] = {}
        self._velocities: dict[Velocity, F64] = {}

    def forget(self, terms: Iterable[int], velocities: Iterable[Velocity]) -> None:
        """Drop terms and velocities that no further rule needs: they would take more memory than the body."""
        for term in terms:
            self._terms.pop(term, None)
        for velocity in velocities:
            self._velocities.pop(velocity, None)

    def length(self, number: int) -> float:
        if number not in self._lengths:
            ways = (self.measured[a] - self.measured[b] for a, b in self._plan.lengths[number])
            self._lengths[number] = float(sum(math.sqrt(way.dot(way)) for way in ways))
        return self._lengths[number]

    def scale(self, lengths: Sequence[tuple[float, int]]) -> float:
        """Return the length that scales the thresholds of a rule; NaN where neither it nor a stand-in is known."""
        for factor, number in lengths:
            length = factor * self.length(number)
            if not math.isnan(length):
                return length
        return math.nan if lengths else 1.0

    def quantity(self, terms: Sequence[int]) -> F64:
        total = self._term(terms[0])
        for term in terms[1:]:
            total = total + self._term(term)
        return total

    def _term(self, number: int) -> F64:
        found = self._terms.get(number)
        if found is None:
            term = self._plan.terms[number]
            value = self._primitive(term)
            if term.absolute:
                value = np.abs(value)
            found = self._terms[number] = value if term.factor == 1.0 else value * term.factor
        return found

    def _velocity(self, key: Velocity) -> F64:
        """Return the velocity of joint q relative to joint c, or to the room for c = −1."""
        q, c, window_ms = key
        if key not in self._velocities:
            x = self.positions[q] if c < 0 else p.difference(self.positions[q], self.positions[c])
            self._velocities[key] = p.velocity(x, window_samples(window_ms, self.rate_hz), self.rate_hz)
        return self._velocities[key]

    def _primitive(self, term: Term) -> F64:
        x, j = self.positions, term.joints
        match term.primitive:
            case "plane":
                return p.along_plane_normal(x[j[0]], x[j[1]], x[j[2]], p.difference(x[j[3]], x[j[2]]))
            case "vplane":
                return p.along_plane_normal(x[j[0]], x[j[1]], x[j[2]], self._velocity(*_velocities(term)))
            case "nplane":
                return p.along_direction(x[j[0]], x[j[1]], p.difference(x[j[3]], x[j[2]]))
            case "vnplane":
                return p.along_direction(x[j[0]], x[j[1]], self._velocity(*_velocities(term)))
            case "speed":
                speeds = [p.norm(self._velocity(key)) for key in _velocities(term)]
                return speeds[0] if len(speeds) == 1 else np.minimum.reduce(speeds)
            case "angle":
                return p.angle_between(p.difference(x[j[0]], x[j[2]]), p.difference(x[j[1]], x[j[2]]))
            case "segments":
                return p.angle_between(p.difference(x[j[0]], x[j[1]]), p.difference(x[j[2]], x[j[3]]))
            case "tilt":
                up = np.zeros((3, x.shape[2]))
                up[1] = 1.0
                return p.angle_between(p.difference(x[j[1]], x[j[0]]), up)
            case "height":
                return x[j[0], 1] - p.lowest(x, self._joints(without=term.without))
            case "extent_y":
                everything = self._joints()
                return p.highest(x, everything) - p.lowest(x, everything)
            case "extent_xz":
                return p.widest_xz(x, np.array(j, dtype=np.int64))
            case "turn_rate":
                return p.turn_rate(self.orientation, self.rate_hz)
        if term.primitive not in self.primitives:
            raise ParameterError("primitive", f"one of {', '.join((*JOINTS_OF, *self.primitives))}", term.primitive)
        found = self.primitives[term.primitive].compute(x[list(j)], self.rate_hz)
        if np.shape(found) != x.shape[2:]:
            raise ParameterError(f"the result of '{term.primitive}'", f"of shape {x.shape[2:]}", np.shape(found))
        return np.ascontiguousarray(found, np.float64)

    def _joints(self, without: tuple[int, ...] = ()) -> npt.NDArray[np.int64]:
        return _others(len(self.positions), without)


@lru_cache(maxsize=64)
def _others(count: int, without: tuple[int, ...]) -> npt.NDArray[np.int64]:
    """Return the numbers below a count without some of them."""
    return np.array([i for i in range(count) if i not in without], dtype=np.int64)
