"""Relational features turn joint trajectories into one word a frame by rules (thesis, 2.2)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from kinedex.ops.arrays import F64, U64, Bool
from kinedex.ops.body.feature_kernels import (
    ABSOLUTE,
    COLUMNS,
    FIRST,
    GIVEN,
    KIND,
    KINDS,
    STOP,
    WINDOW,
    A,
    frame_words,
)
from kinedex.ops.body.feature_rules import JOINTS_OF, Primitive, Rule, Term
from kinedex.ops.errors import ParameterError
from kinedex.ops.words import MOST_FEATURES, NO_WORD

Pairs = tuple[tuple[int, int], ...]


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

    Invalid frames divide the take into segments in which velocities and hysteresis are restarted. Limb lengths are
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
    """Return the maximum number of bytes that `words` needs per frame besides its input."""
    given = {term for rule in rules for term in rule.terms if term.primitive not in KINDS}
    return 8 + 8 * len(given) + max((24 * len(term.joints) + 32 for term in given), default=0)


def _stretch(
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
        The terms whose values the kernel is given.
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
        """Return the length that scales each rule's thresholds, (R, 1), from the joints of one frame, (J, 3)."""
        lengths: dict[Pairs, float] = {}
        found = [_scale(scale, measured, lengths) for scale in self._scales]
        return np.array(found, np.float64)[self._scale_of_rule, None]


def _scale(ways: Sequence[tuple[float, Pairs]], measured: F64, lengths: dict[Pairs, float]) -> float:
    """Return a length, or the first of its stand-ins that is known; NaN if none is, and 1 for unscaled thresholds."""
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
