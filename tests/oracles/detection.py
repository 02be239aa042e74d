"""Average precision by sets of frames and plain lists."""

from __future__ import annotations

import math

Segment = tuple[str, int, int]


def share(a: Segment, b: Segment) -> float:
    mine, theirs = set(range(a[1], a[2])), set(range(b[1], b[2]))
    return len(mine & theirs) / len(mine | theirs) if a[0] == b[0] else 0.0


def average_precision(found: list[tuple[str, int, int, float]], known: list[Segment], threshold: float) -> float:
    if not known:
        return math.nan
    left = list(known)
    points: list[tuple[float, float]] = []
    hits = 0
    for rank, one in enumerate(sorted(found, key=lambda one: (-one[3], one[0], one[1], one[2])), start=1):
        best = max(left, key=lambda other: share(one[:3], other), default=None)
        if best is not None and share(one[:3], best) >= threshold - 1e-9:
            left.remove(best)
            hits += 1
        points.append((hits / len(known), hits / rank))
    area, before = 0.0, 0.0
    for recall in sorted({recall for recall, _ in points}):
        area += (recall - before) * max(precision for other, precision in points if other >= recall)
        before = recall
    return area
