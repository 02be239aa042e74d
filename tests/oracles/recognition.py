"""Naive twins of the kernels of `kinedex.ops.numeric`: channels in plain numpy, and paths frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.facing_direction import facing_yaw, turn_about_y
from kinedex.ops.numeric.channels import EXTREMITIES, MAX_SPEED, MAX_TURN, running_mean

Span = tuple[int, int, int]
"""A span's first frame, the frame behind it, and its class."""


def channels(positions: F64, joints: Sequence[str], rate_hz: float) -> tuple[F64, F64]:
    """Return the channels (L, C) and the heading (L,) of a body whose joints are all known."""
    at = {name: positions[:, index] for index, name in enumerate(joints)}
    left, right = (np.stack([at[side + "hip"], at[side + "shoulder"]], axis=1) for side in "lr")
    yaw = running_mean(np.unwrap(facing_yaw(left, right)), rate_hz / 6)
    legs = [
        np.linalg.norm(at[side + "hip"] - at[side + "knee"], axis=1)
        + np.linalg.norm(at[side + "knee"] - at[side + "ankle"], axis=1)
        for side in "lr"
    ]
    leg = np.mean([np.median(one) for one in legs])
    pose = _along(positions - at["root"][:, None] * np.array([1.0, 0.0, 1.0]), yaw) / leg
    velocities = _along(np.gradient(positions, axis=0) * rate_hz / leg, yaw)
    limited = np.clip(velocities, -MAX_SPEED, MAX_SPEED)
    turning = np.clip(np.gradient(yaw) * rate_hz, -MAX_TURN, MAX_TURN)
    parts = [
        pose[:, 1:].reshape(len(pose), -1),
        limited[:, [list(joints).index(name) for name in EXTREMITIES]].reshape(len(pose), -1),
        np.minimum(np.linalg.norm(velocities, axis=2), MAX_SPEED),
        limited[:, 0],
        np.stack([turning, np.abs(turning), pose[:, 0, 1]], axis=1),
    ]
    return np.concatenate(parts, axis=1), yaw


def _along(vectors: F64, yaw: F64) -> F64:
    return np.stack([turn_about_y(one, -angle) for one, angle in zip(vectors, yaw.tolist(), strict=True)])


def changes(evidence: F64, firsts: I64, readiness: float, cost: float) -> set[int]:
    """Return the frames in which a motion of the most probable sequence begins, 0 among them.

    Every frame has, for each state and for the background, the value of the best sequence and its beginnings.
    """
    classes = list(zip(firsts[:-1].tolist(), firsts[1:].tolist(), strict=True))
    before: dict[int, tuple[float, tuple[int, ...]]] = {-1: (0.0, (0,))}  # −1 is the background
    for first, _ in classes:
        before[first] = (evidence[0, first] + readiness, (0,))
    for t in range(1, len(evidence)):
        ends = [before[-1], *(before[last - 1] for _, last in classes if last - 1 in before)]
        value, begins = max(ends, key=lambda one: one[0])
        begun = (value - cost, (*begins, t))
        now = {-1: max(before[-1], begun, key=lambda one: one[0])}
        for first, last in classes:
            for state in range(first, last):
                options = [before[s] for s in range(state, max(state - 3, first - 1), -1) if s in before]
                options += [begun] if state == first else []
                if options:
                    best = max(options, key=lambda one: one[0])
                    now[state] = (best[0] + evidence[t, state] + readiness, best[1])
        before = now
    return set(max(before.values(), key=lambda one: one[0])[1])


def path_evidence(evidence: F64) -> float:
    """Return the evidence of the best path from the first to the last state (L, S), −∞ if there is none."""
    value = {0: float(evidence[0, 0])}
    for row in evidence[1:]:
        value = {
            state: max(value[s] for s in range(state - 2, state + 1) if s in value) + float(row[state])
            for state in range(len(row))
            if any(s in value for s in range(state - 2, state + 1))
        }
    return value.get(evidence.shape[1] - 1, -np.inf)


def best_spans(evidence: F64, firsts: I64, cuts: I64, worth: dict[Span, float], readiness: float) -> list[Span]:
    """Return the spans between cuts with the greatest sum of scores; the worth has all that may be chosen."""
    best: dict[int, tuple[float, list[Span]]] = {int(cuts[0]): (0.0, [])}
    for stop in cuts[1:].tolist():
        options = [max(best.values(), key=lambda one: one[0])]
        for start in [cut for cut in best if cut < stop]:
            for k in range(len(firsts) - 1):
                if (start, stop, k) in worth:
                    own = evidence[start:stop, firsts[k] : firsts[k + 1]] + readiness
                    score = path_evidence(own) + worth[start, stop, k]
                    options.append((best[start][0] + score, [*best[start][1], (start, stop, k)]))
        best[stop] = max(options, key=lambda one: one[0])
    return best[int(cuts[-1])][1]


def every_span(cuts: I64) -> list[tuple[int, int]]:
    """Return all pairs of cuts."""
    return list(combinations(cuts.tolist(), 2))
