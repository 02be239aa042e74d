"""Annotation frame by frame, written from the thesis (5.2) with sets and plain lists."""

from __future__ import annotations

import math

INF = math.inf
CLOSE = 1e-9

Curve = list[float]


def minima(curve: Curve, tau: float) -> list[int]:
    """A local minimum is finite, below tau, and not above either neighbour; outside is ∞."""
    outside = [INF, *curve, INF]
    return [
        frame
        for frame, value in enumerate(curve)
        if value < tau - CLOSE and value <= outside[frame] + CLOSE and value <= outside[frame + 2] + CLOSE
    ]


def modified(curve: Curve, starts: dict[int, int], tau: float) -> Curve:
    """Eq. 5.4: all frames from a_l to l get at most the cost of l."""
    result = [INF] * len(curve)
    for end in minima(curve, tau):
        for frame in range(starts[end], end + 1):
            result[frame] = min(result[frame], curve[end])
    return result


def annotate(
    curves: list[Curve], classes: list[int], taus: float | list[float] = INF
) -> list[tuple[int, int, int, float, int, float]]:
    """Return (start, stop, class, cost, subclass, confidence) of every segment; `curves` are modified ones."""
    if not curves or not curves[0]:
        return []
    length = len(curves[0])
    of_class = [
        [min((curves[s][n] for s in range(len(curves)) if classes[s] == p), default=INF) for n in range(length)]
        for p in range(max(classes) + 1)
    ]
    covered: list[set[int]] = [set() for _ in of_class]
    for n in range(length):
        least = min(curve[n] for curve in of_class)
        if least == INF:
            continue
        p = next(p for p, curve in enumerate(of_class) if curve[n] <= least + CLOSE)
        curve = of_class[p]
        covered[p].add(n)
        r = n  # growing from every labelled frame reaches as far as growing from the ends of its run
        while r > 0 and curve[r - 1] <= curve[r] + CLOSE and curve[r - 1] < INF:
            r -= 1
            covered[p].add(r)
        u = n
        while u + 1 < length and curve[u + 1] <= curve[u] + CLOSE and curve[u + 1] < INF:
            u += 1
            covered[p].add(u)
    segments = []
    for p, frames in enumerate(covered):
        for start in sorted(n for n in frames if n - 1 not in frames):
            stop = next(n for n in range(start, length + 1) if n not in frames)
            cost = min(of_class[p][start:stop])
            at = of_class[p].index(cost, start)
            nearest = next(s for s in range(len(curves)) if classes[s] == p and curves[s][at] <= cost + CLOSE)
            tau = taus if isinstance(taus, float) else taus[p]
            others = [curve for q, curve in enumerate(of_class) if q != p]
            rival = sum(min([tau, *(curve[n] for curve in others)]) for n in range(start, stop)) / (stop - start)
            segments.append((start, stop, p, cost, nearest, 1 - min(cost / rival, 1) if rival > 0 else 0.0))
    return sorted(segments)
