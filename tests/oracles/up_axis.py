"""Naive twin of the judgement of the up axis: one frame, one axis and one joint at a time."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

AXES = ("x", "y", "z", "-x", "-y", "-z")
HEADS = [["head"], ["headtop"], ["neck"], ["lshoulder", "rshoulder"], ["lclavicle", "rclavicle"], ["chest"]]
HIPS = [["lhip", "rhip"], ["root"], ["belly"]]
FEET = [["lankle", "rankle"], ["ltoes", "rtoes"], ["lknee", "rknee"]]


def up_axis(positions: Mapping[str, np.ndarray], rest: Mapping[str, np.ndarray] | None = None) -> tuple[str, float]:
    """The axis, empty where unsure, and the confidence."""
    postures = [found for found in (_posture(positions, t) for t in range(_frames(positions))) if found]
    if not postures:
        return "", 0.0
    spread = _spread(positions) if any(all(name in positions for name in names) for names in FEET) else None
    stood = _posture({name: np.reshape(place, (3, 1)) for name, place in rest.items()}, 0) if rest else None
    share = [sum(posture[axis] for posture in postures) / len(postures) for axis in range(6)]
    stance = [share[axis] + (0.7 * stood[axis] if stood else 0.0) for axis in range(6)]

    def score(axis: int) -> float:
        return stance[axis] + (1.0 if share[axis] > 0.05 else 0.5) * (_ground(spread, axis) if spread else 0.0)

    least = []
    for axis in range(6):
        opposite = stance[(axis + 3) % 6]
        both = stance[axis] + opposite
        leads = [2.0 * (stance[axis] - opposite) / both if both else 0.0]
        leads += [score(axis) - score(other) for other in range(6) if other % 3 != axis % 3]
        least.append(min(leads))
    confidence = 1 - math.exp(-1.6 * max(0.0, *least))
    return (AXES[least.index(max(least))] if confidence >= 0.5 else ""), confidence


def _ground(spread: list[float], axis: int) -> float:
    travel = max(spread[6 + other] for other in range(3) if other != axis % 3)
    return min(max((travel - spread[axis]) / 0.08, 0.0), 1.0) * max(1.0 - spread[axis] / 0.15, 0.0)


def _frames(positions: Mapping[str, np.ndarray]) -> int:
    return next(iter(positions.values())).shape[1] if positions else 0


def _posture(positions: Mapping[str, np.ndarray], frame: int) -> list[float] | None:
    hips, head, feet = (_middle(positions, choices, frame) for choices in (HIPS, HEADS, FEET))
    if hips is None or (head is None and feet is None):
        return None
    votes = []
    for axis in range(6):
        trunk = None if head is None else _cosine([a - b for a, b in zip(head, hips, strict=True)], axis)
        legs = None if feet is None else _cosine([a - b for a, b in zip(hips, feet, strict=True)], axis)
        if any(value is not None and math.isnan(value) for value in (trunk, legs)):
            return None
        if trunk is None or legs is None:
            votes.append(0.75 if max(v for v in (trunk, legs) if v is not None) > 0.75 else 0.0)
        elif trunk > 0.75 and legs > 0.75:
            votes.append(1.0)
        else:
            votes.append(0.5 if trunk > 0.85 and legs > 0.4 else 0.0)
    return votes


def _middle(positions: Mapping[str, np.ndarray], choices: list[list[str]], frame: int) -> list[float] | None:
    for names in choices:
        if all(name in positions for name in names):
            middle = []
            for k in range(3):
                seen = [float(positions[name][k, frame]) for name in names if not math.isnan(positions[name][k, frame])]
                middle.append(sum(seen) / len(seen) if seen else math.nan)
            return middle
    return None


def _cosine(vector: list[float], axis: int) -> float:
    length = math.sqrt(sum(v * v for v in vector))
    return (vector[axis % 3] if axis < 3 else -vector[axis % 3]) / length if length else math.nan


def _spread(positions: Mapping[str, np.ndarray]) -> list[float] | None:
    """Of the lowest point along each axis, and of the hips along x, y and z."""
    hips = [_middle(positions, HIPS, t) for t in range(_frames(positions))]
    whole = [
        t
        for t, middle in enumerate(hips)
        if np.isfinite(middle or [0.0]).all() and all(np.isfinite(place[:, t]).all() for place in positions.values())
    ]
    if len(whole) < 3:
        return None
    heights = [[[float(place[k, t]) for place in positions.values()] for k in range(3)] for t in whole]
    size = float(np.median([math.sqrt(sum((max(row) - min(row)) ** 2 for row in frame)) for frame in heights]))
    if not 0 < size < math.inf:
        return None
    tracks = [[min(frame[k]) for frame in heights] for k in range(3)]
    tracks += [[-max(frame[k]) for frame in heights] for k in range(3)]
    tracks += [[(hips[t] or [0.0] * 3)[k] for t in whole] for k in range(3)]
    cut = len(whole) // 8
    return [(sorted(track)[len(whole) - 1 - cut] - sorted(track)[cut]) / size for track in tracks]
